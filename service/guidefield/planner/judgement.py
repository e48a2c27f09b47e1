"""The judgement of a motion that somebody else made: free, within its limits, keeping what is asked for; and how far.

It begins as a plan does: a body wholly inside another, or a slight contact that may be left. Then certificates judge
what rests, what moves, and what frames have to keep; of their refusals the first along the motion counts.

Until what touched at the start keeps a distance again it must not come closer, at samples; everything else is certified
meanwhile, and from then on everything is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from guidefield.collision.blocking_pairs import Contact, contacts_at
from guidefield.collision.enclosure import enclosed
from guidefield.collision.world import World
from guidefield.deadline import DeadlineExpired
from guidefield.planner.leaving import DISTANCE_ERROR, LEFT_DISTANCE, SLIGHT_DEPTH, distances_of, touching_pairs
from guidefield.planner.motion.drawn_motion import DrawnMotion
from guidefield.planner.motion.given_motion import GivenMotion
from guidefield.planner.motion.limit_load import Uses
from guidefield.planner.motion_certificate import certify_given, enclosed_start
from guidefield.planner.task.effort import Efforts, measure_efforts
from guidefield.planner.task.motion_limits import CartesianUse, measure_cartesian
from guidefield.planner.task.problem import Conditions
from guidefield.prove.certificate import certify, certify_constraints
from guidefield.prove.curve import restricted
from guidefield.prove.verdict import Reason, Verdict, first_refused
from guidefield.robot.model.configuration import LimitFault, limit_faults
from guidefield.robot.model.spaces import ChartPoints

SPACING = 0.005  # between samples at which what touches is measured [rad, or m at size 1]
INTERVAL = 0.01  # and between them at most, where obstacles move [s]


@dataclass(frozen=True, eq=False)
class Leaving:
    """How a motion that begins in contact goes on."""

    verdict: Verdict
    contacts: tuple[Contact, ...]
    piece: int  # index of the piece on which it has left them, or on which they come closer
    share: float
    leaves: bool


def judge_leaving(problem: GivenProblem) -> Leaving | None:
    """Judge a motion that may begin in slight contact; None where it doesn't, or that is deeper than `SLIGHT_DEPTH`."""
    pieces, begin = problem.motion.pieces, problem.motion.along(0, 0.0)[1] or 0.0
    contacts = tuple(contacts_at(problem.world_at(begin), problem.group.expand_from_chart(pieces[0, 0])))
    if not contacts or any(one.depth is not None and one.depth > SLIGHT_DEPTH for one in contacts):
        return None
    piece, share, closer = _way_out(problem, contacts)
    if closer is not None:
        names, z = problem.world.pair_names(closer), _part(pieces[piece], share, share)[0]
        reason = Reason.STOPPED if problem.deadline.expired() else Reason.CONTACT
        verdict = Verdict(reason, 1, piece, share, (0, 0.0), names, z)
        return Leaving(verdict, contacts, piece, share, leaves=False)
    return Leaving(_judge_parts(problem, contacts, piece, share), contacts, piece, share, leaves=True)


def _way_out(problem: GivenProblem, contacts: tuple[Contact, ...]) -> tuple[int, float, int | None]:
    world, motion = problem.world, problem.motion
    pairs = touching_pairs(world, contacts)
    distances, enough = distances_of(world, pairs), max(LEFT_DISTANCE, problem.min_clearance)
    before = distances(motion.start, motion.along(0, 0.0)[1])
    for piece, controls in enumerate(motion.pieces):
        length = float(np.linalg.norm(np.diff(controls, axis=0) / problem.group.sizes, axis=1).sum())
        count = max(1, math.ceil(length / SPACING), _moments(problem, piece))
        for share in (k / count for k in range(1, count + 1)):
            now = distances(_part(controls, share, share)[0], motion.along(piece, share)[1])
            if (now < before - DISTANCE_ERROR).any() or problem.deadline.expired():
                return piece, share, pairs[int(np.argmin(now - before))]
            if (now >= enough).all():
                return piece, share, None
            before = now
    return len(motion.pieces) - 1, 1.0, pairs[int(np.argmin(before))]


def _moments(problem: GivenProblem, piece: int) -> int:
    """At so many moments of a piece what moves is measured, whether the robot moves or not."""
    begin, end = (problem.motion.along(piece, share)[1] for share in (0.0, 1.0))
    return 0 if not problem.scene.moves or begin is None or end is None else math.ceil((end - begin) / INTERVAL)


