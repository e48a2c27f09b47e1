"""Enclosure: a body wholly inside a closed mesh touches nothing, because Coal judges such a mesh as a surface."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import coal
import numpy as np

from guidefield.collision.pairs import PairNames
from guidefield.collision.world import World
from guidefield.geometry.closed import connected_pieces
from guidefield.geometry.extents import box_about
from guidefield.geometry.mesh_surface import mesh_surface
from guidefield.kept import MISSING, Answers, kept_with
from guidefield.kernels.cover.crossings import RUN, UNSURE, find_run_boxes, winding_by_crossings
from guidefield.kernels.cover.winding import winding_by_angles
from guidefield.robot.group.alike import kept_with_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.shapes import triangulation
from guidefield.robot.model.spaces import ModelConfiguration
from guidefield.scene.obstacle import Obstacle


def enclosed(world: World, q: ModelConfiguration) -> PairNames | None:
    """Names of the first pair of bodies, one wholly inside the other's closed mesh, or None.

    Without contact a connected body is inside with all of its points or with none, so one point of each connected piece
    tells. A body that touches may be reported too: it is partly inside.
    A motion without contact can't change the answer: it is asked for once, at the start.

    Args:
        world: The robot among obstacles.
        q: Configuration of the group's model, shape (model.nq,).
    """
    answer = _ENCLOSURES.of(world, key := q.tobytes())  # starts are asked about again and again
    return _ENCLOSURES.keep(world, key, _enclosed_each(world, [q])[0]) if answer is MISSING else answer


_ENCLOSURES = Answers[PairNames | None]()


def enclosed_each(world: World, qs: Sequence[ModelConfiguration]) -> list[PairNames | None]:
    """`enclosed` at each of some configurations, sooner than one after the other; the robot is left anywhere."""
    return [enclosed(world, q) for q in qs] if len(qs) == 1 else _enclosed_each(world, qs)


def enclosed_pairs(world: World, q: ModelConfiguration) -> list[int]:
    """Indices of all pairs of bodies one wholly inside the other's closed mesh, as `enclosed`, in ascending order."""
    return list(next(_enclosures(world, [q])))


def _enclosed_each(world: World, qs: Sequence[ModelConfiguration]) -> list[PairNames | None]:
    first = (next(pairs, None) for pairs in _enclosures(world, qs))
    return [None if pair is None else world.pair_names(pair) for pair in first]


def _enclosures(world: World, qs: Sequence[ModelConfiguration]) -> Iterator[Iterator[int]]:
    """Of each of some configurations the pairs one of whose bodies is inside the other; to be asked in order."""
    closed = closed_bodies(world.group)
    if not len(qs) or (world.scene.convex and not closed.any()):
        yield from (iter(()) for _ in qs)
        return
    for q, pairs in zip(qs, world.near_each(qs, closed), strict=True):
        world.place(q)
        yield (pair for pair in pairs if _is_one_around_the_other(world, *world.pairs.of(pair)))


def _is_one_around_the_other(world: World, first: int, second: int) -> bool:
    return _is_around(world, first, second) or _is_around(world, second, first)


def _is_around(world: World, outer: int, inner: int) -> bool:
    """Whether a body where the robot stands is a closed mesh around another, or around one of a cloud's points."""
    if not world.is_surface(outer) or (solid := _solid_of(world, outer)).surface is None:
        return False
    cloud = None if inner < world.pairs.links else world.scene.obstacles[inner - world.pairs.links].cloud
    if cloud is not None:
        return _around_a_point(world, outer, solid, cloud.points)
    there, at = world.placement(outer), world.placement(inner)
    local = np.array([there.actInv(at.act(point)) for point in _solid_of(world, inner).points]).reshape(-1, 3)
    within = ((local > solid.box[0]) & (local < solid.box[1])).all(axis=1)
    return any(_winds_around(solid.surface, point) for point in local[within])


