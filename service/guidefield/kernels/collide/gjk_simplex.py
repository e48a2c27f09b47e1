"""The point of a simplex nearest to the origin, for GJK; Voronoi regions as in Ericson, Real-Time Collision Detection.

A simplex is up to four points in a flat float64 array, `POINT` numbers each. A reduction keeps the points that span the
nearest point, moves them to the front, writes the nearest point behind the fourth (`NEAREST`), and returns how many
were kept; four means that the origin is inside. `gjk.py` has the array at the begin of its scratch, before `POSE_A`.
"""

from __future__ import annotations

from numba import boolean, int64

from guidefield.kernels.jit.arrays import DOUBLE_POINTER, Floats
from guidefield.kernels.jit.decorators import lane_part, lane_step

POINT = 3  # numbers of a point
NEAREST = 4 * POINT  # place of the nearest point in the array
SIMPLEX = 5 * POINT  # numbers of the array


@lane_part
def nearest_point(w: Floats) -> tuple[float, float, float]:
    """The point of a simplex, shape (`SIMPLEX`,), nearest to the origin, as the last reduction left it."""
    return w[NEAREST], w[NEAREST + 1], w[NEAREST + 2]


@lane_part
def has_point(w: Floats, count: int, x: float, y: float, z: float) -> bool:
    """Tell if a point is among the `count` points of a simplex, shape (`SIMPLEX`,)."""
    found = False
    for at in range(0, count * POINT, POINT):
        found |= w[at] == x and w[at + 1] == y and w[at + 2] == z
    return found


@lane_part
def _dot(w: Floats, i: int, j: int) -> float:
    return float(w[i] * w[j] + w[i + 1] * w[j + 1] + w[i + 2] * w[j + 2])


@lane_part
def _copy(w: Floats, source: int, target: int) -> None:
    for k in range(POINT):
        w[target + k] = w[source + k]


@lane_part
def _mix(w: Floats, a: int, b: int, c: int, s: float, t: float) -> None:
    """Write a + s (b - a) + t (c - a) as the nearest point."""
    for k in range(POINT):
        base = w[a + k]
        w[NEAREST + k] = base + s * (w[b + k] - base) + t * (w[c + k] - base)


@lane_part
def _on_segment(w: Floats, a: int, b: int) -> int:
    """Nearest point of a segment; which of (a, b) span it, as bits."""
    ab = _dot(w, a, b) - _dot(w, a, a)
    bb = _dot(w, b, b) - _dot(w, a, b)
    length = bb - ab
    if -ab <= 0.0 or length <= 0.0:
        _copy(w, a, NEAREST)
        return 1
    if bb <= 0.0:
        _copy(w, b, NEAREST)
        return 2
    _mix(w, a, b, a, -ab / length, 0.0)
    return 3


@lane_step(int64(DOUBLE_POINTER, int64, int64, int64))
def _on_triangle(w: Floats, a: int, b: int, c: int) -> int:  # noqa: PLR0911  one for each region of the plane
    """Nearest point of a triangle; which of (a, b, c) span it, as bits."""
    aa, bb, cc = _dot(w, a, a), _dot(w, b, b), _dot(w, c, c)
    ab, ac, bc = _dot(w, a, b), _dot(w, a, c), _dot(w, b, c)
    d1, d2 = aa - ab, aa - ac
    d3, d4 = ab - bb, ab - bc
    d5, d6 = ac - bc, ac - cc
    if d1 <= 0.0 and d2 <= 0.0:
        _copy(w, a, NEAREST)
        return 1
    if d3 >= 0.0 and d4 <= d3:
        _copy(w, b, NEAREST)
        return 2
    if d6 >= 0.0 and d5 <= d6:
        _copy(w, c, NEAREST)
        return 4
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        _mix(w, a, b, c, d1 / max(d1 - d3, 1e-300), 0.0)
        return 3
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        _mix(w, a, b, c, 0.0, d2 / max(d2 - d6, 1e-300))
        return 5
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        t = (d4 - d3) / max((d4 - d3) + (d5 - d6), 1e-300)
        _mix(w, a, b, c, 1.0 - t, t)
        return 6
    total = max(va + vb + vc, 1e-300)
    _mix(w, a, b, c, vb / total, vc / total)
    return 7


@lane_step(boolean(DOUBLE_POINTER, int64, int64, int64, int64))
def _outside(w: Floats, a: int, b: int, c: int, d: int) -> bool:
    """Tell if the plane through (a, b, c) has the origin and d on different sides, or either on it."""
    ax, ay, az = w[a], w[a + 1], w[a + 2]
    ux, uy, uz = w[b] - ax, w[b + 1] - ay, w[b + 2] - az
    vx, vy, vz = w[c] - ax, w[c + 1] - ay, w[c + 2] - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    origin = -(nx * ax + ny * ay + nz * az)
    other = nx * (w[d] - ax) + ny * (w[d + 1] - ay) + nz * (w[d + 2] - az)
    return bool(origin * other <= 0.0)


@lane_part
def _on_tetrahedron(w: Floats) -> int:
    """Nearest point of a tetrahedron; which of its four points span it, as bits."""
    best, kept = 1e300, 15
    bx, by, bz = 0.0, 0.0, 0.0
    for face in range(4):
        # the face without point 3 - face
        a = 0 if face < 3 else POINT
        b = POINT if face < 2 else 2 * POINT
        c = 2 * POINT if face == 0 else 3 * POINT
        d = (3 - face) * POINT
        if not _outside(w, a, b, c, d):
            continue
        bits = _on_triangle(w, a, b, c)
        square = _dot(w, NEAREST, NEAREST)
        if square < best:
            best = square
            bx, by, bz = nearest_point(w)
            kept = (bits & 1) << (a // POINT)
            kept |= ((bits >> 1) & 1) << (b // POINT)
            kept |= ((bits >> 2) & 1) << (c // POINT)
    w[NEAREST], w[NEAREST + 1], w[NEAREST + 2] = bx, by, bz
    return kept


@lane_step(int64(DOUBLE_POINTER, int64))
def _reduced(w: Floats, count: int) -> int:
    """Reduce a simplex of `count` points; how many are left."""
    bits = 1
    if count == 1:
        _copy(w, 0, NEAREST)
    elif count == 2:
        bits = _on_segment(w, 0, POINT)
    elif count == 3:
        bits = _on_triangle(w, 0, POINT, 2 * POINT)
    else:
        bits = _on_tetrahedron(w)
    kept = 0
    for i in range(count):
        if (bits >> i) & 1:
            if kept != i:
                _copy(w, POINT * i, POINT * kept)
            kept += 1
    return kept


@lane_part
def reduced_with(w: Floats, count: int, x: float, y: float, z: float) -> int:
    """Reduce a simplex of `count` points, shape (`SIMPLEX`,), and one more; how many are left."""
    at = POINT * count
    w[at], w[at + 1], w[at + 2] = x, y, z
    return int(_reduced(w, count + 1))
