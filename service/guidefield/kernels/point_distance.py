"""Distance of a point to the nearest point of a cloud, which a tree of boxes finds."""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.signatures import MATRIX, SCALAR, Floats, compiled
from guidefield.kernels.triangle_distance import FOUR_SCALARS, LEAF, SPAN, Span, box_gap_squared

_STACK = 64


@compiled(FOUR_SCALARS(SCALAR, SCALAR, SCALAR, MATRIX, MATRIX, SPAN, SCALAR))
def cloud_distance(
    x: float, y: float, z: float, nodes: Floats, points: Floats, span: Span, cutoff: float
) -> tuple[float, float, float, float]:
    """Distance of a point to a cloud and the unit vector along which it grows.

    Args:
        x: Point in the frame of the cloud [m], with y and z.
        y: See x.
        z: See x.
        nodes: Trees of boxes, among them the cloud's, shape (m, 6) [m].
        points: Points of all clouds, in the order of their trees, shape (p, 3) [m].
        span: Where the cloud's tree and points stand.
        cutoff: Distance beyond which nothing is looked for [m]; may be infinite.

    Returns:
        Distance [m] and unit vector (3); infinite and zero if no point is within the cutoff.
    """
    root, leaves, first, count = span
    waiting, gaps = np.empty(_STACK, np.int64), np.empty(_STACK)
    waiting[0], gaps[0] = 0, box_gap_squared(x, y, z, nodes, root)
    top, best, found = 1, cutoff * cutoff, -1
    while top > 0:
        top -= 1
        node = waiting[top]
        if gaps[top] >= best:
            continue
        leaf = node - (leaves - 1)
        if leaf >= 0:
            for i in range(first + leaf * LEAF, first + min(count, (leaf + 1) * LEAF)):
                dx, dy, dz = x - points[i, 0], y - points[i, 1], z - points[i, 2]
                square = dx * dx + dy * dy + dz * dz
                if square < best:
                    best, found = square, i
            continue
        near, far = 2 * node + 1, 2 * node + 2
        to_near = box_gap_squared(x, y, z, nodes, root + near)
        to_far = box_gap_squared(x, y, z, nodes, root + far)
        if to_far < to_near:
            near, far, to_near, to_far = far, near, to_far, to_near
        if to_far < best:
            waiting[top], gaps[top] = far, to_far
            top += 1
        if to_near < best:  # on top: the nearer one is looked at first
            waiting[top], gaps[top] = near, to_near
            top += 1
    if found < 0:
        return math.inf, 0.0, 0.0, 0.0
    distance = math.sqrt(best)
    if distance < 1e-12:
        return distance, 0.0, 0.0, 1.0
    over = 1.0 / distance
    return distance, over * (x - points[found, 0]), over * (y - points[found, 1]), over * (z - points[found, 2])
