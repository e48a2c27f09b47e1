"""A world with every body and pair in a list, as Pinocchio has them, to compare with: made without a broad phase."""

from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.collision.world import World
from guidefield.memo import memoized
from guidefield.robot.model.pairs import scratch_space


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


def part_separations(world: World, placements: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Lower bounds of the distances of pairs by balls about parts of bodies; minus infinity where balls overlap.

    Joints stand at placements, shape (njoints, 3, 4) [m].
    """
    about = world.bodies
    first, second = world.pairs.bodies(pairs).T
    own, found = pairs < world.pairs.n_self, np.empty(len(pairs))

    def centres(of: np.ndarray) -> np.ndarray:
        carriers = placements[about.joints[of]]
        return about.part_centres[of] @ carriers[..., :3].swapaxes(1, 2) + carriers[:, None, :, 3]

    between = centres(first[own])[:, :, None] - centres(second[own])[:, None]
    radii = about.part_radii
    found[own] = (
        np.linalg.norm(between, axis=3).min(axis=(1, 2), initial=np.inf) - radii[first[own]] - radii[second[own]]
    )
    gaps = world.boxes.gaps(centres(first[~own]), second[~own] - world.pairs.links).min(axis=1)
    found[~own] = gaps - radii[first[~own]]
    return np.where(found > 0.0, found, -np.inf)
