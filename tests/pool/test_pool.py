"""Laws of the pool: every job gets one answer, whatever becomes of its worker."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import wait
from pathlib import Path

import pytest

from guidefield.errors import ServerBusy, WorkerCrashed
from guidefield.messages.identities import Asker
from guidefield.pool.pool import CHECK_INTERVAL_S, DEFAULT_LIMITS, Pool
from guidefield.pool.waiting import Answer, Limits, Task, TimedAnswer
from tests import worker_setups

PATIENCE = 120.0  # longer than anything here takes on a busy machine [s]


def _started(workers: int, limits: Limits = DEFAULT_LIMITS) -> Pool:
    pool = Pool(worker_setups.obedient, workers=workers, limits=limits)
    pool.start()
    assert pool.ready(PATIENCE)
    return pool


@pytest.fixture
def pool() -> Iterator[Pool]:
    pool = _started(1)
    yield pool
    pool.close(0.0)


def _pid(pool: Pool) -> int:
    return int(pool.submit(Task(("pid", ""), PATIENCE)).result(PATIENCE)[1])


def _never() -> Answer:
    raise AssertionError("a job that is worked on is answered by its worker")


def await_begun(path: Path) -> int:
    """The process id that a worker left in a file when it began its job."""
    deadline = time.monotonic() + PATIENCE
    while not path.exists() or not path.read_text():
        assert time.monotonic() < deadline, "the worker did not begin"
        time.sleep(0.01)
    return int(path.read_text())


def closing_ends(pool: Pool, job: str, begun: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Close a pool whose worker is at a job that marks its beginning in a file: both end, and that is the reason."""
    monkeypatch.setattr("guidefield.pool.pool.ENDING_S", 0.1)
    running = pool.submit(Task((job, str(begun)), PATIENCE))
    pid = await_begun(begun)
    pool.close(0.1)
    with pytest.raises(WorkerCrashed, match="the service is shutting down"):
        running.result(0)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_answers_come_back_as_the_worker_gave_them(pool: Pool) -> None:
    assert pool.submit(Task(("echo", "bookshelf"), PATIENCE)).result(PATIENCE) == (True, b"bookshelf")
    assert pool.submit(Task(("refuse", "no"), PATIENCE)).result(PATIENCE) == (False, b"no")


def test_a_killed_worker_costs_its_own_request_and_no_other(pool: Pool, tmp_path: Path) -> None:
    doomed = pool.submit(Task(("mark", str(tmp_path / "begun")), PATIENCE))
    patient = pool.submit(Task(("echo", "next"), PATIENCE))
    os.kill(await_begun(tmp_path / "begun"), signal.SIGKILL)
    with pytest.raises(WorkerCrashed, match="died"):
        doomed.result(PATIENCE)
    assert patient.result(PATIENCE) == (True, b"next")
    assert pool.crashes == 1


def test_a_segmentation_fault_costs_its_own_request(pool: Pool) -> None:
    with pytest.raises(WorkerCrashed):
        pool.submit(Task(("segfault", ""), PATIENCE)).result(PATIENCE)
    assert pool.submit(Task(("echo", "alive"), PATIENCE)).result(PATIENCE) == (True, b"alive")


def test_a_worker_that_takes_too_long_is_stopped(pool: Pool) -> None:
    before = _pid(pool)
    with pytest.raises(WorkerCrashed, match=r"longer than 0\.3 s"):
        pool.submit(Task(("sleep", str(worker_setups.LONG)), 0.3)).result(PATIENCE)
    assert _pid(pool) != before


def test_a_full_queue_refuses_and_the_rest_is_answered(tmp_path: Path) -> None:
    pool = _started(1, Limits(tasks=2))
    try:
        running = pool.submit(Task(("until_cancelled", str(tmp_path / "begun")), PATIENCE))
        await_begun(tmp_path / "begun")
        waiting = [pool.submit(Task(("echo", str(n)), PATIENCE)) for n in range(2)]
        with pytest.raises(ServerBusy, match="2 requests wait") as refused:
            pool.submit(Task(("echo", "too many"), PATIENCE))
        assert refused.value.details == {"queue": 2, "limit": 2, "retry_after": 1.0}
        pool.cancel(running, _never)
        assert running.result(PATIENCE) == (True, b"cancelled")
        assert [future.result(PATIENCE)[1] for future in waiting] == [b"0", b"1"]
    finally:
        pool.close(0.0)


def test_a_job_that_waits_beyond_its_deadline_is_answered_then(pool: Pool, tmp_path: Path) -> None:
    running = pool.submit(Task(("until_cancelled", str(tmp_path / "begun")), PATIENCE))
    late = TimedAnswer(time.monotonic() + 0.2, lambda: (True, b"too late"))
    assert pool.submit(Task(("echo", "in time"), PATIENCE, deadline=late)).result(PATIENCE) == (True, b"too late")
    assert not running.done()
    pool.cancel(running, _never)
    assert running.result(PATIENCE) == (True, b"cancelled")


