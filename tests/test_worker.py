"""The worker between queries: it goes on with what a plan had no time for, until the next query."""

from __future__ import annotations

import time

import pytest

from guidefield.deadline import UNLIMITED, Deadline, DeadlineExpired
from guidefield.engine import Engine
from guidefield.handlers.preparation import is_laid_out
from guidefield.messages.requests import JointsGoal, PlanRequest, UrdfText
from guidefield.messages.scene import Scene
from guidefield.worker import ContinuedPreparation
from tests.robots import box_arm


@pytest.mark.parametrize("asked_again", [False, True])
def test_a_preparation_goes_on_until_the_next_query(asked_again: bool) -> None:
    parts: list[int] = []

    def prepare(deadline: Deadline) -> None:
        for part in range(30):
            deadline.check(f"part {part}")
            time.sleep(0.02)
            parts.append(part)

    continued = ContinuedPreparation()
    continued.begin(prepare)
    if asked_again:
        time.sleep(0.1)
        continued.end()
        done = len(parts)
        assert done < 30
        time.sleep(0.1)
        assert len(parts) == done
    else:
        until = time.monotonic() + 60.0
        while len(parts) < 30 and time.monotonic() < until:
            time.sleep(0.02)
        assert len(parts) == 30
        continued.end()


def test_an_engine_prepares_all_that_a_plan_needs_of_its_robot() -> None:
    engine = Engine()
    request = PlanRequest(
        robot=UrdfText(box_arm("y x slide", 3).text), scene=Scene(name="s"), goal=JointsGoal({"j1": 0.1})
    )
    with pytest.raises(DeadlineExpired):
        engine.prepare(request, Deadline(time.monotonic()))
    engine.prepare(request, UNLIMITED)
    assert is_laid_out(engine._robot(request.robot))
