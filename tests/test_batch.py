"""`guidefield batch`: over worker processes, interrupted and taken up again; over a Ray cluster that loses a node.

Nothing is lost, nothing is asked twice, whatever a killed process left behind.
"""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result
from hypothesis import given, strategies as st
from typer.testing import CliRunner

import guidefield
from guidefield.batch import (
    BYTES_AHEAD,
    RESULTS,
    Item,
    ItemAnswer,
    RequestFile,
    Results,
    _over_pool,
    _why,
    find_longest_time,
    make_crash_answer,
)
from guidefield.cli import app
from guidefield.errors import MalformedRequest, WorkerCrashed
from guidefield.pool.process import Work
from guidefield.pool.waiting import BACKSTOP, LONGEST_WORK, Task
from guidefield.recorder.stored import read_recording
from guidefield.stores.recordings import Recordings

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


BALL = {"name": "ball", "obstacles": [{"type": "sphere", "name": "s", "radius": 0.1}]}
PLAN = {
    "robot": "ur5",
    "scene": "table",
    "goal": {"type": "joints", "positions": {"elbow_joint": 1.2}},
    "guide_planes": [],
    "allowed_planning_time": 60.0,
}
PATIENCE = 600.0


def _potential(number: int) -> dict[str, Any]:
    return {"type": "potential", "scene": BALL, "points": [[0.0, 0.0, 1.0 + number]]}


def _written(path: Path, requests: list[dict[str, Any]]) -> Path:
    path.write_text("\n".join(json.dumps(request) for request in requests))
    return path


def _command(requests: Path, folder: Path, *options: str) -> list[str]:
    return [sys.executable, "-m", "guidefield", "batch", str(requests), "-o", str(folder), "--workers", "1", *options]


def _here(requests: Path, folder: Path, *options: str) -> Result:
    """The same in this process, which has loaded all that it needs."""
    return CliRunner().invoke(app, _command(requests, folder, *options)[3:])


def _results(folder: Path) -> dict[int, dict[str, Any]]:
    lines = [json.loads(line) for line in (folder / RESULTS).read_text().splitlines()]
    assert len({line["line"] for line in lines}) == len(lines), "nothing is answered twice"
    return {line["line"]: line for line in lines}


def test_a_batch_is_killed_taken_up_and_finished(tmp_path: Path) -> None:
    wanted = [PLAN, *(_potential(number) for number in range(400)), {"robot": "r2d2", "scene": "table"}]
    requests, folder = _written(tmp_path / "requests.jsonl", wanted), tmp_path / "out"
    with subprocess.Popen(_command(requests, folder), stderr=subprocess.DEVNULL, start_new_session=True) as first:
        deadline = time.monotonic() + PATIENCE
        while not (folder / RESULTS).exists() or b"\n" not in (folder / RESULTS).read_bytes():
            assert time.monotonic() < deadline
            assert first.poll() is None
            time.sleep(0.002)
        os.kill(first.pid, signal.SIGKILL)
    begun = (folder / RESULTS).read_bytes().count(b"\n")
    second = subprocess.run(_command(requests, folder), check=False, capture_output=True, text=True, timeout=PATIENCE)
    assert second.returncode == 2, second.stderr
    assert "1 MALFORMED_REQUEST" in second.stderr
    found = _results(folder)
    assert sorted(found) == list(range(1, len(wanted) + 1))
    assert 1 <= begun <= len(wanted)
    assert found[1]["reply"]["status"]["name"] == "SUCCESS"
    recording = Path(found[1]["reply"]["recording"])
    assert recording == folder / "recordings" / "1.rrd"
    assert recording.read_bytes()[:3] == b"RRF"
    for number in (0, 7, 399):
        reply = guidefield.answer(_potential(number))
        assert found[number + 2]["reply"]["potential"] == reply.potential
    assert {path.name for path in folder.iterdir()} == {RESULTS, "recordings"}
    before = (folder / RESULTS).read_bytes()
    assert _here(requests, folder).exit_code == 2
    assert (folder / RESULTS).read_bytes() == before, "there was nothing left to do"


def test_recordings_of_a_batch_are_rendered_when_it_is_asked_for(tmp_path: Path) -> None:
    requests, folder = _written(tmp_path / "requests.jsonl", [PLAN, PLAN]), tmp_path / "out"
    recordings = Recordings(folder / "recordings")
    assert "2 SUCCESS" in _here(requests, folder, "--no-render").stderr
    assert sorted(recordings.list_owed()) == ["1", "2"]
    (folder / "recordings" / "2.log").write_bytes(b"damaged")
    said = CliRunner().invoke(app, ["runs", "render", str(folder)])
    assert (said.exit_code, said.stdout) == (1, "1 rendered, 1 lost\n")
    assert {path.name for path in recordings.folder.iterdir()} == {"1.rrd", "2.lost"}
    assert read_recording(recordings.path("1")).reply.recording == str(recordings.path("1"))
    recordings.store_log("1", b"damaged", ())
    assert "recorded" in _here(requests, folder).stderr
    assert {path.name for path in recordings.folder.iterdir()} == {"1.lost", "2.lost"}, "a finished batch renders, too"


