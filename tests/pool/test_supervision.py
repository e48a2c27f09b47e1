"""What a slot does for its worker: ends it early, hears what it tells, and stops it when it takes too much."""

import multiprocessing.process
import os
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import wait
from pathlib import Path

import pytest

from guidefield.errors import WorkerCrashed
from guidefield.pool.pool import Pool
from guidefield.pool.waiting import Task, TimedAnswer
from tests import worker_setups
from tests.journeys.service import await_death
from tests.pool.test_pool import PATIENCE, await_begun, closing_ends

MEMORY = 300 * 2**20  # a worker of the tests may have so much [bytes]; it has less than 100 MiB when it begins


@pytest.fixture(scope="module")
def pool() -> Iterator[Pool]:
    pool = Pool(worker_setups.obedient, workers=1, memory=MEMORY)
    pool.start()
    assert pool.ready(PATIENCE)
    yield pool
    pool.close(0.0)


def _echoes(pool: Pool) -> bool:
    return pool.submit(Task(("echo", "alive"), PATIENCE)).result(PATIENCE) == (True, b"alive")


def test_a_job_that_is_worked_on_is_told_to_end_and_the_next_is_not(pool: Pool, tmp_path: Path) -> None:
    crashes = pool.crashes
    running = pool.submit(Task(("until_cancelled", str(tmp_path / "begun")), PATIENCE))
    following = pool.submit(Task(("until_cancelled", str(tmp_path / "next")), PATIENCE))
    await_begun(tmp_path / "begun")
    assert pool.busy == 1
    pool.cancel(running, lambda: (False, b"never asked for"))
    assert running.result(PATIENCE) == (True, b"cancelled")
    await_begun(tmp_path / "next")
    time.sleep(0.1)
    assert not following.done()
    pool.cancel(following, lambda: (False, b"never asked for"))
    assert following.result(PATIENCE) == (True, b"cancelled")
    assert pool.crashes == crashes


def test_a_job_that_is_prepared_too_long_is_answered_and_the_worker_goes_on(pool: Pool, tmp_path: Path) -> None:
    crashes, has_ended = pool.crashes, threading.Event()
    begun, prepared, done = (tmp_path / name for name in ("begun", "prepared", "done"))
    late = TimedAnswer(time.monotonic() + 0.2, lambda: (True, b"too late"))
    job = ("prepare", f"{begun} {prepared} {done}")
    task = pool.submit(Task(job, PATIENCE, late=late, end_late=has_ended.set))
    await_begun(begun)
    assert task.result(PATIENCE) == (True, b"too late")
    assert time.monotonic() >= late.at
    assert pool.busy == 1, "what it prepares is kept"
    assert not has_ended.is_set()
    for file in (prepared, done):
        file.touch()
    assert pool.submit(Task(("pid", ""), PATIENCE)).result(PATIENCE) == (True, begun.read_bytes())
    assert has_ended.wait(PATIENCE)
    assert pool.crashes == crashes


def test_a_worker_that_dies_after_its_job_was_answered_late_is_replaced(pool: Pool, tmp_path: Path) -> None:
    begun, prepared, done = (tmp_path / name for name in ("begun", "prepared", "done"))
    late = TimedAnswer(time.monotonic() + 0.2, lambda: (True, b"too late"))
    begins: list[float] = []
    job = ("prepare", f"{begun} {prepared} {done}")
    task = pool.submit(Task(job, PATIENCE, late=late, begin=lambda: begins.append(time.monotonic())))
    assert task.result(PATIENCE) == (True, b"too late")
    assert len(begins) == 1
    await_begun(begun)
    os.kill(int(begun.read_bytes()), signal.SIGKILL)
    assert _echoes(pool)


def test_a_job_that_waits_is_withdrawn(pool: Pool, tmp_path: Path) -> None:
    running = pool.submit(Task(("until_cancelled", str(tmp_path / "begun")), PATIENCE))
    waiting = pool.submit(Task(("until_cancelled", str(tmp_path / "never")), PATIENCE))
    await_begun(tmp_path / "begun")
    pool.cancel(waiting, lambda: (True, b"withdrawn"))
    assert waiting.result(0) == (True, b"withdrawn")
    pool.cancel(running, lambda: (True, b"never asked for"))
    running.result(PATIENCE)
    assert _echoes(pool)
    assert not (tmp_path / "never").exists()


