"""Boxes about primitives along their own axes and along the world's, and the cores that hold them."""

from __future__ import annotations

import math

from numba import void

from guidefield.kernels.collide.primitive import BOX, CAPSULE, CYLINDER, HALF_SPACE
from guidefield.kernels.jit.signatures import MATRIX, MATRIX_OUT, SCALAR, VECTOR_OUT, Floats, exact_kernel, lane_part


@lane_part
def _write_axes(x: float, y: float, z: float, w: float, axes: Floats) -> None:
    """Write the axes of a body that is turned by a unit quaternion as columns, row by row, shape (9,)."""
    axes[0], axes[1], axes[2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
    axes[3], axes[4], axes[5] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)
    axes[6], axes[7], axes[8] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)


@exact_kernel(void(MATRIX, MATRIX_OUT, MATRIX_OUT, MATRIX_OUT, MATRIX_OUT, VECTOR_OUT, VECTOR_OUT))
def primitive_boxes(
    placed: Floats,
    axes: Floats,
    middles: Floats,
    halves: Floats,
    cores: Floats,
    discs: Floats,
    rounded: Floats,
) -> None:
    """Find the boxes along their own axes and the cores of primitives, as `collision.certify.cores` has them.

    Args:
        placed: How they are declared, `PLACED` of each, shape (n, 12).
        axes: Gets the axes as columns, row by row, shape (n, 9).
        middles: Gets the middles in the world, shape (n, 3) [m]; of a half-space the origin.
        halves: Gets the half extents, shape (n, 3) [m]; infinite for a half-space.
        cores: Gets the half extents of boxes whose corners are those of the cores, shape (n, 3) [m].
        discs: Gets the radii of the cores' discs about the last axis, 0 for none, shape (n,) [m].
        rounded: Gets the radii of the balls at each point of a core, shape (n,) [m]; infinite for a half-space.
    """
    for i in range(placed.shape[0]):
        row = placed[i]
        kind, radius = row[0], row[11]
        _write_axes(row[1], row[2], row[3], row[4], axes[i])
        discs[i] = radius if kind == CYLINDER else 0.0
        rounded[i] = math.inf if kind == HALF_SPACE else radius if kind == CAPSULE else 0.0
        for k in range(3):
            middles[i, k], core = row[5 + k], row[8 + k]
            half = core
            if kind == HALF_SPACE:
                middles[i, k], core, half = 0.0, math.inf, math.inf
            elif kind != BOX and k < 2:
                half = radius
            elif kind == CAPSULE:
                half = core + radius
            cores[i, k], halves[i, k] = core, half


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