def test_a_cluster_that_loses_a_node_answers_all(tmp_path: Path) -> None:
    ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'guidefield[ray]'")
    from ray.cluster_utils import Cluster

    from guidefield.batch import answer_over_cluster

    cluster = Cluster()
    try:
        cluster.add_node(num_cpus=0)  # the head, which does no work
        cluster.add_node(num_cpus=1)
        doomed = cluster.add_node(num_cpus=1)
        cluster.wait_for_nodes()
        wanted = [PLAN, *(_potential(number) for number in range(300))]
        asked = [
            Item(line, json.dumps(request).encode(), tmp_path / f"{line}.rrd") for line, request in enumerate(wanted, 1)
        ]
        found = {}
        for outcome in answer_over_cluster(asked, cluster.address):
            found[outcome.item.line] = outcome
            if len(found) == 20:
                cluster.remove_node(doomed, allow_graceful=False)
        assert sorted(found) == [item.line for item in asked]
        assert all(outcome.is_reply for outcome in found.values())
        for line in (2, 150, 301):
            expected = guidefield.answer(_potential(line - 2))
            assert json.loads(found[line].payload)["potential"] == expected.potential
        assert json.loads(found[1].payload)["status"]["name"] == "SUCCESS"
        assert (tmp_path / "1.rrd").read_bytes()[:3] == b"RRF"
    finally:
        ray.shutdown()
        cluster.shutdown()


def test_a_worker_has_the_time_of_its_request_and_that_of_preparing_a_robot() -> None:
    """A worker was ended, as crashed, that prepared a robot for a minute, or whose kinematics were allowed more."""
    certified = {"type": "certify", "robot": "ur5", "scene": "table", "path": [[0.0], [0.1]], "allowed_time": 900.0}
    for asked, allowed in (
        (PLAN, 60.0),
        ({**PLAN, "allowed_planning_time": 900.0}, 900.0),
        (certified, 900.0),
        ({**_potential(0), "allowed_time": 900.0}, 900.0),
        (_potential(0), 60.0),
    ):
        assert find_longest_time(json.dumps(asked).encode()) == max(LONGEST_WORK, allowed + BACKSTOP)
    assert find_longest_time(b"{") == LONGEST_WORK


def _prepare_nothing() -> Work:
    return lambda job, _call: (True, job)


def test_requests_that_take_much_memory_wait_their_turn() -> None:
    """The queue refused requests beyond 256 MiB, which ended a batch."""
    tasks = ((number, Task(b"%d" % number, LONGEST_WORK, size=BYTES_AHEAD // 2)) for number in range(6))
    answers = {number: task.result() for number, task in _over_pool(_prepare_nothing, tasks, workers=1)}
    assert answers == {number: (True, b"%d" % number) for number in range(6)}


def test_what_a_node_lacks_is_said_without_colours() -> None:
    class TaskError(Exception):
        """As Ray tells what was raised on a node: in colours, the cause beside it."""

        cause = ModuleNotFoundError("No module named 'coal'")

    told = _why(TaskError("\x1b[36mray::_answer()\x1b[39m (pid=1, ip=10.0.0.1)\n  File ...\nModuleNotFoundError: ..."))
    assert told == (
        "a node can't answer: ModuleNotFoundError: No module named 'coal'; guidefield must be installed on every node"
    )
    lost = _why(Exception("\n\x1b[31mThe node died\x1b[0m unexpectedly\nsee the logs"))
    assert lost == "the worker of this request was lost: The node died unexpectedly"


def test_a_cluster_whose_node_lacks_a_package_says_which(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'guidefield[ray]'")
    (tmp_path / "coal.py").write_text("raise ModuleNotFoundError(\"No module named 'coal'\")\n")
    requests = _written(tmp_path / "requests.jsonl", [_potential(0)])
    folder = tmp_path / "results"
    done = subprocess.run(
        [*_command(requests, folder), "--ray", "local"],
        check=False,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])},
    )
    assert done.returncode == 2, done.stderr
    error = _results(folder)[1]["error"]
    assert error["name"] == "CRASH"
    assert "No module named 'coal'; guidefield must be installed on every node" in error["message"]
    assert "\x1b" not in error["message"]


def test_no_cluster_is_said_so(tmp_path: Path) -> None:
    requests = _written(tmp_path / "requests.jsonl", [_potential(0)])
    done = _here(requests, tmp_path, "--ray", "127.0.0.1:1")
    assert "Ray" in f"{done.stderr}{done.exception}"
