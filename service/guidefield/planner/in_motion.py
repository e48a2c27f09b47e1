"""Plans that begin or end in motion: the stop after the start, and the run up to the goal's velocities.

What joins the two is planned from rest to rest, so there is always a motion: stop, go, and get up to speed. The
optimiser makes one of it that doesn't stop. If a joint can't come to rest before its limit or an obstacle, the plan is
refused. Among obstacles that move the stop is judged in time, and the run to the goal as they come to rest. Refusals
name the fields of the wire (`_START`, `_GOAL`); `STOPS` is a sentence for people.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from guidefield.errors import Status
from guidefield.planner.motion.limit_load import TOLERANCE
from guidefield.planner.motion.trajectory import (
    Trajectory,
    choose_jerks,
    concatenate,
    reverse_motion,
    separate_jerks,
    stop_motion,
    unwrap_towards,
)
from guidefield.planner.motion_certificate import judge_itself
from guidefield.planner.task.effort import torques_of
from guidefield.planner.task.motion_limits import KEPT_SHARE
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import StageFailed, Stages
from guidefield.prove.verdict import Reason
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoint, ChartPoints, ChartRate, ChartRates

STOPS = "no motion within limits was found that doesn't stop: this one comes to rest after its start, or before its end"
"""Warning about a motion that begins or ends in motion, and is at rest on the way."""


@dataclass(frozen=True, eq=False)
class MovingEnds(ReadOnly):
    """The first part of a motion, to rest, and for each goal the last part, from rest to its velocities."""

    stop: Trajectory
    goals: ChartPoints  # chart points (m, nv) of the goals that can be reached so
    runs: tuple[Trajectory, ...]

    @property
    def inner_goals(self) -> ChartPoints:
        """The chart points of rest before each goal, shape (m, nv)."""
        return np.array([run.positions[0] for run in self.runs])

    def between(self, problem: Problem) -> Problem:
        """The problem from when and where the robot has come to rest."""
        return problem.since(self.stop.duration, problem.group.from_chart(self.stop.positions[-1]))

    def around(self, middle: Trajectory) -> Trajectory:
        """A motion from rest to rest between the two, with them before and after it."""
        end = middle.positions[-1]
        away = [np.abs((end - run.positions[0] + np.pi) % (2.0 * np.pi) - np.pi).max() for run in self.runs]
        run = self.runs[int(np.argmin(away))]
        turned = run.positions + (end - run.positions[0])  # whole turns may have been added
        return concatenate([unwrap_towards(self.stop, middle), middle, Trajectory(run.times, turned, run.velocities)])


def moving_ends(problem: Problem, goals: ChartPoints, stages: Stages) -> MovingEnds:
    """Plan how a problem's ends are left and reached in motion; goals are chart points (m, nv), free.

    Raises:
        StageFailed: START_STATE_INVALID or GOAL_STATE_INVALID, with the joint that can't keep its limits, or can't stop
            in time, and why.
    """
    with stages.entered("ends", "out of the start's velocities, into the goal's") as stage:
        _require_within(problem, _START, problem.start_rates, problem.start_acceleration)
        _require_within(problem, _GOAL, problem.end_rates, None)
        _require_within_whole(problem, _START, problem.z_start, problem.start_rates, problem.start_acceleration)
        stop = _stop_within_limits(problem, _START, problem.z_start, problem.start_rates, problem.start_acceleration)
        reached: list[tuple[ChartPoint, Trajectory]] = []
        failures: list[StageFailed] = []
        once_at_rest = problem.at(problem.scene.end)
        for goal in goals:
            try:
                _require_within_whole(problem, _GOAL, goal, problem.end_rates, None)
                run = reverse_motion(_stop_within_limits(once_at_rest, _GOAL, goal, -problem.end_rates, None))
                reached.append((goal, run))
            except StageFailed as failed:
                failures.append(failed)
        if not reached:
            raise failures[0]
        stage.outcome = f"at rest after {stop.duration:.3f} s"
    return MovingEnds(stop, np.array([goal for goal, _ in reached]), tuple(run for _, run in reached))


@dataclass(frozen=True)
class _EndWords:
    status: Status
    stage: str
    field: str
    verb: str


_START = _EndWords(Status.START_STATE_INVALID, "start", "start_velocities", "stop")
_GOAL = _EndWords(Status.GOAL_STATE_INVALID, "goal", "end_velocities", "get up to speed")


def _require_within(problem: Problem, end: _EndWords, velocity: ChartRate, acceleration: ChartRate | None) -> None:
    """Refuse what is beyond the limits of a joint, or will be whatever it does."""
    group = problem.group
    names = group.velocity_names
    for j, name in enumerate(names):
        v, top = float(velocity[j]), float(group.velocity_limits[j])
        if abs(v) > top * (1.0 + TOLERANCE):
            raise _make_refusal(
                end, name, f"`{end.field}` has joint {name} at {v:.6g}, its limit is {top:.6g}", limit=top
            )
        if acceleration is None:
            continue
        a, most = float(acceleration[j]), float(group.acceleration_limits[j])
        if abs(a) > most * (1.0 + TOLERANCE):
            told = f"`start_accelerations` has joint {name} at {a:.6g}, its limit is {most:.6g}"
            raise _make_refusal(end, name, told, limit=most)
        jerk = np.inf if problem.jerk_limits is None else float(problem.jerk_limits[j])
        reached = abs(v) + a * a / (2.0 * jerk)
        if v * a > 0.0 and (reached > top * (1.0 + TOLERANCE) or (jerk == np.inf and abs(v) >= top)):
            told = (
                f"joint {name} can't keep its velocity limit of {top:.6g}: with the acceleration at the start it"
                f" reaches {reached:.6g} at least"
            )
            raise _make_refusal(end, name, told, limit=top, reached=reached)


def _require_within_whole(
    problem: Problem, end: _EndWords, z: ChartPoint, velocity: ChartRate, acceleration: ChartRate | None
) -> None:
    still = np.zeros_like(velocity)
    rows = [cast(ChartRates, row[None]) for row in (velocity, still if acceleration is None else acceleration)]
    point = cast(ChartPoints, z[None])
    for limit in problem.cartesian_limits:
        speed = limit.speed / math.sqrt(float(limit.along(point, rows[0], cast(ChartRates, still[None])).caps[0]))
        if speed > limit.speed * KEPT_SHARE:
            kind = "link" if limit.is_link else "frame"
            told = f"`{end.field}` move {kind} {limit.name!r} at {speed:.6g} m/s, its limit is {limit.speed:g} m/s"
            raise StageFailed(end.status, told, stage=end.stage, speed=speed, limit=limit.speed, **{kind: limit.name})
    effort = problem.effort_limit
    if effort is None:
        return
    torques = torques_of(effort.tree, point, *rows)[0]
    worst = int(np.argmax(np.abs(torques) / effort.limits))
    most, name = float(effort.limits[worst]), effort.names[worst]
    if abs(torques[worst]) > most * KEPT_SHARE:
        told = f"with `{end.field}` joint {name} takes {torques[worst]:.6g} N m, its limit is {most:g} N m"
        raise _make_refusal(end, name, told, effort=float(torques[worst]), limit=most)


def _stop_within_limits(
    problem: Problem, end: _EndWords, z: ChartPoint, velocity: ChartRate, acceleration: ChartRate | None
) -> Trajectory:
    """The motion to rest; at a goal that of time running backwards."""
    group = problem.group
    still = cast(ChartRate, np.zeros(group.nv))
    rise = still if acceleration is None else acceleration
    room = group.velocity_limits - np.abs(velocity)
    rises = np.where(velocity * rise > 0.0, rise**2 / (2.0 * np.maximum(room, 1e-300)), 0.0)
    jerks = choose_jerks(group.acceleration_limits, problem.jerk_limits, rises)
    jerks = separate_jerks(velocity, rise, group.acceleration_limits, jerks, rises)
    motion = stop_motion(z, velocity, rise, group.acceleration_limits, jerks)
    if motion.duration == 0.0:
        return motion
    verdict = judge_itself(problem, motion)
    problem.counters.collision_checks += verdict.evaluations
    if verdict.free:
        return motion
    if verdict.reason is Reason.BEYOND_LIMITS and verdict.beyond is not None:
        fault = verdict.beyond
        j = group.velocity_names.index(fault.joint)
        limit = fault.upper if fault.value > fault.upper else fault.lower
        told = (
            f"joint {fault.joint} can't {end.verb} in time: at {abs(float(velocity[j])):.6g} it takes"
            f" {abs(float(motion.positions[-1, j] - z[j])):.6g}, and its limit of {limit:.6g} is"
            f" {abs(limit - float(z[j])):.6g} away"
        )
        raise _make_refusal(end, fault.joint, told, limit=limit, pair=None)
    slowest = int(np.argmax(np.abs(velocity) / group.acceleration_limits))
    name, pair = group.velocity_names[slowest], " and ".join(verdict.pair) if verdict.pair else "bodies"
    told = (
        f"the robot can't {end.verb} in time: {verdict.reason.value} between {pair} within the"
        f" {motion.duration:.3f} s that it takes, most of all joint {name}"
    )
    raise _make_refusal(end, name, told, pair=list(verdict.pair) if verdict.pair else None, duration=motion.duration)


def _make_refusal(end: _EndWords, joint: str, message: str, **details: Any) -> StageFailed:
    return StageFailed(end.status, message, stage=end.stage, joint=joint, **details)
