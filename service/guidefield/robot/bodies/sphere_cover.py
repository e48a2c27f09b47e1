"""The balls of a robot's links: those that contain each collision shape, and those inside of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import coal
import numpy as np

from guidefield.geometry.cache import Arrays
from guidefield.geometry.cover import LEAST_REACHES, Cover, cover
from guidefield.geometry.inner import inner_balls
from guidefield.geometry.primitive_covers import (
    cover_box,
    cover_capsule,
    cover_cylinder,
    cover_sphere,
    inner_box,
    inner_capsule,
    inner_cylinder,
    inner_sphere,
)
from guidefield.geometry.solid import fill_hollows, fill_solid_of_mesh, near_solid_of_mesh, solid_of_mesh
from guidefield.geometry.surfaces import Floats
from guidefield.memo import memoized
from guidefield.robot.bodies.by_shape import ByShape, Progress, Question, log_task
from guidefield.robot.model.collision_shapes import WIDEST_GAP, triangulation
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.size import scale

DELTA = 0.015  # by how much covers may leave the shapes, unless told otherwise [m], at size 1

LARGE = 3_000.0
"""A surface of more squares of delta than these gets a cover that may leave it further: as if it had as many.

So the tolerance follows the size of a link: it is `DELTA` up to 0.67 m^2, and a link takes about half a second at most.
With 1500 plans for Baxter took a twentieth longer.
"""


SMALL = 2.0
"""Covers of smaller robots than usual may leave the shapes by this factor more, for their size.

Their links are as intricate: the first use of an SO-101 takes a tenth less so. Plans of a Panda of 0.35 and 0.1 times
the size are as long and take as long (`tools/bench otherwise`).
"""


@dataclass(frozen=True, eq=False)
class ShapeCoverage:
    """Balls about and inside, shape (n, 4) [m], of a collision shape as it is judged, in its own frame."""

    cover: Cover
    inner: Floats


@dataclass(frozen=True, eq=False)
class Coverage:
    """Balls of every shape of a robot, in the geometry's order."""

    shapes: tuple[ShapeCoverage, ...]
    # by how much the covers may leave the shapes, at size 1 [m]; those of `LARGE` ones and of small robots may leave
    # them further
    delta: float

    @property
    def spheres(self) -> int:
        """How many spheres contain the robot."""
        return sum(len(shape.cover.spheres) for shape in self.shapes)

    @property
    def inner(self) -> int:
        """How many balls are inside of it."""
        return sum(len(shape.inner) for shape in self.shapes)

    @property
    def overhang(self) -> float:
        """Largest overhang of a sphere [m], at most `delta` at size 1 or more unless a shape is `LARGE`."""
        return max(shape.cover.overhang for shape in self.shapes)


def coverage(robot: RobotModel, delta: float = DELTA, progress: Progress = log_task) -> Coverage:
    """Return covers and inner balls of a robot's collision shapes; kept on disk.

    Args:
        delta: By how much the covers may leave the shapes [m], at size 1.
        progress: Called before each shape that isn't known yet; what it raises comes through.

    Raises:
        ValueError: if `delta` is not positive.
    """
    if not (delta > 0.0 and np.isfinite(delta)):
        raise ValueError(f"`delta` must be positive, got {delta} m")
    COVERS.all(robot, delta, progress)
    return _coverage(robot, delta)


@memoized
def _coverage(robot: RobotModel, delta: float) -> Coverage:
    return Coverage(cast("tuple[ShapeCoverage, ...]", recall_coverage(robot, delta)), delta)


def recall_coverage(robot: RobotModel, delta: float = DELTA) -> tuple[ShapeCoverage | None, ...]:
    """What `coverage` gives, as far as it is known without computing anything, by shape; None where it isn't."""
    return COVERS.recall(robot, delta)


