"""Straight lines of a tip from pose to pose: why the robot can't follow one, and the certificate that it does.

A motion of the joints along which the tip goes straight: inverse kinematics from place to place, then time.

Where the certificate refuses it for its shape, places are taken closer together. `certify_straight` decides by bounds
(`_rests`), which may be larger, never smaller; `PIECES_AT_ONCE` changes which place it names. Others but `POINT` are a
search: they change whether a motion is found, where it ends (docs/steps.md promises 1e-8) and why, and the time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np
import pinocchio as pin

from guidefield.deadline import UNLIMITED, Deadline, end_reason
from guidefield.errors import Status
from guidefield.planner.ends import check_start
from guidefield.planner.goal_among_movers import keep_schedule
from guidefield.planner.held_paths import without_movers
from guidefield.planner.motion_certificate import CertifiedMotion, certify_from_start, find_enclosed_start
from guidefield.planner.path_so_far import time_path
from guidefield.planner.plan import Plan
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Ending, StageFailed, Stages, make_refusal
from guidefield.prove.certificate import certify
from guidefield.prove.curve import halve_curves
from guidefield.prove.verdict import CONSTRAINT_RESOLUTION, Reason, Verdict
from guidefield.read_only import ReadOnly
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.inverse_kinematics import PoseTarget, solve
from guidefield.robot.model.joints import TRANSLATION, Joint, LocalCurves, LocalPoint, LocalPoints
from guidefield.robot.model.model import frame_index

POINT = 1e-9  # on a line no longer than this the tip turns on the spot [m], if by more than this [rad]


@dataclass(frozen=True, eq=False)
class CartesianLine:
    """A straight line of a frame from one pose to another, along which it turns evenly."""

    frame: str
    begin: Any  # its placements at the ends, pinocchio.SE3 [m, world]
    end: Any
    line_tolerance: float  # how far the frame's origin may be from the straight line between the two [m]
    turn_tolerance: float  # how far the frame may be turned away from the line's orientation there [rad]

    @cached_property
    def shift(self) -> np.ndarray:
        """From one origin to the other, shape (3,) [m, world]."""
        shift: np.ndarray = self.end.translation - self.begin.translation
        return shift

    @cached_property
    def length(self) -> float:
        """[m]."""
        return float(np.linalg.norm(self.shift))

    @cached_property
    def is_point(self) -> bool:
        """True if the frame turns on the spot."""
        return self.length <= POINT

    @cached_property
    def direction(self) -> np.ndarray:
        """Of the line, shape (3,), of length 1; zero on the spot."""
        direction: np.ndarray = np.zeros(3) if self.is_point else self.shift / self.length
        return direction

    @cached_property
    def turn(self) -> np.ndarray:
        """Rotation vector from one orientation to the other in the world's axes, shape (3,) [rad]; at most pi long."""
        turn: np.ndarray = pin.log3(self.end.rotation @ self.begin.rotation.T)
        return turn

    @cached_property
    def angle(self) -> float:
        """The angle by which the frame turns [rad]."""
        return float(np.linalg.norm(self.turn))

    def at(self, share: float) -> Any:
        """The frame's placement at a share of the line, a pinocchio.SE3."""
        return pin.SE3(pin.exp3(share * self.turn) @ self.begin.rotation, self.begin.translation + share * self.shift)

    def share(self, placement: Any) -> float:
        """The share of the line at a placement (pinocchio.SE3) of the frame: by its place; on the spot by its rotation.

        Less than 0 before its beginning, more than 1 beyond its end.
        """
        if not self.is_point:
            return float(self.direction @ (placement.translation - self.begin.translation)) / self.length
        if self.angle <= POINT:
            return 0.0
        return float(self.turn @ pin.log3(placement.rotation @ self.begin.rotation.T)) / self.angle**2

    def sideways(self, placement: Any) -> np.ndarray:
        """From the line's nearest point to the origin of a placement (pinocchio.SE3), shape (3,) [m]."""
        away: np.ndarray = placement.translation - self.begin.translation
        sideways: np.ndarray = away - self.direction * (self.direction @ away)
        return sideways

    def measure_turn(self, placement: Any) -> float:
        """Angle between a placement (pinocchio.SE3) and the line's at its share [rad]."""
        return float(np.linalg.norm(pin.log3(placement.rotation @ self.at(self.share(placement)).rotation.T)))


REACHED = 1e-7  # largest error of a place that counts as reached [m or rad]
REACHED_CLOSELY = 1e-10  # the same where the exact end of the line is searched for
STEPS = 20  # Newton steps to a place, from the one before
JUMP = 0.35  # largest change of a joint from one place to the next [rad or m]: beyond it the arm folds over
DAMPING = 1e-6  # of the steps, times the largest singular value
FAILED_SHARES = (1.0, 0.1, 0.01)  # shares of the step that failed at which the cause is searched for


