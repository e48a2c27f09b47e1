"""The place at which a straight way ends early, and the cause: a joint's limit, the robot's reach, a singularity."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pinocchio as pin

from guidefield.errors import Status
from guidefield.planner.sequence.straight_way import StraightWay
from guidefield.planner.task.ending import Ending
from guidefield.planner.task.problem import Problem
from guidefield.read_only import ReadOnly
from guidefield.robot.ik.inverse_kinematics import solve
from guidefield.robot.ik.pose_target import PoseTarget
from guidefield.robot.model.chart import TRANSLATION
from guidefield.robot.model.model import Joint
from guidefield.robot.model.spaces import ChartPoint


@dataclass(frozen=True)
class StraightSettings:
    """Numbers of straight motions.

    Attributes:
        spacing: Length of the way between two places that are solved for [m].
        turning: Angle between them [rad].
        finest: Where a place is not reached, nearer ones are tried, up to this share of the way.
        denser: How often the places are taken twice as close where the certificate refuses.
        most: Places at most.
        reached: How far off a place may be that counts as reached [m or rad].
        closely: The same where the exact end of the way is looked for.
        steps: Newton steps to a place, from the one before.
        jump: Largest change of a joint from one place to the next [rad or m]: beyond it the arm folds over.
        damping: Of the steps, times the largest singular value.
        ahead: Shares of the step that failed at which the cause is looked for.
    """

    spacing: float = 0.01
    turning: float = 0.05
    finest: float = 1e-9
    denser: int = 3
    most: int = 4000
    reached: float = 1e-7
    closely: float = 1e-10
    steps: int = 20
    jump: float = 0.35
    damping: float = 1e-6
    ahead: tuple[float, ...] = (1.0, 0.1, 0.01)


STRAIGHT = StraightSettings()


@dataclass(frozen=True, eq=False)
class StraightStop(ReadOnly):
    """The last place of a straight way that the robot can follow.

    Attributes:
        z: Chart point at the last place, shape (nv,).
    """

    share: float
    unreached: float
    z: ChartPoint


def stop_ending(problem: Problem, way: StraightWay, stop: StraightStop) -> Ending:
    """The ending of a plan whose straight way can't be followed: the place, the cause, the joint with its limits."""
    cause, sentence, details = _cause(problem, way, stop)
    message = f"the tip can't go straight: {_place(way, stop.share)} {sentence}"
    return Ending(Status.NO_IK_SOLUTION, message, {"stage": "connect", "share": stop.share, "cause": cause, **details})


def floored(value: float, unit: float) -> str:
    """A value in words, rounded down to whole multiples of a unit."""
    digits = max(0, round(-math.log10(unit)))
    return f"{math.floor(value / unit + 1e-6) * unit:.{digits}f}"


def bring(
    problem: Problem, z: ChartPoint, target: Any, reached: float = STRAIGHT.reached, *, limited: bool = True
) -> ChartPoint | None:
    """The chart point (nv,) next to another that brings the tip to a placement; None if none does.

    Newton's method with the least motion; a joint that a step would push beyond its limit stays there.

    Args:
        z: Chart point, shape (nv,).
        target: The placement, pinocchio.SE3 [m, world].
        reached: How far off it may be [m or rad].
    """
    group, kinematics = problem.group, problem.kinematics
    unlimited = np.full(group.nv, np.inf)
    lower, upper = (group.lower, group.upper) if limited else (-unlimited, unlimited)
    z = z.copy()
    for _ in range(STRAIGHT.steps):
        q = group.expand_from_chart(z)
        placed = kinematics.frame_placement(q, group.tip_id)
        error = np.concatenate([target.translation - placed.translation, pin.log3(target.rotation @ placed.rotation.T)])
        if np.abs(error).max() <= reached:
            return z
        z = _step(z, kinematics.tip_jacobian(q), error, lower, upper)
    return None


def _step(z: ChartPoint, jacobian: np.ndarray, error: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> ChartPoint:
    """One step towards the placement, shape (nv,)."""
    free = np.ones(len(z), bool)
    step = np.zeros(len(z))
    for _ in range(len(z)):
        step = np.zeros(len(z))
        U, sizes, V = np.linalg.svd(jacobian[:, free], full_matrices=False)
        damping = STRAIGHT.damping * float(sizes[0]) if len(sizes) else 0.0
        step[free] = V.T @ (sizes / np.maximum(sizes**2 + damping**2, 1e-300) * (U.T @ error))
        pushed = free & ((z + step > upper) & (z >= upper) | (z + step < lower) & (z <= lower))
        if not pushed.any():
            break
        free &= ~pushed
    return cast(ChartPoint, np.clip(z + step, lower, upper))


def _cause(problem: Problem, way: StraightWay, stop: StraightStop) -> tuple[str, str, dict[str, Any]]:
    """Cause, sentence and values of a stop."""
    places = [way.at(stop.share + part * (stop.unreached - stop.share)) for part in STRAIGHT.ahead]
    for place in places:
        beyond = bring(problem, stop.z, place, limited=False)
        if beyond is None or np.abs(beyond - stop.z).max() > STRAIGHT.jump:
            continue
        if (found := _limit(problem, beyond)) is not None:
            joint, limit, lower, upper, unit = found
            sentence = f"{joint.name} reaches its limit of {limit:.6g} {unit}"
            return "joint limit", sentence, {"joint": joint.name, "value": limit, "limits": [lower, upper]}
    for place in places:
        target = PoseTarget(place, np.zeros(3), np.zeros(3))
        found_there = solve(problem.group, target, [stop.z], 1, rng=np.random.default_rng([problem.seed, 6]))
        if not found_there.solutions:
            return "reach", f"the way leaves the robot's reach: {found_there.reason}", {}
    return "singular", "the arm is at a singular configuration: it would have to fold over to go on", {}


def _limit(problem: Problem, beyond: ChartPoint) -> tuple[Joint, float, float, float, str] | None:
    """The joint that would have to go farthest beyond a limit, that limit, both limits and unit; None if none."""
    group = problem.group
    excess = np.maximum(group.lower - beyond, beyond - group.upper) / group.units
    worst = int(np.argmax(excess))
    if excess[worst] <= 0.0:
        return None
    joint = next(joint for joint in group.joints if joint.idx_v <= worst < joint.idx_v + joint.nv)
    lower, upper = float(group.lower[worst]), float(group.upper[worst])
    limit = upper if beyond[worst] > upper else lower
    slides = worst - joint.idx_v in range(joint.nv)[TRANSLATION.get(joint.kind, slice(0, 0))]
    return joint, limit, lower, upper, "m" if slides else "rad"


def _place(way: StraightWay, share: float) -> str:
    """A share of a way in words, rounded down."""
    percent = f"{floored(100.0 * share, 0.1)} %"
    if way.is_point:
        return f"after {floored(share * way.angle, 0.001)} rad of a turn of {way.angle:.3f} rad ({percent})"
    length = 1000.0 * way.length
    return f"{floored(share * length, 0.1)} mm along the straight way of {length:.1f} mm ({percent})"
