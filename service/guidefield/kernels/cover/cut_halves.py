"""Halves of a surface on either side of planes across an axis: cut triangles, and the points furthest out.

Each plane has two halves: below it, then above. Sums of halves keep their order: their last bits choose convex pieces
(`geometry/decomposition.py`). Those of `not_beyond` and `beyond_any` vary by machine: the latter's order vertices.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.jit.arrays import (
    Blocks,
    BlocksOut,
    Floats,
    Indices,
    IndicesOut,
    Integers,
    Row,
    Rows,
    RowsOut,
    TruthsOut,
)
from guidefield.kernels.jit.decorators import exact_kernel, exact_part, kernel
from guidefield.kernels.simd.packing import fused


@kernel
def not_beyond(corners: Rows, planes: Rows, rounding: float, kept_out: TruthsOut) -> None:
    """Write for each triangle whether no plane has all of it beyond, (t,).

    `corners` (3 t, 3) are those of the triangles one after the other [m], `planes` (m, 4) unit normals n and offsets d:
    beyond is n.x > d + `rounding` [m].
    """
    for t in range(kept_out.shape[0]):
        kept = True
        for m in range(planes.shape[0]):
            x, y, z, least = planes[m, 0], planes[m, 1], planes[m, 2], planes[m, 3] + rounding
            beyond = True
            for k in range(3 * t, 3 * t + 3):
                beyond &= corners[k, 0] * x + corners[k, 1] * y + corners[k, 2] * z > least
            if beyond:
                kept = False
                break
        kept_out[t] = kept


@kernel
def beyond_any(points: Rows, planes: Rows, rounding: float, beyond_out: TruthsOut) -> None:
    """Write for each of `points` (n, 3) [m] whether any of `planes` (m, 4) has it beyond, as in `not_beyond`; (n,)."""
    for i in range(beyond_out.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        beyond = False
        for m in range(planes.shape[0]):
            if x * planes[m, 0] + y * planes[m, 1] + z * planes[m, 2] > planes[m, 3] + rounding:
                beyond = True
                break
        beyond_out[i] = beyond


CORNERS = 3  # of a triangle


@exact_part
def _is_across(along: Floats, t: int, place: float) -> bool:
    """Tell if a plane meets triangle t, which isn't within a plane across the axis."""
    low, high = min(along[t, 0], along[t, 1], along[t, 2]), max(along[t, 0], along[t, 1], along[t, 2])
    across: bool = low <= place <= high and low < high
    return across


@exact_part
def _below(along: Floats, t: int, side: float, place: float) -> int:
    """Number of corners of triangle t in the half on a side of a plane."""
    count = 0
    for k in range(CORNERS):
        count += 1 if side * (along[t, k] - place) <= 0.0 else 0
    return count


@exact_kernel
def count_cut(along: Rows, places: Row) -> int:
    """Return the number of `cut_halves`' points: corners at `along` (t, 3) on the axis, planes at `places` (n,) [m]."""
    count = 0
    for place in places:
        for t in range(along.shape[0]):
            if _is_across(along, t, place):
                for side in (1.0, -1.0):
                    below = _below(along, t, side, place)
                    count += CORNERS * (2 if below == 2 else 1 if below > 0 else 0)
    return count


@exact_part
def _cut(corners: Floats, along: Floats, t: int, i: int, j: int, place: float, point_out: Floats) -> None:
    """The point at which the edge from corner i, in the half, to corner j of triangle t meets a plane."""
    here, there = along[t, i] - place, along[t, j] - place
    for k in range(3):
        point_out[k] = corners[t, i, k] + here / (here - there) * (corners[t, j, k] - corners[t, i, k])


@exact_kernel
def cut_halves(corners: Blocks, along: Rows, places: Row, points_out: RowsOut, first_out: IndicesOut) -> None:
    """Write the corners (k, 3) of what each half has of the triangles (t, 3, 3) that its plane meets [m].

    `along` (t, 3) is where corners are along the axis, `places` (n,) where the planes are, `first_out` (2 n + 1,) gets
    where the points of each half begin; k is `count_cut`.
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


@exact_part
def _further(x: float, y: float, z: float, directions: Floats, i: int, best_out: Floats, which_out: Integers) -> None:
    """Take in point i, where it is further in a direction than those before; `directions` has shape (3, d)."""
    for d in range(directions.shape[1]):
        height = fused(z, directions[2, d], fused(y, directions[1, d], x * directions[0, d]))
        which_out[d] = i if height > best_out[d] else which_out[d]
        best_out[d] = max(best_out[d], height)


@exact_kernel
def furthest_out(
    points: Rows,
    along: Row,
    cut: Rows,
    first: Indices,
    places: Row,
    directions: Rows,
    origins_out: RowsOut,
    furthest_out: BlocksOut,
) -> None:
    """Write the points of each half that are furthest in `directions` (3, d), of several the first: (2 n, d, 3) [m].

    `points` (m, 3) stand at `along` (m,), `cut` (k, 3) and `first` (2 n + 1,) are those of `cut_halves`. The first
    point of each half (2 n, 3) is not a number where it has none.
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


@exact_kernel
def furthest_along(points: Rows, directions: Rows, which_out: IndicesOut) -> None:
    """Write which of `points` (m, 3) [m] is furthest in each of `directions` (3, d) (d,), of several the first."""
    best = np.full(directions.shape[1], -math.inf)
    which_out[:] = 0
    for i in range(points.shape[0]):
        _further(points[i, 0], points[i, 1], points[i, 2], directions, i, best, which_out)