@dataclass(frozen=True, eq=False)
class StraightStop(ReadOnly):
    """The last place of a straight line that the robot can follow."""

    share: float  # of the line, that it follows
    unreached: float  # share of the line at the next place, which it doesn't reach
    z: LocalPoint  # local coordinates at the last place, shape (nv,)


def make_stop_ending(problem: Problem, line: CartesianLine, stop: StraightStop) -> Ending:
    """The ending of a plan whose straight line can't be followed: the place, the cause, the joint with its limits."""
    cause, sentence, details = _find_cause(problem, line, stop)
    message = f"the tip can't go straight: {_place(line, stop.share)} {sentence}"
    return Ending(Status.NO_IK_SOLUTION, message, {"stage": "connect", "share": stop.share, "cause": cause, **details})


def format_rounded_down(value: float, unit: float) -> str:
    """A value in words, rounded down to whole multiples of a unit."""
    digits = max(0, round(-math.log10(unit)))
    return f"{math.floor(value / unit + 1e-6) * unit:.{digits}f}"


def bring_tip(
    problem: Problem, z: LocalPoint, target: Any, reached: float = REACHED, *, limited: bool = True
) -> LocalPoint | None:
    """The point (nv,) next to another that brings the tip to a placement, pinocchio.SE3 [m, world].

    None if none does. Newton's method with the least motion; a joint that a step would push beyond its limit stays
    there.
    """
    group, kinematics = problem.group, problem.kinematics
    unlimited = np.full(group.nv, np.inf)
    lower, upper = (group.lower, group.upper) if limited else (-unlimited, unlimited)
    z = z.copy()
    for _ in range(STEPS):
        q = group.expand_from_local(z)
        placed = kinematics.frame_placement(q, group.tip_id)
        error = np.concatenate([target.translation - placed.translation, pin.log3(target.rotation @ placed.rotation.T)])
        if np.abs(error).max() <= reached:
            return z
        z = _step(z, kinematics.tip_jacobian(q), error, lower, upper)
    return None


