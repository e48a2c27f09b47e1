"""Cracks of a surface of triangles: corners that nearly coincide are found, and thin lids put between them."""

from __future__ import annotations

import itertools

import numpy as np

from guidefield.geometry.closed import boundary, connected_pieces
from guidefield.geometry.edges import numbered_edges
from guidefield.geometry.surfaces import Floats, Integers

WIDEST_CRACK = 1e-3
"""Corners at most so far apart along each axis may be one [m]: the sides of a box about those that should be."""

_STEPS = 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 0.17, 0.3, 0.55, 1.0
"""Widths that are tried, as shares of the widest: the corners of small triangles must not be taken for one."""


def seams(
    vertices: Floats, triangles: Integers, widest: float = WIDEST_CRACK, numbered: tuple[Integers, int] | None = None
) -> tuple[Integers, float]:
    """Which corners along the edges of a surface should be one, so that no edge is left that is one triangle's only.

    Args:
        vertices: Shape (v, 3) [m], no two at one place.
        triangles: Shape (t, 3), each with three different vertices.
        widest: How far apart along each axis corners may be that should be one [m].
        numbered: What `numbered_edges` found, if it is at hand.

    Returns:
        For each vertex the one that it should be, shape (v,), itself where it is none of those; and the width of the
        widest crack [m], the diagonal of the box about its corners. Where the surface has no such edge, or joining
        leaves some, each is itself and the width 0.
    """
    alone = np.arange(len(vertices))
    loose = _loose(triangles, numbered or numbered_edges(triangles))
    if not len(loose) or widest <= 0.0:
        return alone, 0.0
    open_ = np.zeros(len(vertices), bool)
    open_[loose] = True
    near = triangles[open_[triangles].any(axis=1)]  # joining changes no edge but those of these
    for width in widest * np.array(_STEPS):
        joined, widths = alone.copy(), np.zeros(1)
        joined[loose], widths = _join_points(vertices[loose], loose, float(width))
        welded = joined[near]
        welded = welded[are_proper(welded)]
        if not len(_loose(welded, numbered_edges(welded), open_)):
            return joined, float(widths.max())
    return alone, 0.0


def crack_lids(triangles: Integers, joined: Integers) -> Integers:
    """Triangles between the edges of a surface and the edges that they should be: what is left of its boundary cancels.

    No triangle is moved; a lid reaches no further from an edge than the crack is wide. Where the joined surface is
    closed, so is this one with its lids.

    Args:
        triangles: Shape (t, 3).
        joined: For each vertex the one that it should be, shape (v,), as of `seams`.

    Returns:
        The lids, shape (n, 3).
    """
    start, end = boundary(triangles).T
    lids = np.concatenate(
        [np.column_stack([end, start, joined[start]]), np.column_stack([end, joined[start], joined[end]])]
    )
    kept: Integers = lids[are_proper(lids)]
    return kept


def are_proper(triangles: Integers) -> np.ndarray:
    """Which triangles (t, 3) have three different vertices, shape (t,)."""
    a, b, c = triangles.T
    proper: np.ndarray = (a != b) & (b != c) & (c != a)
    return proper


def _loose(triangles: Integers, numbered: tuple[Integers, int], among: np.ndarray | None = None) -> Integers:
    """Vertices of the edges that are one triangle's only, ascending, shape (n,).

    Args:
        triangles: Shape (t, 3).
        numbered: Their edges.
        among: Only edges with one of these vertices count, shape (v,), bool; None: all do.
    """
    numbers, edges = numbered
    alone = np.bincount(numbers, minlength=edges) == 1
    if not alone.any():
        return np.empty(0, np.int64)
    sides = np.flatnonzero(alone[numbers])
    start, end = triangles.ravel()[sides], triangles[sides // 3, (sides + 1) % 3]
    if among is not None:
        counted = among[start] | among[end]
        start, end = start[counted], end[counted]
    return np.unique(np.concatenate([start, end]))


def _join_points(points: Floats, indices: Integers, width: float) -> tuple[Integers, Floats]:
    """For each point of some the index of the first of those it should be, its own if they don't fit in the width.

    Points that are at most `width` apart share a cell of twice the width in one of eight grids.
    """
    near = []
    for shift in itertools.product((0.0, 0.5), repeat=3):
        cells = np.floor(points / (2.0 * width) + shift)
        order = np.lexsort(cells.T)
        same = (cells[order][1:] == cells[order][:-1]).all(axis=1)
        near.append(np.column_stack([order[:-1], order[1:]])[same])
    labels = connected_pieces(len(points), np.concatenate(near))
    low, high = np.full((len(points), 3), np.inf), np.full((len(points), 3), -np.inf)
    np.minimum.at(low, labels, points)
    np.maximum.at(high, labels, points)
    sides = high[labels] - low[labels]
    fit = (sides <= width).all(axis=1)
    return np.where(fit, indices[labels], indices), np.where(fit, np.linalg.norm(sides, axis=1), 0.0)
