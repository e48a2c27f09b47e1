"""Deadlines, and a slice of `tools/attack deadlines`: a service answers in time however large what is asked."""

import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from guidefield.deadline import UNLIMITED, Deadline, DeadlineExpired, seconds_waited, waiting_for_kernels, working_time
from guidefield.errors import Status
from guidefield.first_start import plain_numba
from guidefield.kernels.jit.arrays import SCALAR, VECTOR
from guidefield.kernels.jit.decorators import make_kernel as kernel
from tests.deadline_attack import FORMS, SMALL, Ask, late, service, too_late
from tests.deadline_requests import triangles


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


SHARE = 0.2  # of the largest scenes: reading one takes from 5 to 100 ms, and building it more

SCENES = ["boxes", "triangles", "points"]

OTHERS = [
    *("polygons", "planes", "scene_planes", "step_planes", "places", "movers", "crowd", "moving_mesh", "held", "path"),
    *("trajectory", "samples", "goals", "blocked_goals", "steps", "constraints", "pairs", "frames", "clearances"),
    *("poses", "field"),
]
"""What else there may be much of: each of them was late once, or might be."""

TRIES = 8  # on a busy machine a thread may get its turn late


@pytest.fixture(scope="module")
def ask() -> Iterator[Ask]:
    with service() as ask:
        yield ask


def missed(ask: Ask, kind: str, form: str, allowed: float, share: float) -> bool:
    """Whether answers came too late each time that it was tried."""
    return all(
        any(too_late(seconds, allowed) for seconds, _ in late(ask, kind, form, allowed, share=share))
        for _ in range(TRIES)
    )


@pytest.mark.parametrize("form", FORMS)
def test_answers_come_in_time(ask: Ask, form: str) -> None:
    assert [kind for kind in SCENES if missed(ask, kind, form, 0.05, SHARE)] == []


def test_answers_to_whatever_is_long_come_in_time(ask: Ask) -> None:
    assert [kind for kind in OTHERS if missed(ask, kind, "json", 0.05, 0.1)] == []


def test_a_service_goes_on_with_what_was_late_and_the_next_request_finds_it(ask: Ask) -> None:
    made = triangles(100_000)
    made["scene"]["obstacles"][0]["vertices"] += 0.001 * np.random.default_rng().random()  # nobody has seen it
    assert ask(FORMS["packed"]({**made, "allowed_planning_time": 0.02}))[1].startswith("TIMED_OUT")
    again = FORMS["packed"]({**made, "allowed_planning_time": 0.3})
    assert any(ask(again)[1] == "SUCCESS" for _ in range(30)), "each goes on where the one before ended"


def test_a_small_request_is_answered_as_soon_as_the_worker_is_free(ask: Ask) -> None:
    assert ask(msgspec.json.encode(SMALL | {"recording": "off", "allowed_planning_time": 15.0}))[1] == "SUCCESS"
