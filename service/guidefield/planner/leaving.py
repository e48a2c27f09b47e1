"""Leaving a slight contact at the start: a short straight motion out of it, and the judgement of given motions.

Until bodies that touched at the start keep a distance again, `LEFT_DISTANCE` at least, they must not come closer, by
more than `DISTANCE_ERROR`, at samples; all other pairs are certified until then, and from then on all are. So samples
(`WAY_OUT_SAMPLES` of a plan's way out, `SPACING` and `INTERVAL` of given motions) enter the verdict on the way out of
contact, and where it ends: closer ones overlook less. Lengths and directions without a way out refuse the plan.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from guidefield.collision.clearance import Contact, clearance_at, contacts_at, find_enclosed_pair
from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.errors import Status
from guidefield.planner.motion.submitted_motion import CurveKind, SubmittedMotion
from guidefield.planner.motion.trajectory import Trajectory, concatenate, unwrap_towards
from guidefield.planner.motion_certificate import CertifiedMotion, certify_given
from guidefield.planner.path_so_far import time_path
from guidefield.planner.task.problem import Conditions, Problem
from guidefield.planner.task.stages import StageFailed, Stages
from guidefield.prove.certificate import certify
from guidefield.prove.closest import measure
from guidefield.prove.curve import point_on
from guidefield.prove.verdict import Reason, Verdict
from guidefield.read_only import ReadOnly
from guidefield.robot.model.joints import LocalCurves, LocalPoint

SLIGHT_DEPTH = 0.01  # a contact deeper than this is not slight [m]: docs/certificate.md and docs/goals.md promise it
LEFT_DISTANCE = 1e-3  # distance that what touched keeps in the end, at least [m]. Unrecorded

WAY_OUT_LENGTHS = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32)
"""Lengths of the motions that are tried, in this order [rad, or m at size 1]. Unrecorded."""

DIRECTIONS = 48  # directions that are tried with each length. Unrecorded
DISTANCE_ERROR = 1e-6  # a distance that becomes smaller by less has not become smaller [m]: the error of Coal's answers
WAY_OUT_SAMPLES = 24  # places on the motion at which the touching pairs are measured. Unrecorded
SPACING = 0.005  # between samples at which what touches is measured [rad, or m at size 1]
INTERVAL = 0.01  # and between them at most, where obstacles move [s]


@dataclass(frozen=True, eq=False)
class LeftContact(ReadOnly):
    """A contact that is left."""

    motion: Trajectory  # straight, from rest to rest; its end is free
    contacts: tuple[Contact, ...]

    @property
    def warning(self) -> str:
        """The warning of the reply."""
        return warn_of_left_contacts(self.contacts)


def leave_contacts(problem: Problem, stages: Stages) -> LeftContact | None:
    """A motion out of the contacts at the start; None if there are none.

    Along it what touches never comes closer, what is apart again stays apart, and everything else is certified free.

    Raises:
        StageFailed: START_STATE_IN_COLLISION if a contact is deep, or no short motion leads out of all of them.
    """
    contacts = tuple(contacts_at(problem.world_at(0.0), problem.group.expand_from_local(problem.z_start)))
    if not contacts:
        return None
    with stages.enter("ends", "out of the contact at the start") as stage:
        for one in contacts:
            if one.depth is not None and one.depth > SLIGHT_DEPTH:
                raise _make_refusal(one, f"deeper than the {1000 * SLIGHT_DEPTH:.0f} mm that can be planned away from")
        start, group = problem.z_start, problem.group
        rng = np.random.default_rng([problem.seed, 3])
        exits = _ContactExits(problem, contacts)
        for length in WAY_OUT_LENGTHS:
            for direction in rng.normal(size=(DIRECTIONS, group.nv)):
                offset = length * direction / np.linalg.norm(direction) * group.sizes
                end = np.clip(start + offset, group.lower, group.upper)
                if (motion := exits.along(end)) is not None:
                    stage.outcome = f"{length:g} rad lead out of the contact"
                    return LeftContact(motion, contacts)
            if problem.deadline.expired():
                break
        raise _make_refusal(contacts[0], "and no short motion leads out of it")


def join_way_out(left: LeftContact, rest: CertifiedMotion) -> CertifiedMotion:
    """The motion out of contact, from rest to rest, and after it the rest of the motion, from where it was left.

    Where the rest has no trajectory it gets the warning only.
    """
    warnings = (left.warning, *rest.warnings)
    if rest.trajectory is None:
        return replace(rest, warnings=warnings)
    trajectory = concatenate([unwrap_towards(left.motion, rest.trajectory), rest.trajectory])
    return replace(
        rest,
        trajectory=trajectory,
        path=np.concatenate([trajectory.positions[:1], rest.path]),
        crossings={plane: index + 1 for plane, index in rest.crossings.items()},
        warnings=warnings,
        judged_from=left.motion.duration,
    )


class _ContactExits:
    def __init__(self, problem: Problem, contacts: tuple[Contact, ...]) -> None:
        self._problem = problem
        self._distances = measure_distances(problem.world, touching_pairs(problem.world, contacts))
        allowed = (*problem.allowed_collisions, *(one.pair for one in contacts))
        self._others = World.build(problem.group, problem.scene, allowed)

    def along(self, end: LocalPoint) -> Trajectory | None:
        """The motion to a point (nv,) if it leads out of the contacts, and touches nothing else; None if not.

        It leads out of them even if nothing that moves makes way.
        """
        problem, least = self._problem, self._problem.min_clearance
        enough = max(LEFT_DISTANCE, least)
        if (self._distances(end, 0.0) < enough).any():
            return None
        motion = time_path(problem, np.array([problem.z_start, end]))
        arrival = motion.duration
        there, q = problem.world_at(arrival), problem.group.expand_from_local(end)
        if there.in_collision(q) or (least > 0.0 and clearance_at(there, q).obstacle_distance < least):
            return None
        times = np.linspace(0.0, arrival, WAY_OUT_SAMPLES)
        places = zip(motion.evaluate(times)[0], times.tolist(), strict=True)
        distances = np.array([self._distances(z, time) for z, time in places])
        farthest = np.maximum.accumulate(distances)
        if (distances[-1] < enough).any() or (distances < farthest - DISTANCE_ERROR).any():
            return None
        tube = None if problem.execution is None else problem.execution.tube
        if not _is_free_beside(there, end, tube, least, UNLIMITED):
            return None
        return motion if certify(self._others, motion.bezier(), times=motion.piece_times()).free else None


def touching_pairs(world: World, contacts: Sequence[Contact]) -> list[int]:
    """The world's pairs of the bodies of contacts."""
    names = {one.pair for one in contacts}
    named = [index for index, one in enumerate(world.scene.obstacles) if any(one.name in pair for pair in names)]
    own, mixed = np.arange(world.pairs.n_self), world.pairs.of_obstacles(np.array(named, int))
    return [k for k in np.concatenate([own, mixed]).tolist() if world.pair_names(k) in names]