def test_a_deadline_does_not_touch_what_has_begun(pool: Pool, tmp_path: Path) -> None:
    for seconds in (0.3, 3.0, 30.0):  # the first is enough unless the machine is too busy to begin by then
        begun = tmp_path / str(seconds)
        soon = TimedAnswer(time.monotonic() + seconds, lambda: (True, b"too late"))
        running = pool.submit(Task(("until_cancelled", str(begun)), PATIENCE, deadline=soon))
        while not begun.exists() and not running.done():
            time.sleep(0.01)
        if begun.exists():
            break
    time.sleep(max(0.0, soon.at - time.monotonic()) + 4 * CHECK_INTERVAL_S)
    assert not running.done()
    pool.cancel(running, _never)
    assert running.result(PATIENCE) == (True, b"cancelled")


def test_closing_finishes_what_runs_and_refuses_what_waits(tmp_path: Path) -> None:
    """What runs comes to its end when what waits was refused, and is waited for by then."""
    pool = _started(1)
    running = pool.submit(Task(("until_there", f"{tmp_path / 'begun'} {tmp_path / 'refused'}"), PATIENCE))
    await_begun(tmp_path / "begun")
    waiting = pool.submit(Task(("echo", "never"), PATIENCE))
    waiting.add_done_callback(lambda _: (tmp_path / "refused").touch())
    pool.close(PATIENCE)
    assert running.result(0) == (True, b"came")
    with pytest.raises(ServerBusy, match="shutting down"):
        waiting.result(0)
    with pytest.raises(ServerBusy, match="shutting down"):
        pool.submit(Task(("echo", "never"), PATIENCE))


def test_closing_ends_what_outlasts_the_grace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pool = _started(1)
    closing_ends(pool, "mark", tmp_path / "begun", monkeypatch)
    assert pool.crashes == 0


def test_closing_has_what_outlasts_the_grace_come_to_an_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However long that takes where the worker hardly gets a processor: this one is told to wait."""
    monkeypatch.setattr("guidefield.pool.pool.ENDING_S", PATIENCE)
    begun, told, heard = (tmp_path / name for name in ("begun", "told", "heard"))
    pool = _started(1)
    running = pool.submit(Task(("last_word", f"{begun} {told} {heard}"), PATIENCE))
    await_begun(begun)
    closing = threading.Thread(target=pool.close, args=(0.1,))
    closing.start()
    deadline = time.monotonic() + PATIENCE
    while not told.exists():
        assert time.monotonic() < deadline, "the worker was not told"
        time.sleep(0.01)
    closing.join(0.5)  # longer than its grace
    heard.touch()
    closing.join(PATIENCE)
    assert running.result(0) == (True, b"cancelled")


def test_closing_ends_what_uses_a_processor_for_too_long_after_it_was_told(tmp_path, monkeypatch):
    monkeypatch.setattr("guidefield.pool.pool.ENDING_PROCESSOR_S", 0.2)
    monkeypatch.setattr("guidefield.pool.pool.ENDING_S", worker_setups.LONG)
    pool = _started(1)
    running = pool.submit(Task(("use", f"{tmp_path / 'begun'} 20.0"), PATIENCE))
    await_begun(tmp_path / "begun")
    pool.close(0.1)
    with pytest.raises(WorkerCrashed, match="the service is shutting down"):
        running.result(0)


def test_a_worker_that_cannot_be_prepared_is_said_at_the_start() -> None:
    pool = Pool(worker_setups.broken, workers=1)
    pool.start()
    with pytest.raises(RuntimeError, match="could not be prepared"):
        pool.ready(PATIENCE)
    pool.close(0.0)


def test_a_pool_that_is_closed_waits_for_what_its_workers_owe(tmp_path: Path) -> None:
    pool = Pool(worker_setups.obedient, workers=1)
    pool.start()
    asked, written = tmp_path / "asked", tmp_path / "written"
    assert pool.submit(Task(("owe", f"{asked} {written}"), PATIENCE)).result(PATIENCE) == (True, b"owed")
    closing = threading.Thread(target=pool.close, args=(0.0,))
    closing.start()
    closing.join(0.3)
    assert closing.is_alive()
    asked.touch()
    closing.join(PATIENCE)
    assert written.read_text() == "whole"


def _of(user: str, verb: str, value: str) -> Task:
    return Task((verb, value), PATIENCE, asker=Asker(user))


def test_a_user_whom_long_requests_hold_up_gets_the_worker_that_stands_by(pool: Pool, tmp_path: Path) -> None:
    """Two users' long requests: one has the only worker, the other one that which stands by, and gives way."""
    begun, awaited, anew = tmp_path / "begun", tmp_path / "awaited", tmp_path / "anew"
    pool.stand_by()
    first = pool.submit(_of("long", "until_there", f"{begun} {awaited}"))
    await_begun(begun)
    second = pool.submit(_of("longer", "give_way", str(anew)))
    await_begun(anew)
    assert pool.submit(_of("quiet", "echo", "quick")).result(PATIENCE) == (True, b"quick")
    assert second.result(PATIENCE) == (True, b"begun anew")
    assert pool.busy == 1
    assert not first.done()
    awaited.touch()
    assert first.result(PATIENCE) == (True, b"came")
    assert second.set_back == 1
    assert len(set(anew.read_text().split())) == 1
    assert pool.crashes == 0


