"""The results of a batch: nothing is lost, nothing is asked twice, whatever a killed process left behind."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from guidefield.batch.results import RESULTS, Item, Outcome, Results, crashed, items
from guidefield.errors import MalformedRequest, WorkerCrashed

REPLY = b'{"status": {"code": 1, "name": "SUCCESS"}}'


def _item(line: int, request: bytes = b"{}") -> Item:
    return Item(line, request, None)


def test_requests_are_read_line_by_line(tmp_path: Path) -> None:
    (tmp_path / "r.jsonl").write_bytes(b'{"a": 1}\n\n  \n{"b": 2}')
    found = list(items(tmp_path / "r.jsonl", tmp_path / "out", recordings=True))
    assert [(item.line, item.request) for item in found] == [(1, b'{"a": 1}'), (4, b'{"b": 2}')]
    assert found[1].recording == tmp_path / "out" / "recordings" / "4.rrd"
    with pytest.raises(MalformedRequest, match="can't be read"):
        list(items(tmp_path / "nowhere", tmp_path, recordings=False))


def test_what_was_answered_stays_answered(tmp_path: Path) -> None:
    with Results(tmp_path) as results:
        results.add(Outcome(_item(1), True, REPLY))
        results.add(Outcome(_item(2), False, b'{"code": -105, "name": "ROBOT_INVALID"}'))
    with Results(tmp_path) as again:
        assert again.has(_item(1))
        assert again.has(_item(2))
        assert not again.has(_item(3))
        assert not again.has(_item(1, b'{"edited": 1}'))
        assert sorted(again.codes()) == [-105, 1]
    lines = [json.loads(line) for line in (tmp_path / RESULTS).read_text().splitlines()]
    assert lines[0]["reply"]["status"]["name"] == "SUCCESS"
    assert lines[1]["error"]["name"] == "ROBOT_INVALID"


def test_what_crashed_is_told_and_asked_again(tmp_path: Path) -> None:
    with Results(tmp_path) as results:
        results.add(crashed(_item(1), WorkerCrashed("it died")))
        assert "CRASH" in (tmp_path / RESULTS).read_text()
    with Results(tmp_path) as again:
        assert not again.has(_item(1))
        again.add(Outcome(_item(1), True, REPLY))
    assert len((tmp_path / RESULTS).read_text().splitlines()) == 1


def test_a_file_of_somebody_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / RESULTS).write_text('{"speed": 1}\n')
    with pytest.raises(MalformedRequest, match="choose another folder"):
        Results(tmp_path)
    assert (tmp_path / RESULTS).read_text() == '{"speed": 1}\n'


@given(cut=st.integers(0, 3 * 200))
def test_a_file_that_was_cut_anywhere_keeps_its_whole_lines(cut: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("batch")
    with Results(folder) as results:
        for line in (1, 2, 3):
            results.add(Outcome(_item(line), True, REPLY))
    whole = (folder / RESULTS).read_bytes()
    (folder / RESULTS).write_bytes(whole[:cut])
    with Results(folder) as again:
        kept = whole[:cut].count(b"\n")
        assert [again.has(_item(line)) for line in (1, 2, 3)] == [line <= kept for line in (1, 2, 3)]
        for line in (1, 2, 3):
            if not again.has(_item(line)):
                again.add(Outcome(_item(line), True, REPLY))
    assert (folder / RESULTS).read_bytes() == whole
