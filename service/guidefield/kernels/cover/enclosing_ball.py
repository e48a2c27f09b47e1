"""Smallest balls around points and circles around points of a plane, small balls around balls, largest distances.

Covers and collision tests rely on balls that contain everything, whatever rounding does: `SLACK` may grow, not shrink.
A circle's radius is the distance of its farthest point; `robot/link_charges.py`, which fits capsules about links with
it, widens it by `SLACK`. A smallest ball or circle takes in the farthest point outside until there is none: the one
that the few points hold grows each time, so that no such set returns.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.jit.arrays import Floats, Indices, Integers, RowOut, Rows, RowsOut
from guidefield.kernels.jit.decorators import exact_kernel, exact_part, inlined, kernel
from guidefield.kernels.simd.packing import fused

SLACK = 1.0 + 1e-12
"""A point farther than the radius by this factor counts as inside; radii of balls are larger by it."""

_FLAT = 1e-12
"""Determinant over the product of squared lengths, below which points count as lying in a plane or on a line."""

_HELD = 5  # points that a ball is held by, and the next one outside
_STEPS = 200  # rounds at most, from 1 on; a ball left early is widened to contain all, a little larger than it need be

_HELD_BY_CIRCLE = 4  # points that a circle is held by, and the next one outside
_FLAT_TRIANGLE = 1e-24
"""Square of twice a triangle's area over those of two sides, below which its corners lie on a line."""


@inlined
def _farthest(points: Floats, count: int, ball: Floats) -> tuple[int, float]:
    """Index of the farthest of the first `count` points from a centre, and its distance squared."""
    best, square = 0, -1.0
    for i in range(count):
        dx, dy, dz = points[i, 0] - ball[0], points[i, 1] - ball[1], points[i, 2] - ball[2]
        d = dx * dx + dy * dy + dz * dz
        if d > square:
            best, square = i, d
    return best, square


@inlined
def _circumscribe(held: Floats, subset: int, ball_out: Floats) -> bool:
    """Write the ball through a subset of points with its centre in their span; False if they lie too flat.

    With v_i the others less the first and G their products, the centre is the first + sum l_i v_i, G l = diag(G) / 2.
    """
    v = np.zeros((3, 3))
    first, n = -1, 0
    for i in range(_HELD):
        if subset >> i & 1:
            if first < 0:
                first = i
            else:
                for a in range(3):
                    v[n, a] = held[i, a] - held[first, a]
                n += 1
    g = np.eye(3)
    r = np.zeros(3)
    scale = 1.0
    for i in range(n):
        for j in range(n):
            g[i, j] = v[i, 0] * v[j, 0] + v[i, 1] * v[j, 1] + v[i, 2] * v[j, 2]
        r[i] = 0.5 * g[i, i]
        scale *= g[i, i]
    m0 = g[1, 1] * g[2, 2] - g[1, 2] * g[2, 1]
    m1 = g[1, 0] * g[2, 2] - g[1, 2] * g[2, 0]
    m2 = g[1, 0] * g[2, 1] - g[1, 1] * g[2, 0]
    det = g[0, 0] * m0 - g[0, 1] * m1 + g[0, 2] * m2
    if det <= _FLAT * scale:
        return False
    l0 = r[0] * m0 - g[0, 1] * (r[1] * g[2, 2] - g[1, 2] * r[2]) + g[0, 2] * (r[1] * g[2, 1] - g[1, 1] * r[2])
    l1 = g[0, 0] * (r[1] * g[2, 2] - g[1, 2] * r[2]) - r[0] * m1 + g[0, 2] * (g[1, 0] * r[2] - r[1] * g[2, 0])
    l2 = g[0, 0] * (g[1, 1] * r[2] - r[1] * g[2, 1]) - g[0, 1] * (g[1, 0] * r[2] - r[1] * g[2, 0]) + r[0] * m2
    square = 0.0
    for a in range(3):
        arm = (l0 * v[0, a] + l1 * v[1, a] + l2 * v[2, a]) / det
        ball_out[a] = held[first, a] + arm
        square += arm * arm
    ball_out[3] = math.sqrt(square)
    return True


@inlined
def _smallest_of_few(held: Floats, count: int, ball_out: Floats) -> int:
    """The smallest ball around up to five points, and which of them hold it, as bits."""
    trial = np.zeros(4)
    best = 0
    ball_out[3] = math.inf
    for subset in range(1, 1 << count):
        ones = 0
        for i in range(count):
            ones += subset >> i & 1
        if ones > 4 or not _circumscribe(held, subset, trial) or trial[3] >= ball_out[3]:
            continue
        reach = trial[3] * (1.0 + 1e-10)
        if _farthest(held, count, trial)[1] <= reach * reach:
            best = subset
            ball_out[:] = trial
    return best


@kernel
def smallest_ball(points: Rows, ball_out: RowOut) -> None:
    """Find the smallest ball (4,) that contains `points` (n, 3), n >= 1 [m], whatever rounding does.

    It takes in the farthest point outside until there is none; the ball of the few points that hold it grows each time.
    """
    held = np.zeros((_HELD, 3))
    held[0] = points[0]
    count, radius = 1, -1.0
    trial = np.zeros(4)
    for _ in range(_STEPS):
        subset = _smallest_of_few(held, count, trial)
        if trial[3] <= radius:
            break
        radius = trial[3]
        ball_out[:] = trial
        farthest, square = _farthest(points, points.shape[0], ball_out)
        if square <= (radius * SLACK) ** 2:
            break
        kept = 0
        for i in range(count):
            if subset >> i & 1:
                held[kept] = held[i]
                kept += 1
        held[kept] = points[farthest]
        count = kept + 1
    square = _farthest(points, points.shape[0], ball_out)[1]
    ball_out[3] = math.sqrt(square) * SLACK


