"""Primitives declared as obstacles: at once only what lanes need is made of them, the rest when it is asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from guidefield.geometry import surfaces
from guidefield.geometry.placements import moved, se3, unit
from guidefield.kernels.lane_math import BOX, CAPSULE, CYLINDER, HALF_SPACE
from guidefield.kernels.lane_primitives import PLACED
from guidefield.messages import scene as messages
from guidefield.scene.charges import Charges
from guidefield.scene.flat import axes_across

HALF_SPACE_PATCH = 4.0
"""Side of the square that stands for a half-space in drawings [m]."""

_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


class Primitive(NamedTuple):
    """What an obstacle that is a primitive is made of; see `Obstacle`."""

    body: Callable[[], tuple[Any, Any]]
    surface: Callable[[], tuple[np.ndarray, np.ndarray]]
    charged: Callable[[Any], Charges]
    placed: bytes


def _box(message: messages.Box) -> Primitive:
    x, y, z = message.size

    def charged(placement: Any) -> Charges:
        return Charges(boxes=np.array([[*placement.translation, *placement.rotation.T.ravel(), *message.size]]))

    return Primitive(
        lambda: (_bounded(coal.Box(x, y, z)), se3(message.position, message.quaternion_xyzw)),
        lambda: surfaces.box(message.size),
        charged,
        PLACED.pack(BOX, *unit(message.quaternion_xyzw), *message.position, 0.5 * x, 0.5 * y, 0.5 * z, 0.0),
    )


def _cylinder(message: messages.Cylinder) -> Primitive:
    size = radius, length = message.radius, message.length

    def charged(placement: Any) -> Charges:
        quads = moved(placement, surfaces.prism_quads(*size).reshape(-1, 3))
        return Charges(quads=quads.reshape(-1, 4, 3))

    return Primitive(
        lambda: (_bounded(coal.Cylinder(*size)), se3(message.position, message.quaternion_xyzw)),
        lambda: surfaces.cylinder(*size),
        charged,
        PLACED.pack(CYLINDER, *unit(message.quaternion_xyzw), *message.position, 0.0, 0.0, 0.5 * length, radius),
    )


def _sphere(message: messages.Sphere) -> Primitive:
    radius = message.radius
    return Primitive(
        lambda: (_bounded(coal.Sphere(radius)), pin.SE3(np.eye(3), np.array(message.position))),
        lambda: surfaces.sphere(radius),
        lambda _: Charges(spheres=np.array([[*message.position, radius]])),
        PLACED.pack(CAPSULE, *_UPRIGHT, *message.position, 0.0, 0.0, 0.0, radius),
    )


def _capsule(message: messages.Capsule) -> Primitive:
    size = radius, length = message.radius, message.length

    def charged(placement: Any) -> Charges:
        half_axis = placement.rotation[:, 2] * (0.5 * length)
        ends = [*(placement.translation - half_axis), *(placement.translation + half_axis)]
        return Charges(capsules=np.array([[*ends, radius]]))

    return Primitive(
        lambda: (_bounded(coal.Capsule(*size)), se3(message.position, message.quaternion_xyzw)),
        lambda: surfaces.capsule(*size),
        charged,
        PLACED.pack(CAPSULE, *unit(message.quaternion_xyzw), *message.position, 0.0, 0.0, 0.5 * length, radius),
    )


def _half_space(message: messages.HalfSpace) -> Primitive:
    norm = float(np.linalg.norm(message.normal))
    normal, offset = np.array(message.normal) / norm, message.offset / norm

    def patch() -> tuple[np.ndarray, np.ndarray]:
        sides = axes_across(normal) * (0.5 * HALF_SPACE_PATCH)
        corners = offset * normal + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ sides
        return corners, np.array([[0, 1, 2], [0, 2, 3]])

    return Primitive(
        lambda: (_bounded(coal.Halfspace(normal, offset)), pin.SE3.Identity()),
        patch,
        lambda _: Charges(planes=np.array([[*normal, offset]])),
        PLACED.pack(HALF_SPACE, *_UPRIGHT, *(offset * normal), *normal, 0.0),
    )


def _bounded(shape: Any) -> Any:
    """The shape, with the box about it that Coal's broad phase asks for."""
    shape.computeLocalAABB()
    return shape


PRIMITIVES: dict[type[messages.Obstacle], Callable[[Any], Primitive]] = {
    messages.Box: _box,
    messages.Sphere: _sphere,
    messages.Cylinder: _cylinder,
    messages.Capsule: _capsule,
    messages.HalfSpace: _half_space,
}
"""What makes them of their messages."""
