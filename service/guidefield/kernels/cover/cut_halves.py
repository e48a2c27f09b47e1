"""What planes across an axis leave of a surface on either side: cut triangles, and the points furthest out.

Each plane has two halves: of what is below it, then of what is above. All sums keep their order.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types, void

from guidefield.kernels.jit.compilers import part
from guidefield.kernels.jit.signatures import (
    BLOCKS,
    BLOCKS_OUT,
    INDICES,
    INDICES_OUT,
    MATRIX,
    MATRIX_OUT,
    VECTOR,
    Floats,
    Integers,
    exact_kernel,
)
from guidefield.kernels.simd.fused import fused

CORNERS = 3


@part
def _is_across(along: Floats, t: int, place: float) -> bool:
    """Whether a plane meets triangle t, which isn't within a plane across the axis."""
    low, high = min(along[t, 0], along[t, 1], along[t, 2]), max(along[t, 0], along[t, 1], along[t, 2])
    across: bool = low <= place <= high and low < high
    return across


@part
def _below(along: Floats, t: int, side: float, place: float) -> int:
    """How many corners of triangle t are in the half on a side of a plane."""
    count = 0
    for k in range(CORNERS):
        count += 1 if side * (along[t, k] - place) <= 0.0 else 0
    return count


@exact_kernel(types.int64(MATRIX, VECTOR))
def count_cut(along: Floats, places: Floats) -> int:
    """How many points `cut_halves` makes.

    Args:
        along: Where the triangles' corners are along the axis, shape (t, 3) [m].
        places: Where the planes are, shape (n,) [m].
    """
    count = 0
    for place in places:
        for t in range(along.shape[0]):
            if _is_across(along, t, place):
                for side in (1.0, -1.0):
                    below = _below(along, t, side, place)
                    count += CORNERS * (2 if below == 2 else 1 if below > 0 else 0)
    return count


@part
def _cut(corners: Floats, along: Floats, t: int, i: int, j: int, place: float, point_out: Floats) -> None:
    """The point at which the edge from corner i, in the half, to corner j of triangle t meets a plane."""
    here, there = along[t, i] - place, along[t, j] - place
    for k in range(3):
        point_out[k] = corners[t, i, k] + here / (here - there) * (corners[t, j, k] - corners[t, i, k])


@exact_kernel(void(BLOCKS, MATRIX, VECTOR, MATRIX_OUT, INDICES_OUT))
def cut_halves(corners: Floats, along: Floats, places: Floats, points_out: Floats, first_out: Integers) -> None:
    """Cut the triangles that planes go through.

    Args:
        corners: Of triangles, shape (t, 3, 3) [m].
        along: Where these are along the axis, shape (t, 3) [m].
        places: Where the planes are, shape (n,) [m].
        points_out: Gets the corners of what each half has of the triangles that its plane meets, as many as
            `count_cut` says; shape (k, 3).
        first_out: Gets where those of each half begin, and k; shape (2 n + 1,).
    """
    at = half = 0
    for place in places:
        for side in (1.0, -1.0):
            first_out[half] = at
            half += 1
            # whole triangles, then those with one corner in the half, then the two that are left where two are
            for turn in range(4):
                wanted = (3, 1, 2, 2)[turn]
                for t in range(along.shape[0]):
                    if not _is_across(along, t, place) or _below(along, t, side, place) != wanted:
                        continue
                    if wanted == CORNERS:
                        points_out[at : at + CORNERS] = corners[t]
                        at += CORNERS
                        continue
                    a = 0
                    while (side * (along[t, a] - place) <= 0.0) != (wanted == 1):
                        a += 1
                    b, c = (a + 1) % CORNERS, (a + 2) % CORNERS
                    if turn == 1:
                        points_out[at] = corners[t, a]
                        _cut(corners, along, t, a, b, place, points_out[at + 1])
                        _cut(corners, along, t, a, c, place, points_out[at + 2])
                    else:
                        _cut(corners, along, t, b, a, place, points_out[at])
                        points_out[at + 1] = corners[t, b] if turn == 2 else corners[t, c]
                        if turn == 2:
                            points_out[at + 2] = corners[t, c]
                        else:
                            _cut(corners, along, t, c, a, place, points_out[at + 2])
                    at += CORNERS
    first_out[half] = at


@part
def _further(x: float, y: float, z: float, directions: Floats, i: int, best_out: Floats, which_out: Integers) -> None:
    """Take in point i, where it is further in a direction than those before; `directions` has shape (3, d)."""
    for d in range(directions.shape[1]):
        height = fused(z, directions[2, d], fused(y, directions[1, d], x * directions[0, d]))
        which_out[d] = i if height > best_out[d] else which_out[d]
        best_out[d] = max(best_out[d], height)


@exact_kernel(void(MATRIX, VECTOR, MATRIX, INDICES, VECTOR, MATRIX, MATRIX_OUT, BLOCKS_OUT))
def furthest_out(
    points: Floats,
    along: Floats,
    cut: Floats,
    first: Integers,
    places: Floats,
    directions: Floats,
    origins_out: Floats,
    furthest_out: Floats,
) -> None:
    """Find the points of each half that are furthest in some directions; of several the first.

    Args:
        points: Shape (m, 3) [m].
        along: Where they are along the axis, shape (m,) [m].
        cut: Points of the cut triangles, as of `cut_halves`, shape (k, 3) [m].
        first: Where those of each half begin, shape (2 n + 1,).
        places: Where the planes are, shape (n,) [m].
        directions: Shape (3, d).
        origins_out: Gets the first point of each half, shape (2 n, 3) [m]; not a number where it has none.
        furthest_out: Gets the furthest ones, shape (2 n, d, 3) [m].
    """
    best, which = np.empty(directions.shape[1]), np.empty(directions.shape[1], np.int64)
    for half in range(origins_out.shape[0]):
        side, place = 1.0 - 2.0 * (half & 1), places[half >> 1]
        best[:], which[:] = -math.inf, -1
        origins_out[half] = math.nan
        if first[half] < first[half + 1]:
            origins_out[half] = cut[first[half]]
        for i in range(points.shape[0] - 1, -1, -1):
            if side * (along[i] - place) < 0.0:
                origins_out[half] = points[i]
        for i in range(points.shape[0]):
            if side * (along[i] - place) < 0.0:
                _further(points[i, 0], points[i, 1], points[i, 2], directions, i, best, which)
        for i in range(first[half], first[half + 1]):
            _further(cut[i, 0], cut[i, 1], cut[i, 2], directions, points.shape[0] + i, best, which)
        for d in range(directions.shape[1]):
            i = which[d]
            if i >= 0:
                furthest_out[half, d] = points[i] if i < points.shape[0] else cut[i - points.shape[0]]


@exact_kernel(void(MATRIX, MATRIX, INDICES_OUT))
def furthest_along(points: Floats, directions: Floats, which_out: Integers) -> None:
    """Find the points that are furthest in some directions; of several the first.

    Args:
        points: Shape (m, 3) [m].
        directions: Shape (3, d).
        which_out: Gets the points' places, shape (d,).
    """
    best = np.full(directions.shape[1], -math.inf)
    which_out[:] = 0
    for i in range(points.shape[0]):
        _further(points[i, 0], points[i, 1], points[i, 2], directions, i, best, which_out)
