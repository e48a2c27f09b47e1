"""Closed surfaces of triangles: vertices merged, gaps found and closed, pieces told apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from guidefield.geometry.edges import edge_counts, numbered_edges
from guidefield.geometry.surfaces import Floats, Integers
from guidefield.kernels.cover.connected import lowest_connected
from guidefield.kernels.cover.merge_points import merge_points
from guidefield.kernels.cover.signed_volume import signed_volume


def compact(vertices: Floats, triangles: Integers) -> tuple[Floats, Integers, Integers]:
    """Merge vertices at the same place, and leave out what is too much then.

    Args:
        vertices: Shape (v, 3) [m], in any frame.
        triangles: Indices of vertices, shape (t, 3).

    Returns:
        Vertices that triangles use, shape (w, 3); triangles with three different ones, shape (u, 3); which of the given
        ones each is, shape (u,).

    Raises:
        ValueError: if a vertex is not finite.
    """
    vertices = np.asarray(vertices, dtype=np.float64) + 0.0  # so that 0 and -0 are the same place
    if not np.isfinite(vertices).all():
        raise ValueError("`vertices` must be finite")
    first, index = merged_points(vertices)
    merged = vertices[first]
    corners = np.take(index, np.asarray(triangles, dtype=np.int64).reshape(-1, 3))
    a, b, c = corners.T
    proper = (a != b) & (b != c) & (c != a)
    kept = np.flatnonzero(proper)
    return *used_alone(merged, corners if len(kept) == len(corners) else corners[kept]), kept


def merged_points(points: Floats) -> tuple[Integers, Integers]:
    """Merge points at the same place; 0 and -0 are the same.

    Args:
        points: Shape (n, 3) [m], all finite.

    Returns:
        The first point of each place, ascending, shape (k,); the place of each point among these, shape (n,).
    """
    words = (np.ascontiguousarray(points, np.float64) + 0.0).view(np.uint64).reshape(-1, 3)
    place, first = np.empty(len(words), np.int64), np.empty(len(words), np.int64)
    count = merge_points(words, place, first)
    return first[:count], place


def used_alone(vertices: Floats, triangles: Integers) -> tuple[Floats, Integers]:
    """The vertices (v, 3) that triangles (t, 3) use, in their order, and the triangles of these."""
    used = np.zeros(len(vertices), bool)
    used[triangles] = True
    if used.all():
        return vertices, triangles
    return vertices[used], np.take(np.cumsum(used) - 1, triangles)


def closing_lids(vertices: Floats, triangles: Integers) -> tuple[Integers, float]:
    """Triangles that close a surface: a fan for each connected part of its boundary.

    The boundary are the edges that are run through more often in one direction than in the other. It has no boundary
    itself: what comes to a vertex leaves it. So the sides of a fan cancel, whatever its apex.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3), each with three different vertices.

    Returns:
        The lids, shape (n, 3), and the largest extent of a part of the boundary [m]; 0 if the surface is closed.
    """
    edges = boundary(triangles)
    if not len(edges):
        return np.empty((0, 3), np.int64), 0.0
    used, local = np.unique(edges, return_inverse=True)
    labels = connected_pieces(len(used), local.reshape(-1, 2))
    fans = np.column_stack([used[labels[local.reshape(-1, 2)[:, 0]]], edges[:, 1], edges[:, 0]])
    low, high = np.full((len(used), 3), np.inf), np.full((len(used), 3), -np.inf)
    np.minimum.at(low, labels, vertices[used])
    np.maximum.at(high, labels, vertices[used])
    parts = np.unique(labels)
    extent = float(np.linalg.norm(high[parts] - low[parts], axis=1).max())
    return fans[(fans[:, 0] != fans[:, 1]) & (fans[:, 0] != fans[:, 2])], extent


def connected_pieces(count: int, simplices: Integers) -> Integers:
    """For each of `count` vertices the lowest one that edges or triangles (n, k) connect it to, shape (count,)."""
    labels = np.empty(count, np.int64)
    lowest_connected(np.ascontiguousarray(simplices, np.int64), labels)
    return labels


def volume(vertices: Floats, triangles: Integers) -> float:
    """Volume within a closed surface [m^3]; negative if its triangles run clockwise from outside.

    Args:
        vertices: Shape (v, 3) [m], in any frame.
        triangles: Indices of vertices, shape (t, 3).
    """
    return volumes(vertices, [triangles])[0]


def volumes(vertices: Floats, pieces: Sequence[Integers]) -> list[float]:
    """The same of several closed surfaces that share vertices.

    Args:
        vertices: Shape (v, 3) [m], in any frame.
        pieces: Indices of vertices of each, shape (t, 3).
    """
    vertices = np.ascontiguousarray(vertices, float)
    about = vertices.mean(axis=0)
    return [float(signed_volume(vertices, np.ascontiguousarray(one, np.int64), about)) for one in pieces]


def boundary(triangles: Integers) -> Integers:
    """Edges of the boundary, as often as they are run through more this way than the other.

    Args:
        triangles: Indices of vertices, shape (t, 3).

    Returns:
        First and second vertex of each, shape (n, 2).
    """
    numbered = numbers, count = numbered_edges(triangles)
    up, down = edge_counts(triangles, numbered)
    surplus = up - down
    sides = np.flatnonzero(surplus[numbers])
    start, end = triangles.ravel()[sides], triangles[sides // 3, (sides + 1) % 3]
    low, high = np.zeros(count, np.int64), np.zeros(count, np.int64)
    low[numbers[sides]], high[numbers[sides]] = np.minimum(start, end), np.maximum(start, end)
    forward = np.where(surplus > 0, low, high), np.where(surplus > 0, high, low)
    edges_of_it: Integers = np.repeat(np.column_stack(forward), np.abs(surplus), axis=0)
    return edges_of_it
