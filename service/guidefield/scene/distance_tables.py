"""The obstacles of a scene as the distance kernels read them."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from guidefield.geometry.box_tree import box_tree
from guidefield.geometry.charged import field_tables
from guidefield.geometry.pseudonormals import pseudonormals
from guidefield.kernels.distance import BOX, CAPSULE, CYLINDER, HALF_SPACE, SHEET, SOLID, DistanceTables
from guidefield.kernels.field import potential_at_points
from guidefield.kernels.triangle_distance import SurfaceTables
from guidefield.messages import scene as messages
from guidefield.scene.flat import axes_across
from guidefield.scene.mesh import pieces, volume
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene

NO_SURFACE = (np.empty((0, 3)), np.empty((0, 3), np.int64))


@dataclass(frozen=True, eq=False)
class _Body:
    """One body in a frame of its own.

    Attributes:
        kind: As in kernels/distance.py.
        placement: Rotation and translation in the world, shape (3, 4) [m].
        size: Three numbers by kind [m].
        bounds: Lower and upper corner of a box about it in its frame, shape (6,) [m].
        surface: Vertices and triangles of a solid or sheet, in its frame.
    """

    kind: int
    placement: np.ndarray
    size: tuple[float, float, float]
    bounds: np.ndarray
    surface: tuple[np.ndarray, np.ndarray] = NO_SURFACE


@functools.lru_cache(maxsize=8)
def distance_tables(scene: Scene) -> DistanceTables:
    """Tables of all obstacles of a scene; computed once for each scene.

    A closed mesh is a solid for each of its connected pieces, together with the hollows within it, so that pieces that
    overlap are told apart from hollows.
    """
    bodies = [(index, body) for index, one in enumerate(scene.obstacles) for body in BODIES[type(one.message)](one)]
    endless = [pair for pair in bodies if pair[1].kind == HALF_SPACE]
    bounded = [pair for pair in bodies if pair[1].kind != HALF_SPACE]
    nodes = np.empty((0, 6))
    if bounded:
        tree = box_tree(*_boxes_in_world([body for _, body in bounded]))
        nodes, bounded = tree.nodes, [bounded[k] for k in tree.order]
    ordered = endless + bounded
    surfaces, spans = _surface_tables([body.surface for _, body in ordered])
    return _frozen(
        DistanceTables(
            kinds=np.array([body.kind for _, body in ordered], np.int64),
            obstacles=np.array([index for index, _ in ordered], np.int64),
            placements=np.array([body.placement for _, body in ordered], float).reshape(-1, 3, 4),
            sizes=np.array([body.size for _, body in ordered], float).reshape(-1, 3),
            bounds=np.array([body.bounds for _, body in ordered], float).reshape(-1, 6),
            spans=spans,
            nodes=nodes,
            surfaces=surfaces,
        )
    )


def _box(obstacle: Obstacle) -> list[_Body]:
    half = np.array(obstacle.shape.halfSide)
    return [_primitive(obstacle, BOX, (half[0], half[1], half[2]), half)]


def _cylinder(obstacle: Obstacle) -> list[_Body]:
    radius, half = obstacle.shape.radius, obstacle.shape.halfLength
    return [_primitive(obstacle, CYLINDER, (radius, half, 0.0), np.array([radius, radius, half]))]


def _capsule(obstacle: Obstacle) -> list[_Body]:
    radius, half = obstacle.shape.radius, obstacle.shape.halfLength
    return [_primitive(obstacle, CAPSULE, (radius, half, 0.0), np.array([radius, radius, half + radius]))]


def _sphere(obstacle: Obstacle) -> list[_Body]:
    radius = obstacle.shape.radius
    return [_primitive(obstacle, CAPSULE, (radius, 0.0, 0.0), np.full(3, radius))]


def _half_space(obstacle: Obstacle) -> list[_Body]:
    normal = np.array(obstacle.shape.n)
    placement = np.column_stack([*axes_across(normal), normal, obstacle.shape.d * normal])
    bounds = np.array([-np.inf, -np.inf, -np.inf, np.inf, np.inf, 0.0])
    return [_Body(HALF_SPACE, placement, (0.0, 0.0, 0.0), bounds)]


def _triangles(obstacle: Obstacle) -> list[_Body]:
    vertices = (obstacle.vertices - obstacle.placement.translation) @ obstacle.placement.rotation
    triangles = _with_area(vertices, obstacle.triangles)
    parts = _solids(vertices, triangles) if obstacle.solid else [triangles]
    return [
        _Body(
            SOLID if obstacle.solid else SHEET,
            _rows(obstacle),
            (0.0, 0.0, 0.0),
            np.r_[vertices[part].min(axis=(0, 1)), vertices[part].max(axis=(0, 1))],
            (vertices, part),
        )
        for part in parts
    ]


BODIES: dict[type[messages.Obstacle], Callable[[Obstacle], list[_Body]]] = {
    messages.Box: _box,
    messages.Sphere: _sphere,
    messages.Cylinder: _cylinder,
    messages.Capsule: _capsule,
    messages.Mesh: _triangles,
    messages.Polygon: _triangles,
    messages.HalfSpace: _half_space,
}
"""The bodies of an obstacle, by kind of message."""


def _primitive(obstacle: Obstacle, kind: int, size: tuple[float, float, float], half: np.ndarray) -> _Body:
    return _Body(kind, _rows(obstacle), size, np.r_[-half, half])


def _rows(obstacle: Obstacle) -> np.ndarray:
    """Rotation and translation of an obstacle's frame, shape (3, 4)."""
    return np.column_stack([obstacle.placement.rotation, obstacle.placement.translation])


