"""Deadlines: what is left, what ends early, what may begin late, and what is told about a step that is not begun.

Waiting for kernels isn't planning time: deadlines pass it over, and replies count it as loading.
"""

import json
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from guidefield.deadline import UNLIMITED, Deadline, DeadlineExpired, seconds_waited, waiting_for_kernels, working_time
from guidefield.errors import Status
from guidefield.first_start import plain_numba
from guidefield.kernels.jit.arrays import SCALAR, VECTOR
from guidefield.kernels.jit.decorators import make_kernel as kernel


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time that the clock tells, which the test sets [s]."""
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_it_expires_at_its_time_and_not_before(clock: list[float]) -> None:
    deadline = Deadline(110.0)
    assert (deadline.remaining(), deadline.expired(), deadline.status()) == (10.0, False, None)
    deadline.check("anything was done")
    clock[0] = 110.0
    assert (deadline.remaining(), deadline.expired(), deadline.status()) == (0.0, True, Status.TIMED_OUT)
    with pytest.raises(DeadlineExpired, match=r"^the hall was built$") as late:
        deadline.check("the hall was built")
    assert (late.value.status, late.value.step) == (Status.TIMED_OUT, "the hall was built")


def test_a_cancelled_one_has_expired_whatever_the_time() -> None:
    deadline = Deadline(is_cancelled=lambda: True)
    assert deadline.expired()
    with pytest.raises(DeadlineExpired) as late:
        deadline.check("the hall was built")
    assert late.value.status is Status.PREEMPTED
    assert not UNLIMITED.expired()
    assert UNLIMITED.or_if(lambda: True).expired()
    assert deadline.or_if(lambda: False).expired()


def test_a_share_is_one_of_what_is_left(clock: list[float]) -> None:
    assert Deadline(110.0).share(0.25) == Deadline(102.5)
    clock[0] = 120.0
    assert Deadline(110.0).share(0.25).expired()
    assert not UNLIMITED.share(0.25).expired()
    assert Deadline(130.0, lambda: True).share(0.5).status() is Status.PREEMPTED


@pytest.mark.parametrize(("due", "until"), [(99.0, 100.5), (110.0, 110.0)], ids=["begins late", "begins early"])
def test_a_least_time_is_allowed_however_late_it_begins(clock: list[float], due: float, until: float) -> None:
    deadline = Deadline(due).at_least(0.5)
    clock[0] = until - 0.01
    assert not deadline.expired()
    clock[0] = until
    assert deadline.status() is Status.TIMED_OUT


def test_who_asked_to_stop_waits_no_longer_than_that(clock: list[float]) -> None:
    deadline = Deadline(is_cancelled=lambda: True).at_least(0.5)
    assert not deadline.expired()
    clock[0] = 100.5
    assert deadline.status() is Status.PREEMPTED


def test_a_deadline_passes_over_what_is_waited_for_kernels_after_it_was_set() -> None:
    with waiting_for_kernels():
        time.sleep(0.05)  # before it is set
    deadline = Deadline(time.monotonic() + 0.2)
    half, later, begun = deadline.share(0.5), deadline.at_least(0.1), working_time()
    assert 0.0 < deadline.remaining() <= 0.2
    with waiting_for_kernels():
        time.sleep(0.2)
        with waiting_for_kernels():  # counts once
            time.sleep(0.1)
    assert not deadline.expired()
    assert not half.expired()
    assert not later.expired()
    assert working_time() - begun < 0.1
    assert 0.0 < deadline.remaining() <= 0.2
    assert deadline.or_if(lambda: False).status() is None
    time.sleep(0.2)
    assert deadline.expired()
    assert half.expired()
    assert later.expired()
    assert deadline.at_least(0.0).remaining() == 0.0


def test_threads_that_wait_at_the_same_time_count_once() -> None:
    both, expired = threading.Barrier(2), []
    before, working, begin = seconds_waited(), working_time(), time.monotonic()
    deadline = Deadline(begin + 0.1)

    def wait() -> None:
        with waiting_for_kernels():
            both.wait()
            time.sleep(0.3)
            expired.append(deadline.expired())
            both.wait()

    threads = [threading.Thread(target=wait) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert expired == [False, False]
    assert 0.3 <= seconds_waited() - before <= time.monotonic() - begin
    assert working_time() >= working


def test_the_first_call_of_a_kernel_counts_as_waiting() -> None:
    before, begin = seconds_waited(), time.monotonic()

    @kernel(SCALAR(VECTOR))
    def product(values: np.ndarray) -> float:
        return values.prod()

    assert product(np.full(2, 2.0)) == 4.0
    lasted = time.monotonic() - begin
    assert 0.5 * lasted < seconds_waited() - before <= lasted
    waited = seconds_waited()
    assert product(np.full(3, 2.0)) == 8.0
    assert seconds_waited() == waited


SLOW = """
import json, time
import guidefield, msgspec
from guidefield.cli.demonstration import REQUESTS
from guidefield.kernels.jit import patched_compiler
WAIT, ALLOWED = 12.0, 10.0
awaited = []
def wait(function):
    if function.__module__.endswith(slow) and not awaited:
        awaited.append(function.__name__)
        time.sleep(WAIT)
patched_compiler.await_machine_code = wait
slow = "optimize.motion_objective"
asked = msgspec.structs.replace(REQUESTS["demo-guide-planes"][1], allowed_planning_time=ALLOWED, recording="off")
plan = guidefield.answer(asked)
print(json.dumps([plan.status.name, awaited, plan.timing.total, plan.timing.load]))
"""


@pytest.mark.skipif(plain_numba(), reason="numba compiles at the import where it is left as it is")
def test_a_plan_has_its_time_although_it_waits_for_kernels() -> None:
    ran = subprocess.run([sys.executable, "-c", SLOW], capture_output=True, text=True, check=True, timeout=300)
    status, awaited, total, load = json.loads(ran.stdout.splitlines()[-1])
    assert awaited
    assert status == "SUCCESS"
    assert total > load > 12.0
