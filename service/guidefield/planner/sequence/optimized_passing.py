"""Motions past goals optimised as one: shape and time together, each goal a passage whose time is free.

A straight way is a path constraint on its section of the motion: its line, and its even turn. Where the tip is within
the radius of a goal that is passed it need not keep to one.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion.waypoints import length_of
from guidefield.planner.optimize.clearance_samples import Sections
from guidefield.planner.optimize.optimization import Optimized, Outcome, optimize
from guidefield.planner.optimize.passages import Passage
from guidefield.planner.optimize.settings import (
    BALANCED,
    MANY,
    OPTIMIZATION,
    OptimizationSettings,
    closer,
    constrained,
    sized,
)
from guidefield.planner.sequence.joined import Joined, Part, PassedAt, find_refused_part, passed_about, slowest
from guidefield.planner.sequence.nearness import PassedGoal
from guidefield.planner.sequence.straight_way import StraightWay
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Stages
from guidefield.robot.group.path_constraints import ConstrainedFrames, EvenTurn, PathConstraint, line, point


@dataclass(frozen=True)
class OptimizedPassingSettings:
    """Numbers of optimised passing.

    Attributes:
        piece: Length of a piece before the last subdivision, as a share of the smallest radius.
        least_pieces, most_pieces: At least so many for each step, and at most so many for all.
        inside: Share of a radius up to which the tip is at a goal.
        time: Share of the time that is left which may be taken.
        tries: Motions that are judged at most; after the first with more weight on the clearance and twice the pieces.
    """

    piece: float = 0.5
    least_pieces: int = 16
    most_pieces: int = 160
    inside: float = 0.95
    time: float = 0.5
    tries: int = 2


PASSING = OptimizedPassingSettings()


def optimized_past(parts: Sequence[Part], first: Joined, stages: Stages) -> Joined | None:
    """The optimised motion, certified; None where none is, or not all steps may be optimised.

    Args:
        first: A motion past the goals with which it begins, whatever its jerk.
    """
    problem = _limit_time(slowest(parts))
    if not _may_be(parts) or problem.deadline.expired():
        return None
    goals = [one.goal for one in parts if one.goal is not None]
    passages = tuple(
        Passage(goal, first.motion.positions[at.nearest]) for goal, at in zip(goals, first.passages, strict=True)
    )
    sections, settings = _sections(problem, parts), _settings(problem, parts, first.motion)
    for _ in range(PASSING.tries):
        with stages.entered("relax", f"past the goals, shape and time together, {problem.objective.value}") as stage:
            optimized = optimize(problem, first.motion, settings, (), passages, sections)
            stage.outcome = optimized.outcome.value
        joined = None if optimized.outcome is Outcome.NOT_PASSING else _join(optimized, parts)
        if joined is not None:
            with stages.entered("certify", "between the goals and past them, between samples too") as stage:
                fault = find_refused_part(parts, joined)
                stage.outcome = "free" if fault is None else fault[1].reason.value
            if fault is None:
                return joined
        if problem.deadline.expired():
            break
        pieces = 2 * settings.least_pieces
        settings = dataclasses.replace(closer(settings), least_pieces=pieces, most_pieces=2 * settings.most_pieces)
    return None


def _limit_time(problem: Problem) -> Problem:
    """With a share of the time that is left: later steps need some, too."""
    return dataclasses.replace(problem, deadline=problem.deadline.share(PASSING.time))


def _may_be(parts: Sequence[Part]) -> bool:
    """Whether steps may be optimised: in few coordinates, straight ones along a line and next to goals of the tip."""
    if parts[0].problem.group.nv > MANY:
        return False
    for k, one in enumerate(parts):
        problem, way = one.problem, one.way
        if one.motion.duration == 0.0 or problem.guide_planes or problem.optimization_iterations == 0:
            return False
        goals = [beside.goal for beside in parts[max(k - 1, 0) : k + 1] if beside.goal is not None]
        if way is not None and (way.is_point or not all(goal.is_of_tip for goal in goals)):
            return False
    return True


def _sections(problem: Problem, parts: Sequence[Part]) -> Sections:
    """What the whole motion keeps; and on a straight way that, or one beside it, or being at a goal between them."""
    constraints: list[PathConstraint] = list(problem.path_constraints)
    groups, near = [-1] * len(constraints), [range(len(parts))] * len(constraints)
    for k, one in enumerate(parts):  # what is at a goal isn't held to a way as well
        if one.goal is not None and one.goal.is_of_tip:
            constraints += _at(one.goal)
            groups += 2 * [k]
            near += 2 * [range(k, k + 2)]
    for k, one in enumerate(parts):
        if one.way is not None:
            constraints += _along(one.way)
            groups += 2 * [len(parts) + k]
            near += 2 * [range(k - 1, k + 2)]
    straight = [one.way is not None for one in parts]
    asked = np.array(
        [
            [group == -1 or (straight[k] and k in sections) for group, sections in zip(groups, near, strict=True)]
            for k in range(len(parts))
        ],
        np.int64,
    ).reshape(len(parts), -1)
    return Sections(ConstrainedFrames(problem.group, tuple(constraints)), np.array(groups, np.int64), asked)


def _at(goal: PassedGoal) -> tuple[PathConstraint, PathConstraint]:
    """That the tip is at a goal, place and turn, as far as its constraints cost nothing."""
    frame, here = goal.problem.group.tip, goal.placement
    limit = PASSING.inside / BALANCED.constraint_room * goal.radius
    return point(frame, here.translation, limit), EvenTurn(frame, here, np.zeros(3), np.zeros(3), limit)


def _along(way: StraightWay) -> tuple[PathConstraint, PathConstraint]:
    """That a frame stays near the line of a way, and turns evenly along it."""
    begin = way.begin
    return (
        line(way.frame, begin.translation, way.direction, way.line_tolerance),
        EvenTurn(way.frame, begin, way.shift, way.turn, way.turn_tolerance),
    )


def _settings(problem: Problem, parts: Sequence[Part], motion: Trajectory) -> OptimizationSettings:
    """With pieces that are short against the radii, and enough of them for each step."""
    radius = min(one.goal.radius for one in parts if one.goal is not None)
    wanted = math.ceil(length_of(motion.positions) / (PASSING.piece * radius))
    least = min(max(wanted, PASSING.least_pieces * len(parts)), PASSING.most_pieces)
    settings = sized(OPTIMIZATION[problem.objective], problem.group.size)
    keeps = problem.path_constraints or any(one.way is not None for one in parts)
    settings = constrained(settings) if keeps else settings
    return dataclasses.replace(settings, least_pieces=least, most_pieces=max(PASSING.most_pieces, least))


def _join(optimized: Optimized, parts: Sequence[Part]) -> Joined:
    """An optimised motion, and where it passes the goals."""
    motion = optimized.trajectory
    bounds = [0, *optimized.passed, len(motion.times) - 1]
    goals = [one.goal for one in parts if one.goal is not None]
    passages = list[PassedAt]()
    for goal, first, about, last in zip(goals, bounds, bounds[1:], bounds[2:], strict=False):
        since = max(first, passages[-1].nearest) if passages else first  # within large radii they stay in order, too
        passages.append(passed_about(goal, motion, (since, about, last)))
    return Joined(motion, tuple(passages))
