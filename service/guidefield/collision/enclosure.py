"""Enclosure: a body wholly inside a closed mesh touches nothing, because Coal judges such a mesh as a surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.geometry.closed import connected_pieces
from guidefield.kept import kept_with
from guidefield.robot.model import RobotModel
from guidefield.robot.shapes import triangulation
from guidefield.scene.mesh import mesh_surface
from guidefield.scene.scene import Scene

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
    solids, pairs = _enclosable(world)
    if not pairs:
        return None
    pin.updateGeometryPlacements(world.model, world.data, world.geometry, world.geometry_data, world.group.expand(q))
    for pair in pairs:
        first, second = world.pairs[pair].tolist()
        for outer, inner in ((first, second), (second, first)):
            if _inside(world, solids, outer, inner):
                return world.pair_names(pair)
    return None


def winding_number(point: np.ndarray, corners: np.ndarray) -> float:
    """How often a surface winds around a point: whole numbers for a closed one, 0 outside.

    The sum of the triangles' solid angles over 4 pi (A. van Oosterom and J. Strackee, IEEE Trans. Biomedical
    Engineering 30(2), 1983).

    Args:
        point: Shape (3,) [m], in the surface's frame.
        corners: Triangles in the same frame, shape (t, 3, 3) [m].
    """
    a, b, c = np.moveaxis(corners - point, 1, 0)
    la, lb, lc = (np.linalg.norm(arm, axis=1) for arm in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = [np.einsum("ij,ij->i", *arms) for arms in ((a, b), (b, c), (c, a))]
    solid_angles = 2.0 * np.arctan2(volume, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb)
    return float(solid_angles.sum() / (4.0 * np.pi))


_NOWHERE = np.array([np.full(3, np.inf), np.full(3, -np.inf)])


@dataclass(frozen=True, eq=False)
class _Solid:
    """What tells whether a body is inside another, in the body's own frame [m].

    Attributes:
        surface: Triangles (t, 3, 3) of a closed mesh that is judged as a surface; None for all others.
        box: Lower and upper corner about them, shape (2, 3).
        points: A point of each connected piece, shape (n, 3); of a half-space none, because nothing encloses it.
    """

    surface: np.ndarray | None
    box: np.ndarray
    points: np.ndarray


@kept_with
def _enclosable(world: World) -> tuple[Sequence[_Solid], list[int]]:
    """What tells whether bodies are inside others, and the pairs of which one body could be."""
    solids = _solids(world)
    surfaced = np.array([solid.surface is not None for solid in solids])
    return solids, np.flatnonzero(world.is_obstacle_pair & surfaced[world.pairs].any(axis=1)).tolist()


def _solids(world: World) -> Sequence[_Solid]:
    """Of each body of a world."""
    group, of_links = world.group, _of_links(world.group.robot)
    index_of = {shape.name: index for index, shape in enumerate(group.robot.geometry.geometryObjects)}
    return [
        *(of_links[index_of[shape.name]] for shape in group.geometry.geometryObjects),
        *_of_obstacles(world.scene),
    ]


@kept_with
def _of_links(robot: RobotModel) -> tuple[_Solid, ...]:
    return tuple(_solid(shape.geometry) for shape in robot.geometry.geometryObjects)


@kept_with
def _of_obstacles(scene: Scene) -> tuple[_Solid, ...]:
    return tuple(_solid(obstacle.shape) for obstacle in scene.obstacles)


def _solid(shape: Any) -> _Solid:
    if isinstance(shape, coal.Halfspace):
        return _Solid(None, _NOWHERE, np.empty((0, 3)))
    if isinstance(shape, coal.Convex):
        return _Solid(None, _NOWHERE, np.mean(shape.points(), axis=0, keepdims=True))
    if not isinstance(shape, coal.BVHModelBase):
        return _Solid(None, _NOWHERE, np.zeros((1, 3)))
    mesh = mesh_surface(*triangulation(shape))
    if mesh is None:
        return _Solid(None, _NOWHERE, np.empty((0, 3)))
    first_of_each = np.unique(connected_pieces(len(mesh.vertices), mesh.triangles))
    if not mesh.solid:
        return _Solid(None, _NOWHERE, mesh.vertices[first_of_each])
    corners = mesh.vertices[mesh.triangles]
    return _Solid(corners, np.array([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))]), mesh.vertices[first_of_each])


def _inside(world: World, solids: Sequence[_Solid], outer: int, inner: int) -> bool:
    surface = solids[outer].surface
    if surface is None:
        return False
    local = world.geometry_data.oMg[outer].actInv(world.geometry_data.oMg[inner])
    low, high = solids[outer].box
    for point in solids[inner].points:
        here = local.act(point)
        if (here > low).all() and (here < high).all() and abs(winding_number(here, surface)) > 0.5:
            return True
    return False
