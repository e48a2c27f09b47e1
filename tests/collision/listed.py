"""A world with every body and pair in a list, as Pinocchio has them, to compare with: made without a broad phase."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.collision.world import World
from guidefield.memo import memoized
from guidefield.robot.model.scratch_space import scratch_space


@memoized
def listed(world: World) -> np.ndarray:
    """Bodies of every pair, shape (n, 2)."""
    bodies = world.pairs.bodies(np.arange(len(world.pairs)))
    bodies.setflags(write=False)
    return bodies


def are_mixed(world: World) -> np.ndarray:
    """Which pairs are of a robot's body and an obstacle, shape (n,)."""
    return np.arange(len(world.pairs)) >= world.pairs.n_self


def are_signed(world: World) -> np.ndarray:
    """Whether both bodies of a pair are convex, shape (n,)."""
    return np.array([world.is_signed(pair) for pair in range(len(world.pairs))], bool)


@memoized
def geometry_of(world: World) -> Any:
    """Pinocchio geometry model of all bodies, with all pairs."""
    geometry = world.group.geometry.copy()
    for obstacle in world.scene.obstacles:
        name = f"obstacle/{obstacle.name}"
        geometry.addGeometryObject(pin.GeometryObject(name, 0, obstacle.placement, obstacle.shape))
    geometry.removeAllCollisionPairs()
    for first, second in listed(world).tolist():
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    return geometry


def touching(world: World, q: np.ndarray) -> list[int]:
    """Which pairs touch at a configuration of the model, by Pinocchio."""
    geometry, data = geometry_of(world), world.model.createData()
    scratch = scratch_space(geometry)
    pin.computeCollisions(world.model, data, geometry, scratch, q, False)
    return [index for index, result in enumerate(scratch.collisionResults) if result.isCollision()]
