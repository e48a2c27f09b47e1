"""Solids: the inside of closed meshes, and points by which bodies are known to be in there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from guidefield.geometry.closed import connected_pieces
from guidefield.geometry.extents import box_about
from guidefield.geometry.mesh_surface import mesh_surface
from guidefield.kernels.cover.crossings import RUN, UNSURE, find_run_boxes, winding_by_crossings
from guidefield.kernels.cover.winding import winding_by_angles
from guidefield.memo import memoized
from guidefield.robot.group.alike import memoized_for_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.shapes import triangulation
from guidefield.scene.obstacle import Obstacle


class _Surface(NamedTuple):
    """A closed surface in its own frame.

    Attributes:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3).
        boxes: About runs of them, see `find_run_boxes`, shape (k, 4) [m].
    """

    vertices: np.ndarray
    triangles: np.ndarray
    boxes: np.ndarray


def winds_around(surface: _Surface, point: np.ndarray) -> bool:
    """Whether a closed surface winds around a point, shape (3,) [m]: crossings tell, where they don't solid angles."""
    x, y, z = point.tolist()
    turns = winding_by_crossings(x, y, z, *surface)
    if turns == UNSURE:
        return abs(winding_by_angles(x, y, z, surface.vertices, surface.triangles)) > 0.5
    return turns != 0


_NOWHERE = np.array([np.full(3, np.inf), np.full(3, -np.inf)])


@dataclass(frozen=True, eq=False)
class Solid:
    """What tells whether a body is inside another, in the body's own frame [m].

    Attributes:
        surface: That of a closed mesh that is judged as a surface; None for all others.
        box: Lower and upper corner about them, shape (2, 3).
        points: A point of each connected piece, shape (n, 3); of a half-space none, because nothing encloses it.
    """

    surface: _Surface | None
    box: np.ndarray
    points: np.ndarray


def is_around(outer: Solid, inner: Solid, there: pin.SE3, at: pin.SE3) -> bool:
    """Return whether a solid is a closed mesh around a piece of another, given where both are."""
    if outer.surface is None:
        return False
    local = np.array([there.actInv(at.act(point)) for point in inner.points]).reshape(-1, 3)
    within = ((local > outer.box[0]) & (local < outer.box[1])).all(axis=1)
    return any(winds_around(outer.surface, point) for point in local[within])


@memoized_for_alike
def solids_of_group(group: PlanningGroup) -> tuple[Solid, ...]:
    """Of each of a group's bodies."""
    solids, robot = _of_links(group.robot), group.robot.geometry
    index_of = {shape.name: index for index, shape in enumerate(robot.geometryObjects)}
    return tuple(solids[index_of[shape.name]] for shape in group.geometry.geometryObjects)


@memoized
def _of_links(robot: RobotModel) -> tuple[Solid, ...]:
    return tuple(_solid(shape.geometry) for shape in robot.geometry.geometryObjects)


@memoized
def solid_of_obstacle(obstacle: Obstacle) -> Solid:
    """Of an obstacle."""
    if obstacle.cloud is not None:
        return _NOTHING
    if obstacle.facets is None:
        return _solid(obstacle.shape)
    return _of_surface(*obstacle.whole_surface, solid=obstacle.solid)


_NOTHING = Solid(None, _NOWHERE, np.empty((0, 3)))


def _solid(shape: Any) -> Solid:
    if isinstance(shape, coal.Halfspace):
        return _NOTHING
    if isinstance(shape, coal.Convex):
        return Solid(None, _NOWHERE, np.mean(shape.points(), axis=0, keepdims=True))
    if not isinstance(shape, coal.BVHModelBase):
        return Solid(None, _NOWHERE, np.zeros((1, 3)))
    mesh = mesh_surface(*triangulation(shape))
    return _NOTHING if mesh is None else _of_surface(mesh.vertices, mesh.triangles, solid=mesh.solid)


def _of_surface(vertices: np.ndarray, triangles: np.ndarray, *, solid: bool) -> Solid:
    """Of a mesh, vertices (v, 3) [m] and triangles (t, 3)."""
    first_of_each = vertices[np.unique(connected_pieces(len(vertices), triangles))]
    if not solid:
        return Solid(None, _NOWHERE, first_of_each)
    vertices, triangles = np.ascontiguousarray(vertices, float), np.ascontiguousarray(triangles, np.int64)
    boxes = np.empty((-(-len(triangles) // RUN), 4))
    find_run_boxes(vertices, triangles, boxes)
    return Solid(_Surface(vertices, triangles, boxes), box_about(vertices), first_of_each)
