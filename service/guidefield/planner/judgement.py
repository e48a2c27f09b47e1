"""Judge a given motion for a certify request: collisions, joint, Cartesian and effort limits, path constraints.

Limits of rates are judged before (`LimitUses`). Plans that begin in contact use `judge_leaving` and `split_where_left`.

It begins as a plan does: a body wholly inside another, or a slight contact that may be left. Then certificates judge
it among obstacles at rest and in motion, and its path constraints; of their refusals the first along the motion counts.

Until bodies that touched at the start keep a distance again they must not come closer, at samples; all other pairs are
certified until then, and from then on all are. So `SPACING` and `INTERVAL` enter the verdict on the way out of contact
and nothing else: smaller ones overlook less and take longer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np

from guidefield.collision.clearance import Contact, contacts_at, enclosed
from guidefield.collision.world import World
from guidefield.deadline import DeadlineExpired
from guidefield.planner.leaving import DISTANCE_ERROR, LEFT_DISTANCE, SLIGHT_DEPTH, measure_distances, touching_pairs
from guidefield.planner.motion.drawn_motion import DrawnMotion
from guidefield.planner.motion.limit_load import LimitUses
from guidefield.planner.motion.submitted_motion import CurveKind, SubmittedMotion
from guidefield.planner.motion_certificate import certify_given, find_enclosed_start
from guidefield.planner.task.effort import Efforts, measure_efforts
from guidefield.planner.task.motion_limits import CartesianUse, measure_cartesian
from guidefield.planner.task.problem import Conditions
from guidefield.prove.certificate import certify, certify_constraints
from guidefield.prove.curve import point_on
from guidefield.prove.verdict import LIMIT_TOLERANCE, Reason, Verdict, first_refused
from guidefield.robot.model.configuration import LimitFault, limit_faults
from guidefield.robot.model.spaces import ChartCurves, ChartPoint

SPACING = 0.005  # between samples at which what touches is measured [rad, or m at size 1]
INTERVAL = 0.01  # and between them at most, where obstacles move [s]


@dataclass(frozen=True, eq=False)
class Leaving:
    """The judgement of a motion that begins in contact."""

    verdict: Verdict
    contacts: tuple[Contact, ...]
    piece: int  # index of the piece on which it has left them, or on which they come closer
    share: float  # share of that piece that has passed by then
    leaves: bool
    # both parts of it with their conditions: until it has left them, without the pairs that touch, and from then on
    parts: tuple[tuple[Conditions, SubmittedMotion], ...] = ()


def judge_leaving(conditions: Conditions, motion: SubmittedMotion) -> Leaving | None:
    """Judge a motion that may begin in slight contact; None where it doesn't, or that is deeper than `SLIGHT_DEPTH`."""
    begin = motion.along(0, 0.0)[1] or 0.0
    contacts = tuple(contacts_at(conditions.world_at(begin), conditions.group.expand_from_chart(motion.start)))
    if not contacts or any(one.depth is not None and one.depth > SLIGHT_DEPTH for one in contacts):
        return None
    piece, share, closer = _judge_way_out(conditions, motion, contacts)
    if closer is not None:
        names, z = conditions.world.pair_names(closer), _place(motion, piece, share)
        reason = Reason.STOPPED if conditions.deadline.expired() else Reason.CONTACT
        verdict = Verdict(reason, 1, piece, share, (0, 0.0), names, z)
        return Leaving(verdict, contacts, piece, share, leaves=False)
    parts = split_where_left(conditions, motion, contacts, (piece, share))
    return Leaving(_judge_parts(parts, piece, share), contacts, piece, share, leaves=True, parts=parts)


def split_where_left(
    conditions: Conditions, motion: SubmittedMotion, contacts: Sequence[Contact], left: tuple[int, float]
) -> tuple[tuple[Conditions, SubmittedMotion], ...]:
    """Split a motion at the place by which it leaves contacts; the parts are those of `Leaving`."""
    allowed = (*conditions.allowed_collisions, *(one.pair for one in contacts))
    others = World.build(conditions.group, conditions.scene, allowed)
    end = len(motion.pieces) - 1, 1.0
    out = replace(conditions, world=others, min_clearance=0.0), motion.between((0, 0.0), left)
    return (out,) if left == end else (out, (conditions, motion.between(left, end)))


