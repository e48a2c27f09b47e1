"""Triangulated surfaces of shapes in their own frames, boxes and directions of points, and placements.

They are drawn, and charges stand on them; collisions are judged by the exact shapes. A cylinder's prism contains it, as
covers need (`primitive_covers.py`). A sphere's and a capsule's vertices are so placed on it that a capsule fitted to
them, which proves motions (`robot/link_charges.py`), contains it: with over 512, as from 32 `sides` on, it may not.

Products are kernels or sums by hand, because NumPy hands tall ones to BLAS, whose threads cost more than these loops.
Covers and hulls are chosen by these directions: others give other (as valid) shapes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import Any, NamedTuple

import mapbox_earcut
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from guidefield.kernels.cover.cut_halves import furthest_along
from guidefield.kernels.linalg.small_systems import principal_axes


def box_about(points: Floats) -> Floats:
    """Return the lower and upper corner of the box about points, shape (n, 3), n >= 1; shape (2, 3)."""
    columns = [points[:, axis] for axis in range(3)]  # one by one, which takes NumPy a fifth of the time
    return np.array([[column.min() for column in columns], [column.max() for column in columns]])


def extents(points: Floats) -> Floats:
    """Return the extents along each axis of points, shape (n, 3), n >= 1; shape (3,)."""
    low, high = box_about(points)
    along: Floats = high - low
    return along


Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Surface(NamedTuple):
    """Triangles (t, 3), counter-clockwise from outside, over shared vertices (v, 3) [m]; read-only."""

    vertices: Floats
    triangles: Integers

    @property
    def area(self) -> float:
        """Area of all triangles [m^2]."""
        return area_of(self.corners)

    @property
    def corners(self) -> Floats:
        """Corners of every triangle, shape (t, 3, 3) [m]."""
        return self.vertices[self.triangles]


def area_of(corners: Floats) -> float:
    """Area of triangles with corners (n, 3, 3) [m^2]."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def surface(vertices: Floats, triangles: Integers) -> Surface:
    """Copy and freeze vertices (v, 3) [m] and triangles (t, 3)."""
    frozen = Surface(np.array(vertices, dtype=np.float64), np.array(triangles, dtype=np.int64).reshape(-1, 3))
    for array in frozen:
        array.setflags(write=False)
    return frozen


def box(size: ArrayLike) -> Surface:
    """Box about the origin with its edges along the axes; `size` is its full extents, shape (3,) [m]."""
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    halves = [half for a, b, c, d in quads for half in ((a, b, c), (a, c, d))]
    return surface(corners * np.asarray(size, dtype=np.float64), np.array(halves))


def cylinder(radius: float, length: float, sides: int = 24) -> Surface:
    """Prism that contains the cylinder along z about the origin: its sides touch it, its ends are the cylinder's."""
    ring = radius / np.cos(np.pi / sides)
    return _revolve([(0.0, -0.5 * length), (ring, -0.5 * length), (ring, 0.5 * length), (0.0, 0.5 * length)], sides)


def prism_quads(radius: float, length: float, sides: int = 24) -> Floats:
    """The faces of `cylinder` as quadrilaterals, each end in `sides`/2 - 1; shape (n, 4, 3) [m]; `sides` is even."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    circle = radius / np.cos(np.pi / sides) * np.column_stack([np.cos(angles), np.sin(angles)])
    low, high = (np.column_stack([circle, np.full(sides, z)]) for z in (-0.5 * length, 0.5 * length))
    around = np.stack([low, np.roll(low, -1, axis=0), np.roll(high, -1, axis=0), high], axis=1)
    fan = np.array([(0, i, i + 1, i + 2) for i in range(1, sides - 2, 2)])
    return np.concatenate([around, high[fan], low[fan][:, ::-1]])


def capsule(radius: float, length: float, sides: int = 24) -> Surface:
    """Capsule along z about the origin, its vertices on the capsule; `length` is that of its straight part [m]."""
    latitudes = np.linspace(0.0, 0.5 * np.pi, sides // 4 + 1)
    upper = [(radius * np.cos(angle), 0.5 * length + radius * np.sin(angle)) for angle in latitudes[:-1]]
    lower = [(rho, -z) for rho, z in reversed(upper)]
    pole = 0.5 * length + radius
    return _revolve([(0.0, -pole), *lower, *upper, (0.0, pole)], sides)


def sphere(radius: float, subdivisions: int = 2) -> Surface:
    """Sphere about the origin: an icosahedron, its triangles quartered `subdivisions` times, its vertices on it."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    flat = np.array([(0.0, s, t * golden) for s in (-1, 1) for t in (-1, 1)])
    vertices = np.concatenate([np.roll(flat, turn, axis=1) for turn in range(3)])
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    triangles = _icosahedron(vertices)
    for _ in range(subdivisions):
        vertices, triangles = _quarter(vertices, triangles)
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    return surface(radius * vertices, triangles)


def triangulate_polygon(corners: Floats, area: float) -> Integers:
    """Cut a counter-clockwise polygon (k, 2) of an area [m^2] in triangles (t, 3); ValueError if it crosses itself."""
    if len(corners) == 3:
        return np.array([[1, 2, 0]])
    triangles = mapbox_earcut.triangulate_float64(np.array(corners), np.array([len(corners)], np.uint32)).reshape(-1, 3)
    u, v = (corners[triangles[:, column]] - corners[triangles[:, 0]] for column in (1, 2))
    areas = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    # Ears of a polygon that crosses itself cover some of its plane twice or not at all.
    covered = float(np.abs(areas).sum())
    if abs(covered - area) > 1e-9 * area:
        raise ValueError(f"a polygon must not cross itself: it encloses {area} m^2, its triangles {covered} m^2")
    turned: Integers = np.where((areas < 0.0)[:, None], triangles[:, ::-1], triangles).astype(np.int64)
    return turned