def test_what_a_worker_tells_is_heard_in_order_by_its_own_job_before_the_answer(pool: Pool) -> None:
    for words in ("one two three", "four"):
        heard: list[bytes] = []
        assert pool.submit(Task(("tell", words), PATIENCE, hear=heard.append)).result(PATIENCE) == (True, b"told")
        assert heard == words.encode().split()


@pytest.mark.parametrize(("code", "says"), [("0", "died"), ("3", "exit code 3")])
def test_a_worker_that_leaves_in_the_middle_is_noticed_at_once(code: str, says: str, pool: Pool) -> None:
    with pytest.raises(WorkerCrashed, match=says):  # not of the time that it may take, which is longer
        pool.submit(Task(("exit", code), 2.0 * PATIENCE)).result(PATIENCE)
    assert _echoes(pool)


def test_a_worker_that_takes_too_much_memory_is_stopped_with_the_reason(pool: Pool) -> None:
    before = pool.submit(Task(("pid", ""), PATIENCE)).result(PATIENCE)[1]
    assert 0 < pool.memory < MEMORY
    with pytest.raises(WorkerCrashed, match="more than 300 MiB of memory") as stopped:
        pool.submit(Task(("grow", "320"), PATIENCE)).result(PATIENCE)
    assert stopped.value.details == {"mebibytes": 300}
    assert _echoes(pool)
    with pytest.raises(ProcessLookupError):
        os.kill(int(before), 0)


def test_a_worker_that_takes_too_much_memory_after_its_answer_is_replaced(pool: Pool) -> None:
    before, crashes = int(pool.submit(Task(("pid", ""), PATIENCE)).result(PATIENCE)[1]), pool.crashes
    assert pool.submit(Task(("grow after", "320"), PATIENCE)).result(PATIENCE) == (True, b"answered")
    until = time.monotonic() + PATIENCE
    while pool.crashes == crashes and time.monotonic() < until:
        time.sleep(0.01)
    assert pool.crashes == crashes + 1
    with pytest.raises(ProcessLookupError):
        os.kill(before, 0)
    assert _echoes(pool)


def test_one_huge_allocation_fails_at_once_inside_the_worker(pool: Pool) -> None:
    crashes = pool.crashes
    assert pool.submit(Task(("allocate", "100000"), PATIENCE)).result(PATIENCE) == (False, b"no memory")
    assert pool.crashes == crashes


@pytest.mark.parametrize("pause", [0.0, 0.02, 0.2])
def test_a_worker_that_is_killed_while_it_starts_costs_no_request(pool: Pool, pause: float) -> None:
    before = _kill_idle_worker(pool)
    fresh = _fresh_worker(before)
    time.sleep(pause)
    fresh.kill()
    assert _echoes(pool)


def test_a_job_that_was_handed_over_and_never_begun_is_handed_to_the_next_worker(pool: Pool) -> None:
    pid = int(pool.submit(Task(("pid", ""), PATIENCE)).result(PATIENCE)[1])
    os.kill(pid, signal.SIGSTOP)
    task = pool.submit(Task(("pid", ""), PATIENCE))
    time.sleep(0.1)
    assert not task.done()
    os.kill(pid, signal.SIGKILL)
    assert int(task.result(PATIENCE)[1]) != pid


def test_a_long_job_for_a_worker_that_does_not_read_holds_up_nobody() -> None:
    pool = Pool(worker_setups.obedient, workers=2)
    pool.start()
    try:
        assert pool.ready(PATIENCE)
        pid = int(pool.submit(Task(("pid", ""), PATIENCE)).result(PATIENCE)[1])
        os.kill(pid, signal.SIGSTOP)
        long = pool.submit(Task(("echo", "guide" * 2**20), PATIENCE))
        assert _echoes(pool)
        os.kill(pid, signal.SIGCONT)
        assert len(long.result(PATIENCE)[1]) == 5 * 2**20
    finally:
        pool.close(0.0)


