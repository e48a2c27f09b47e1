"""Bodies that are wholly inside another's closed mesh along a motion: in contact, though far from its surface."""

from __future__ import annotations

import numpy as np

from guidefield.collision.enclosure import closed_bodies, enclosed_pairs
from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.prove.curve import Curve


def enclosures_at(world: World, curve: Curve, times: np.ndarray, deadline: Deadline = UNLIMITED) -> list[list[int]]:
    """Return the pairs of which one body is wholly inside the other, at times (k,) [s] of a motion, for each of them.

    Obstacles that move are met where they are then.

    Raises:
        DeadlineExpired: if the deadline passed before all are found.
    """
    group = world.group
    if world.scene.convex and not closed_bodies(group).any():
        return [[] for _ in times]
    found = []
    for time, z in zip(times.tolist(), curve.at(times), strict=True):
        deadline.check("the motion was measured")
        there = World(group, world.scene.at(time), world.pairs) if world.scene.moves else world
        found.append(enclosed_pairs(there, group.expand_from_chart(z)))
    return found
