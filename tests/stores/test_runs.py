from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from guidefield.errors import MalformedRequest, Status, UnknownObject, WorkerCrashed
from guidefield.messages.replies import error_reply
from guidefield.messages.requests import JointsGoal, PlanRequest, UrdfText
from guidefield.messages.scene import Scene
from guidefield.stores import runs
from guidefield.stores.run_folder import RUNNING, UNREADABLE, summary
from guidefield.stores.runs import NoRuns, Retention, RunStore
from tests.replies import plan_reply

REQUEST = PlanRequest(robot="panda", scene="bookshelf", goal=JointsGoal({"a": 1.0}))
CRASH = error_reply(WorkerCrashed("the process died", signal=9))


@pytest.fixture
def store(tmp_path: Path) -> RunStore:
    return RunStore(tmp_path / "runs")


def _ended(store: RunStore, run_id: str, status: Status = Status.SUCCESS) -> None:
    store.begin(run_id, REQUEST)
    store.finish(run_id, plan_reply(run_id, status))


def test_a_run_is_read_back_as_it_was_kept(store: RunStore) -> None:
    before = time.time()
    store.begin("r1", REQUEST)
    running = store.read("r1")
    assert (running.request, running.reply, running.error) == (REQUEST, None, None)
    assert before - 1.0 < running.began < time.time() + 1.0
    store.finish("r1", plan_reply("r1"))
    assert store.read("r1").reply == plan_reply("r1")


def test_the_files_are_where_the_layout_says(store: RunStore, tmp_path: Path) -> None:
    store.begin("r1", REQUEST)
    path = store.recording_path("r1")
    assert path == tmp_path / "runs" / "r1" / "recording.rrd"
    path.write_bytes(b"recording")
    store.finish("r1", plan_reply("r1"))
    assert sorted(file.name for file in path.parent.iterdir()) == ["recording.rrd", "reply.json", "request.json"]
    assert store.recording("r1") == path


def test_a_run_id_is_used_once(store: RunStore) -> None:
    store.begin("r1", REQUEST)
    with pytest.raises(MalformedRequest, match="'r1' is taken"):
        store.begin("r1", REQUEST)
    assert [run.run_id for run in store.summaries()] == ["r1"]


def test_summaries_say_how_a_run_stands(store: RunStore) -> None:
    inline = PlanRequest(robot=UrdfText("<robot/>"), scene=Scene("inline"), goal=JointsGoal({}))
    store.begin("running", inline)
    _ended(store, "found")
    _ended(store, "stuck", Status.STUCK_IN_MINIMUM)
    store.begin("crashed", REQUEST)
    store.fail("crashed", CRASH)
    listed = {run.run_id: run for run in store.summaries()}
    assert {name: run.status for name, run in listed.items()} == {
        "running": RUNNING,
        "found": "SUCCESS",
        "stuck": "STUCK_IN_MINIMUM",
        "crashed": "CRASH",
    }
    assert (listed["running"].robot, listed["running"].scene) == ("urdf", "inline")
    assert (listed["found"].robot, listed["found"].scene) == ("panda", "bookshelf")


