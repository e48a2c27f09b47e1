"""The certificate of a sequence: each stretch of its trajectory judged in the world that holds then.

A stretch is a step, or a part of one, on which the same objects are held and the same pairs may touch. In each, all
joints of the sequence count as moving, those that wait, too: their links are judged against what was put down.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion_certificate import certify_from_start
from guidefield.planner.sequence.composed import part
from guidefield.planner.sequence.permissions import Allowed
from guidefield.planner.sequence.straight_certificate import certify_straight
from guidefield.planner.sequence.straight_way import StraightWay
from guidefield.planner.task.conditions import Conditions
from guidefield.prove.verdict import Verdict


@dataclass(frozen=True, eq=False, kw_only=True)
class Stretch(Conditions):
    """A part of a sequence's trajectory, and what it is judged by."""

    index: int
    motion: Trajectory
    way: StraightWay | None = None


def stretches_of(
    index: int,
    conditions: Conditions,
    trajectory: Trajectory,
    span: tuple[float, float],
    permissions: Sequence[Allowed],
    way: StraightWay | None,
    straight: tuple[float, float],
) -> list[Stretch]:
    """The stretches of a step.

    Args:
        trajectory: The sequence's, with a knot wherever a permission, or a straight way, begins or ends.
        span: When the step begins and ends [s].
        straight: From when to when it does [s]; not at all where that is no time.
    """
    begin, end = span
    changes = [time for one in permissions for time in (one.begin, one.end)] + list(straight if way else ())
    cuts = {time for time in changes if begin < time < end}
    fields = {field.name: getattr(conditions, field.name) for field in dataclasses.fields(Conditions)}
    stretches = []
    for first, last in pairwise([begin, *sorted(cuts), end]):
        touches = [one.touch for one in permissions if one.covers(first, last)]
        if touches:
            pairs = conditions.allowed_collisions.union(touches)
            fields["allowed_collisions"] = pairs
            fields["world"] = World.build(conditions.group, conditions.scene, pairs)
        else:
            fields["allowed_collisions"], fields["world"] = conditions.allowed_collisions, conditions.world
        kept = straight[0] < straight[1] and straight[0] <= first and last <= straight[1]
        motion = part(trajectory, first, last)
        stretches.append(Stretch(**fields, index=index, motion=motion, way=way if kept else None))
    return stretches


def certify_stretch(stretch: Stretch, deadline: Deadline = UNLIMITED) -> Verdict:
    """Judge a stretch: free, and keeping what the step has to keep."""
    verdict = certify_from_start(stretch, stretch.motion, deadline)
    if not verdict.free or stretch.way is None:
        return verdict
    turns, pieces = stretch.world.bodies.turns, stretch.motion.bezier()
    kept = certify_straight(stretch.way, stretch.group, turns, pieces, deadline)
    return dataclasses.replace(kept, evaluations=verdict.evaluations + kept.evaluations)
