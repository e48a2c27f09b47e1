"""Runs in a database: what was answered is there, others' is not shown, the oldest make room, and faults are told."""

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import pytest

from guidefield.errors import DiskRefused, InvalidGoal, MalformedRequest, Status, UnknownObject, WorkerCrashed
from guidefield.messages import codec
from guidefield.messages.identities import PLAIN
from guidefield.messages.replies import make_error_reply
from guidefield.messages.requests import RUNNING, UNREADABLE, PlanRequest, ReadRuns
from guidefield.stores import run_file, runs as module
from guidefield.stores.recordings import LOG
from guidefield.stores.run_file import FILE
from guidefield.stores.runs import NoRuns, Retention, RunDatabase, UserRuns
from tests.kept_runs import REQUEST, begin, fail, keep, new_run
from tests.replies import plan_reply

CRASH = make_error_reply(WorkerCrashed("the process died", signal=9))
ALL = ReadRuns()


@pytest.fixture
def database(tmp_path: Path) -> Iterator[RunDatabase]:
    kept = RunDatabase(tmp_path)
    yield kept
    kept.close()


@pytest.fixture
def runs(database: RunDatabase) -> UserRuns:
    return database.of(PLAIN)


def _statuses(runs: UserRuns) -> dict[str, str]:
    return {run.run_id: run.status for run in runs.list(ALL).runs}


def test_a_run_is_read_back_as_it_was_kept(database: RunDatabase, runs: UserRuns) -> None:
    before = time.time()
    run = begin(database, "r1")
    running = runs.read("r1")
    assert (running.request.goal, running.reply, running.error) == (REQUEST.goal, None, None)
    assert before <= running.began <= time.time()
    runs.finish(run, codec.encode(plan_reply("r1"))).result()
    assert runs.read("r1").reply == plan_reply("r1")
    (line,) = runs.list(ALL).runs
    assert before <= line.began <= line.ended <= time.time()
    assert (line.status, line.message) == ("SUCCESS", "a plan made by hand")
    assert line.bytes == len(codec.encode(REQUEST)) + len(codec.encode(plan_reply("r1")))


def test_a_run_says_how_it_stands(database: RunDatabase, runs: UserRuns) -> None:
    begin(database, "running")
    keep(database, "found")
    keep(database, "stuck", Status.STUCK_IN_MINIMUM)
    fail(database, "crashed", CRASH)
    fail(database, "refused", make_error_reply(InvalidGoal("no such joint")))
    assert _statuses(runs) == {
        "crashed": "CRASH",
        "stuck": "STUCK_IN_MINIMUM",
        "found": "SUCCESS",
        "running": RUNNING,
    }, "what was refused leaves no run"
    assert list(_statuses(runs)) == ["crashed", "stuck", "found", "running"], "the newest is first"
    assert runs.read("crashed").error == CRASH


def test_a_list_comes_in_pages(database: RunDatabase, runs: UserRuns) -> None:
    for number in range(7):
        keep(database, f"r{number}", Status.SUCCESS if number % 2 else Status.TIMED_OUT)
    pages, after = [], None
    while True:
        page = runs.list(ReadRuns(limit=3, after=after))
        pages.append([run.run_id for run in page.runs])
        assert page.total == 7
        if (after := page.next) is None:
            break
        keep(database, f"later{len(pages)}")  # what comes meanwhile moves no page
        runs.delete(f"later{len(pages)}")
    assert pages == [["r6", "r5", "r4"], ["r3", "r2", "r1"], ["r0"]]
    late = runs.list(ReadRuns(status="TIMED_OUT", limit=2))
    assert ([run.run_id for run in late.runs], late.total) == (["r6", "r4"], 4)
    runs.delete("r4")
    assert [run.run_id for run in runs.list(ReadRuns(status="TIMED_OUT", after=late.next)).runs] == ["r2", "r0"]
    assert runs.list(ReadRuns(after="0")).runs == []
    assert len(runs.list(ReadRuns(after="9" * 18)).runs) == 6
    assert runs.list(ReadRuns(limit=6)).next is None


