"""Motions optimised in time: sooner, as far away, certified, free at dense times by Coal, within limits."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

from guidefield.messages import scene as messages
from guidefield.planner import optimized_motion as room
from guidefield.planner.motion_certificate import CertifiedMotion
from guidefield.planner.optimize.optimization import Optimized, optimize
from guidefield.planner.optimized_motion import optimize_motion
from guidefield.planner.plan import Plan, plan
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.trace import StageEntered
from guidefield.prove.verdict import Reason, Verdict
from tests.planner.problems import Listener
from tests.planner.schedule.test_schedule import flight
from tests.planner.test_goal_among_movers import DOOR, LEFT, RIGHT, asked, made_tip, require_free


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


def test_the_start_stands_until_it_departs() -> None:
    made, shaped = planned(None, None)
    begins = shaped.trajectory.times[1]
    assert begins > 0.5, "a door is waited for"
    still = shaped.trajectory.evaluate(np.linspace(0.0, begins, 20))[0]
    np.testing.assert_array_equal(still, np.repeat(made.z_start[None], 20, axis=0))


def given(made: Problem, monkeypatch: pytest.MonkeyPatch, **options: object) -> tuple[Plan, object, list[object]]:
    """The plan, the schedule that was optimised, and what was judged of it then."""
    scheduled: list[object] = []
    judged: list[object] = []

    def spied(problem: Problem, motion: object, *rest: object) -> CertifiedMotion | None:
        *others, judge = rest

        def judging(problem: Problem, motion: object) -> Verdict:
            judged.append(motion)
            return options.get("verdict") or judge(problem, motion)

        scheduled.append(motion)
        return optimize_motion(problem, motion, *others, judging)

    monkeypatch.setattr("guidefield.planner.goal_among_movers.optimize_motion", spied)
    return plan(made), scheduled[0], judged


def test_what_the_certificate_refuses_stays_the_scheduled_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    refused = Verdict(Reason.CONTACT, 1, 0, 0.0, (0, 0.0), None, LEFT)
    found, scheduled, judged = given(asked(DOOR), monkeypatch, verdict=refused)
    assert found.trajectory is scheduled
    assert judged


def test_what_is_worse_stays_the_scheduled_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    def slowly(problem: Problem, motion: object, *rest: object, **options: object) -> Optimized:
        made = optimize(problem, motion, *rest, **options)
        begin = made.trajectory.times[0]
        late = dataclasses.replace(made.trajectory, times=begin + 10.0 + made.trajectory.times)
        return dataclasses.replace(made, trajectory=late)

    monkeypatch.setattr(room, "optimize", slowly)
    found, scheduled, judged = given(asked(DOOR), monkeypatch)
    assert found.trajectory is scheduled
    assert not judged


def test_it_does_not_arrive_before_its_end_is_free_for_good() -> None:
    """A bar passes over the goal; the robot comes after it, though nothing but that is in its way."""
    x, y, z = made_tip(RIGHT).translation
    way = flight([0.0, 3.0], (x, y - 0.9, z), (x, y + 0.9, z))
    made = asked(messages.Sphere(name="ball", radius=0.08, trajectory=way), min_clearance=0.005)
    found = plan(made)
    require_free(made, found)
    assert found.trajectory.times[-1] > 1.4