def _around_a_point(world: World, outer: int, solid: _Solid, points: np.ndarray) -> bool:
    """Whether a robot body where the world's data stand is around one of some points (n, 3) [m, world]."""
    there = world.placement(outer)
    low, high = solid.box
    middle, reach, near = there.act(0.5 * (low + high)), 0.5 * float(np.linalg.norm(high - low)), points
    for axis in range(3):  # one after another: few are left after the first
        near = near[np.abs(near[:, axis] - middle[axis]) < reach]
    local = (near - there.translation) @ there.rotation
    within = local[((local > low) & (local < high)).all(axis=1)]
    assert solid.surface is not None, "only closed meshes are asked for"
    return any(_winds_around(solid.surface, point) for point in within)


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


def _winds_around(surface: _Surface, point: np.ndarray) -> bool:
    """Whether a closed surface winds around a point, shape (3,) [m]: crossings tell, where they don't solid angles."""
    x, y, z = point.tolist()
    turns = winding_by_crossings(x, y, z, *surface)
    if turns == UNSURE:
        return abs(winding_by_angles(x, y, z, surface.vertices, surface.triangles)) > 0.5
    return turns != 0


_NOWHERE = np.array([np.full(3, np.inf), np.full(3, -np.inf)])


@dataclass(frozen=True, eq=False)
class _Solid:
    """What tells whether a body is inside another, in the body's own frame [m].

    Attributes:
        surface: That of a closed mesh that is judged as a surface; None for all others.
        box: Lower and upper corner about them, shape (2, 3).
        points: A point of each connected piece, shape (n, 3); of a half-space none, because nothing encloses it.
    """

    surface: _Surface | None
    box: np.ndarray
    points: np.ndarray


def _solid_of(world: World, body: int) -> _Solid:
    """Of a body of a world."""
    if body >= world.pairs.links:
        return _of_obstacle(world.scene.obstacles[body - world.pairs.links])
    name, robot = world.group.geometry.geometryObjects[body].name, world.group.robot
    return _of_links(robot)[int(robot.geometry.getGeometryId(name))]


@kept_with_alike
def closed_bodies(group: PlanningGroup) -> np.ndarray:
    """Which of a group's bodies are closed meshes that Coal judges as surfaces, shape (r,): no other is around any."""
    solids, robot = _of_links(group.robot), group.robot.geometry
    index_of = {shape.name: index for index, shape in enumerate(robot.geometryObjects)}
    closed = [solids[index_of[shape.name]].surface is not None for shape in group.geometry.geometryObjects]
    return np.array(closed, bool)


@kept_with
def _of_links(robot: RobotModel) -> tuple[_Solid, ...]:
    return tuple(_solid(shape.geometry) for shape in robot.geometry.geometryObjects)


@kept_with
def _of_obstacle(obstacle: Obstacle) -> _Solid:
    if obstacle.cloud is not None:
        return _NOTHING
    if obstacle.facets is None:
        return _solid(obstacle.shape)
    return _of_surface(*obstacle.whole_surface, solid=obstacle.solid)


_NOTHING = _Solid(None, _NOWHERE, np.empty((0, 3)))


def _solid(shape: Any) -> _Solid:
    if isinstance(shape, coal.Halfspace):
        return _NOTHING
    if isinstance(shape, coal.Convex):
        return _Solid(None, _NOWHERE, np.mean(shape.points(), axis=0, keepdims=True))
    if not isinstance(shape, coal.BVHModelBase):
        return _Solid(None, _NOWHERE, np.zeros((1, 3)))
    mesh = mesh_surface(*triangulation(shape))
    return _NOTHING if mesh is None else _of_surface(mesh.vertices, mesh.triangles, solid=mesh.solid)


def _of_surface(vertices: np.ndarray, triangles: np.ndarray, *, solid: bool) -> _Solid:
    """Of a mesh, vertices (v, 3) [m] and triangles (t, 3)."""
    first_of_each = vertices[np.unique(connected_pieces(len(vertices), triangles))]
    if not solid:
        return _Solid(None, _NOWHERE, first_of_each)
    vertices, triangles = np.ascontiguousarray(vertices, float), np.ascontiguousarray(triangles, np.int64)
    boxes = np.empty((-(-len(triangles) // RUN), 4))
    find_run_boxes(vertices, triangles, boxes)
    return _Solid(_Surface(vertices, triangles, boxes), box_about(vertices), first_of_each)
