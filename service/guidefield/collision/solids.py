"""The inside of closed meshes, points by which bodies are found to be in there, and hulls in place of meshes.

`clearance.py` and `pairs.py` test the inside by exact winding numbers; `world.py` tests hulls first because that takes
less time. A hull must contain its mesh, and points must be of every connected piece.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.geometry.closed import boxes_about, find_connected
from guidefield.geometry.convex import convex, convex_hull
from guidefield.geometry.mesh_surface import mesh_surface
from guidefield.kernels.distance.winding import RUN, UNSURE, find_run_boxes, winding_by_angles, winding_by_crossings
from guidefield.memo import memoized
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.model.collision_shapes import hull, triangulation
from guidefield.robot.model.model import RobotModel
from guidefield.scene.obstacle import Obstacle

MOST_TRIANGLES = 20_000
"""An obstacle of more gets no hull (Qhull would take seconds), and SIMD tables on disk that know no solids in it."""

FEW = 16  # most pairs of a point and a box that are compared one by one, which takes less time than as arrays


@memoized_for_alike
def link_hulls(group: PlanningGroup) -> tuple[Any | None, ...]:
    """Return the hull of each of a group's bodies that counts as a mesh; None for all others."""
    of_robot = hulls_of(group.robot)
    index_of = {shape.name: index for index, shape in enumerate(group.robot.geometry.geometryObjects)}
    return tuple(of_robot[index_of[shape.name]] for shape in group.geometry.geometryObjects)


@memoized
def hulls_of(robot: RobotModel) -> tuple[Any | None, ...]:
    """Return the hull of each collision shape that counts as a mesh; None for all others."""
    shapes = [shape.geometry for shape in robot.geometry.geometryObjects]
    return tuple(hull(shape) if isinstance(shape, coal.BVHModelBase) else None for shape in shapes)


@memoized
def obstacle_hull(obstacle: Obstacle) -> Any | None:
    """Return the hull of an obstacle that counts as a mesh; None for a flat one, and for all others.

    A cloud of points has none: what is among its points is mostly free. So is what is within the hull of a mesh of very
    many triangles, which takes long to find.
    """
    if obstacle.cloud is not None or not 0 < obstacle.faces <= MOST_TRIANGLES:
        return None
    try:
        found = convex_hull(obstacle.recipe.surface(obstacle.message)[0])
    except ValueError:
        return None
    return convex(np.asarray(found.vertices), np.asarray(found.triangles))


@dataclass(frozen=True, eq=False)
class Solid:
    """A body's inside, if it is a closed mesh, and a point of each of its pieces, in its own frame [m]."""

    vertices: np.ndarray  # those of a closed mesh that counts as a surface, shape (v, 3)
    # triangles of each of its solids, shape (t, 3), and boxes about runs of them (k, 4); else none
    surfaces: tuple[tuple[np.ndarray, np.ndarray], ...]
    boxes: np.ndarray  # lower and upper corners about the solids, shape (n, 2, 3)
    # a point of each connected piece, shape (n, 3); of a half-space none, because nothing encloses it
    points: np.ndarray

    def contains_any(self, points: np.ndarray) -> bool:
        """Return whether one of some points (n, 3) is inside."""
        if len(points) * len(self.boxes) <= FEW:
            return any(self._contains(point) for point in points)
        low, high = self.boxes.swapaxes(0, 1)
        within = np.ones((len(low), len(points)), bool)
        for axis in range(3):  # one by one, which takes less time than all together
            within &= (points[:, axis] > low[:, axis, None]) & (points[:, axis] < high[:, axis, None])
        found = zip(*(at.tolist() for at in within.nonzero()), strict=True)
        return any(self._winds_around(points[i], *self.surfaces[k]) for k, i in found)

    def _contains(self, point: np.ndarray) -> bool:
        x, y, z = point.tolist()
        for k, ((left, front, bottom), (right, back, top)) in enumerate(self._corners):
            is_near = left < x < right and front < y < back and bottom < z < top
            if is_near and self._winds_around(point, *self.surfaces[k]):
                return True
        return False

    @cached_property
    def _corners(self) -> list[list[list[float]]]:
        corners: list[list[list[float]]] = self.boxes.tolist()
        return corners

    def _winds_around(self, point: np.ndarray, triangles: np.ndarray, runs: np.ndarray) -> bool:
        """Check whether a solid winds around a point (3,), by crossings or, where they are unsure, by solid angles."""
        x, y, z = point.tolist()
        turns = winding_by_crossings(x, y, z, self.vertices, triangles, runs)
        if turns == UNSURE:
            return abs(winding_by_angles(x, y, z, self.vertices, triangles)) > 0.5
        return turns != 0


def is_around(outer: Solid, inner: Solid, there: pin.SE3, at: pin.SE3) -> bool:
    """Return whether a solid is a closed mesh around a piece of another, given where both are."""
    if not outer.surfaces:
        return False
    between = there.actInv(at)
    return outer.contains_any(inner.points @ between.rotation.T + between.translation)


@memoized_for_alike
def solids_of_group(group: PlanningGroup) -> tuple[Solid, ...]:
    """Return the `Solid` of each of a group's bodies."""
    solids, robot = _of_links(group.robot), group.robot.geometry
    index_of = {shape.name: index for index, shape in enumerate(robot.geometryObjects)}
    return tuple(solids[index_of[shape.name]] for shape in group.geometry.geometryObjects)


@memoized
def _of_links(robot: RobotModel) -> tuple[Solid, ...]:
    return tuple(_solid(shape.geometry) for shape in robot.geometry.geometryObjects)


@memoized
def solid_of_obstacle(obstacle: Obstacle) -> Solid:
    """Return the `Solid` of an obstacle; of a cloud one without inside or points."""
    if obstacle.cloud is not None:
        return _NOTHING
    if obstacle.facets is None:
        return _solid(obstacle.shape)
    return _of_surface(*obstacle.whole_surface, obstacle.whole_solids)


def _empty_solid(points: np.ndarray) -> Solid:
    return Solid(np.empty((0, 3)), (), np.empty((0, 2, 3)), points)


_NOTHING = _empty_solid(np.empty((0, 3)))


def _solid(shape: Any) -> Solid:
    if isinstance(shape, coal.Halfspace):
        return _NOTHING
    if isinstance(shape, coal.Convex):
        return _empty_solid(np.mean(shape.points(), axis=0, keepdims=True))
    if not isinstance(shape, coal.BVHModelBase):
        return _empty_solid(np.zeros((1, 3)))
    mesh = mesh_surface(*triangulation(shape))
    return _NOTHING if mesh is None else _of_surface(mesh.vertices, mesh.triangles, [mesh.triangles][: mesh.solid])


def _of_surface(vertices: np.ndarray, triangles: np.ndarray, solids: Sequence[np.ndarray]) -> Solid:
    """Build it for a mesh, vertices (v, 3) [m] and triangles (t, 3), and the triangles of its solids."""
    first_of_each = vertices[np.unique(find_connected(len(vertices), triangles))]
    vertices, surfaces = np.ascontiguousarray(vertices, float), list[tuple[np.ndarray, np.ndarray]]()
    for some in solids:
        triangles, runs = np.ascontiguousarray(some, np.int64), np.empty((-(-len(some) // RUN), 4))
        find_run_boxes(vertices, triangles, runs)
        surfaces.append((triangles, runs))
    boxes = boxes_about(vertices, [triangles for triangles, _ in surfaces])
    return Solid(vertices, tuple(surfaces), boxes, first_of_each)
