"""The results of a batch: nothing is lost, nothing is asked twice, whatever a killed process left behind."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from guidefield.batch.results import RESULTS, Item, ItemAnswer, RequestFile, Results, make_crash_answer
from guidefield.errors import MalformedRequest, WorkerCrashed

REPLY = b'{"status": {"code": 1, "name": "SUCCESS"}}'


def _requests(folder: Path, *lines: bytes) -> RequestFile:
    path = folder / "requests.jsonl"
    path.write_bytes(b"\n".join(lines))
    return RequestFile(path)


def _items(requests: RequestFile) -> list[Item]:
    return list(requests.items(Path("out"), recordings=False))


def test_requests_are_read_line_by_line(tmp_path: Path) -> None:
    with _requests(tmp_path, b'{"a": 1}', b"", b"  \r", b'{"b": 2}\r', b'{"c": 3}') as requests:
        for _ in range(2):
            found = list(requests.items(tmp_path / "out", recordings=True))
            assert [(item.line, item.request) for item in found] == [
                (1, b'{"a": 1}'),
                (4, b'{"b": 2}'),
                (5, b'{"c": 3}'),
            ]
        assert len(requests) == 3
        assert found[1].recording == tmp_path / "out" / "recordings" / "4.rrd"
        assert found[1].content == hashlib.sha256(b'{"b": 2}').hexdigest()[:16]
    with pytest.raises(MalformedRequest, match="can't be read"):
        RequestFile(tmp_path / "nowhere")


def test_what_was_answered_stays_answered(tmp_path: Path) -> None:
    with _requests(tmp_path, b"{}", b"{}", b"{}") as requests, Results(tmp_path, requests) as results:
        first, second, _ = _items(requests)
        results.add(ItemAnswer(first, True, REPLY))
        results.add(ItemAnswer(second, False, b'{"code": -105, "name": "ROBOT_INVALID"}'))
    with _requests(tmp_path, b"{}", b"{}", b"{}") as requests, Results(tmp_path, requests) as again:
        assert [again.has(item) for item in _items(requests)] == [True, True, False]
        assert again.codes == {1: 1, -105: 1}
    with _requests(tmp_path, b'{"edited": 1}', b"{}") as requests, Results(tmp_path, requests) as again:
        assert [again.has(item) for item in _items(requests)] == [False, True]
        assert again.codes == {-105: 1}, "the answer to what was edited doesn't count"
    lines = [json.loads(line) for line in (tmp_path / RESULTS).read_text().splitlines()]
    assert lines[0]["reply"]["status"]["name"] == "SUCCESS"
    assert lines[1]["error"]["name"] == "ROBOT_INVALID"


def test_what_crashed_is_told_and_asked_again(tmp_path: Path) -> None:
    with _requests(tmp_path, b"{}") as requests:
        (item,) = _items(requests)
        with Results(tmp_path, requests) as results:
            results.add(make_crash_answer(item, WorkerCrashed("it died")))
            assert not results.has(item)
        with Results(tmp_path, requests) as again:
            assert not again.has(item)
            assert not again.codes
            again.add(ItemAnswer(item, True, REPLY))
        with Results(tmp_path, requests) as answered:
            assert answered.has(item)
            assert answered.codes == {1: 1}
    lines = [json.loads(line) for line in (tmp_path / RESULTS).read_text().splitlines()]
    assert [line.get("error", {}).get("name") for line in lines] == ["CRASH", None], "the last line counts"


def test_one_process_at_a_time_adds_to_results(tmp_path: Path) -> None:
    with _requests(tmp_path, b"{}") as requests:
        with Results(tmp_path, requests), pytest.raises(MalformedRequest, match="another process adds"):
            Results(tmp_path, requests)
        with Results(tmp_path, requests):
            pass


@pytest.mark.parametrize("text", ['{"speed": 1}\n', '{"speed": 1}'])
def test_a_file_of_somebody_else_is_left_alone(text: str, tmp_path: Path) -> None:
    (tmp_path / RESULTS).write_text(text)
    with _requests(tmp_path, b"{}") as requests, pytest.raises(MalformedRequest, match="choose another folder"):
        Results(tmp_path, requests)
    assert (tmp_path / RESULTS).read_text() == text


@given(cut=st.integers(0, 3 * 200))
def test_a_file_that_was_cut_anywhere_keeps_its_whole_lines(cut: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("batch")
    with _requests(folder, b"{}", b"{}", b"{}") as requests:
        wanted = _items(requests)
        with Results(folder, requests) as results:
            for item in wanted:
                results.add(ItemAnswer(item, True, REPLY))
        whole = (folder / RESULTS).read_bytes()
        (folder / RESULTS).write_bytes(whole[:cut])
        with Results(folder, requests) as again:
            kept = whole[:cut].count(b"\n")
            assert [again.has(item) for item in wanted] == [item.line <= kept for item in wanted]
            for item in wanted:
                if not again.has(item):
                    again.add(ItemAnswer(item, True, REPLY))
        assert (folder / RESULTS).read_bytes() == whole
