"""An answer is given once its run is kept; where it can't be, the reply says so, and is given all the same."""

import threading
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from guidefield.endpoint.under_way import keep_answer
from guidefield.errors import GuidefieldError, InvalidGoal, ServerBusy, WorkerCrashed
from guidefield.messages import codec
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN
from guidefield.messages.replies import PlanReply, make_error_reply
from guidefield.messages.requests import ReadRuns
from guidefield.pool.waiting import Answer, Task, TimedAnswer
from guidefield.stores.run_file import FILE
from guidefield.stores.runs import RunDatabase
from tests.kept_runs import REQUEST, new_run
from tests.replies import plan_reply

KEY = "guidefield/local/runs/r1/recording"
PATIENCE = 30.0


@pytest.fixture
def database(tmp_path: Path) -> Iterator[RunDatabase]:
    kept = RunDatabase(tmp_path)
    kept.recordings(PLAIN).folder.mkdir()
    kept.recordings(PLAIN).path("r1").write_bytes(b"recorded")
    yield kept
    kept.close()


def _answer(
    database: RunDatabase, outcome: Answer | GuidefieldError, encoding: Encoding = Encoding.JSON, *, begun: bool = True
) -> Answer:
    """What is answered where a worker comes to an outcome."""
    runs, run = database.of(PLAIN), new_run("r1", REQUEST, PLAIN, encoding)
    task = Task(None, PATIENCE)
    answer = keep_answer(runs, run, task)
    if begun:
        runs.begin(run)
        runs.list(ReadRuns())
    if isinstance(outcome, GuidefieldError):
        task.set_exception(outcome)
    else:
        task.set_result(outcome)
    return answer.result(PATIENCE)


@pytest.mark.parametrize("begun", [True, False])
@pytest.mark.parametrize("encoding", Encoding)
def test_what_is_answered_is_kept_before(encoding, begun, database, tmp_path):
    reply = msgspec.structs.replace(plan_reply("r1"), recording=KEY)
    sent = True, codec.encode(reply, encoding)
    assert _answer(database, sent, encoding, begun=begun) == sent
    reader = RunDatabase(tmp_path)
    assert reader.of(PLAIN).read("r1").reply == reply
    reader.close()


def test_an_answer_because_time_is_up_waits_for_no_disk_and_is_kept_all_the_same(database: RunDatabase) -> None:
    runs, run, task = database.of(PLAIN), new_run("r1", REQUEST, PLAIN), Task(None, PATIENCE)
    sent = True, codec.encode(plan_reply("r1"))
    release = threading.Event()
    database.writer.submit(lambda _: release.wait(PATIENCE))
    answer = keep_answer(runs, run, task)
    task.end_overdue(TimedAnswer(0.0, lambda: sent))
    assert answer.result(0) == sent
    release.set()
    assert [one.run_id for one in runs.list(ReadRuns()).runs] == ["r1"]


def test_an_error_that_is_not_the_requests_fault_is_kept(database: RunDatabase) -> None:
    crash = WorkerCrashed("it took too much memory", mebibytes=4)
    with pytest.raises(WorkerCrashed):
        _answer(database, crash)
    assert database.of(PLAIN).read("r1").error == make_error_reply(crash)


def test_a_refusal_leaves_no_run(database: RunDatabase) -> None:
    refusal = False, codec.encode(make_error_reply(InvalidGoal("no such joint")))
    assert _answer(database, refusal) == refusal
    assert database.of(PLAIN).list(ReadRuns()).runs == []
    with pytest.raises(ServerBusy):
        _answer(database, ServerBusy("the queue is full"))
    assert database.of(PLAIN).list(ReadRuns()).runs == []


@pytest.mark.parametrize("encoding", Encoding)
def test_a_run_that_cannot_be_kept_is_answered_with_a_warning(encoding: Encoding, tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"no database" * 1000)
    database = RunDatabase(tmp_path)
    recordings = database.recordings(PLAIN)
    recordings.folder.mkdir()
    recordings.path("r1").write_bytes(b"recorded")
    reply = msgspec.structs.replace(plan_reply("r1"), recording=KEY, warnings=["the first"])
    is_reply, payload = _answer(database, (True, codec.encode(reply, encoding)), encoding, begun=False)
    told = codec.decode(payload, PlanReply, encoding)
    assert is_reply
    assert told.warnings[0] == "the first"
    assert told.warnings[1].startswith("the run is not kept: the database of runs is damaged")
    assert told == msgspec.structs.replace(reply, recording=None, warnings=told.warnings)
    assert str(tmp_path) not in told.warnings[1]
    assert list(recordings.folder.iterdir()) == [], "a recording without its run is nobody's"
    with pytest.raises(WorkerCrashed):
        _answer(database, WorkerCrashed("it died"), begun=False)
    database.close()