@pytest.mark.parametrize("after", ["", "-1", "1.5", "r1", "²", "9" * 19, "1;DROP TABLE runs", "\x00"])
def test_what_is_no_end_of_a_list_is_refused(after: str) -> None:
    with pytest.raises(ValueError, match="`after` must be the `next` of a list of runs"):
        ReadRuns(after=after)


def test_filters_are_joined_and_take_text_as_it_stands(database: RunDatabase, runs: UserRuns) -> None:
    for number, sentence in enumerate(("100 % sure", "100 x sure", "under_line", "underXline", r"back\slash", "it's")):
        reply = plan_reply(f"r{number}")
        reply = msgspec.structs.replace(reply, status=msgspec.structs.replace(reply.status, message=sentence))
        keep(database, f"r{number}", reply, PlanRequest(robot=f"robot{number % 2}", scene="s", goal=REQUEST.goal))
    found = {
        text: [run.run_id for run in runs.list(ReadRuns(text=text)).runs]
        for text in ("SURE", "0 % s", "r_l", "\\s", "t's", "' OR 1 --", "nothing")
    }
    assert found == {
        "SURE": ["r1", "r0"],
        "0 % s": ["r0"],
        "r_l": ["r2"],
        "\\s": ["r4"],
        "t's": ["r5"],
        "' OR 1 --": [],
        "nothing": [],
    }
    assert [run.run_id for run in runs.list(ReadRuns(text="sure", robot="robot1", status="SUCCESS")).runs] == ["r1"]
    assert runs.list(ReadRuns(since=time.time() + 60.0)).total == 0
    assert runs.list(ReadRuns(since=time.time() - 60.0)).total == 6


def test_a_user_sees_its_own_runs_and_what_is_shared(database: RunDatabase) -> None:
    for owner, run_id in (("alice", "r1"), ("alice", "r2"), ("bob", "r1"), (PLAIN, "r3")):
        keep(database, run_id, owner=owner)
    database.of("alice").share("r1", shared=True)
    listed = {user: [run.run_id for run in database.of(user).list(ALL).runs] for user in ("alice", "bob", PLAIN)}
    assert listed == {"alice": ["r2", "r1"], "bob": ["r1", "alice:r1"], PLAIN: ["r3", "bob:r1", "alice:r2", "alice:r1"]}
    assert database.of("bob").list(ReadRuns(limit=1)).next is not None
    assert database.of("bob").list(ReadRuns(limit=1)).total == 2
    database.of("alice").share("r1", shared=False)
    assert [run.run_id for run in database.of("bob").list(ALL).runs] == ["r1"]
    database.of("bob").delete("r1")
    assert database.of("alice").has("r1"), "another user's run of that name stays"
    with pytest.raises(UnknownObject):
        database.of("bob").share("r2", shared=True)


@pytest.mark.parametrize("ask", [UserRuns.read, UserRuns.require, UserRuns.delete, NoRuns.read])
def test_a_run_that_is_not_there_is_said_so(ask: object, database: RunDatabase, runs: UserRuns) -> None:
    keep(database, "other")
    with pytest.raises(UnknownObject, match="no run 'nowhere'"):
        ask(NoRuns() if ask is NoRuns.read else runs, "nowhere")


@pytest.mark.parametrize("name", ["../r1", "..", ".r1", "a/b", ""])
def test_no_name_leads_out_of_the_folder(name: str, database: RunDatabase, runs: UserRuns, tmp_path: Path) -> None:
    keep(database, "r1")
    (tmp_path / "r1.rrd").write_bytes(b"mine")
    for ask in (runs.read, runs.require, runs.recordings.find, runs.delete):
        with pytest.raises(MalformedRequest):
            ask(name)
    assert (tmp_path / "r1.rrd").exists()


def test_a_deleted_run_is_gone_with_its_recording(database: RunDatabase, runs: UserRuns, tmp_path: Path) -> None:
    runs.recordings.folder.mkdir()
    runs.recordings.path("r1").write_bytes(b"recording")
    keep(database, "r1")
    assert runs.recordings.find("r1") == tmp_path / "recordings" / "r1.rrd"
    runs.delete("r1")
    assert runs.list(ALL).runs == []
    assert list((tmp_path / "recordings").iterdir()) == []
    running = begin(database, "r2")
    runs.list(ALL)
    runs.delete("r2")
    runs.finish(running, codec.encode(plan_reply("r2"))).result()
    assert runs.list(ALL).runs == [], "what is deleted while it runs doesn't come back"