def _question(shape: Any, delta: float, unit: float) -> Question:
    """What the balls of a shape, in a unit [m], are kept under: a name, what they depend on, and how they are found."""
    kind = next((kind for kind in _KINDS if isinstance(shape, kind)), None)
    if kind is None:
        raise TypeError(f"a robot's collision shape can't be a {type(shape).__name__}")
    inputs, build = _KINDS[kind]
    delta *= SMALL if unit < 1.0 else 1.0
    arrays = inputs(shape)
    arrays = scale(arrays, 1.0 / unit, *(arrays.keys() - {"triangles"}))
    return (
        f"coverage-{kind.__name__.lower()}",
        {**arrays, "delta": np.array(delta)},
        lambda: _store(build(arrays, delta)),
    )


def _allowance(area: float, delta: float) -> float:
    """By how much the cover of a surface of that area [m^2] may leave it [m], so that it is found soon."""
    return max(delta, float(np.sqrt(area / LARGE)))


def _mesh(arrays: Arrays, delta: float) -> ShapeCoverage:
    mesh = arrays["vertices"], arrays["triangles"], WIDEST_GAP
    body, outer = near_solid_of_mesh(*mesh), fill_solid_of_mesh(*mesh)
    if _allowance(body.area, delta) < LEAST_REACHES * body.reach:
        body = solid_of_mesh(*mesh)
        outer = fill_hollows(body)
    return ShapeCoverage(cover(outer, _allowance(body.area, delta)), inner_balls(body).reshape(-1, 4))


def _mesh_arrays(shape: Any) -> Arrays:
    vertices, triangles = triangulation(shape)
    return {"vertices": vertices, "triangles": triangles}


def _box(arrays: Arrays, delta: float) -> ShapeCoverage:
    x, y, z = arrays["size"].tolist()
    allowed = _allowance(2.0 * (x * y + y * z + z * x), delta)
    return ShapeCoverage(cover_box(arrays["size"], allowed), inner_box(arrays["size"]))


def _sphere(arrays: Arrays, delta: float) -> ShapeCoverage:  # noqa: ARG001 - as the others
    radius = float(arrays["radius"])
    return ShapeCoverage(cover_sphere(radius), inner_sphere(radius))


def _cylinder(arrays: Arrays, delta: float) -> ShapeCoverage:
    radius, length = arrays["size"].tolist()
    allowed = _allowance(2.0 * np.pi * radius * (radius + length), delta)
    return ShapeCoverage(cover_cylinder(radius, length, allowed), inner_cylinder(radius, length))


def _capsule(arrays: Arrays, delta: float) -> ShapeCoverage:
    radius, length = arrays["size"].tolist()
    allowed = _allowance(2.0 * np.pi * radius * (2.0 * radius + length), delta)
    return ShapeCoverage(cover_capsule(radius, length, allowed), inner_capsule(radius, length))


_KINDS: dict[type, tuple[Callable[[Any], Arrays], Callable[[Arrays, float], ShapeCoverage]]] = {
    coal.Box: (lambda s: {"size": 2.0 * np.asarray(s.halfSide)}, _box),
    coal.Sphere: (lambda s: {"radius": np.array(s.radius)}, _sphere),
    coal.Cylinder: (lambda s: {"size": np.array([s.radius, 2.0 * s.halfLength])}, _cylinder),
    coal.Capsule: (lambda s: {"size": np.array([s.radius, 2.0 * s.halfLength])}, _capsule),
    coal.BVHModelBase: (_mesh_arrays, _mesh),
    coal.Convex: (_mesh_arrays, _mesh),
}
"""What the balls of each kind of shape depend on, and how they are found."""

_FIELDS = ("spheres", "overhangs", "groups", "first", "bound")


def _store(found: ShapeCoverage) -> Arrays:
    arrays = {name: getattr(found.cover, name) for name in _FIELDS}
    return {**arrays, "inner": found.inner}


def _restore(arrays: Arrays, unit: float) -> ShapeCoverage:
    arrays = scale(arrays, unit, "spheres", "overhangs", "groups", "bound", "inner")
    return ShapeCoverage(Cover(**{name: arrays[name] for name in _FIELDS}), arrays["inner"].reshape(-1, 4))


COVERS = ByShape("covering", _question, _restore)
"""By robot and by how much covers may leave the shapes [m], at size 1."""
