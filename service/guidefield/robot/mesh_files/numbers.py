"""Helpers for readers of mesh files: checked numbers, polygons cut into triangles, instances placed.

Files are untrusted: limits here bound what a reader collects. Messages of `MeshFault` continue a sentence that begins
with the file's name.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mapbox_earcut
import numpy as np

MAX_TRIANGLES = 20_000_000
"""A file with nodes (COLLADA, glTF, 3MF) of more triangles, instances counted, is refused: nested instances can double
with each level. Those of other kinds are bounded by the file's size."""

MAX_DEPTH = 1_000  # a deeper nesting of nodes is refused
MAX_NODES = 100_000  # a file of more nodes, instances counted, is refused

AREA_TOLERANCE = 1e-9  # triangles fill a simple polygon to this share of its area


def triangulate(vertices: np.ndarray, corners: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Cut polygons into triangles (t, 3) that turn as they do; those of fewer than three corners are left out.

    A quadrilateral is cut at its reflex corner, else between its first and third corner. A larger convex polygon is a
    fan about its first corner, another one is cut into ears; one that crosses itself is a fan.

    Args:
        vertices: Shape (v, 3).
        corners: Vertices of all polygons, one polygon after the other, shape (c,).
        sizes: Number of corners of each polygon, shape (p,).
    """
    if len(corners) == 3 * len(sizes) and (sizes == 3).all():
        return corners.reshape(-1, 3)
    starts = np.cumsum(sizes) - sizes
    places = np.cumsum(np.maximum(sizes - 2, 0)) - np.maximum(sizes - 2, 0)
    triangles = np.empty((int(np.maximum(sizes - 2, 0).sum()), 3), np.int64)
    three, four = np.flatnonzero(sizes == 3), np.flatnonzero(sizes == 4)
    triangles[places[three]] = corners[starts[three, None] + np.arange(3)]
    halves = _halve(vertices, corners[starts[four, None] + np.arange(4)])
    triangles[places[four]], triangles[places[four] + 1] = halves[:, 0], halves[:, 1]
    for index in np.flatnonzero(sizes > 4).tolist():
        polygon = corners[starts[index] : starts[index] + sizes[index]]
        place = places[index]
        triangles[place : place + sizes[index] - 2] = polygon[_cut(vertices[polygon])]
    return triangles


def triangulate_with_holes(vertices: np.ndarray, rings: Sequence[np.ndarray]) -> np.ndarray:
    """Cut a polygon of vertices (v, 3), given by its outline and holes, into triangles (t, 3) that turn like it."""
    corners = np.concatenate(rings)
    flat, _ = _flatten(vertices[corners], len(rings[0]))
    ears = _ears(flat, np.cumsum([len(ring) for ring in rings]))
    found: np.ndarray = corners[ears]
    return found


def _halve(vertices: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Cut each quadrilateral (q, 4) into two triangles, shape (q, 2, 3)."""
    points = vertices[quads]
    normal = np.cross(points[:, 2] - points[:, 0], points[:, 3] - points[:, 1])
    behind, before = points - np.roll(points, 1, axis=1), np.roll(points, -1, axis=1) - points
    reflex = np.einsum("qki,qi->qk", np.cross(behind, before), normal) < 0.0
    other = reflex[:, 1] | reflex[:, 3]
    first, second = np.where(other[:, None], [1, 2, 3], [0, 1, 2]), np.where(other[:, None], [1, 3, 0], [0, 2, 3])
    cut: np.ndarray = np.stack([np.take_along_axis(quads, each, 1) for each in (first, second)], axis=1)
    return cut


def _cut(points: np.ndarray) -> np.ndarray:
    """Cut one polygon (n, 3) into triangles, as indices of its corners, shape (n - 2, 3)."""
    count = len(points)
    fan = np.column_stack([np.zeros(count - 2, np.int64), np.arange(1, count - 1), np.arange(2, count)])
    flat, area = _flatten(points, count)
    turns = _cross(flat - np.roll(flat, 1, axis=0), np.roll(flat, -1, axis=0) - flat)
    if (turns >= 0.0).all():
        return fan
    ears = _ears(flat, np.array([count]))
    filled = float(np.abs(_twice_areas(flat[ears])).sum())
    return ears if len(ears) == count - 2 and abs(filled - 2.0 * area) <= 2.0 * AREA_TOLERANCE * area else fan


def _flatten(points: np.ndarray, outline: int) -> tuple[np.ndarray, float]:
    """Project points onto the plane of the first `outline` ones, counter-clockwise then; return also their area."""
    centred = points - points[0]
    ring = centred[:outline]
    normal = 0.5 * np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0)
    area = float(np.linalg.norm(normal))
    if area == 0.0:
        return centred[:, :2], 0.0
    first = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(normal / area, first)
    first /= np.linalg.norm(first)
    second = np.cross(normal / area, first)
    return centred @ np.column_stack([first, second]), area


