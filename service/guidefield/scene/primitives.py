"""Primitives declared as obstacles: a row for kernels (`primitives_layout.PLACED`) at once, all else on demand.

Each has a recipe of its Coal shape, its triangulation for pictures, and its charges, which must all mean one shape. The
row's columns are read by kernels/collide and `distance_tables.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.geometry import surfaces
from guidefield.geometry.placements import se3, transform_points, unit
from guidefield.kernels.collide.primitive import BOX, CAPSULE, CYLINDER, HALF_SPACE
from guidefield.kernels.collide.primitives_layout import PLACED
from guidefield.messages import scene as messages
from guidefield.scene.guide_plane import axes_across
from guidefield.scene.recipe import Charges, Recipe

HALF_SPACE_PATCH = 4.0  # side of the square that represents a half-space in drawings [m]

_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def _bounded_body(shape: Any) -> Any:
    shape.computeLocalAABB()
    return shape


def _box(message: messages.Box) -> bytes:
    x, y, z = message.size
    turned = unit(message.quaternion_xyzw)
    return PLACED.pack(BOX, *turned, *message.position, 0.5 * x, 0.5 * y, 0.5 * z, 0.0)


_BOX = Recipe(
    lambda m: (_bounded_body(coal.Box(*m.size)), se3(m.position, m.quaternion_xyzw)),
    lambda m: surfaces.box(m.size),
    lambda m, placement: Charges(boxes=np.array([[*placement.translation, *placement.rotation.T.ravel(), *m.size]])),
)


def _cylinder(message: messages.Cylinder) -> bytes:
    turned = unit(message.quaternion_xyzw)
    return PLACED.pack(CYLINDER, *turned, *message.position, 0.0, 0.0, 0.5 * message.length, message.radius)


def _charge_cylinder(message: messages.Cylinder, placement: Any) -> Charges:
    quads = transform_points(placement, surfaces.prism_quads(message.radius, message.length).reshape(-1, 3))
    return Charges(quads=quads.reshape(-1, 4, 3))


_CYLINDER = Recipe(
    lambda m: (_bounded_body(coal.Cylinder(m.radius, m.length)), se3(m.position, m.quaternion_xyzw)),
    lambda m: surfaces.cylinder(m.radius, m.length),
    _charge_cylinder,
)


def _sphere(message: messages.Sphere) -> bytes:
    return PLACED.pack(CAPSULE, *_UPRIGHT, *message.position, 0.0, 0.0, 0.0, message.radius)


_SPHERE = Recipe(
    lambda m: (_bounded_body(coal.Sphere(m.radius)), pin.SE3(np.eye(3), np.array(m.position))),
    lambda m: surfaces.sphere(m.radius),
    lambda m, _: Charges(spheres=np.array([[*m.position, m.radius]])),
)


def _capsule(message: messages.Capsule) -> bytes:
    turned = unit(message.quaternion_xyzw)
    return PLACED.pack(CAPSULE, *turned, *message.position, 0.0, 0.0, 0.5 * message.length, message.radius)


def _charge_capsule(message: messages.Capsule, placement: Any) -> Charges:
    half_axis = placement.rotation[:, 2] * (0.5 * message.length)
    ends = [*(placement.translation - half_axis), *(placement.translation + half_axis)]
    return Charges(capsules=np.array([[*ends, message.radius]]))


_CAPSULE = Recipe(
    lambda m: (_bounded_body(coal.Capsule(m.radius, m.length)), se3(m.position, m.quaternion_xyzw)),
    lambda m: surfaces.capsule(m.radius, m.length),
    _charge_capsule,
)


def _plane(message: messages.HalfSpace) -> tuple[np.ndarray, float]:
    """Return the unit normal (3,), and the offset along it [m]."""
    length = float(np.linalg.norm(message.normal))
    return np.array(message.normal) / length, message.offset / length


def _half_space(message: messages.HalfSpace) -> bytes:
    normal, offset = _plane(message)
    return PLACED.pack(HALF_SPACE, *_UPRIGHT, *(offset * normal), *normal, 0.0)


def _patch(message: messages.HalfSpace) -> tuple[np.ndarray, np.ndarray]:
    normal, offset = _plane(message)
    sides = axes_across(normal) * (0.5 * HALF_SPACE_PATCH)
    corners = offset * normal + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ sides
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def _charge_half_space(message: messages.HalfSpace, _: Any) -> Charges:
    normal, offset = _plane(message)
    return Charges(planes=np.array([[*normal, offset]]))


_HALF_SPACE = Recipe(
    lambda m: (_bounded_body(coal.Halfspace(*_plane(m))), pin.SE3.Identity()), _patch, _charge_half_space
)

PRIMITIVES: dict[type[messages.Obstacle], tuple[Recipe, Callable[[Any], bytes]]] = {
    messages.Box: (_BOX, _box),
    messages.Sphere: (_SPHERE, _sphere),
    messages.Cylinder: (_CYLINDER, _cylinder),
    messages.Capsule: (_CAPSULE, _capsule),
    messages.HalfSpace: (_HALF_SPACE, _half_space),
}
"""Recipe of each kind, and the function that packs its message as `PLACED`."""