def measure_distances(world: World, pairs: Sequence[int]) -> Callable[[LocalPoint, float | None], np.ndarray]:
    """Make a function of a point (nv,) and a time [s]: distances of some pairs (k,) [m], signed or 0 in contact.

    Without a time obstacles rest.
    """

    def distances(z: LocalPoint, time: float | None) -> np.ndarray:
        world.place(world.group.expand_from_local(z))
        return np.array([measure(world, k, time)[0] for k in pairs])

    return distances


def warn_of_left_contacts(contacts: Sequence[Contact]) -> str:
    """Return the warning of a motion that leaves contacts at the start."""
    pairs = ", ".join(f"{one.pair[0]} and {one.pair[1]}{_depth(one)}" for one in contacts)
    return f"the start was in contact ({pairs}): the motion begins by leaving it, and is certified free from then on"


def _make_refusal(contact: Contact, why: str) -> StageFailed:
    message = f"the start is in collision: {contact.pair[0]} and {contact.pair[1]}{_depth(contact)}, {why}"
    details: dict[str, Any] = {"pair": list(contact.pair), "depth": contact.depth}
    return StageFailed(Status.START_STATE_IN_COLLISION, message, stage="start", **details)


def _depth(contact: Contact) -> str:
    return "" if contact.depth is None else f", {1000 * contact.depth:.1f} mm deep"


def continue_after(problem: Problem, left: LeftContact) -> Problem:
    """The problem from when and where the contact is left."""
    end = problem.group.from_local(left.motion.positions[-1])
    return replace(problem.since(left.motion.duration, end), leave_start_contact=False)


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
    contacts = tuple(contacts_at(conditions.world_at(begin), conditions.group.expand_from_local(motion.start)))
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


def _place(motion: SubmittedMotion, piece: int, share: float) -> LocalPoint:
    """A place on a motion (nv,); of steps on the straight path between both."""
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
            if can_end and (now >= enough).all() and _is_free_beside_motion(conditions, motion, piece, share):
                return piece, share, None
            farthest = np.maximum(farthest, now)  # however slowly they come closer
    return len(motion.pieces) - 1, 1.0, pairs[int(np.argmin(now))]


def _is_free_beside(world: World, z: LocalPoint, tube: np.ndarray | None, clearance: float, deadline: Deadline) -> bool:
    """Return whether nothing touches anywhere in a controller's tube (nv,) about a place (nv,)."""
    if tube is None:
        return True
    still = cast(LocalCurves, np.stack([z, z])[None])
    return certify(world, still, clearance, deadline=deadline, tube=tube[None]).free


def _is_free_beside_motion(conditions: Conditions, motion: SubmittedMotion, piece: int, share: float) -> bool:
    world = conditions.world_at(motion.along(piece, share)[1] or 0.0)
    tube = None if motion.tube is None else motion.tube[piece]
    z = point_on(motion.pieces[piece], share)
    return _is_free_beside(world, z, tube, conditions.min_clearance, conditions.deadline)


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
    if (
        inside := find_enclosed_pair(conditions.world_at(time or 0.0), conditions.group.expand_from_local(z))
    ) is not None:
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
