"""A budget: what begins late may still take some time, and is stopped after that."""

from __future__ import annotations

import time

import pytest

from guidefield.errors import Status
from guidefield.planner.task.conditions import Budget


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time that the clock tells, which the test sets [s]."""
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_what_begins_late_is_allowed_so_long_and_no_longer(clock: list[float]) -> None:
    budget = Budget(deadline=99.0)
    stopped = budget.with_at_least(0.5)
    assert budget.spent() is Status.TIMED_OUT
    clock[0] = 100.49
    assert stopped() is None
    clock[0] = 100.5
    assert stopped() is Status.TIMED_OUT


def test_what_begins_early_has_all_the_time_there_is(clock: list[float]) -> None:
    stopped = Budget(deadline=110.0).with_at_least(0.5)
    clock[0] = 109.9
    assert stopped() is None
    clock[0] = 110.0
    assert stopped() is Status.TIMED_OUT


def test_who_asked_to_stop_waits_no_longer_than_that(clock: list[float]) -> None:
    stopped = Budget(cancelled=lambda: True).with_at_least(0.5)
    assert stopped() is None
    clock[0] = 100.5
    assert stopped() is Status.PREEMPTED
