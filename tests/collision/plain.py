"""Collision the plain way, to compare with: every pair of a list, one configuration at a time, no broad phase.

`panda_among` has the Panda's meshes as they are in its package, not their hulls, and obstacles without our builders;
`listed` has the bodies and pairs of a world as Pinocchio lists them.
"""

from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.collision.world import World
from guidefield.memo import memoized
from guidefield.messages import scene as messages
from guidefield.robot.model.pairs import scratch_space

PANDA = "panda_description/urdf/panda.urdf"
PANDA_SRDF = "panda_description/srdf/panda.srdf"
FINGERS = ("panda_finger_joint1", "panda_finger_joint2")

SHAPES = {
    messages.Box: lambda m: coal.Box(*m.size),
    messages.Sphere: lambda m: coal.Sphere(m.radius),
    messages.Cylinder: lambda m: coal.Cylinder(m.radius, m.length),
    messages.Capsule: lambda m: coal.Capsule(m.radius, m.length),
    messages.HalfSpace: lambda m: coal.Halfspace(np.array(m.normal), m.offset),
}


@dataclass
class Plain:
    """A robot among obstacles, and scratch space for it."""

    model: Any
    geometry: Any
    data: Any
    geometry_data: Any
    self_pairs: int

    def collides(self, q: np.ndarray) -> bool:
        return bool(pin.computeCollisions(self.model, self.data, self.geometry, self.geometry_data, q, True))

    def distances(self, q: np.ndarray) -> np.ndarray:
        """Of all pairs, the robot's own first."""
        pin.computeDistances(self.model, self.data, self.geometry, self.geometry_data, q)
        return np.array([result.min_distance for result in self.geometry_data.distanceResults])


def panda_among(obstacles: list[Any], finger: float) -> Plain:
    """A Panda with its fingers held, among obstacles of the wire's primitive kinds."""
    folder = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share")))
    urdf = str(folder / "example-robot-data/robots" / PANDA)
    model = pin.buildModelFromUrdf(urdf)
    geometry = pin.buildGeomFromUrdf(model, urdf, pin.GeometryType.COLLISION, package_dirs=[str(folder)])
    geometry.addAllCollisionPairs()
    pin.removeCollisionPairs(model, geometry, str(folder / "example-robot-data/robots" / PANDA_SRDF))
    held = pin.neutral(model)
    held[-2:] = finger
    model, geometry = pin.buildReducedModel(model, geometry, [model.getJointId(name) for name in FINGERS], held)
    self_pairs = len(geometry.collisionPairs)
    bodies = [i for i, shape in enumerate(geometry.geometryObjects) if shape.parentJoint != 0]
    for message in obstacles:
        index = geometry.addGeometryObject(
            pin.GeometryObject(message.name, 0, placement(message), SHAPES[type(message)](message))
        )
        for body in bodies:
            geometry.addCollisionPair(pin.CollisionPair(body, index))
    return Plain(model, geometry, model.createData(), geometry.createData(), self_pairs)


def placement(message: Any) -> Any:
    """Where a message puts its shape."""
    if isinstance(message, messages.HalfSpace):
        return pin.SE3.Identity()
    x, y, z, w = getattr(message, "quaternion_xyzw", (0.0, 0.0, 0.0, 1.0))
    return pin.SE3(pin.Quaternion(w, x, y, z).matrix(), np.array(message.position))


def dense(control: np.ndarray, step: float = 5e-3) -> np.ndarray:
    """Points (n, nv) along a Bezier curve, no coordinate moving more than the step between two."""
    length = np.abs(np.diff(control, axis=0)).max(axis=1).sum()
    parameters = np.linspace(0.0, 1.0, int(np.ceil(length / step)) + 2)
    rows = np.broadcast_to(control, (len(parameters), *control.shape))
    t = parameters[:, None, None]
    while rows.shape[1] > 1:
        rows = (1 - t) * rows[:, :-1] + t * rows[:, 1:]
    return rows[:, 0]


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
        frames = placements[about.joints[of]]
        return about.part_centres[of] @ frames[..., :3].swapaxes(1, 2) + frames[:, None, :, 3]

    between = centres(first[own])[:, :, None] - centres(second[own])[:, None]
    radii = about.part_radii
    found[own] = (
        np.linalg.norm(between, axis=3).min(axis=(1, 2), initial=np.inf) - radii[first[own]] - radii[second[own]]
    )
    gaps = world.boxes.gaps(centres(first[~own]), second[~own] - world.pairs.links).min(axis=1)
    found[~own] = gaps - radii[first[~own]]
    return np.where(found > 0.0, found, -np.inf)
