"""Coal shapes as the kernels' convex parts: a primitive or hull is one part, a triangle mesh a tree of triangles."""

from __future__ import annotations

import hashlib
import itertools
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.geometry.convex import convex_hull
from guidefield.kernels.lane_math import CAPSULE, CYLINDER, HALF_SPACE
from guidefield.kernels.lanes import LANES
from guidefield.kernels.separation import PART, POLYTOPE, TRIANGLE, Parts
from guidefield.robot.shapes import triangulation


class UnservedError(Exception):
    """What the lane kernels don't know: a kind of shape or joint."""


class PartsTable:
    """Collects the parts of bodies."""

    def __init__(self) -> None:
        self._balls: list[np.ndarray] = []
        self._links: list[np.ndarray] = []
        self._shapes: list[np.ndarray] = []
        self._numbers: list[np.ndarray] = []
        self._vertices: list[np.ndarray] = []
        self._n_nodes = self._n_parts = self._n_blocks = 0

    def add_shape(self, shape: Any, placement: Any) -> int:  # noqa: PLR0911  one for each kind
        """Add a Coal shape that stands at a pinocchio.SE3 in its body; the root of its tree.

        Raises:
            UnservedError: if it is of a kind that the kernels don't know.
        """
        numbers = np.zeros(PART)
        numbers[:12] = np.c_[placement.rotation, placement.translation].ravel()
        centre = placement.translation
        if isinstance(shape, coal.BVHModelBase):
            return self._mesh(_known_mesh(shape), placement)
        if isinstance(shape, coal.Convex):
            return self._polytope(_moved(placement, np.array(shape.points())))
        if isinstance(shape, coal.Box):
            corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * np.array(shape.halfSide)
            return self._polytope(_moved(placement, corners))
        if isinstance(shape, coal.Cylinder):
            numbers[12], numbers[14] = shape.radius, shape.halfLength
            return self._single(CYLINDER, numbers, centre, float(np.hypot(shape.radius, shape.halfLength)))
        if isinstance(shape, coal.Capsule):
            numbers[14], numbers[15] = shape.halfLength, shape.radius
            return self._single(CAPSULE, numbers, centre, shape.halfLength + shape.radius)
        if isinstance(shape, coal.Sphere):
            numbers[15] = shape.radius
            return self._single(CAPSULE, numbers, centre, shape.radius)
        if isinstance(shape, coal.Halfspace):
            normal = placement.rotation @ shape.n
            numbers[:4] = *normal, shape.d + normal @ centre
            return self._single(HALF_SPACE, numbers, centre, np.inf)
        raise UnservedError(type(shape).__name__)

    def add_triangles(self, corners: np.ndarray) -> int:
        """Add triangles, shape (t, 3, 3) [m, the body's frame]; the root of their tree."""
        return self._mesh(_mesh(corners), pin.SE3.Identity())

    def _mesh(self, mesh: _Mesh, placement: Any) -> int:
        """Add a mesh that stands at a pinocchio.SE3 in its body; the root of its tree."""
        count = len(mesh.corners)
        numbers = np.zeros((count, PART))
        numbers[:, :9] = _moved(placement, mesh.corners.reshape(-1, 3)).reshape(-1, 9)
        self._numbers.append(numbers.ravel())
        self._shapes.append(np.tile([TRIANGLE, 0, 0], count))
        links = mesh.links + np.where(mesh.links >= 0, [self._n_nodes, self._n_nodes, self._n_parts], 0)
        root = self._n_nodes
        self._n_parts += count
        self._n_nodes += len(mesh.balls)
        if count > 1 and mesh.hull is not None:
            links[0, 2] = self._add_hull(_moved(placement, mesh.hull))
        self._balls.append(np.column_stack([_moved(placement, mesh.balls[:, :3]), mesh.balls[:, 3]]).ravel())
        self._links.append(links.ravel())
        return root

    def _add_hull(self, vertices: np.ndarray) -> int:
        """Add a hull as a part without a node: what it is apart from, all that it contains is."""
        blocks = self._add_vertices(vertices)
        self._shapes.append(np.array([POLYTOPE, self._n_blocks, blocks]))
        self._numbers.append(np.zeros(PART))
        self._n_blocks += blocks
        self._n_parts += 1
        return self._n_parts - 1

    def _add_vertices(self, vertices: np.ndarray) -> int:
        """Add vertices in blocks; how many blocks."""
        blocks = -(-len(vertices) // LANES)
        padded = np.concatenate([vertices, np.repeat(vertices[:1], blocks * LANES - len(vertices), axis=0)])
        self._vertices.append(padded.reshape(blocks, LANES, 3).transpose(0, 2, 1).ravel())
        return blocks

    def tables(self) -> Parts:
        """What was added, frozen."""
        arrays = (
            np.concatenate([np.empty(0), *self._balls]),
            np.concatenate([np.empty(0, np.int64), *self._links]),
            np.concatenate([np.empty(0, np.int64), *self._shapes]),
            np.concatenate([np.empty(0), *self._numbers]),
            np.concatenate([np.empty(0), *self._vertices]).astype(np.float32),
        )
        for array in arrays:
            array.setflags(write=False)
        return Parts(*arrays)

    def _polytope(self, vertices: np.ndarray) -> int:
        blocks = self._add_vertices(vertices)
        centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        radius = float(np.linalg.norm(vertices - centre, axis=1).max())
        self._n_blocks += blocks
        return self._single(POLYTOPE, np.zeros(PART), centre, radius, blocks)

    def _single(self, kind: int, numbers: np.ndarray, centre: np.ndarray, radius: float, blocks: int = 0) -> int:
        """Add one part, whose vertices are the last blocks, with a ball about it; its node."""
        self._shapes.append(np.array([kind, self._n_blocks - blocks, blocks]))
        self._numbers.append(numbers)
        self._links.append(np.array([-1, -1, self._n_parts]))
        self._balls.append(np.array([*centre, radius]))
        self._n_parts += 1
        self._n_nodes += 1
        return self._n_nodes - 1


@dataclass(frozen=True, eq=False)
class _Mesh:
    """Triangles and a binary tree over them.

    Attributes:
        corners: Shape (t, 3, 3) [m].
        balls: Ball about each node, shape (n, 4); the root is the first.
        links: Children and triangle of each node, shape (n, 3); -1 where there is none.
        hull: Vertices of the hull; None if it is flat.
    """

    corners: np.ndarray
    balls: np.ndarray
    links: np.ndarray
    hull: np.ndarray | None


_KNOWN: dict[tuple[bytes, int], _Mesh] = {}
_MOST_KNOWN = 128


def _known_mesh(shape: Any) -> _Mesh:
    """The mesh of a Coal tree, made once for the same vertices."""
    key = (hashlib.sha256(np.ascontiguousarray(shape.vertices()).tobytes()).digest(), int(shape.num_tris))
    if key not in _KNOWN:
        while len(_KNOWN) >= _MOST_KNOWN:
            del _KNOWN[next(iter(_KNOWN))]
        vertices, faces = triangulation(shape)
        _KNOWN[key] = _mesh(vertices[faces])
    return _KNOWN[key]


def _mesh(triangles: np.ndarray) -> _Mesh:
    """Build the tree over triangles (t, 3, 3), each group halved along its widest side."""
    centres, members = triangles.mean(axis=1), np.arange(len(triangles))
    sizes = np.array([len(triangles)])
    balls, links, made = [], np.empty((0, 3), np.int64), 0
    while len(sizes):  # level by level: the members of its nodes one after the other
        starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        balls.append(_balls_about(triangles[members], starts, sizes))
        split = sizes > 1
        children = made + len(sizes) + 2 * np.cumsum(split) - 2
        rows = np.column_stack([np.where(split, children, -1), np.where(split, children + 1, -1), members[starts]])
        rows[split, 2] = -1
        links = np.concatenate([links, rows])
        members = _halved(centres, members[np.repeat(split, sizes)], sizes[split])
        made += len(sizes)
        halves = sizes[split] // 2
        sizes = np.column_stack([halves, sizes[split] - halves]).ravel()
    try:
        hull = np.array(convex_hull(triangles.reshape(-1, 3)).vertices)
    except ValueError:
        hull = None
    return _Mesh(triangles, np.concatenate(balls), links, hull)


def _balls_about(triangles: np.ndarray, starts: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """A ball (n, 4) about each of n runs of triangles."""
    low, high = np.minimum.reduceat(triangles.min(axis=1), starts), np.maximum.reduceat(triangles.max(axis=1), starts)
    middles = 0.5 * (low + high)
    apart = np.linalg.norm(triangles - np.repeat(middles, sizes, axis=0)[:, None], axis=2).max(axis=1)
    return np.column_stack([middles, np.maximum.reduceat(apart, starts)])


def _halved(centres: np.ndarray, members: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """The members of runs, each run in order along the side where its centres spread most."""
    if not len(sizes):
        return members
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    places = centres[members]
    widest = np.argmax(np.maximum.reduceat(places, starts) - np.minimum.reduceat(places, starts), axis=1)
    along = places[np.arange(len(members)), np.repeat(widest, sizes)]
    ordered: np.ndarray = members[np.lexsort((along, np.repeat(np.arange(len(sizes)), sizes)))]
    return ordered


def _moved(placement: Any, points: np.ndarray) -> np.ndarray:
    moved: np.ndarray = points @ placement.rotation.T + placement.translation
    return moved
