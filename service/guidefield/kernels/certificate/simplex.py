"""The point nearest to the origin of the hull of a few points: a subset of them holds it on a face of its own.

What is found decides only across which direction a slab is tried: it needs no trust.
"""

from __future__ import annotations

from guidefield.kernels.jit.no_refcount import lane_uncounted
from guidefield.kernels.jit.signatures import Floats

POINTS = 4
"""So many points at most."""

FIRST = -1, 0, 1, 0, 2, 0, 1, 0
SECOND = -1, -1, -1, 1, -1, 2, 2, 1
THIRD = -1, -1, -1, -1, -1, -1, -1, 2
"""Up to three of the older points by the bits of a number, -1 for none."""

FLAT = 1e-12
"""Of a simplex whose edges span no larger share of what they would at right angles no point is looked for: a smaller
one has it."""


@lane_uncounted
def _dot(a: Floats, b: Floats, base: Floats, other: Floats) -> float:
    """(a - base) . (b - other) of points (3,)."""
    total = 0.0
    for i in range(3):
        total += (a[i] - base[i]) * (b[i] - other[i])
    return total


@lane_uncounted
def _toward(a: Floats, base: Floats) -> float:
    """How far the origin is along the edge from a base to a point, both of shape (3,), times its length."""
    total = 0.0
    for i in range(3):
        total -= (a[i] - base[i]) * base[i]
    return total


@lane_uncounted
def _shares(points: Floats, newest: int, i: int, j: int, k: int) -> tuple[float, float, float]:
    """Shares of up to three points in the point nearest to the origin of the plane through them and the newest one.

    Of numbers below 0 there is none; that of the newest point is what is left to 1. All are -1 where the origin is seen
    from beyond an edge of theirs, or the points are flat.
    """
    base, none = points[newest], (-1.0, -1.0, -1.0)
    g, p = _dot(points[i], points[i], base, base), _toward(points[i], base)
    if j < 0:
        a = p / g if g > 0.0 else -1.0
        return (a, 0.0, 0.0) if 0.0 < a < 1.0 else none
    h, m, q = _dot(points[i], points[j], base, base), _dot(points[j], points[j], base, base), _toward(points[j], base)
    square = g * m - h * h
    if square <= FLAT * g * m:
        return none
    if k < 0:
        a, b = (p * m - q * h) / square, (g * q - h * p) / square
        return (a, b, 0.0) if a > 0.0 and b > 0.0 and a + b < 1.0 else none
    n, o = _dot(points[i], points[k], base, base), _dot(points[j], points[k], base, base)
    t, r = _dot(points[k], points[k], base, base), _toward(points[k], base)
    cube = g * (m * t - o * o) - h * (h * t - o * n) + n * (h * o - m * n)
    if cube <= FLAT * g * m * t:
        return none
    a = (p * (m * t - o * o) - h * (q * t - o * r) + n * (q * o - m * r)) / cube
    b = (g * (q * t - o * r) - p * (h * t - o * n) + n * (h * r - q * n)) / cube
    c = (g * (m * r - q * o) - h * (h * r - q * n) + p * (h * o - m * n)) / cube
    return (a, b, c) if a > 0.0 and b > 0.0 and c > 0.0 and a + b + c < 1.0 else none


@lane_uncounted
def nearest_in(points: Floats, count: int, found: Floats) -> int:
    """Find the point nearest to the origin of the hull of some points, given that the newest of them is needed for it.

    Args:
        points: Shape (at least `POINTS`, 3), the newest last; those that aren't needed are dropped.
        count: How many there are.
        found: Out: the nearest point, shape (3,).

    Returns:
        How many are left.
    """
    newest, kept, best = count - 1, 0, 0.0
    base = points[newest]
    for i in range(3):
        found[i] = base[i]
        best += base[i] * base[i]
    for mask in range(1, 1 << newest):
        i, j, k = FIRST[mask], SECOND[mask], THIRD[mask]
        a, b, c = _shares(points, newest, i, j, k)
        if a < 0.0:
            continue
        x, y, z = base[0], base[1], base[2]
        for share, index in ((a, i), (b, j), (c, k)):
            if index >= 0:
                x += share * (points[index, 0] - base[0])
                y += share * (points[index, 1] - base[1])
                z += share * (points[index, 2] - base[2])
        square = x * x + y * y + z * z
        if square < best:
            best, kept = square, mask
            found[0], found[1], found[2] = x, y, z
    left = 0
    for index in range(count):
        if index == newest or kept >> index & 1:
            for i in range(3):
                points[left, i] = points[index, i]
            left += 1
    return left
