"""Collision the plain way, to compare with: every pair, one configuration at a time, on shapes built here.

The Panda has its meshes as they are in its package, not their hulls; obstacles are made without our builders.
"""

from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.messages import scene as messages

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
