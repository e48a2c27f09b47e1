"""Deadlines: what is left, what ends early, what may begin late, and what is told about a step that is not begun."""

from __future__ import annotations

import time

import pytest

from guidefield.deadline import UNLIMITED, Deadline, DeadlineExpired
from guidefield.errors import Status


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


def test_what_begins_late_is_allowed_so_long_and_no_longer(clock: list[float]) -> None:
    deadline = Deadline(99.0).at_least(0.5)
    clock[0] = 100.49
    assert not deadline.expired()
    clock[0] = 100.5
    assert deadline.status() is Status.TIMED_OUT


def test_what_begins_early_has_all_the_time_there_is(clock: list[float]) -> None:
    deadline = Deadline(110.0).at_least(0.5)
    clock[0] = 109.9
    assert not deadline.expired()
    clock[0] = 110.0
    assert deadline.status() is Status.TIMED_OUT


def test_who_asked_to_stop_waits_no_longer_than_that(clock: list[float]) -> None:
    deadline = Deadline(is_cancelled=lambda: True).at_least(0.5)
    assert not deadline.expired()
    clock[0] = 100.5
    assert deadline.status() is Status.PREEMPTED
