"""Enclosure: a body wholly inside a closed mesh touches nothing, because Coal judges such a mesh as a surface."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.geometry.closed import connected_pieces
from guidefield.robot.shapes import triangulation
from guidefield.scene.mesh import mesh_surface

if TYPE_CHECKING:
    from guidefield.collision.world import World


def enclosed(world: World, q: np.ndarray) -> tuple[str, str] | None:
    """Names of the first robot body and obstacle, one wholly inside the other's closed mesh, or None.

    Without contact a connected body is inside with all of its points or with none, so one point of each connected piece
    tells. A body that touches may be reported too: it is partly inside.

    Args:
        world: The robot among obstacles.
        q: Configuration, shape (group.nq,).
    """
    pin.updateGeometryPlacements(world.model, world.data, world.geometry, world.geometry_data, world.group.expand(q))
    surfaces = dict(_closed_surfaces(world))
    for pair in np.flatnonzero(world.is_obstacle_pair).tolist():
        first, second = world.pairs[pair].tolist()
        for outer, inner in ((first, second), (second, first)):
            if outer in surfaces and _inside(world, surfaces[outer], outer, inner):
                return world.pair_names(pair)
    return None


def winding_number(point: np.ndarray, corners: np.ndarray) -> float:
    """How often a surface winds around a point: whole numbers for a closed one, 0 outside.

    The sum of the triangles' solid angles over 4 pi (van Oosterom and Strackee, 1983).

    Args:
        point: Shape (3,) [m].
        corners: Triangles, shape (t, 3, 3) [m].
    """
    a, b, c = np.moveaxis(corners - point, 1, 0)
    la, lb, lc = (np.linalg.norm(arm, axis=1) for arm in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = [np.einsum("ij,ij->i", *arms) for arms in ((a, b), (b, c), (c, a))]
    solid_angles = 2.0 * np.arctan2(volume, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb)
    return float(solid_angles.sum() / (4.0 * np.pi))


def _closed_surfaces(world: World) -> Iterator[tuple[int, np.ndarray]]:
    """Body and triangles (t, 3, 3), in the body's own frame, of each closed mesh that is judged as a surface."""
    for body, shape in enumerate(world.geometry.geometryObjects):
        if isinstance(shape.geometry, coal.BVHModelBase):
            surface = mesh_surface(*triangulation(shape.geometry))
            if surface is not None and surface.solid:
                yield body, surface.vertices[surface.triangles]


def _inside(world: World, surface: np.ndarray, outer: int, inner: int) -> bool:
    points = _piece_points(world.geometry.geometryObjects[inner].geometry)
    local = world.geometry_data.oMg[outer].actInv(world.geometry_data.oMg[inner])
    low, high = surface.min(axis=(0, 1)), surface.max(axis=(0, 1))
    for point in points:
        here = local.act(point)
        if (here > low).all() and (here < high).all() and abs(winding_number(here, surface)) > 0.5:
            return True
    return False


def _piece_points(shape: Any) -> np.ndarray:
    """One point of each connected piece of a shape, shape (n, 3) [m, its frame]; nothing encloses a half-space."""
    if isinstance(shape, coal.Halfspace):
        return np.empty((0, 3))
    if isinstance(shape, coal.BVHModelBase):
        surface = mesh_surface(*triangulation(shape))
        if surface is None:
            return np.empty((0, 3))
        first_of_each = np.unique(connected_pieces(len(surface.vertices), surface.triangles))
        return np.array(surface.vertices[first_of_each])
    if isinstance(shape, coal.Convex):
        return np.array([np.mean(shape.points(), axis=0)])
    return np.zeros((1, 3))
