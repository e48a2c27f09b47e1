"""A motion of the joints along which the tip goes straight: inverse kinematics from place to place, then time.

Where the certificate refuses it for its shape, the places are taken closer together.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.deadline import end_reason
from guidefield.errors import Status
from guidefield.planner.ends import check_start
from guidefield.planner.goal_among_movers import keep_schedule
from guidefield.planner.held_paths import without_movers
from guidefield.planner.motion_certificate import CertifiedMotion, certify_from_start, find_enclosed_start
from guidefield.planner.path_so_far import time_path
from guidefield.planner.plan import Plan
from guidefield.planner.sequence.straight_way import (
    JUMP,
    REACHED,
    REACHED_CLOSELY,
    StraightStop,
    StraightWay,
    bring_tip,
    certify_straight,
    format_rounded_down,
    make_stop_ending,
)
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Ending, StageFailed, Stages, make_refusal
from guidefield.prove.certificate import certify
from guidefield.prove.verdict import Reason, Verdict
from guidefield.robot.model.spaces import ChartCurves, ChartPoints

SPACING = 0.01  # length of the way between two places that are solved for [m]
TURNING = 0.05  # angle between them [rad]
FINEST = 1e-9  # if a place is not reached, nearer ones are tried, down to this share of the way
DENSER = 3  # times that the places are taken twice as close if the certificate refuses the shape
MOST_PLACES = 4000  # places at most


def straight_plan(problem: Problem, way: StraightWay) -> Plan:
    """Plan a motion along a straight way; no other way is searched for."""
    stages, still = Stages(problem), without_movers(problem)
    try:
        with stages.entered("ends", "start and straight way") as stage:
            check_start(problem.at(0.0))
            stage.outcome = "the start is free"
    except StageFailed as failed:
        return _make_failed_plan(problem.at(0.0), problem.z_start[None], failed.ending, stages)
    places = _choose_places(way)
    for attempt in range(DENSER + 1):
        with stages.entered("connect", "along the straight way") as stage:
            path, stop = follow_way(problem, way, places)
            stage.outcome = (
                "reached" if stop is None else f"stopped at {format_rounded_down(100.0 * stop.share, 0.1)} % of the way"
            )
        if stop is not None:
            return _make_failed_plan(
                still, path, _find_stop_ending(problem, stage.outcome) or make_stop_ending(problem, way, stop), stages
            )
        with stages.entered("parameterize", "as fast as the limits allow") as stage:
            trajectory = time_path(problem, path, 2**attempt)
            stage.outcome = f"{trajectory.duration:.3f} s"
        with stages.entered("certify", "on the exact geometry and on the straight way, between samples too") as stage:
            verdict = certify_from_start(still, trajectory, problem.deadline)
            if verdict.free:
                verdict = _certify_straightness(still, way, trajectory.bezier())
            problem.counters.collision_checks += verdict.evaluations
            stage.outcome = verdict.reason.value
        last = attempt == DENSER or 2 * places > MOST_PLACES or problem.deadline.expired()
        if verdict.free or verdict.reason is not Reason.PATH_CONSTRAINT or last:
            break
        places *= 2
    made = CertifiedMotion(verdict, path, {}, trajectory)
    if verdict.free:
        made = keep_schedule(problem, made, stages, lambda motion: _certify_straightness(problem, way, motion.bezier()))
    if made.failure is not None:
        return _make_failed_plan(problem.at(0.0), problem.z_start[None], made.failure, stages)
    ended = Ending(Status.SUCCESS, "found a straight motion and certified it over its whole length")
    if not made.verdict.free:
        ended = make_refusal(problem, made.verdict)
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


def follow_way(
    problem: Problem, way: StraightWay, places: int | None = None
) -> tuple[ChartPoints, StraightStop | None]:
    """Chart points (n, nv) with the tip at places of the way, evenly spaced, and closer where joints move much.

    Where it goes no further, or time is up, those before and the place at which it ends.
    """
    count, z = _choose_places(way) if places is None else places, problem.z_start
    path, share = [z], 0.0
    for index in range(1, count + 1):
        there = index / count
        step = there - share
        while share < there:
            onward = there if step >= there - share else share + step
            near = REACHED if onward == there and step * count > 0.9 else REACHED_CLOSELY
            reached = None if problem.deadline.expired() else bring_tip(problem, z, way.at(onward), near)
            if reached is not None and np.abs(reached - z).max() <= JUMP:
                share, z = onward, reached
                path.append(z)
            elif step > FINEST and not problem.deadline.expired():
                step *= 0.5
            else:
                return np.array(path), StraightStop(share, there, z)
    return np.array(path), None


def _choose_places(way: StraightWay) -> int:
    wanted = max(way.length / SPACING, way.angle / TURNING, 2.0)
    return min(math.ceil(wanted), MOST_PLACES)


def _certify_straightness(problem: Problem, way: StraightWay, pieces: ChartCurves) -> Verdict:
    return certify_straight(way, problem.group, problem.world.bodies.turns, pieces, problem.deadline)


def _find_stop_ending(problem: Problem, where: str) -> Ending | None:
    status = problem.deadline.status()
    if status is None:
        return None
    return Ending(status, f"{end_reason(status)} along the straight way: {where}", {"stage": "connect"})


def _make_failed_plan(problem: Problem, path: ChartPoints, ending: Ending, stages: Stages) -> Plan:
    pieces = np.stack([path[:-1], path[1:]], axis=1) if len(path) > 1 else np.repeat(path[None], 2, axis=1)
    verdict = find_enclosed_start(problem, path[0]) or certify(problem.world, pieces, problem.min_clearance)
    return Plan(
        ending.status,
        ending.message,
        verdict,
        path,
        stages=tuple(stages.left),
        seconds=stages.seconds,
        details=ending.details,
    )