def _boxes_in_world(bodies: list[_Body]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corners (n, 3) of boxes in the world about bodies."""
    placements, bounds = np.array([body.placement for body in bodies]), np.array([body.bounds for body in bodies])
    centres = 0.5 * (bounds[:, :3] + bounds[:, 3:])
    middles = np.einsum("bij,bj->bi", placements[:, :, :3], centres) + placements[:, :, 3]
    halves = np.einsum("bij,bj->bi", np.abs(placements[:, :, :3]), 0.5 * (bounds[:, 3:] - bounds[:, :3]))
    # what rounding takes off a box must not hide the body in it
    halves += 1e-9 * (1.0 + np.abs(middles))
    return middles - halves, middles + halves


def _surface_tables(surfaces: list[tuple[np.ndarray, np.ndarray]]) -> tuple[SurfaceTables, np.ndarray]:
    """Tables of surfaces (vertices, triangles), and where the tree of each stands, shape (n, 4)."""
    nodes, corners, normals = [np.empty((0, 6))], [np.empty((0, 9))], [np.empty((0, 21))]
    spans = np.zeros((len(surfaces), 4), np.int64)
    node = triangle = 0
    for index, (vertices, triangles) in enumerate(surfaces):
        if not len(triangles):
            continue
        a, b, c = np.moveaxis(vertices[triangles], 1, 0)
        tree = box_tree(np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c))
        spans[index] = node, tree.leaves, triangle, len(triangles)
        nodes.append(tree.nodes)
        corners.append(np.hstack([a, b - a, c - a])[tree.order])
        normals.append(pseudonormals(vertices, triangles)[tree.order])
        node, triangle = node + len(tree.nodes), triangle + len(triangles)
    return SurfaceTables(*(np.concatenate(rows) for rows in (nodes, corners, normals))), spans


def _with_area(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The triangles that are more than a line: their neighbours' edges cover the others."""
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    across = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.maximum.reduce([np.linalg.norm(edge, axis=1) for edge in (b - a, c - b, a - c)])
    solid: np.ndarray = triangles[across > 1e-12 * longest**2]
    return solid


def _solids(vertices: np.ndarray, triangles: np.ndarray) -> list[np.ndarray]:
    """Triangles of each solid: a connected piece that encloses a volume, with the hollows that lie within it."""
    labels = pieces(len(vertices), triangles)[triangles[:, 0]]
    parts = [triangles[labels == label] for label in np.unique(labels)]
    solids = sorted((part for part in parts if volume(vertices, part) > 0.0), key=lambda part: volume(vertices, part))
    hollows = [part for part in parts if volume(vertices, part) <= 0.0]
    within: list[list[np.ndarray]] = [[solid] for solid in solids]
    for hollow in hollows:
        inside = vertices[hollow[0]].mean(axis=0)[None]
        around = (k for k, solid in enumerate(solids) if _winding(vertices[solid], inside) > 0.5)
        # a hollow in nothing is the surface of everything else: it belongs to all there is
        within[next(around, len(solids) - 1)].append(hollow)
    return [np.concatenate(group) for group in within]


def _winding(corners: np.ndarray, point: np.ndarray) -> float:
    return float(potential_at_points(field_tables(triangles=corners), point)[2][0])


def _frozen(tables: DistanceTables) -> DistanceTables:
    for array in (*tables[:-1], *tables.surfaces):
        array.setflags(write=False)
    return tables
