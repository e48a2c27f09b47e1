"""Leaving a slight contact at the start: a short straight motion out of it, free of everything else.

Given motions are judged by the same `SLIGHT_DEPTH`, `LEFT_DISTANCE` and `DISTANCE_ERROR` (`judgement.py`). With fewer
`WAY_OUT_SAMPLES` it is seen less well that touching bodies come no closer; lengths and directions are a search.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from guidefield.collision.clearance import Contact, clearance_at, contacts_at
from guidefield.collision.world import World
from guidefield.errors import Status
from guidefield.planner.motion.trajectory import Trajectory, concatenate, unwrap_towards
from guidefield.planner.motion_certificate import CertifiedMotion
from guidefield.planner.path_so_far import time_path
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import StageFailed, Stages
from guidefield.prove.certificate import certify
from guidefield.prove.closest import measure
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartCurves, ChartPoint

SLIGHT_DEPTH = 0.01  # a contact deeper than this is not slight [m]: docs/certificate.md and docs/goals.md promise it
LEFT_DISTANCE = 1e-3  # distance that what touched keeps in the end, at least [m]. Unrecorded

WAY_OUT_LENGTHS = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32)
"""Lengths of the motions that are tried, in this order [rad, or m at size 1]. Unrecorded."""

DIRECTIONS = 48  # directions that are tried with each length. Unrecorded
DISTANCE_ERROR = 1e-6  # a distance that becomes smaller by less has not become smaller [m]: the error of Coal's answers
WAY_OUT_SAMPLES = 24  # places on the motion at which the touching pairs are measured. Unrecorded


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
    contacts = tuple(contacts_at(problem.world_at(0.0), problem.group.expand_from_chart(problem.z_start)))
    if not contacts:
        return None
    with stages.entered("ends", "out of the contact at the start") as stage:
        for one in contacts:
            if one.depth is not None and one.depth > SLIGHT_DEPTH:
                raise _make_refusal(one, f"deeper than the {1000 * SLIGHT_DEPTH:.0f} mm that can be planned away from")
        start, group = problem.z_start, problem.group
        rng = np.random.default_rng([problem.seed, 3])
        ways = _WaysOut(problem, contacts)
        for length in WAY_OUT_LENGTHS:
            for direction in rng.normal(size=(DIRECTIONS, group.nv)):
                way = length * direction / np.linalg.norm(direction) * group.sizes
                end = np.clip(start + way, group.lower, group.upper)
                if (motion := ways.along(end)) is not None:
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
        return dataclasses.replace(rest, warnings=warnings)
    trajectory = concatenate([unwrap_towards(left.motion, rest.trajectory), rest.trajectory])
    return dataclasses.replace(
        rest,
        trajectory=trajectory,
        path=np.concatenate([trajectory.positions[:1], rest.path]),
        crossings={plane: index + 1 for plane, index in rest.crossings.items()},
        warnings=warnings,
        judged_from=left.motion.duration,
    )


class _WaysOut:
    def __init__(self, problem: Problem, contacts: tuple[Contact, ...]) -> None:
        self._problem = problem
        self._distances = measure_distances(problem.world, touching_pairs(problem.world, contacts))
        allowed = (*problem.allowed_collisions, *(one.pair for one in contacts))
        self._others = World.build(problem.group, problem.scene, allowed)

    def along(self, end: ChartPoint) -> Trajectory | None:
        """The motion to a chart point (nv,) if it leads out of the contacts, and touches nothing else; None if not.

        It leads out of them even if nothing that moves makes way.
        """
        problem, least = self._problem, self._problem.min_clearance
        enough = max(LEFT_DISTANCE, least)
        if (self._distances(end, 0.0) < enough).any():
            return None
        motion = time_path(problem, np.array([problem.z_start, end]))
        arrival = motion.duration
        there, q = problem.world_at(arrival), problem.group.expand_from_chart(end)
        if there.in_collision(q) or (least > 0.0 and clearance_at(there, q).obstacle_distance < least):
            return None
        times = np.linspace(0.0, arrival, WAY_OUT_SAMPLES)
        places = zip(motion.evaluate(times)[0], times.tolist(), strict=True)
        distances = np.array([self._distances(z, time) for z, time in places])
        farthest = np.maximum.accumulate(distances)
        if (distances[-1] < enough).any() or (distances < farthest - DISTANCE_ERROR).any():
            return None
        if not self._is_free_beside(there, end):
            return None
        return motion if certify(self._others, motion.bezier(), times=motion.piece_times()).free else None

    def _is_free_beside(self, there: World, end: ChartPoint) -> bool:
        """Return whether nothing touches anywhere in the controller's tube about the end of a way."""
        tube = None if self._problem.execution is None else self._problem.execution.tube
        if tube is None:
            return True
        still = cast(ChartCurves, np.stack([end, end])[None])
        return certify(there, still, self._problem.min_clearance, tube=tube[None]).free


def touching_pairs(world: World, contacts: Sequence[Contact]) -> list[int]:
    """The world's pairs of the bodies of contacts."""
    names = {one.pair for one in contacts}
    named = [index for index, one in enumerate(world.scene.obstacles) if any(one.name in pair for pair in names)]
    own, mixed = np.arange(world.pairs.n_self), world.pairs.of_obstacles(np.array(named, int))
    return [k for k in np.concatenate([own, mixed]).tolist() if world.pair_names(k) in names]


def measure_distances(world: World, pairs: Sequence[int]) -> Callable[[ChartPoint, float | None], np.ndarray]:
    """Make a function of a chart point (nv,) and a time [s]: distances of some pairs (k,) [m], signed or 0 in contact.

    Without a time obstacles rest.
    """

    def distances(z: ChartPoint, time: float | None) -> np.ndarray:
        world.place(world.group.expand_from_chart(z))
        return np.array([measure(world, k, time)[0] for k in pairs])

    return distances


def warn_of_left_contacts(contacts: Sequence[Contact]) -> str:
    """Return the warning of a motion that leaves contacts at the start."""
    told = ", ".join(f"{one.pair[0]} and {one.pair[1]}{_depth(one)}" for one in contacts)
    return f"the start was in contact ({told}): the motion begins by leaving it, and is certified free from then on"


def _make_refusal(contact: Contact, why: str) -> StageFailed:
    message = f"the start is in collision: {contact.pair[0]} and {contact.pair[1]}{_depth(contact)}, {why}"
    details: dict[str, Any] = {"pair": list(contact.pair), "depth": contact.depth}
    return StageFailed(Status.START_STATE_IN_COLLISION, message, stage="start", **details)


def _depth(contact: Contact) -> str:
    return "" if contact.depth is None else f", {1000 * contact.depth:.1f} mm deep"


def continue_after(problem: Problem, left: LeftContact) -> Problem:
    """The problem from when and where the contact is left."""
    end = problem.group.from_chart(left.motion.positions[-1])
    return dataclasses.replace(problem.since(left.motion.duration, end), leave_start_contact=False)