def test_a_refused_run_leaves_nothing(database: RunDatabase, runs: UserRuns) -> None:
    run = begin(database, "r1")
    runs.discard(run).result()
    assert runs.list(ALL).total == 0
    run = begin(database, "r1")
    assert runs.list(ALL).total == 1
    runs.discard(run).result()
    assert runs.list(ALL).total == 0


def test_the_oldest_ended_runs_make_room(tmp_path: Path) -> None:
    database = RunDatabase(tmp_path, Retention(runs=3), lambda user: 10_000 if user == "alice" else None)
    begin(database, "running")
    for number in range(6):
        keep(database, f"r{number}")
    assert set(_statuses(database.of(PLAIN))) == {"running", "r3", "r4", "r5"}
    recordings = database.of("alice").recordings
    recordings.folder.mkdir(parents=True)
    for number in range(3):
        recordings.path(f"a{number}").write_bytes(bytes(4_000))
        keep(database, f"a{number}", owner="alice")
    assert set(_statuses(database.of("alice"))) == {"a2"}, "her quota leaves room for one with its recording"
    assert [file.name for file in recordings.folder.iterdir()] == ["a2.rrd"]
    recordings.path("huge").write_bytes(bytes(20_000))
    keep(database, "huge", owner="alice")
    assert set(_statuses(database.of("alice"))) == {"huge"}, "what was answered last is kept in any case"
    database.close()


def test_runs_that_are_too_old_are_dropped(tmp_path: Path) -> None:
    database = RunDatabase(tmp_path, Retention(seconds=3600.0))
    for run_id in ("old", "young"):
        keep(database, run_id)
    with sqlite3.connect(tmp_path / FILE) as db:
        db.execute("UPDATE runs SET ended = ended - 7200 WHERE run_id = 'old'")
    keep(database, "next")
    assert set(_statuses(database.of(PLAIN))) == {"young", "next"}
    database.close()


def test_a_recording_that_is_rendered_of_a_run_that_was_deleted_goes(database: RunDatabase, runs: UserRuns) -> None:
    runs.recordings.store_log("r1", b"log", ())
    keep(database, "r1")
    runs.delete("r1")
    runs.recordings.path("r1").write_bytes(b"late")
    database.note_recording(PLAIN, "r1")
    runs.list(ALL)
    assert list(runs.recordings.folder.iterdir()) == []


def test_a_start_has_the_recordings_rendered_that_are_owed(database: RunDatabase, tmp_path: Path) -> None:
    for index, (owner, run_id) in enumerate([(PLAIN, "r1"), ("alice", "a1"), (PLAIN, "r2")]):
        recordings = database.recordings(owner)
        recordings.store_log(run_id, b"log", ())
        os.utime(recordings.file(run_id, LOG), (index, index))
        keep(database, run_id, owner=owner)
    database.recordings(PLAIN).store_log("unknown", b"of a run that was never answered", ())
    os.utime(database.recordings(PLAIN).file("unknown", LOG), (9, 9))
    database.recordings("alice").give_up("a1", "rendered by somebody else, or not, while no service ran")
    database.close()
    again, told = RunDatabase(tmp_path), list[tuple[str, str]]()
    again.render = lambda owner, run_id: told.append((owner, run_id))
    again.sweep(CRASH)
    assert set(told) == {(PLAIN, "unknown"), (PLAIN, "r2"), (PLAIN, "r1"), ("alice", "a1")}
    assert [run_id for owner, run_id in told if owner == PLAIN] == ["r1", "r2", "unknown"], "the newest is told last"
    for named in told:
        again.note_recording(*named)
    assert {run.run_id: run.recording for run in again.of("alice").list(ALL).runs} == {"a1": "lost"}
    assert not again.recordings(PLAIN).is_owed("unknown")
    again.close()


