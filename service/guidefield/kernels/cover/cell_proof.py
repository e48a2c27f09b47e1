"""Whether balls contain all of a body's inside: a box about it is halved, again and again, until all is decided."""

from __future__ import annotations

import math

import numpy as np
from numba import types

from guidefield.kernels.cover.inscribed import SPANS, gap_to, is_inside, no_further
from guidefield.kernels.distance.triangle_distance import SURFACES, SurfaceTables
from guidefield.kernels.jit.signatures import MATRIX, MATRIX_OUT, SCALAR, Floats, compiled, inlined

FINENESS = 0.1
"""A cell within the body that is in no single ball is given up when its half size is this share of its depth."""

FINEST = 0.25
"""The same next to the surface, as a share of the margin."""

_STACK = 8 * 64
_DIAGONAL = math.sqrt(3.0)


@inlined
def _in_ball(x: float, y: float, z: float, half: float, balls: Floats, i: int) -> bool:
    """Whether ball i contains the cube of half size `half` about a point."""
    dx, dy, dz = abs(x - balls[i, 0]) + half, abs(y - balls[i, 1]) + half, abs(z - balls[i, 2]) + half
    inside: bool = dx * dx + dy * dy + dz * dz <= balls[i, 3] * balls[i, 3]
    return inside


@inlined
def _halve(cell: Floats, inside: float, waiting: Floats, top: int) -> int:
    """Put the eight halves of a cell on the stack."""
    half = 0.5 * cell[3]
    for k in range(8):
        waiting[top, 0] = cell[0] + (half if k & 1 else -half)
        waiting[top, 1] = cell[1] + (half if k & 2 else -half)
        waiting[top, 2] = cell[2] + (half if k & 4 else -half)
        waiting[top, 3] = half
        waiting[top, 4] = inside
        top += 1
    return top


@compiled(types.int64(MATRIX, MATRIX, SCALAR, SURFACES, SPANS, MATRIX_OUT))
def uncovered_cells(
    balls: Floats, box: Floats, margin: float, surfaces: SurfaceTables, spans: np.ndarray, cells_out: Floats
) -> int:
    """Cells of a body's inside that aren't known to be in the balls; if there are none, the balls contain the body.

    A cell is done with if it is in one ball, or wholly outside, or so close to the surface that it is within the margin
    by which the balls contain the surface. Every point of the body is in a cell that is done with or returned.

    Args:
        balls: Centre and radius, shape (n, 4), n >= 1 [m].
        box: One row: centre and half size of a cube that contains the body, shape (1, 4) [m].
        margin: Every point within this distance of the surface is in a ball [m], positive.
        surfaces: All surfaces.
        spans: Where the trees of the body's solids stand, shape (k, 4).
        cells_out: Gets centre, half size and depth of the cells, shape (m, 5) [m].

    Returns:
        How many; if as many as there is room for, there may be more.
    """
    waiting = np.zeros((_STACK, 5))
    waiting[0, :4] = box[0]
    top, count, last = 1, 0, 0
    cell, before = np.zeros(5), np.array([0.0, 0.0, 0.0, math.inf])  # before: the last cell's centre and depth
    while top > 0 and count < cells_out.shape[0]:
        top -= 1
        cell[:] = waiting[top]
        x, y, z, half, inside = cell[0], cell[1], cell[2], cell[3], cell[4]
        if _in_ball(x, y, z, half, balls, last):
            continue
        found = -1
        for i in range(balls.shape[0]):
            if _in_ball(x, y, z, half, balls, i):
                found = i
                break
        if found >= 0:
            last = found
            continue
        bound = no_further(before[3], x - before[0], y - before[1], z - before[2])
        depth = gap_to(x, y, z, surfaces, spans, bound)
        before[0], before[1], before[2], before[3] = x, y, z, depth
        corner = _DIAGONAL * half
        if depth + corner <= margin:
            continue
        if depth > corner:
            # no surface in the cell: it is inside or outside as a whole
            if inside == 0.0 and not is_inside(x, y, z, surfaces, spans):
                continue
            inside = 1.0
            if half <= max(FINENESS * depth, FINEST * margin):
                cells_out[count, :4] = cell[:4]
                cells_out[count, 4] = depth
                count += 1
                continue
        top = _halve(cell, inside, waiting, top)
    return count