@kernel
def smallest_balls(points: Rows, first: Indices, balls_out: RowsOut) -> None:
    """`smallest_ball` (m, 4) of each run of points (k, 3), which begin at `first` (m + 1,); none is empty."""
    for m in range(balls_out.shape[0]):
        smallest_ball(points[first[m] : first[m + 1]], balls_out[m])


@exact_kernel
def largest_distances(points: Rows, first: Indices, centres: Rows, distances_out: RowOut) -> None:
    """Write the largest distance (m,) of each run of points (k, 3), from `first` on, from its own centre (m, 3) [m]."""
    for m in range(centres.shape[0]):
        square = 0.0
        for i in range(first[m], first[m + 1]):
            dx, dy, dz = points[i, 0] - centres[m, 0], points[i, 1] - centres[m, 1], points[i, 2] - centres[m, 2]
            square = max(square, dx * dx + dy * dy + dz * dz)
        distances_out[m] = math.sqrt(square)


@kernel
def ball_around_balls(balls: Rows, ball_out: RowOut) -> None:
    """Find a small ball (4,) that contains balls (n, 4), n >= 1 [m].

    Its centre goes towards the far end of the farthest ball, less and less far (Badoiu and Clarkson, 2003).
    """
    ball_out[:] = balls[0]
    best = math.inf
    centre = balls[0, :3].copy()
    for step in range(_STEPS):
        farthest, reach, gap = 0, -1.0, 0.0
        for i in range(balls.shape[0]):
            dx, dy, dz = balls[i, 0] - centre[0], balls[i, 1] - centre[1], balls[i, 2] - centre[2]
            d = math.sqrt(dx * dx + dy * dy + dz * dz)
            if d + balls[i, 3] > reach:
                farthest, reach, gap = i, d + balls[i, 3], d
        if reach < best:
            best = reach
            ball_out[:3] = centre
            ball_out[3] = reach * SLACK
        if gap == 0.0:
            return
        share = reach / (step + 2.0) / gap
        for a in range(3):
            centre[a] += share * (balls[farthest, a] - centre[a])


@exact_part
def _farthest_in_plane(points: Floats, x: float, y: float) -> tuple[float, int]:
    """Distance of the farthest of points (n, 2) from a centre, and which it is, the first of several."""
    best, which = -1.0, 0
    for i in range(points.shape[0]):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        distance = math.sqrt(dx * dx + dy * dy)
        if distance > best:
            best, which = distance, i
    return best, which


@exact_part
def _circumcentre(points: Floats, i: int, j: int, k: int) -> tuple[bool, float, float]:
    """Tell if there is a circle through three points, and its centre."""
    ux, uy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    vx, vy = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1]
    twice_area = ux * vy - uy * vx
    uu, vv = fused(uy, uy, ux * ux), fused(vy, vy, vx * vx)
    if twice_area * twice_area <= _FLAT_TRIANGLE * uu * vv:
        return False, 0.0, 0.0
    over = 2.0 * twice_area
    return True, points[i, 0] + (vy * uu - uy * vv) / over, points[i, 1] + (ux * vv - vx * uu) / over


@exact_part
def _smallest_circle_of_few(points: Floats, circle_out: Floats, holding_out: Integers) -> int:
    """The smallest circle around one to four points, and which of them hold it: how many, and their places."""
    count = points.shape[0]
    circle_out[0], circle_out[1] = points[0, 0], points[0, 1]
    circle_out[2] = _farthest_in_plane(points, points[0, 0], points[0, 1])[0]
    held: int = count
    for i in range(count):
        holding_out[i] = i
    for i in range(count):
        for j in range(i + 1, count):
            x, y = 0.5 * (points[i, 0] + points[j, 0]), 0.5 * (points[i, 1] + points[j, 1])
            radius = _farthest_in_plane(points, x, y)[0]
            if radius < circle_out[2]:
                circle_out[0], circle_out[1], circle_out[2] = x, y, radius
                holding_out[0], holding_out[1] = i, j
                held = 2
    for i in range(count):
        for j in range(i + 1, count):
            for k in range(j + 1, count):
                there, x, y = _circumcentre(points, i, j, k)
                radius = _farthest_in_plane(points, x, y)[0] if there else math.inf
                if radius < circle_out[2]:
                    circle_out[0], circle_out[1], circle_out[2] = x, y, radius
                    holding_out[0], holding_out[1], holding_out[2] = i, j, k
                    held = 3
    return held


@exact_kernel
def enclosing_circle(points: Rows, circle_out: RowOut) -> None:
    """Find the smallest circle (3,) around `points` (n, 2), n >= 1 [m]: its centre, the farthest point's distance."""
    held, kept = np.empty((_HELD_BY_CIRCLE, 2)), np.empty((_HELD_BY_CIRCLE, 2))
    holding = np.empty(_HELD_BY_CIRCLE, np.int64)
    held[0] = points[0]
    count, radius = 1, -1.0
    while True:
        few = _smallest_circle_of_few(held[:count], circle_out, holding)
        distance, farthest = _farthest_in_plane(points, circle_out[0], circle_out[1])
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