def test_a_list_reads_only_what_changed(store: RunStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store.begin("running", REQUEST)
    _ended(store, "ended")
    first = store.summaries()
    read: list[str] = []
    monkeypatch.setattr(runs, "summary", lambda folder: (read.append(folder.name), summary(folder))[1])
    assert store.summaries() == first
    assert read == []
    store.fail("running", CRASH)
    _ended(store, "another")
    reply = tmp_path / "runs" / "ended" / "reply.json"
    reply.write_bytes(reply.read_bytes()[:-10])
    assert {run.run_id: run.status for run in store.summaries()} == {
        "running": "CRASH",
        "another": "SUCCESS",
        "ended": UNREADABLE,
    }
    assert sorted(read) == ["another", "ended", "running"]
    store.delete("another")
    assert store.summaries() == RunStore(tmp_path / "runs").summaries()


def test_the_newest_run_is_listed_first(store: RunStore, tmp_path: Path) -> None:
    for age, name in enumerate(("newest", "middle", "oldest")):
        _ended(store, name)
        os.utime(tmp_path / "runs" / name / "request.json", (1e9 - age, 1e9 - age))
    assert [run.run_id for run in store.summaries()] == ["newest", "middle", "oldest"]


def test_an_error_does_not_replace_a_reply(store: RunStore) -> None:
    _ended(store, "r1")
    store.fail("r1", CRASH)
    assert store.read("r1").error is None
    store.fail("never-begun", CRASH)
    with pytest.raises(UnknownObject):
        store.read("never-begun")


def test_a_refused_request_leaves_no_run(store: RunStore, tmp_path: Path) -> None:
    store.begin("r1", REQUEST)
    store.discard("r1")
    assert list((tmp_path / "runs").iterdir()) == []


@pytest.mark.parametrize("ask", [RunStore.read, RunStore.recording, RunStore.delete, NoRuns.read])
def test_a_run_that_is_not_there_is_said_so(ask: object, store: RunStore) -> None:
    owner = NoRuns() if ask is NoRuns.read else store
    with pytest.raises(UnknownObject, match="no run 'nowhere'"):
        ask(owner, "nowhere")


def test_a_run_without_a_recording_says_so(store: RunStore) -> None:
    _ended(store, "r1")
    with pytest.raises(UnknownObject, match="has no recording"):
        store.recording("r1")


@pytest.mark.parametrize("name", ["../r1", "..", ".r1", "a/b", ""])
def test_no_name_leads_out_of_the_folder(name: str, store: RunStore, tmp_path: Path) -> None:
    (tmp_path / "r1").mkdir()
    for ask in (store.read, store.recording, store.delete):
        with pytest.raises(MalformedRequest):
            ask(name)
    assert (tmp_path / "r1").exists()


def test_a_deleted_run_is_gone(store: RunStore, tmp_path: Path) -> None:
    _ended(store, "r1")
    store.delete("r1")
    assert store.summaries() == []
    assert list((tmp_path / "runs").iterdir()) == []


def test_the_oldest_ended_runs_make_room(tmp_path: Path) -> None:
    store = RunStore(tmp_path, Retention(runs=3))
    store.begin("running", REQUEST)
    for index in range(6):
        _ended(store, f"r{index}")
        os.utime(tmp_path / f"r{index}", (1e9 + index, 1e9 + index))
    assert {run.run_id for run in store.summaries()} == {"running", "r3", "r4", "r5"}


def test_runs_that_are_too_old_are_dropped(tmp_path: Path) -> None:
    store = RunStore(tmp_path, Retention(seconds=3600.0))
    for age, run_id in ((7200.0, "old"), (1800.0, "young")):
        _ended(store, run_id)
        os.utime(tmp_path / run_id, (time.time() - age,) * 2)
    store.begin("running", REQUEST)
    os.utime(tmp_path / "running", (1e9, 1e9))
    store.begin("next", REQUEST)
    assert {run.run_id for run in store.summaries()} == {"young", "running", "next"}


def test_large_recordings_make_room_too(tmp_path: Path) -> None:
    store = RunStore(tmp_path, Retention(bytes=12_000))
    for index in range(4):
        store.begin(f"r{index}", REQUEST)
        store.recording_path(f"r{index}").write_bytes(b"x" * 4_000)
        store.finish(f"r{index}", plan_reply(f"r{index}"))
        os.utime(tmp_path / f"r{index}", (1e9 + index, 1e9 + index))
    assert {run.run_id for run in store.summaries()} == {"r1", "r2", "r3"}


def test_a_sweep_ends_abandoned_runs_and_clears_leftovers(store: RunStore, tmp_path: Path) -> None:
    _ended(store, "found")
    store.begin("abandoned", REQUEST)
    (tmp_path / "runs" / "abandoned" / ".deadbeef.draft").write_bytes(b"half")
    (tmp_path / "runs" / ".deadbeef.draft").mkdir()
    store.sweep(CRASH)
    assert {run.run_id: run.status for run in store.summaries()} == {"found": "SUCCESS", "abandoned": "CRASH"}
    assert store.read("abandoned").error == CRASH
    assert not list((tmp_path / "runs").rglob(".*"))


WRITER = """
import sys
from pathlib import Path
from guidefield.stores.runs import RunStore
from tests.replies import plan_reply
from tests.stores.test_runs import REQUEST

store = RunStore(Path(sys.argv[1]))
for index in range(100_000):
    store.begin(f"r{index}", REQUEST)
    print(index, flush=True)
    store.finish(f"r{index}", plan_reply(f"r{index}"))
    if index > 5:
        store.delete(f"r{index - 5}")
"""


@pytest.mark.parametrize("after", [1, 4, 11, 23])
def test_a_kill_at_any_moment_leaves_whole_runs_only(after: int, tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE) as writer:
        assert writer.stdout is not None
        for _ in range(after):
            assert writer.stdout.readline()
        writer.send_signal(signal.SIGKILL)
    store = RunStore(tmp_path)
    for run in store.summaries():
        whole = store.read(run.run_id)
        assert whole.request == REQUEST
        assert whole.reply in (None, plan_reply(run.run_id))
    store.sweep(CRASH)
    assert all(run.status in ("SUCCESS", "CRASH") for run in store.summaries())