def test_a_sweep_ends_what_a_killed_service_left(database: RunDatabase, runs: UserRuns, tmp_path: Path) -> None:
    keep(database, "found")
    begin(database, "abandoned")
    runs.list(ALL)
    runs.recordings.folder.mkdir()
    (runs.recordings.folder / ".abandoned.rrd.1234.draft").write_bytes(b"half")
    database.close()
    again = RunDatabase(tmp_path)
    again.sweep(CRASH)
    assert _statuses(again.of(PLAIN)) == {"abandoned": "CRASH", "found": "SUCCESS"}
    assert again.of(PLAIN).read("abandoned").error == CRASH
    assert list(runs.recordings.folder.iterdir()) == []
    again.close()


WRITER = """
import sys
from pathlib import Path
from guidefield.messages import codec
from guidefield.messages.identities import PLAIN
from guidefield.stores.runs import Retention, RunDatabase
from tests.kept_runs import begin
from tests.replies import plan_reply

database = RunDatabase(Path(sys.argv[1]), Retention(runs=100_000))
for index in range(100_000):
    run = begin(database, f"r{index}")
    database.of(PLAIN).finish(run, codec.encode(plan_reply(f"r{index}"))).result()
    print(index, flush=True)
"""


@pytest.mark.parametrize("after", [1, 4, 23, 200])
def test_what_was_answered_survives_a_kill_at_any_moment(after: int, tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE) as writer:
        for _ in range(after):
            assert writer.stdout.readline()
        writer.send_signal(signal.SIGKILL)
        answered = after + len(writer.stdout.readlines())
    database = RunDatabase(tmp_path)
    database.sweep(CRASH)
    for number in range(answered):
        assert database.of(PLAIN).read(f"r{number}").reply == plan_reply(f"r{number}")
    assert set(_statuses(database.of(PLAIN)).values()) <= {"SUCCESS", "CRASH"}
    database.close()


READER = """
import os, sys, urllib.parse  # Python 3.13 imports it for an address of a path, where nobody else may read it
from pathlib import Path
from guidefield.messages.identities import PLAIN
from guidefield.stores.runs import RunDatabase
from guidefield.messages.requests import ReadRuns

os.setuid(65534)
print([run.run_id for run in RunDatabase(Path(sys.argv[1])).of(PLAIN).list(ReadRuns()).runs])
"""


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become somebody else")
def test_who_may_write_nothing_reads_while_a_service_runs_and_after_its_end() -> None:
    data = Path(tempfile.mkdtemp(dir="/tmp"))  # where others may look
    data.chmod(0o755)
    database = RunDatabase(data)
    for number in range(2):
        keep(database, f"r{number}")
        done = subprocess.run([sys.executable, "-c", READER, str(data)], capture_output=True, text=True, check=True)
        assert done.stdout == f"{[f'r{k}' for k in range(number, -1, -1)]}\n"
    database.close()
    assert [file.name for file in data.iterdir()] == [FILE]
    done = subprocess.run([sys.executable, "-c", READER, str(data)], capture_output=True, text=True, check=True)
    assert done.stdout == "['r1', 'r0']\n"
    shutil.rmtree(data)


def test_a_damaged_database_is_told_and_nothing_is_lost_of_it(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"this is no database" * 500)
    database = RunDatabase(tmp_path)
    with pytest.raises(DiskRefused, match=rf"database of runs is damaged .* move {FILE} away"):
        database.sweep(CRASH)
    run = new_run("r1")
    database.of(PLAIN).begin(run)
    with pytest.raises(DiskRefused, match="damaged"):
        database.of(PLAIN).finish(run, b"{}").result()
    with pytest.raises(DiskRefused, match="damaged"):
        database.of(PLAIN).list(ALL)
    database.close()
    assert (tmp_path / FILE).read_bytes() == b"this is no database" * 500


