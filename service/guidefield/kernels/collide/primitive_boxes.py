"""Declared primitives as boxes, as bodies that the distance kernels read, and as bounds of distances from a ball."""

from __future__ import annotations

import math

from numba import void

from guidefield.kernels.collide.primitive import BOX, CAPSULE, HALF_SPACE
from guidefield.kernels.distance.distance import BOX as BOX_BODY, CAPSULE as CAPSULE_BODY, CYLINDER as CYLINDER_BODY
from guidefield.kernels.jit.signatures import (
    BLOCKS_OUT,
    INDICES_OUT,
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    VECTOR,
    VECTOR_OUT,
    Floats,
    Integers,
    exact_kernel,
    lane_part,
)


@lane_part
def write_rotation(placed: Floats, rotation: Floats) -> None:
    """Write the rotation of a primitive, `PLACED` of it of shape (12,), to the first three columns of (3, k)."""
    x, y, z, w = placed[1], placed[2], placed[3], placed[4]
    rotation[0, 0], rotation[0, 1] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w)
    rotation[1, 0], rotation[1, 1] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z)
    rotation[2, 0], rotation[2, 1] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w)
    rotation[0, 2], rotation[1, 2] = 2.0 * (x * z + y * w), 2.0 * (y * z - x * w)
    rotation[2, 2] = 1.0 - 2.0 * (x * x + y * y)


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


@exact_kernel(void(MATRIX, SCALAR, INDICES_OUT, MATRIX_OUT, MATRIX_OUT, BLOCKS_OUT, MATRIX_OUT))
def primitive_bodies(
    placed: Floats,
    rounding: float,
    kinds: Integers,
    sizes: Floats,
    bounds: Floats,
    placements: Floats,
    boxes: Floats,
) -> None:
    """Write the rows of bodies, as `DistanceTables` has them.

    Args:
        placed: How they are declared, `PLACED` of each, shape (n, 12); of what is neither rows say nothing.
        rounding: By how much boxes in the world are made larger [m, and a share].
        kinds: Gets their kinds, shape (n,).
        sizes: Gets their sizes, shape (n, 3) [m].
        bounds: Gets boxes about them in their own frames, shape (n, 6) [m].
        placements: Gets their placements, shape (n, 3, 4) [m].
        boxes: Gets boxes about them along the world's axes, shape (n, 6) [m].
    """
    for i in range(placed.shape[0]):
        row, placement = placed[i], placements[i]
        write_rotation(row, placement)
        for k in range(3):
            placement[k, 3] = row[5 + k]
        radius, half = row[11], row[10]
        if row[0] == BOX:
            kinds[i] = BOX_BODY
            sizes[i, 0], sizes[i, 1], sizes[i, 2] = row[8], row[9], row[10]
            bounds[i, 3], bounds[i, 4], bounds[i, 5] = row[8], row[9], row[10]
        else:
            is_capsule = row[0] == CAPSULE
            kinds[i] = CAPSULE_BODY if is_capsule else CYLINDER_BODY
            sizes[i, 0], sizes[i, 1], sizes[i, 2] = radius, half, 0.0
            bounds[i, 3], bounds[i, 4], bounds[i, 5] = radius, radius, half + radius if is_capsule else half
        for k in range(3):
            bounds[i, k] = -bounds[i, 3 + k]
        for k in range(3):
            turned = placement[k]
            reach = abs(turned[0]) * bounds[i, 3] + abs(turned[1]) * bounds[i, 4] + abs(turned[2]) * bounds[i, 5]
            reach += rounding * (1.0 + abs(turned[3]))
            boxes[i, k], boxes[i, 3 + k] = turned[3] - reach, turned[3] + reach


@exact_kernel(void(MATRIX, VECTOR, SCALAR, VECTOR_OUT, VECTOR_OUT))
def gaps_from_ball(placed: Floats, ball: Floats, rounding: float, least: Floats, most: Floats) -> None:
    """Find the distances; of what is no primitive nothing is known.

    Args:
        placed: How primitives are declared, `PLACED` of each, shape (n, 12); all zero of what is none.
        ball: Centre and radius, shape (4,) [m].
        rounding: What distances are taken for wider, of a metre and of each metre that places are from the origin.
        least: Gets how far each is at least from any place in the ball, shape (n,) [m].
        most: Gets how far it is at most, shape (n,) [m].
    """
    middle_far = max(abs(ball[0]), abs(ball[1]), abs(ball[2]))
    for i in range(placed.shape[0]):
        row = placed[i]
        known = False
        for k in range(row.shape[0]):
            known = known or row[k] != 0.0
        if not known:
            least[i], most[i] = -math.inf, math.inf
            continue
        kind, radius = row[0], row[11]
        x, y, z, a, b, c = row[5], row[6], row[7], row[8], row[9], row[10]
        wider = rounding * (1.0 + max(abs(x), abs(y), abs(z)) + middle_far)
        if kind == HALF_SPACE:
            above = (ball[0] - x) * a + (ball[1] - y) * b + (ball[2] - z) * c
            least[i], most[i] = -math.inf, max(above + ball[3], 0.0) + wider
            continue
        apart = math.sqrt((x - ball[0]) ** 2 + (y - ball[1]) ** 2 + (z - ball[2]) ** 2)
        if kind == BOX:
            about, within = math.sqrt(a * a + b * b + c * c), min(a, b, c)
        elif kind == CAPSULE:
            about, within = c + radius, radius
        else:
            about, within = math.sqrt(c * c + radius * radius), min(c, radius)
        least[i] = apart - about - ball[3] - wider
        most[i] = max(apart - within + ball[3], 0.0) + wider
