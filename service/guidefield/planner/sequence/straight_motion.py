"""A motion of the joints along which the tip goes straight: inverse kinematics from place to place, then time.

Where the certificate refuses it for its shape, the places are taken closer together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pinocchio as pin

from guidefield.collision.certify.certificate import certify
from guidefield.collision.certify.constraint_certificate import certify_constraints
from guidefield.collision.certify.verdict import Reason, Verdict
from guidefield.errors import Status
from guidefield.planner.ends import check_start
from guidefield.planner.finish import Finished
from guidefield.planner.path_motion import motion_along
from guidefield.planner.plan import Plan
from guidefield.planner.sequence.straight_certificate import certify_straight
from guidefield.planner.sequence.straight_way import StraightWay
from guidefield.planner.start_enclosure import enclosed_start
from guidefield.planner.task.ending import Ending
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.refusal import refusal
from guidefield.planner.task.stages import StageFailed, Stages
from guidefield.planner.timed_goal import keep_schedule
from guidefield.planner.timed_ways import among_what_rests
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ChartPoints


@dataclass(frozen=True)
class StraightSettings:
    """Numbers of straight motions.

    Attributes:
        spacing: Length of the way between two places that are solved for [m].
        turning: Angle between them [rad].
        denser: How often the places are taken twice as close where the certificate refuses.
        most: Places at most.
        reached: How far off a place may be that counts as reached [m or rad].
        steps: Newton steps to a place, from the one before.
        jump: Largest change of a joint from one place to the next [rad or m]: beyond it the arm folds over.
        damping: Of the steps, times the largest singular value.
    """

    spacing: float = 0.01
    turning: float = 0.05
    denser: int = 3
    most: int = 4000
    reached: float = 1e-7
    steps: int = 20
    jump: float = 0.35
    damping: float = 1e-6


STRAIGHT = StraightSettings()


def straight_plan(problem: Problem, way: StraightWay) -> Plan:
    """Plan a motion along a straight way; no other way is looked for.

    Args:
        problem: Robot, world, limits and start; its goal doesn't count.
        way: The way, from where the tip is at the start.
    """
    stages, still = Stages(problem), among_what_rests(problem)
    try:
        with stages.entered("ends", "start and straight way") as stage:
            check_start(problem.at(0.0))
            stage.outcome = "the start is free"
    except StageFailed as failed:
        return _failed(problem.at(0.0), problem.z_start[None], failed.ending, stages)
    places = _places(way)
    for attempt in range(STRAIGHT.denser + 1):
        with stages.entered("connect", "along the straight way") as stage:
            path, stuck = followed(problem, way, places)
            stage.outcome = "reached" if stuck is None else f"stuck at {100 * stuck:.0f} % of the way"
        if stuck is not None:
            return _failed(still, path, _stopped(problem, stage.outcome) or stuck_ending(way, stuck), stages)
        with stages.entered("parameterize", "as fast as the limits allow") as stage:
            trajectory = motion_along(problem, path, 2**attempt)
            stage.outcome = f"{trajectory.duration:.3f} s"
        with stages.entered("certify", "on the exact geometry and on the straight way, between samples too") as stage:
            verdict = _judged(still, way, trajectory.bezier())
            problem.counters.collision_checks += verdict.evaluations
            stage.outcome = verdict.reason.value
        last = attempt == STRAIGHT.denser or 2 * places > STRAIGHT.most or problem.budget.spent() is not None
        if verdict.free or verdict.reason is not Reason.PATH_CONSTRAINT or last:
            break
        places *= 2
    made = Finished(verdict, path, {}, trajectory)
    if verdict.free and problem.scene.moves:
        made = keep_schedule(problem, made, stages, lambda motion: _kept_straight(problem, way, motion.bezier()))
    if made.failure is not None:
        return _failed(problem.at(0.0), problem.z_start[None], made.failure, stages)
    ended = Ending(Status.SUCCESS, "found a straight motion and certified it over its whole length")
    if not made.verdict.free:
        ended = refusal(problem, made.verdict)
    return Plan(
        ended.status,
        ended.message,
        made.verdict,
        path,
        made.trajectory,
        stages=tuple(stages.left),
        seconds=stages.seconds,
        details=ended.details,
    )


def followed(problem: Problem, way: StraightWay, places: int | None = None) -> tuple[ChartPoints, float | None]:
    """Chart points along which the tip is at places of the way, evenly spaced.

    Args:
        problem: Robot and start.
        way: The way.
        places: How many beyond the start; None: as many as it takes.

    Returns:
        Shape (n, nv), the start first, and None; where it goes no further, or time is up, those before and the share of
        the way.
    """
    count, z = _places(way) if places is None else places, problem.z_start
    path = [z]
    for share in np.arange(1, count + 1) / count:
        reached = None if problem.budget.spent() else _brought(problem, z, way.at(float(share)))
        if reached is None or np.abs(reached - z).max() > STRAIGHT.jump:
            return np.array(path), float(share)
        z = reached
        path.append(z)
    return np.array(path), None


def _places(way: StraightWay) -> int:
    """Places beyond the start that are solved for."""
    wanted = max(way.length / STRAIGHT.spacing, way.angle / STRAIGHT.turning, 2.0)
    return min(math.ceil(wanted), STRAIGHT.most)


def _brought(problem: Problem, z: ChartPoint, target: Any) -> ChartPoint | None:
    """The chart point (nv,) next to another that brings the tip to a placement within the limits; None if none does.

    Newton's method with the least motion; a joint that a step would push beyond its limit stays there.
    """
    group, kinematics = problem.group, problem.kinematics
    z = z.copy()
    for _ in range(STRAIGHT.steps):
        q = group.expand_from_chart(z)
        placed = kinematics.frame_placement(q, group.tip_id)
        error = np.concatenate([target.translation - placed.translation, pin.log3(target.rotation @ placed.rotation.T)])
        if np.abs(error).max() <= STRAIGHT.reached:
            return z
        J = kinematics.tip_jacobian(q)
        z = _stepped(problem, z, J, error)
    return None


def _stepped(problem: Problem, z: ChartPoint, jacobian: np.ndarray, error: np.ndarray) -> ChartPoint:
    """One step towards the placement, shape (nv,)."""
    lower, upper = problem.group.lower, problem.group.upper
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


def _judged(problem: Problem, way: StraightWay, pieces: ChartCurves) -> Verdict:
    """Whether a motion is free, keeps the path constraints and keeps to the way."""
    inside = enclosed_start(problem, pieces[0, 0])
    verdict = inside or certify(problem.world, pieces, problem.min_clearance, stopped=problem.budget.spent)
    turns = problem.world.bodies.turns
    if verdict.free:
        verdict = _kept_straight(problem, way, pieces)
    if verdict.free and problem.path_constraints:
        verdict = certify_constraints(problem.constrained_frames, turns, pieces, problem.budget.spent)
    return verdict


def _kept_straight(problem: Problem, way: StraightWay, pieces: ChartCurves) -> Verdict:
    """Whether a motion, pieces (m, 4, nv), keeps to the way."""
    return certify_straight(way, problem.group, problem.world.bodies.turns, pieces, problem.budget.spent)


def _stopped(problem: Problem, where: str) -> Ending | None:
    """The ending of a way along which time was up, or the run was cancelled; None where there is time."""
    spent = problem.budget.spent()
    if spent is None:
        return None
    why = "the run was cancelled" if spent is Status.PREEMPTED else "time was up"
    return Ending(spent, f"{why} along the straight way: {where}", {"stage": "connect"})


def stuck_ending(way: StraightWay, share: float) -> Ending:
    """The ending of a way that the robot can't follow."""
    where = f"{1000 * share * way.length:.0f} mm along the straight way of {1000 * way.length:.0f} mm"
    message = f"the tip can't go straight: {where} a joint limit or a singular configuration stops it"
    return Ending(Status.NO_IK_SOLUTION, message, {"stage": "connect", "share": share})


def _failed(problem: Problem, path: ChartPoints, ending: Ending, stages: Stages) -> Plan:
    """The plan of a way that was not followed to its end, its path judged as far as it goes."""
    pieces = np.stack([path[:-1], path[1:]], axis=1) if len(path) > 1 else np.repeat(path[None], 2, axis=1)
    verdict = enclosed_start(problem, path[0]) or certify(problem.world, pieces, problem.min_clearance)
    return Plan(
        ending.status,
        ending.message,
        verdict,
        path,
        stages=tuple(stages.left),
        seconds=stages.seconds,
        details=ending.details,
    )
