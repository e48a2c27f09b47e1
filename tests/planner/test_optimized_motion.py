"""Motions optimised in time: sooner, as far away, certified, free at dense times by Coal, within limits."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

from guidefield.messages import scene as messages
from guidefield.planner.plan import Plan, plan
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.trace import StageEntered
from tests.planner.problems import Listener
from tests.planner.test_goal_among_movers import DOOR, RIGHT, asked, made_tip, require_free
from tests.planner.test_schedule import flight


@functools.cache
def planned(jerk: float | None, iterations: int | None) -> tuple[Problem, Plan]:
    """A Panda that has to wait for a door."""
    limits = None if jerk is None else np.full(7, jerk)
    made = asked(DOOR, min_clearance=0.01, jerk_limits=limits, observer=Listener())
    made = dataclasses.replace(made, optimization_iterations=iterations)
    return made, plan(made)


@pytest.mark.parametrize("jerk", [None, 300.0])
def test_it_arrives_sooner_than_the_schedule_and_stays_free_and_within_limits(jerk: float | None) -> None:
    (_, scheduled), (made, shaped) = planned(jerk, 0), planned(jerk, None)
    require_free(made, shaped)
    assert shaped.trajectory.times[-1] < 0.9 * scheduled.trajectory.times[-1]
    told = [event.message for event in made.observer.events if isinstance(event, StageEntered)]
    assert any("among what moves" in message for message in told)


def test_it_does_not_arrive_before_its_end_is_free_for_good() -> None:
    """A bar passes over the goal; the robot comes after it, though nothing but that is in its way."""
    x, y, z = made_tip(RIGHT).translation
    way = flight([0.0, 3.0], (x, y - 0.9, z), (x, y + 0.9, z))
    made = asked(messages.Sphere(name="ball", radius=0.08, trajectory=way), min_clearance=0.005)
    found = plan(made)
    require_free(made, found)
    assert found.trajectory.times[-1] > 1.4