def test_what_the_worker_that_stands_by_works_on_can_be_cancelled(pool: Pool, tmp_path: Path) -> None:
    begun, awaited, anew = tmp_path / "begun", tmp_path / "awaited", tmp_path / "anew"
    pool.stand_by()
    first = pool.submit(_of("long", "until_there", f"{begun} {awaited}"))
    await_begun(begun)
    second = pool.submit(_of("longer", "give_way", str(anew)))
    await_begun(anew)
    pool.cancel(second, _never)
    assert second.result(PATIENCE) == (True, b"cancelled")
    awaited.touch()
    assert first.result(PATIENCE) == (True, b"came")


def _brief(verb: str, value: str = "") -> Task:
    return Task((verb, value), PATIENCE, is_brief=True)


def test_a_worker_holds_the_next_brief_job_and_begins_it_by_itself(pool: Pool, tmp_path: Path) -> None:
    """While the pool attends to nothing, because a listener keeps it, one that was held is begun all the same."""
    kept, goes_on, begun = threading.Event(), threading.Event(), tmp_path / "begun"

    def keep(_told: bytes) -> None:
        kept.set()
        goes_on.wait(PATIENCE)

    first = Task(("tell", "something"), PATIENCE, is_brief=True, hear=keep)
    sleeping = pool.submit(_brief("sleep", "0.02"))
    pool.submit(first)
    second = pool.submit(_brief("until_there", f"{begun} {begun}"))
    assert kept.wait(PATIENCE)
    if not begun.exists():  # it wasn't held where the machine is so busy that the first had ended before it came
        goes_on.set()
    await_begun(begun)
    goes_on.set()
    assert [task.result(PATIENCE)[1] for task in (sleeping, first, second)] == [b"slept", b"told", b"came"]


def test_a_held_job_that_its_worker_does_not_come_to_goes_to_another_one(tmp_path: Path) -> None:
    pool = _started(2)
    try:
        begun, awaited = tmp_path / "begun", tmp_path / "awaited"
        _both_ready(pool)
        long = [pool.submit(_brief("until_there", f"{begun}{k} {awaited}")) for k in range(2)]
        held = [pool.submit(_brief("echo", str(k))) for k in range(4)]
        await_begun(tmp_path / "begun0")
        time.sleep(0.3)
        assert not any(task.done() for task in held)
        pid = await_begun(tmp_path / "begun1")
        os.kill(pid, signal.SIGKILL)
        with pytest.raises(WorkerCrashed, match="died"):
            long[1].result(PATIENCE)
        assert [task.result(PATIENCE)[1] for task in held] == [b"0", b"1", b"2", b"3"]
        assert not long[0].done()
        awaited.touch()
        assert long[0].result(PATIENCE) == (True, b"came")
    finally:
        pool.close(0.0)


def _both_ready(pool: Pool) -> None:
    pids = {_pid(pool)}
    deadline = time.monotonic() + PATIENCE
    while len(pids) < 2 and time.monotonic() < deadline:
        sleeping = pool.submit(Task(("sleep", "0.2"), PATIENCE))
        pids.add(_pid(pool))
        wait([sleeping], PATIENCE)


def test_many_brief_jobs_are_answered_each_once_while_workers_die(tmp_path: Path) -> None:
    pool = _started(2)
    try:
        tasks = []
        for number in range(300):
            tasks.append(pool.submit(_brief("echo", str(number))))
            if number % 100 == 50:
                tasks.append(pool.submit(_brief("exit", "3")))
            while len(pool.waiting) > 20:
                time.sleep(0.001)
        wait(tasks, PATIENCE)
        answers = [task.result(0)[1] for task in tasks if task.job[0] == "echo"]
        assert answers == [str(number).encode() for number in range(300)]
        assert sum(task.exception(0) is not None for task in tasks) == 3
        assert not len(pool.waiting)
        assert not pool.busy
    finally:
        pool.close(0.0)