def _place(motion: SubmittedMotion, piece: int, share: float) -> ChartPoint:
    """A place on a motion (nv,); of steps on the straight way between both."""
    return point_on((motion.straight if motion.kind is CurveKind.STEPS else motion.pieces)[piece], share)


def _judge_way_out(
    conditions: Conditions, motion: SubmittedMotion, contacts: tuple[Contact, ...]
) -> tuple[int, float, int | None]:
    world = conditions.world
    pairs = touching_pairs(world, contacts)
    distances, enough = measure_distances(world, pairs), max(LEFT_DISTANCE, conditions.min_clearance)
    farthest = now = distances(motion.start, motion.along(0, 0.0)[1])
    for piece, controls in enumerate(motion.pieces):
        length = float(np.linalg.norm(np.diff(controls, axis=0) / conditions.group.sizes, axis=1).sum())
        count = max(1, math.ceil(length / SPACING), _choose_moments(conditions, motion, piece))
        for share in (k / count for k in range(1, count + 1)):
            z, time = _place(motion, piece, share), motion.along(piece, share)[1]
            now = distances(z, time)
            if (now < farthest - DISTANCE_ERROR).any() or conditions.deadline.expired():
                return piece, share, pairs[int(np.argmin(now - farthest))]
            can_end = motion.kind is not CurveKind.STEPS or share == 1.0
            if can_end and (now >= enough).all() and _is_free_beside(conditions, motion, piece, share):
                return piece, share, None
            farthest = np.maximum(farthest, now)  # however slowly they come closer
    return len(motion.pieces) - 1, 1.0, pairs[int(np.argmin(now))]


def _is_free_beside(conditions: Conditions, motion: SubmittedMotion, piece: int, share: float) -> bool:
    """Return whether nothing touches anywhere in the tube about a place."""
    if motion.tube is None:
        return True
    world = conditions.world_at(motion.along(piece, share)[1] or 0.0)
    z, tube = point_on(motion.pieces[piece], share), motion.tube[piece : piece + 1]
    still = cast(ChartCurves, np.stack([z, z])[None])
    return certify(world, still, conditions.min_clearance, deadline=conditions.deadline, tube=tube).free


def _choose_moments(conditions: Conditions, motion: SubmittedMotion, piece: int) -> int:
    """Number of moments of a piece at which distances to what moves are measured, whether the robot moves or not."""
    begin, end = (motion.along(piece, share)[1] for share in (0.0, 1.0))
    return 0 if not conditions.scene.moves or begin is None or end is None else math.ceil((end - begin) / INTERVAL)


def _judge_parts(parts: Sequence[tuple[Conditions, SubmittedMotion]], piece: int, share: float) -> Verdict:
    (others, out), *after = parts
    leaving = certify_given(others, out, others.deadline)
    if not leaving.free or not after:
        return _place_on_whole(leaving, 0, piece, 0.0, share)
    conditions, rest = after[0]
    time, z = rest.along(0, 0.0)[1], rest.start
    if (inside := enclosed(conditions.world_at(time or 0.0), conditions.group.expand_from_chart(z))) is not None:
        return Verdict(Reason.CONTACT, leaving.evaluations, piece, share, (0, 0.0), inside, z)
    left = certify_given(conditions, rest, conditions.deadline)
    first = piece + 1 if share == 1.0 else piece
    return replace(_place_on_whole(left, first, piece, share, 1.0), evaluations=leaving.evaluations + left.evaluations)


def _place_on_whole(verdict: Verdict, first: int, cut: int, begin: float, end: float) -> Verdict:
    if verdict.piece is None or verdict.parameter is None or verdict.free_until is None:
        return verdict
    places = [
        (first + piece, begin + (end - begin) * at if first + piece == cut else at)
        for piece, at in ((verdict.piece, verdict.parameter), verdict.free_until)
    ]
    return replace(verdict, piece=places[0][0], parameter=places[0][1], free_until=places[1])