def _revolve(profile: list[tuple[float, float]], sides: int) -> Surface:
    """Surface of a profile (rho, z) that starts and ends on the z axis and runs upwards outside."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    rings = [np.column_stack([rho * circle, np.full(sides, z)]) for rho, z in profile[1:-1]]
    vertices = np.concatenate([*rings, [(0.0, 0.0, profile[0][1])], [(0.0, 0.0, profile[-1][1])]])
    bottom, top = len(vertices) - 2, len(vertices) - 1
    here = np.arange(sides)
    after = (here + 1) % sides
    triangles = [np.column_stack([np.full(sides, bottom), after, here])]
    for low, high in pairwise(sides * ring for ring in range(len(rings))):
        triangles.append(np.column_stack([low + here, low + after, high + after]))
        triangles.append(np.column_stack([low + here, high + after, high + here]))
    last = sides * (len(rings) - 1)
    triangles.append(np.column_stack([np.full(sides, top), last + here, last + after]))
    return surface(vertices, np.concatenate(triangles))


def _icosahedron(vertices: Floats) -> Integers:
    """The 20 triangles of an icosahedron's vertices: all triples at the edge's distance, turned outwards."""
    distances = np.linalg.norm(vertices[:, None] - vertices[None], axis=2)
    near = (distances > 0.0) & (distances < 1.01 * distances[distances > 0.0].min())
    triples = combinations(range(len(vertices)), 3)
    triangles = np.array([(i, j, k) for i, j, k in triples if near[i, j] and near[j, k] and near[k, i]])
    inward = np.linalg.det(vertices[triangles]) < 0.0
    return np.where(inward[:, None], triangles[:, ::-1], triangles)


def _quarter(vertices: Floats, triangles: Integers) -> tuple[Floats, Integers]:
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    unique, index = np.unique(edges, axis=0, return_inverse=True)
    middles = len(vertices) + index.reshape(3, -1)
    a, b, c = triangles.T
    ab, bc, ca = middles
    split = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    quarters = np.concatenate([np.column_stack(quarter) for quarter in split])
    return np.concatenate([vertices, vertices[unique].mean(axis=1)]), quarters


def perpendicular_axes(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two unit vectors, shape (2, 3), that make a right-handed frame with a unit vector, shape (3,)."""
    first = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(direction, first)])


def spread_directions(count: int) -> Floats:
    """Unit vectors spread over all directions along a spiral from pole to pole, shape (count, 3)."""
    k = np.arange(count)
    heights, turns = 1.0 - (2.0 * k + 1.0) / count, k * np.pi * (3.0 - np.sqrt(5.0))
    radii = np.sqrt(1.0 - heights**2)
    return np.column_stack([radii * np.cos(turns), radii * np.sin(turns), heights])


def spread_and_axes(offsets: Floats) -> tuple[Floats, Floats]:
    """Singular values (3,) and right singular vectors (3, 3), one in each row, of points (n, 3); the largest first."""
    spread, axes = np.empty(3), np.empty((3, 3))
    principal_axes(np.array(offsets, dtype=np.float64, order="C"), spread, axes)
    return spread, axes


def furthest(points: Floats, directions: Floats) -> Integers:
    """Which of points (n, 3) is furthest in each of some directions (d, 3), shape (d,)."""
    found = np.empty(len(directions), np.int64)
    furthest_along(np.ascontiguousarray(points), np.ascontiguousarray(directions.T), found)
    return found


def heights_along(points: Floats, axis: Floats) -> Floats:
    """How far points (.., 3) are along an axis (3,), shape (..)."""
    x, y, z = axis.tolist()
    heights: Floats = x * points[..., 0] + y * points[..., 1] + z * points[..., 2]
    return heights


def se3(position: Sequence[float], quaternion_xyzw: Sequence[float]) -> Any:
    """Return the pinocchio.SE3 of a position (3,) [m] and a quaternion (x, y, z, w), shape (4,), near unit length."""
    return pin.XYZQUATToSE3([*position, *unit(quaternion_xyzw)])


def wire_pose(placement: Any) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    """Return the position [m] and the quaternion (x, y, z, w) of a placement, pinocchio.SE3."""
    x, y, z, a, b, c, d = pin.SE3ToXYZQUAT(placement).tolist()
    return (x, y, z), (a, b, c, d)


def unit(quaternion_xyzw: Sequence[float]) -> tuple[float, float, float, float]:
    """Normalize a quaternion (x, y, z, w)."""
    x, y, z, w = quaternion_xyzw
    norm = math.hypot(x, y, z, w)
    return x / norm, y / norm, z / norm, w / norm


def frames(positions: np.ndarray, quaternions_xyzw: np.ndarray) -> np.ndarray:
    """Return rotation and translation as flat 3 x 4 matrices, (n, 12), of positions (n, 3) and quaternions (n, 4)."""
    x, y, z, w = (quaternions_xyzw / np.linalg.norm(quaternions_xyzw, axis=1, keepdims=True)).T
    columns = (
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w), positions[:, 0],
        2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w), positions[:, 1],
        2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y), positions[:, 2],
    )  # fmt: skip
    return np.column_stack(columns)


def transform_points(placement: Any, points: np.ndarray) -> np.ndarray:
    """Return points (n, 3) of a body in the world [m], where a pinocchio.SE3 places the body."""
    # by this sum, not by `@`: for three columns BLAS takes ten times as long
    there: np.ndarray = np.einsum("nj,ij->ni", points, placement.rotation) + placement.translation
    return there