def _judge_parts(problem: GivenProblem, contacts: tuple[Contact, ...], piece: int, share: float) -> Verdict:
    deadline, pieces, times = problem.deadline, problem.motion.pieces, problem.motion.times
    at = problem.motion.along(piece, share)[1]
    allowed = (*problem.allowed_collisions, *(one.pair for one in contacts))
    others = World.build(problem.group, problem.scene, allowed)
    out = np.concatenate([pieces[:piece], _part(pieces[piece], 0.0, share)[None]])
    until = None if times is None or at is None else np.append(times[: piece + 1], at)
    leaving = certify(others, out, deadline=deadline, times=until)
    if not leaving.free:
        return _on_the_whole(leaving, 0, piece, 0.0, share)
    z = _part(pieces[piece], share, share)[0]
    if (inside := enclosed(problem.world_at(at or 0.0), problem.group.expand_from_chart(z))) is not None:
        return Verdict(Reason.CONTACT, leaving.evaluations, piece, share, (0, 0.0), inside, z)
    rest = np.concatenate([_part(pieces[piece], share, 1.0)[None], pieces[piece + 1 :]])
    since = None if times is None or at is None else np.append(at, times[piece + 1 :])
    left = certify(problem.world, rest, problem.min_clearance, deadline=deadline, times=since)
    return replace(_on_the_whole(left, piece, piece, share, 1.0), evaluations=leaving.evaluations + left.evaluations)


def _on_the_whole(verdict: Verdict, first: int, cut: int, begin: float, end: float) -> Verdict:
    if verdict.piece is None or verdict.parameter is None or verdict.free_until is None:
        return verdict
    places = [
        (first + piece, begin + (end - begin) * at if first + piece == cut else at)
        for piece, at in ((verdict.piece, verdict.parameter), verdict.free_until)
    ]
    return replace(verdict, piece=places[0][0], parameter=places[0][1], free_until=places[1])


def _part(controls: ChartPoints, low: float, high: float) -> ChartPoints:
    part: ChartPoints = restricted(controls[None], np.array([low]), np.array([high]))[0]
    return part


@dataclass(frozen=True, eq=False, kw_only=True)
class GivenProblem(Conditions):
    """A motion that somebody else made, and what it is judged by."""

    motion: GivenMotion
    planned: GivenMotion | None = None  # the motion that `motion` is to follow, if there is another one
    drawn: DrawnMotion | None = None  # what a controller is sent to draw `motion`; None: it is the one that was given

    @cached_property
    def still_fault(self) -> LimitFault | None:
        """The joint that stands still farthest beyond a limit; None if none does."""
        joints, moving = self.group.robot.joints, {joint.name for joint in self.group.joints}
        still = [j for j in joints if (j.name if j.mimic is None else j.mimic.driver) not in moving]
        faults = limit_faults(still, self.group.q_reference)
        return max(faults, key=lambda fault: fault.excess, default=None)


@dataclass(frozen=True, eq=False)
class Judgement:
    """What is said about a motion."""

    verdict: Verdict
    uses: Uses
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


def judge(problem: GivenProblem, uses: Uses) -> Judgement:
    """Judge a motion until time is up.

    Raises:
        ValueError: if obstacles move and the motion has no times.
        DeadlineExpired: if time is up before all of a long motion is looked at for limits beside those of rates.
    """
    if (fault := problem.still_fault) is not None:
        z = problem.motion.start
        return Judgement(Verdict(Reason.BEYOND_LIMITS, 0, 0, 0.0, (0, 0.0), None, z, beyond=fault), uses)
    begin = problem.motion.along(0, 0.0)[1] or 0.0
    if (inside := enclosed_start(problem, problem.motion.start, begin)) is not None:
        return Judgement(inside, uses, enclosed=True)
    kept, leaving = _constraints(problem), None
    if problem.leave_start_contact:
        leaving = judge_leaving(problem)
    verdict = first_refused(kept, _freedom(problem, kept) if leaving is None else leaving.verdict)
    problem.counters.collision_checks += verdict.evaluations
    cartesian: tuple[CartesianUse, ...] = ()
    if problem.cartesian_limits:
        cartesian = measure_cartesian(problem.cartesian_limits, problem.motion.polynomials, problem.deadline)
    return Judgement(verdict, uses, leaving=leaving, cartesian=cartesian, efforts=_efforts(problem))


def _efforts(problem: GivenProblem) -> Efforts | None:
    motion = problem.motion
    if motion.times is None or (motion.velocities is None and not motion.is_point):
        return None
    try:
        return measure_efforts(problem.group, problem.effort_limit, motion.polynomials, problem.deadline)
    except DeadlineExpired:
        if problem.effort_limit is not None:
            raise
        return Efforts("the time that is allowed was up")


def _constraints(problem: GivenProblem) -> Verdict:
    if not problem.path_constraints:
        return Verdict(Reason.FREE, 0)
    turns = problem.world.bodies.turns
    motion = problem.motion
    return certify_constraints(problem.constrained_frames, turns, motion.pieces, problem.deadline, motion.tube)


def _freedom(problem: GivenProblem, kept: Verdict) -> Verdict:
    motion, deadline = problem.motion, problem.deadline
    count = len(motion.pieces) if kept.piece is None else kept.piece + 1
    return certify_given(problem, motion, deadline, count)