def _step(z: LocalPoint, jacobian: np.ndarray, error: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> LocalPoint:
    free = np.ones(len(z), bool)
    step = np.zeros(len(z))
    for _ in range(len(z)):
        step = np.zeros(len(z))
        U, sizes, V = np.linalg.svd(jacobian[:, free], full_matrices=False)
        damping = DAMPING * float(sizes[0]) if len(sizes) else 0.0
        step[free] = V.T @ (sizes / np.maximum(sizes**2 + damping**2, 1e-300) * (U.T @ error))
        pushed = free & ((z + step > upper) & (z >= upper) | (z + step < lower) & (z <= lower))
        if not pushed.any():
            break
        free &= ~pushed
    return cast(LocalPoint, np.clip(z + step, lower, upper))


def _find_cause(problem: Problem, line: CartesianLine, stop: StraightStop) -> tuple[str, str, dict[str, Any]]:
    places = [line.at(stop.share + part * (stop.unreached - stop.share)) for part in FAILED_SHARES]
    for place in places:
        beyond = bring_tip(problem, stop.z, place, limited=False)
        if beyond is None or np.abs(beyond - stop.z).max() > JUMP:
            continue
        if (found := _find_limit(problem, beyond)) is not None:
            joint, limit, lower, upper, unit = found
            sentence = f"{joint.name} reaches its limit of {limit:.6g} {unit}"
            return "joint limit", sentence, {"joint": joint.name, "value": limit, "limits": [lower, upper]}
    for place in places:
        target = PoseTarget(place, np.zeros(3), np.zeros(3))
        found_there = solve(problem.group, target, [stop.z], 1, rng=np.random.default_rng([problem.seed, 6]))
        if not found_there.solutions:
            return "reach", f"the way leaves the robot's reach: {found_there.reason}", {}
    return "singular", "the arm is at a singular configuration: it would have to fold over to go on", {}


def _find_limit(problem: Problem, beyond: LocalPoint) -> tuple[Joint, float, float, float, str] | None:
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


def _place(line: CartesianLine, share: float) -> str:
    percent = f"{format_rounded_down(100.0 * share, 0.1)} %"
    if line.is_point:
        return (
            f"after {format_rounded_down(share * line.angle, 0.001)} rad of a turn of {line.angle:.3f} rad ({percent})"
        )
    length = 1000.0 * line.length
    return f"{format_rounded_down(share * length, 0.1)} mm along the straight way of {length:.1f} mm ({percent})"


PIECES_AT_ONCE = 64  # pieces of a motion that are checked together


class Deviation(NamedTuple):
    """A bound of a frame's deviation from its line."""

    sideways: float  # from the line [m]
    beyond: float  # beyond an end of it [m]
    turned: float  # from the orientation of the line there [rad]

    def within(self, line: CartesianLine) -> bool:
        """Return whether that is within the tolerances."""
        return max(self.sideways, self.beyond) <= line.line_tolerance and self.turned <= line.turn_tolerance


def certify_straight(
    line: CartesianLine, group: PlanningGroup, turns: np.ndarray, pieces: LocalCurves, deadline: Deadline = UNLIMITED
) -> Verdict:
    """Judge whether a frame keeps to its straight line along a motion, Bezier control points (m, k, nv)."""
    frame = _Frame(line, group, turns)
    waiting = deque((index, 0.0, 1.0, piece) for index, piece in enumerate(np.asarray(pieces, float)))
    evaluations = 0
    while waiting:
        batch = [waiting.popleft() for _ in range(min(PIECES_AT_ONCE, len(waiting)))]
        if deadline.expired():
            index, start, _, control = batch[0]
            return Verdict(Reason.STOPPED, evaluations, index, start, (index, start), None, control[0])
        evaluations += len(batch)
        halves: list[tuple[int, float, float, LocalPoints]] = []
        for place, bound in enumerate(frame.bounds([one[-1] for one in batch])):
            if bound.within(line):
                continue
            index, start, end, control = batch[place]
            narrow = np.ptp(control, axis=0).max() <= CONSTRAINT_RESOLUTION
            if narrow or not frame.off(control[0]).within(line):
                if halves:  # whether the line is left before this isn't decided yet
                    waiting.extendleft(reversed(batch[place:]))
                    break
                return Verdict(Reason.PATH_CONSTRAINT, evaluations, index, start, (index, start), None, control[0])
            (one, other), half = halve_curves(control[None]), 0.5 * (start + end)
            halves += [(index, start, half, one), (index, half, end, other)]
        waiting.extendleft(reversed(halves))
    return Verdict(Reason.FREE, evaluations)


class _Frame:
    """A frame that is to keep to its line; owns scratch data (one per thread)."""

    def __init__(self, line: CartesianLine, group: PlanningGroup, turns: np.ndarray) -> None:
        frame = frame_index(group.model, line.frame)
        assert frame is not None, "the way's frame is the robot's"
        self._line, self._group, self._turns, self._frame = line, group, turns, frame
        self._data = group.model.createData()
        self._widths = np.abs(group.expand_velocity)

    def place_frame(self, z: LocalPoint) -> tuple[Any, np.ndarray]:
        model, q = self._group.model, self._group.expand_from_local(z)
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pin.computeFrameJacobian(model, self._data, q, self._frame, axes).reshape(6, -1)
        return pin.updateFramePlacement(model, self._data, self._frame).copy(), jacobian

    def off(self, z: LocalPoint) -> Deviation:
        return self._off(self.place_frame(z)[0])

    def _off(self, placement: Any) -> Deviation:
        line = self._line
        share = 0.0 if line.is_point else line.share(placement)
        beyond = max(-share, share - 1.0, 0.0) * line.length
        return Deviation(float(np.linalg.norm(line.sideways(placement))), beyond, line.measure_turn(placement))

    def bounds(self, controls: Sequence[LocalPoints]) -> list[Deviation]:
        """Bounds of the frame's deviation from its line on each of some Bezier curves, control points (k, nv)."""
        line, curves = self._line, np.array(controls)
        low, high = curves.min(axis=1), curves.max(axis=1)
        middles, e = 0.5 * (low + high), 0.5 * (high - low) @ self._widths.T
        placements, each = zip(*(self.place_frame(cast(LocalPoint, z)) for z in middles), strict=True)
        jacobians = np.array(each)
        moves = (curves - middles[:, None]) @ (jacobians @ self._group.expand_velocity).swapaxes(1, 2)
        shifts, rotations = np.split(moves, 2, axis=2)
        place_rest, turn_rest = self._rests(jacobians, e)
        off = np.array([self._off(placement) for placement in placements])
        along = shifts @ line.direction
        sideways = np.linalg.norm(shifts - along[..., None] * line.direction, axis=2).max(axis=1)
        share = np.array([0.0 if line.is_point else line.share(placement) for placement in placements])
        ahead = share[:, None] * line.length + along
        beyond = np.maximum(np.maximum(-ahead.min(axis=1), ahead.max(axis=1) - line.length), 0.0)
        if line.is_point:
            axis = line.turn / line.angle if line.angle > 0.0 else np.zeros(3)
            even, even_rest = (rotations @ axis)[..., None] * axis, np.zeros(len(curves))
        else:
            even, even_rest = along[..., None] / line.length * line.turn, place_rest * line.angle / line.length
            beyond += place_rest
        uneven = np.linalg.norm(rotations - even, axis=2).max(axis=1)
        found = np.column_stack([off[:, 0] + sideways + place_rest, beyond, off[:, 2] + uneven + turn_rest + even_rest])
        return [Deviation(*row) for row in found.tolist()]

    def _rests(self, jacobians: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of places [m] and orientations [rad] beside their linear terms within half widths e (n, nv)."""
        from_axes = np.linalg.norm(jacobians[:, :3], axis=1)
        sweep = np.where(self._turns, 2.0 * np.sin(0.5 * np.minimum(e, np.pi)), e)
        swept = (sweep * from_axes).sum(axis=1, keepdims=True)
        distances = np.where(self._turns, from_axes + swept, from_axes > 0.0)
        turning = (e * (self._turns & (np.linalg.norm(jacobians[:, 3:], axis=1) > 0.0))).sum(axis=1)
        return turning * (distances * e).sum(axis=1), 0.25 * turning**2


SPACING = 0.01  # length of the line between two places that are solved for [m]
TURNING = 0.05  # angle between them [rad]
FINEST = 1e-9  # if a place is not reached, nearer ones are tried, down to this share of the line
DENSER = 3  # times that the places are taken twice as close if the certificate refuses the shape
MOST_PLACES = 4000  # places at most


def straight_plan(problem: Problem, line: CartesianLine) -> Plan:
    """Plan a motion along a straight line; no other path is searched for."""
    stages, still = Stages(problem), without_movers(problem)
    try:
        with stages.enter("ends", "start and straight way") as stage:
            check_start(problem.at(0.0))
            stage.outcome = "the start is free"
    except StageFailed as failed:
        return _make_failed_plan(problem.at(0.0), problem.z_start[None], failed.ending, stages)
    places = _choose_places(line)
    for attempt in range(DENSER + 1):
        with stages.enter("connect", "along the straight way") as stage:
            path, stop = follow_line(problem, line, places)
            stage.outcome = (
                "reached" if stop is None else f"stopped at {format_rounded_down(100.0 * stop.share, 0.1)} % of the way"
            )
        if stop is not None:
            return _make_failed_plan(
                still, path, _find_stop_ending(problem, stage.outcome) or make_stop_ending(problem, line, stop), stages
            )
        with stages.enter("parameterize", "as fast as the limits allow") as stage:
            trajectory = time_path(problem, path, 2**attempt)
            stage.outcome = f"{trajectory.duration:.3f} s"
        with stages.enter("certify", "on the exact geometry and on the straight way, between samples too") as stage:
            verdict = certify_from_start(still, trajectory, problem.deadline)
            if verdict.free:
                verdict = _certify_straightness(still, line, trajectory.bezier())
            problem.counters.collision_checks += verdict.evaluations
            stage.outcome = verdict.reason.value
        last = attempt == DENSER or 2 * places > MOST_PLACES or problem.deadline.expired()
        if verdict.free or verdict.reason is not Reason.PATH_CONSTRAINT or last:
            break
        places *= 2
    made = CertifiedMotion(verdict, path, {}, trajectory)
    if verdict.free:
        made = keep_schedule(
            problem, made, stages, lambda motion: _certify_straightness(problem, line, motion.bezier())
        )
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


def follow_line(
    problem: Problem, line: CartesianLine, places: int | None = None
) -> tuple[LocalPoints, StraightStop | None]:
    """Local coordinates (n, nv) with the tip at places of the line, evenly spaced, and closer where joints move much.

    Where it goes no further, or time is up, those before and the place at which it ends.
    """
    count, z = _choose_places(line) if places is None else places, problem.z_start
    path, share = [z], 0.0
    for index in range(1, count + 1):
        there = index / count
        step = there - share
        while share < there:
            onward = there if step >= there - share else share + step
            near = REACHED if onward == there and step * count > 0.9 else REACHED_CLOSELY
            reached = None if problem.deadline.expired() else bring_tip(problem, z, line.at(onward), near)
            if reached is not None and np.abs(reached - z).max() <= JUMP:
                share, z = onward, reached
                path.append(z)
            elif step > FINEST and not problem.deadline.expired():
                step *= 0.5
            else:
                return np.array(path), StraightStop(share, there, z)
    return np.array(path), None


def _choose_places(line: CartesianLine) -> int:
    wanted = max(line.length / SPACING, line.angle / TURNING, 2.0)
    return min(math.ceil(wanted), MOST_PLACES)


def _certify_straightness(problem: Problem, line: CartesianLine, pieces: LocalCurves) -> Verdict:
    return certify_straight(line, problem.group, problem.world.bodies.turns, pieces, problem.deadline)


def _find_stop_ending(problem: Problem, where: str) -> Ending | None:
    status = problem.deadline.status()
    if status is None:
        return None
    return Ending(status, f"{end_reason(status)} along the straight way: {where}", {"stage": "connect"})


def _make_failed_plan(problem: Problem, path: LocalPoints, ending: Ending, stages: Stages) -> Plan:
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