@dataclass(frozen=True, eq=False, kw_only=True)
class GivenProblem(Conditions):
    """A given motion with the conditions that it is judged by."""

    motion: SubmittedMotion
    planned: SubmittedMotion | None = None  # the motion that `motion` is to follow, if there is another one
    drawn: DrawnMotion | None = None  # what a controller is sent to draw `motion`; None: it is the one that was given

    @cached_property
    def still_fault(self) -> LimitFault | None:
        """The joint that stands still farthest beyond a limit; None if none does."""
        joints, moving = self.group.robot.joints, {joint.name for joint in self.group.joints}
        still = [j for j in joints if (j.name if j.mimic is None else j.mimic.driver) not in moving]
        # what a follower's law gives is rounded
        faults = [fault for fault in limit_faults(still, self.group.q_reference) if fault.excess > LIMIT_TOLERANCE]
        return max(faults, key=lambda fault: fault.excess, default=None)


@dataclass(frozen=True, eq=False)
class Judgement:
    """The result of judging a motion."""

    verdict: Verdict
    uses: LimitUses
    enclosed: bool = False  # whether what is refused is a body wholly inside another at the start
    # how a contact at the start is left; None where there is none, or it may not be left
    leaving: Leaving | None = None
    cartesian: tuple[CartesianUse, ...] = ()
    efforts: Efforts | None = None  # None of what has no accelerations

    @property
    def within_limits(self) -> bool:
        """True if no rate exceeds its limit."""
        uses = self.uses
        rates = all(use.is_within for use in (uses.velocity, uses.acceleration, uses.jerk))
        kept = self.efforts is None or self.efforts.exceeded is None
        return rates and kept and all(use.exceeded is None for use in self.cartesian)


def judge(problem: GivenProblem, uses: LimitUses) -> Judgement:
    """Judge a motion until time is up.

    Raises:
        ValueError: if obstacles move and the motion has no times.
        DeadlineExpired: if time is up before all of a long motion is examined for limits beside those of rates.
    """
    if (fault := problem.still_fault) is not None:
        z = problem.motion.start
        return Judgement(Verdict(Reason.BEYOND_LIMITS, 0, 0, 0.0, (0, 0.0), None, z, beyond=fault), uses)
    begin = problem.motion.along(0, 0.0)[1] or 0.0
    if (inside := find_enclosed_start(problem, problem.motion.start, begin)) is not None:
        return Judgement(inside, uses, enclosed=True)
    kept, leaving = _judge_constraints(problem), None
    if problem.leave_start_contact:
        leaving = judge_leaving(problem, problem.motion)
    verdict = first_refused(kept, _judge_freedom(problem, kept) if leaving is None else leaving.verdict)
    problem.counters.collision_checks += verdict.evaluations
    cartesian: tuple[CartesianUse, ...] = ()
    if problem.cartesian_limits:
        cartesian = measure_cartesian(problem.cartesian_limits, problem.motion.polynomials, problem.deadline)
    return Judgement(verdict, uses, leaving=leaving, cartesian=cartesian, efforts=_judge_efforts(problem))


def _judge_efforts(problem: GivenProblem) -> Efforts | None:
    motion = problem.motion
    if motion.times is None or (motion.velocities is None and not motion.is_point):
        return None
    try:
        return measure_efforts(problem.group, problem.effort_limit, motion.polynomials, problem.deadline)
    except DeadlineExpired:
        if problem.effort_limit is not None:
            raise
        return Efforts("the time that is allowed was up")


def _judge_constraints(problem: GivenProblem) -> Verdict:
    if not problem.path_constraints:
        return Verdict(Reason.FREE, 0)
    turns = problem.world.bodies.turns
    motion = problem.motion
    return certify_constraints(problem.constrained_frames, turns, motion.pieces, problem.deadline, motion.tube)


def _judge_freedom(problem: GivenProblem, kept: Verdict) -> Verdict:
    motion, deadline = problem.motion, problem.deadline
    count = len(motion.pieces) if kept.piece is None else kept.piece + 1
    return certify_given(problem, motion, deadline, count)