def test_a_job_that_does_not_pickle_is_told_and_costs_no_worker(pool: Pool) -> None:
    crashes = pool.crashes
    with pytest.raises(WorkerCrashed, match="pickle"):
        pool.submit(Task(("echo", lambda: None), PATIENCE)).result(PATIENCE)
    assert _echoes(pool)
    assert pool.crashes == crashes


def test_closing_ends_a_worker_in_a_native_call_that_keeps_the_interpreter(tmp_path, monkeypatch):
    pool = Pool(worker_setups.obedient, workers=1)
    pool.start()
    assert pool.ready(PATIENCE)
    closing_ends(pool, "stuck", tmp_path / "begun", monkeypatch)


def test_closing_leaves_a_slot_behind_whose_listener_does_not_come_back(monkeypatch, caplog):
    monkeypatch.setattr("guidefield.pool.pool.STOPPING_S", 0.3)
    monkeypatch.setattr("guidefield.pool.pool.ENDING_S", 0.1)
    comes_back, heard = threading.Event(), threading.Event()

    def hear(_told: bytes) -> None:
        heard.set()
        comes_back.wait(PATIENCE)

    pool = Pool(worker_setups.obedient, workers=1)
    pool.start()
    assert pool.ready(PATIENCE)
    running = pool.submit(Task(("tell", "something"), PATIENCE, hear=hear))
    assert heard.wait(PATIENCE)
    pool.close(0.1)
    assert "left behind" in caplog.text
    assert not running.done()
    comes_back.set()
    wait([running], PATIENCE)
    pool.close(PATIENCE)


LEFT_ALONE = """
import sys, time
from guidefield.pool.pool import Pool
from guidefield.pool.waiting import Task
from tests import worker_setups

if __name__ == "__main__":
    pool = Pool(worker_setups.obedient, workers=1)
    pool.start()
    assert pool.ready(60.0)
    pool.submit(Task(("stuck", sys.argv[1]), 300.0))
    time.sleep(300.0)
"""


def test_a_worker_in_a_native_call_ends_with_its_parent(tmp_path: Path) -> None:
    parent = tmp_path / "parent.py"
    parent.write_text(LEFT_ALONE)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    with subprocess.Popen([sys.executable, str(parent), str(tmp_path / "begun")], env=environment) as process:
        pid = await_begun(tmp_path / "begun")
        process.kill()
    await_death(pid)


def _kill_idle_worker(pool: Pool) -> set[int | None]:
    """Kill the worker; returns the processes that were there before."""
    pid = int(pool.submit(Task(("pid", ""), PATIENCE)).result(PATIENCE)[1])
    before = {child.pid for child in multiprocessing.active_children()}
    os.kill(pid, signal.SIGKILL)
    return before


def _fresh_worker(before: set[int | None]) -> multiprocessing.process.BaseProcess:
    """The worker that is started next."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        for child in multiprocessing.active_children():
            if child.pid not in before:
                return child
        time.sleep(0.001)
    raise AssertionError("no new worker was started")


def test_an_answer_that_was_sent_before_a_worker_ended_counts(pool: Pool, monkeypatch: pytest.MonkeyPatch) -> None:
    """However both are noticed: here the process's end first."""
    pid = int(pool.submit(Task(("pid", ""), PATIENCE)).result(PATIENCE)[1])
    select = pool._selector.select

    def select_ends_first(timeout: float | None) -> list[tuple[selectors.SelectorKey, int]]:
        found = select(timeout)
        time.sleep(0.05)  # long enough for the other event
        return sorted(select(0.0) or found, key=lambda event: "_hear_last" not in str(event[0].data))

    monkeypatch.setattr(pool._selector, "select", select_ends_first)
    time.sleep(0.2)  # until the pool has looked up
    task = pool.submit(Task(("answer_and_end", ""), PATIENCE))
    assert task.result(PATIENCE) == (True, b"last words")
    monkeypatch.undo()
    assert int(pool.submit(Task(("pid", ""), PATIENCE)).result(PATIENCE)[1]) != pid
