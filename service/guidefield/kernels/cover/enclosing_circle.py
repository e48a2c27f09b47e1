"""The smallest circle around points in the plane.

It takes in the farthest point outside until there is none; the circle of the two or three points that hold it grows
each time, so that no such set returns. `robot/link_charges.py` fits capsules about links with it, and widens them by
`SLACK`, which may grow, not shrink.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.jit.arrays import Floats, Integers, RowOut, Rows
from guidefield.kernels.jit.compilers import part
from guidefield.kernels.jit.decorators import exact_kernel
from guidefield.kernels.simd.packing import fused

SLACK = 1.0 + 1e-12  # a point farther than the radius by this factor counts as inside: rounding

_HELD = 4  # points that a circle is held by, and the next one outside
_FLAT = 1e-24  # square of twice a triangle's area over those of two sides, below which its corners lie on a line


@part
def _farthest(points: Floats, x: float, y: float) -> tuple[float, int]:
    """Distance of the farthest of points (n, 2) from a centre, and which it is, the first of several."""
    best, which = -1.0, 0
    for i in range(points.shape[0]):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        distance = math.sqrt(dx * dx + dy * dy)
        if distance > best:
            best, which = distance, i
    return best, which


@part
def _circumcentre(points: Floats, i: int, j: int, k: int) -> tuple[bool, float, float]:
    """Tell if there is a circle through three points, and its centre."""
    ux, uy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    vx, vy = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1]
    twice_area = ux * vy - uy * vx
    uu, vv = fused(uy, uy, ux * ux), fused(vy, vy, vx * vx)
    if twice_area * twice_area <= _FLAT * uu * vv:
        return False, 0.0, 0.0
    over = 2.0 * twice_area
    return True, points[i, 0] + (vy * uu - uy * vv) / over, points[i, 1] + (ux * vv - vx * uu) / over


@part
def _smallest_of_few(points: Floats, circle_out: Floats, holding_out: Integers) -> int:
    """The smallest circle around one to four points, and which of them hold it: how many, and their places."""
    count = points.shape[0]
    circle_out[0], circle_out[1] = points[0, 0], points[0, 1]
    circle_out[2] = _farthest(points, points[0, 0], points[0, 1])[0]
    held: int = count
    for i in range(count):
        holding_out[i] = i
    for i in range(count):
        for j in range(i + 1, count):
            x, y = 0.5 * (points[i, 0] + points[j, 0]), 0.5 * (points[i, 1] + points[j, 1])
            radius = _farthest(points, x, y)[0]
            if radius < circle_out[2]:
                circle_out[0], circle_out[1], circle_out[2] = x, y, radius
                holding_out[0], holding_out[1] = i, j
                held = 2
    for i in range(count):
        for j in range(i + 1, count):
            for k in range(j + 1, count):
                there, x, y = _circumcentre(points, i, j, k)
                radius = _farthest(points, x, y)[0] if there else math.inf
                if radius < circle_out[2]:
                    circle_out[0], circle_out[1], circle_out[2] = x, y, radius
                    holding_out[0], holding_out[1], holding_out[2] = i, j, k
                    held = 3
    return held


@exact_kernel
def enclosing_circle(points: Rows, circle_out: RowOut) -> None:
    """Find the smallest circle (3,) around `points` (n, 2), n >= 1 [m]: its centre, the farthest point's distance."""
    held, kept, holding = np.empty((_HELD, 2)), np.empty((_HELD, 2)), np.empty(_HELD, np.int64)
    held[0] = points[0]
    count, radius = 1, -1.0
    while True:
        few = _smallest_of_few(held[:count], circle_out, holding)
        distance, farthest = _farthest(points, circle_out[0], circle_out[1])
        grown = circle_out[2]
        if distance <= grown * SLACK or grown <= radius:
            circle_out[2] = distance
            return
        radius = grown
        for i in range(few):
            kept[i] = held[holding[i]]
        held[:few] = kept[:few]
        held[few] = points[farthest]
        count = few + 1