def test_damage_inside_the_database_is_told_where_it_is_met(tmp_path: Path) -> None:
    database = RunDatabase(tmp_path)
    for number in range(300):
        keep(database, f"r{number}")
    database.close()
    content = bytearray((tmp_path / FILE).read_bytes())
    content[4096 * 8 :] = os.urandom(len(content) - 4096 * 8)
    (tmp_path / FILE).write_bytes(content)
    database = RunDatabase(tmp_path)

    def use_all() -> None:
        for number in range(300):
            database.of(PLAIN).finish(new_run(f"new{number}"), codec.encode(plan_reply("x"))).result(30.0)
            database.of(PLAIN).read(f"r{number}")

    with pytest.raises(DiskRefused, match="damaged"):
        use_all()
    database.close()


def test_a_damaged_document_is_told_and_can_be_deleted(database: RunDatabase, runs: UserRuns, tmp_path: Path) -> None:
    for run_id in ("whole", "request", "reply"):
        keep(database, run_id)
    with sqlite3.connect(tmp_path / FILE) as db:
        for column in ("request", "reply"):
            cut = f"UPDATE documents SET {column} = substr({column}, 1, 30) "
            db.execute(f"{cut} WHERE number = (SELECT number FROM runs WHERE run_id = ?)", (column,))
    assert runs.read("whole").reply == plan_reply("whole")
    for run_id in ("request", "reply"):
        with pytest.raises(UnknownObject, match=rf"its {run_id} is damaged; `delete` removes it"):
            runs.read(run_id)
        runs.delete(run_id)
    runs.finish(new_run("unread"), b"{").result()
    assert _statuses(runs) == {"unread": UNREADABLE, "whole": "SUCCESS"}


@pytest.mark.parametrize("version", [1, 3])
def test_another_version_is_left_alone(tmp_path: Path, version: int) -> None:
    with sqlite3.connect(tmp_path / FILE) as db:
        db.execute(f"PRAGMA user_version = {version}")
    database = RunDatabase(tmp_path)
    with pytest.raises(DiskRefused, match=f"tables of version {version}, and this guidefield reads version 2"):
        database.sweep(CRASH)
    database.close()


def test_a_file_system_without_locks_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    connected = sqlite3.connect

    def without_locks(address: str, *arguments: object, **options: object) -> sqlite3.Connection:
        return connected(f"{address}&vfs=unix-none", *arguments, **options)

    monkeypatch.setattr(run_file.sqlite3, "connect", without_locks)
    with pytest.raises(DiskRefused, match="no locks or shared memory for a database; choose a data folder on a local"):
        run_file.connect_writer(tmp_path / FILE)


def test_another_program_that_holds_the_file_is_told(database, runs, tmp_path, monkeypatch):
    monkeypatch.setattr(run_file, "LONGEST_LOCK_S", 0.1)
    keep(database, "before")
    with sqlite3.connect(tmp_path / FILE, isolation_level=None) as other:
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(DiskRefused, match=r"another program holds runs\.sqlite locked; end it"):
            runs.finish(new_run("r1"), codec.encode(plan_reply("r1"))).result(30.0)
        other.execute("COMMIT")
    keep(database, "r2")
    assert set(_statuses(runs)) == {"before", "r2"}


def test_where_far_fewer_are_to_be_kept_no_answer_waits_for_all(database, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "MOST_DROPPED", 4)
    for number in range(12):
        keep(database, f"r{number}")
    stricter = RunDatabase(tmp_path, Retention(runs=3))
    left = []
    for number in range(4):
        keep(stricter, f"new{number}")
        left.append(stricter.of(PLAIN).list(ALL).total)
    assert left == [9, 6, 3, 3]
    stricter.close()


def test_a_change_that_waits_for_room_at_the_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_file, "MAX_WAITING_BYTES", 1)
    writer, begun, free = run_file.RunWriter(tmp_path / FILE, lambda: None), threading.Event(), threading.Event()

    def wait(_: sqlite3.Connection) -> bool:
        begun.set()
        return free.wait(60.0)

    with ThreadPoolExecutor() as threads:
        first = writer.submit(wait)
        assert begun.wait(60.0)
        late = threads.submit(writer.submit, lambda _: None)  # waits until the first one is written, or the end
        end = threads.submit(writer.close)
        try:
            with pytest.raises(DiskRefused, match="has ended"):
                late.result(60.0).result(60.0)
        finally:
            free.set()
        end.result(60.0)
    assert first.result(60.0)
