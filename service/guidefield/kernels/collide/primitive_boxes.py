"""Boxes about primitives along their own axes and along the world's."""

from __future__ import annotations

import math

from numba import void

from guidefield.kernels.collide.placed_rotation import write_rotation
from guidefield.kernels.collide.primitive import BOX, CAPSULE, HALF_SPACE
from guidefield.kernels.jit.signatures import BLOCKS_OUT, MATRIX, MATRIX_OUT, SCALAR, Floats, exact_kernel


@exact_kernel(void(MATRIX, BLOCKS_OUT, MATRIX_OUT, MATRIX_OUT))
def primitive_boxes(placed: Floats, axes: Floats, middles: Floats, halves: Floats) -> None:
    """Find the boxes along their own axes.

    Args:
        placed: How they are declared, `PLACED` of each, shape (n, 12).
        axes: Gets the axes as columns, shape (n, 3, 3).
        middles: Gets the middles in the world, shape (n, 3) [m]; of a half-space the origin.
        halves: Gets the half extents, shape (n, 3) [m]; infinite for a half-space.
    """
    for i in range(placed.shape[0]):
        row = placed[i]
        kind, radius = row[0], row[11]
        write_rotation(row, axes[i])
        for k in range(3):
            middles[i, k], half = row[5 + k], row[8 + k]
            if kind == HALF_SPACE:
                middles[i, k], half = 0.0, math.inf
            elif kind != BOX and k < 2:
                half = radius
            elif kind == CAPSULE:
                half += radius
            halves[i, k] = half


@exact_kernel(void(MATRIX, MATRIX, MATRIX, SCALAR, MATRIX_OUT, MATRIX_OUT))
def along_both(axes: Floats, middles: Floats, halves: Floats, rounding: float, centres: Floats, boxes: Floats) -> None:
    """Find where boxes are along their own axes, and boxes along the world's axes that contain them.

    Args:
        axes: Their axes as columns, row by row, shape (n, 9).
        middles: Their middles in the world, shape (n, 3) [m].
        halves: Half extents, shape (n, 3) [m]; infinite for what is endless.
        rounding: What boxes along the world's axes are wider by, of a metre and of each metre from the origin.
        centres: Gets the middles along the axes, shape (n, 3) [m].
        boxes: Gets lower, then upper corners, shape (n, 6) [m, world].
    """
    for i in range(axes.shape[0]):
        a, m, h = axes[i], middles[i], halves[i]
        for k in range(3):
            centres[i, k] = m[0] * a[k] + m[1] * a[3 + k] + m[2] * a[6 + k]
            reach = abs(a[3 * k]) * h[0] + abs(a[3 * k + 1]) * h[1] + abs(a[3 * k + 2]) * h[2]
            if math.isinf(h[k]):
                reach = math.inf
            low, high = m[k] - reach, m[k] + reach
            wider = rounding * (1.0 + max(abs(low), abs(high)))
            boxes[i, k], boxes[i, 3 + k] = low - wider, high + wider