def _ears(flat: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Cut a polygon in the plane into counter-clockwise triangles, shape (t, 3); `ends` are those of its rings."""
    found = mapbox_earcut.triangulate_float64(np.ascontiguousarray(flat), ends.astype(np.uint32))
    triangles = found.reshape(-1, 3).astype(np.int64)
    turned: np.ndarray = np.where((_twice_areas(flat[triangles]) < 0.0)[:, None], triangles[:, ::-1], triangles)
    return turned


def _twice_areas(corners: np.ndarray) -> np.ndarray:
    return _cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    product: np.ndarray = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return product


class MeshFault(ValueError):
    """A mesh file can't be read; its message continues a sentence that begins with the file's name."""


Triangles = tuple[np.ndarray, np.ndarray]
"""Vertices (v, 3) [m, the file's frame] and the triangles (t, 3) between them, as the file has them."""


class Objects(NamedTuple):
    """Vertices (v, 3) [m] and triangles (t, 3) of a mesh file, and the name and first triangle of each object."""

    vertices: np.ndarray
    triangles: np.ndarray
    firsts: tuple[tuple[str, int], ...] = ()


def triangulate_strip(corners: np.ndarray) -> np.ndarray:
    """Return the triangles (t, 3) of a strip of corners (n,), every second one turned round."""
    rows = np.column_stack([corners[:-2], corners[1:-1], corners[2:]])
    rows[1::2] = rows[1::2, ::-1]
    return rows


def floats(text: bytes, what: str) -> np.ndarray:
    """Return the numbers of a text that blanks separate, shape (n,); MeshFault if a word isn't a number."""
    words = text.split()
    try:
        values = np.fromstring(text, np.float64, sep=" ") if words else np.empty(0)
        return values if len(values) == len(words) else np.array(words, np.float64)
    except (ValueError, DeprecationWarning):
        wrong = next(word for word in words if not _is_number(word))
        raise MeshFault(
            f"has {wrong[:40].decode(errors='replace')!r} among its {what}, which is not a number"
        ) from None


def integers(text: bytes, what: str) -> np.ndarray:
    """Return the whole numbers of a text, shape (n,); arguments and errors are those of `floats`."""
    values = floats(text, what)
    if not (np.isfinite(values).all() and (values == np.floor(values)).all() and (np.abs(values) < 2.0**53).all()):
        raise MeshFault(f"has a number among its {what} that is not whole")
    return values.astype(np.int64)


def check_indices(indices: np.ndarray, count: int) -> None:
    """Check that indices, shape (n,), are below a count; MeshFault if not."""
    if len(indices) and not (indices.min() >= 0 and indices.max() < count):
        wrong = int(indices.min()) if indices.min() < 0 else int(indices.max())
        raise MeshFault(f"has a face with the vertex {wrong} (counted from 0), but only {count} vertices")


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


class Collected:
    """Triangles of instances, one after the other."""

    def __init__(self) -> None:
        self._vertices: list[np.ndarray] = []
        self._triangles: list[np.ndarray] = []
        self._firsts: list[tuple[str, int]] = []
        self._count = self._total = self._nodes = 0

    def visit(self, depth: int, name: str = "") -> None:
        """Count a node; what is added until the next one is an object of its name. MeshFault beyond the limits."""
        self._nodes += 1
        if depth > MAX_DEPTH:
            raise MeshFault(f"has nodes that are nested more than {MAX_DEPTH} deep, or contain themselves")
        if self._nodes > MAX_NODES:
            raise MeshFault(f"has more than {MAX_NODES} nodes, instances counted")
        self._firsts.append((name, self._total))

    def add(self, mesh: Triangles, placement: np.ndarray) -> None:
        """Add a mesh by an affine map (4, 4); one that mirrors it turns its triangles. MeshFault beyond a limit."""
        vertices, triangles = mesh
        self._total += len(triangles)
        if self._total > MAX_TRIANGLES:
            raise MeshFault(f"has more than {MAX_TRIANGLES} triangles, instances counted")
        if (placement != np.eye(4)).any():
            vertices = vertices @ placement[:3, :3].T + placement[:3, 3]
        if np.linalg.det(placement[:3, :3]) < 0.0:
            triangles = triangles[:, ::-1]
        self._vertices.append(vertices)
        self._triangles.append(triangles + self._count)
        self._count += len(vertices)

    def triangles(self) -> Triangles:
        """Return all instances as one mesh."""
        if not self._vertices:
            return np.empty((0, 3)), np.empty((0, 3), np.int64)
        return np.concatenate(self._vertices), np.concatenate(self._triangles)

    def objects(self) -> Objects:
        """Return all instances, those of each node as an object."""
        return Objects(*self.triangles(), tuple(self._firsts))
