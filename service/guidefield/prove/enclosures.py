"""Bodies that are wholly inside another's closed mesh along a motion: in contact, though far from its surface."""

from __future__ import annotations

import numpy as np

from guidefield.collision.enclosure import closed_bodies, enclosed_pairs
from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.prove.curve import Curve
from guidefield.robot.model.spaces import ModelConfiguration


def world_at(world: World, time: float) -> World:
    """Return the robot among the obstacles where they are at a time [s]; the world itself if none moves."""
    return World(world.group, world.scene.at(time), world.pairs) if world.scene.moves else world


def enclosed_pairs_at(world: World, q: ModelConfiguration, time: float) -> list[int]:
    """Return the pairs of which one body is wholly inside the other.

    Args:
        q: Configuration of the group's model, shape (model.nq,).
        time: At which obstacles that move are met [s].
    """
    if world.scene.convex and not closed_bodies(world.group).any():
        return []
    return enclosed_pairs(world_at(world, time), q)


def enclosures_at(world: World, curve: Curve, times: np.ndarray, deadline: Deadline = UNLIMITED) -> list[list[int]]:
    """Return the pairs of which one body is wholly inside the other, at times (k,) [s] of a motion, for each of them.

    Obstacles that move are met where they are then.

    Raises:
        DeadlineExpired: if the deadline passed before all are found.
    """
    found = []
    for time, z in zip(times.tolist(), curve.at(times), strict=True):
        deadline.check("the motion was measured")
        found.append(enclosed_pairs_at(world, world.group.expand_from_chart(z), time))
    return found
