"""Motions past goals along rounded corners: timed as a whole, certified, rounded more tightly where that is refused.

Away from its corners the motion goes along the curves that were planned for the steps; a corner lies within the radius
of the goal that is passed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from guidefield.planner.motion.trajectory import Trajectory, one_after_another
from guidefield.planner.path_motion import motion_along, soonest_along
from guidefield.planner.sequence.corners import Curve, Rounded, rounded
from guidefield.planner.sequence.joined import Joined, Part, PassedAt, passed_about, refused, slowest
from guidefield.planner.sequence.nearness import PassedGoal
from guidefield.planner.sequence.optimized_passing import optimized_past
from guidefield.planner.task.stages import Stages
from guidefield.prove.verdict import Reason


@dataclass(frozen=True)
class RoundingSettings:
    """Numbers of rounding.

    Attributes:
        spacing: Between places of the path that is timed, at most [rad or m].
        tries: Motions that are judged at most.
        tighter: The corners next to what is refused are this much smaller the next time.
        denser: Places, and the pieces of a motion with limits of jerk, are so many times as dense the next time where
            a way, or a goal, isn't kept to.
        densest: So many times as dense at most.
    """

    spacing: float = 0.03
    tries: int = 10
    tighter: float = 0.5
    denser: int = 2
    densest: int = 32


ROUNDING = RoundingSettings()


def rounded_motion(parts: Sequence[Part], stages: Stages) -> tuple[Joined, Rounded] | None:
    """The motion along rounded corners, certified, and its path; None where none is.

    Args:
        parts: Two or more, each certified by itself.
        stages: Where time is counted.
    """
    curves = [Curve(one.motion) for one in parts]
    goals = [one.goal for one in parts if one.goal is not None]
    radii, density = [goal.radius for goal in goals], 1
    problem = slowest(parts)
    for _ in range(ROUNDING.tries):
        with stages.entered("parameterize", "past the goals, as fast as the limits allow") as stage:
            path = rounded(curves, goals, radii, ROUNDING.spacing / density)
            motion = motion_along(problem, path.path, density)
            joined = Joined(motion, passages_of(motion, path, goals))
            stage.outcome = f"{motion.duration:.3f} s"
        with stages.entered("certify", "between the goals and past them, between samples too") as stage:
            fault = refused(parts, joined)
            stage.outcome = "free" if fault is None else fault[1].reason.value
        if fault is None:
            return joined, path
        if problem.deadline.expired():
            break
        at, verdict = fault
        coarse = verdict.reason in (Reason.PATH_CONSTRAINT, Reason.FREE) and density < ROUNDING.densest
        if coarse:
            density *= ROUNDING.denser
        if not coarse or problem.path_constraints:
            for k in (at - 1, at):
                if 0 <= k < len(radii):
                    radii[k] *= ROUNDING.tighter
    return None


def passages_of(motion: Trajectory, path: Rounded, goals: Sequence[PassedGoal]) -> tuple[PassedAt, ...]:
    """Where a motion along a path passes each goal: about the middle of its corner, by length."""
    travelled = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(motion.positions, axis=0), axis=1))]
    lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path.path, axis=0), axis=1))]
    lengths *= travelled[-1] / max(lengths[-1], 1e-300)
    bounds = [0.0, *(0.5 * (lengths[a[1]] + lengths[b[0]]) for a, b in pairwise(path.corners)), travelled[-1]]
    passages = []
    for k, (goal, (begin, end)) in enumerate(zip(goals, path.corners, strict=True)):
        first, last = np.searchsorted(travelled, bounds[k]), np.searchsorted(travelled, bounds[k + 1], side="right") - 1
        low, high = (
            (np.searchsorted(travelled, lengths[[begin, end]]) + np.array([-1, 2])).clip(first, last + 1).tolist()
        )
        about = low + int(np.argmin(goal.distances(motion.positions[low:high])))
        passages.append(passed_about(goal, motion, (int(first), about, int(last))))
    return tuple(passages)


NO_RADIUS = 1e-6
"""Goals with a radius up to this are stopped at: optimised motions pass places that closely, no closer [m, rad]."""


def join(parts: Sequence[Part], stages: Stages) -> Joined:
    """Join motions of the same joints.

    Args:
        parts: Two or more, each certified by itself.
        stages: Where time is counted.
    """
    stopping = _stopping(parts)
    if min(one.goal.radius for one in parts if one.goal is not None) <= NO_RADIUS:
        return stopping
    along = rounded_motion(parts, stages)
    first = stopping if along is None else _soonest(parts, along[1])
    found = [optimized_past(parts, first, stages), None if along is None else along[0], stopping]
    return min(filter(None, found), key=lambda one: one.motion.duration)


def _stopping(parts: Sequence[Part]) -> Joined:
    """The motions as they were planned, at rest at every goal."""
    knots = np.cumsum([max(len(one.motion.times) - 1, 0) for one in parts]).tolist()
    passages = tuple(PassedAt(knot, knot, knot, 0.0) for knot in knots[:-1])
    return Joined(one_after_another([one.motion for one in parts]), passages, stops=True)


def _soonest(parts: Sequence[Part], path: Rounded) -> Joined:
    """The time-optimal motion along rounded corners, whatever its jerk."""
    motion = soonest_along(slowest(parts), path.path)
    return Joined(motion, passages_of(motion, path, [one.goal for one in parts if one.goal is not None]))
