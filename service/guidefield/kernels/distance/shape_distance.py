"""Signed distance of a point to primitive shapes in their own frames, and the unit vector along which it grows.

On an axis or in a middle plane, where the vector isn't unique, it is one of those possible. `points_distance` has the
same formulas for lanes of points.
"""

from __future__ import annotations

import math

from guidefield.kernels.jit.arrays import Vector3
from guidefield.kernels.jit.decorators import inlined

Signed = tuple[float, float, float, float]  # signed distance [m] and the unit vector (3) along which it grows


@inlined
def box_distance(p: Vector3, half: Vector3) -> Signed:
    """Box of half extents `half` about the origin."""
    ex, ey, ez = abs(p[0]) - half[0], abs(p[1]) - half[1], abs(p[2]) - half[2]
    sx = 1.0 if p[0] >= 0.0 else -1.0
    sy = 1.0 if p[1] >= 0.0 else -1.0
    sz = 1.0 if p[2] >= 0.0 else -1.0
    if ex <= 0.0 and ey <= 0.0 and ez <= 0.0:
        if ex >= ey and ex >= ez:
            return ex, sx, 0.0, 0.0
        return (ey, 0.0, sy, 0.0) if ey >= ez else (ez, 0.0, 0.0, sz)
    ex, ey, ez = max(ex, 0.0), max(ey, 0.0), max(ez, 0.0)
    distance = math.sqrt(ex * ex + ey * ey + ez * ez)
    over = 1.0 / distance
    return distance, over * ex * sx, over * ey * sy, over * ez * sz


@inlined
def cylinder_distance(p: Vector3, radius: float, half: float) -> Signed:
    """Cylinder with flat ends along z, from -half to half."""
    rho = math.sqrt(p[0] * p[0] + p[1] * p[1])
    rx = p[0] / rho if rho > 0.0 else 1.0
    ry = p[1] / rho if rho > 0.0 else 0.0
    side, end = rho - radius, abs(p[2]) - half
    sz = 1.0 if p[2] >= 0.0 else -1.0
    if side <= 0.0 and end <= 0.0:
        return (side, rx, ry, 0.0) if side >= end else (end, 0.0, 0.0, sz)
    side, end = max(side, 0.0), max(end, 0.0)
    distance = math.sqrt(side * side + end * end)
    over = 1.0 / distance
    return distance, over * side * rx, over * side * ry, over * end * sz


@inlined
def capsule_distance(p: Vector3, radius: float, half: float) -> Signed:
    """Capsule about the segment from -half to half of the z axis."""
    dz = p[2] - min(max(p[2], -half), half)
    distance = math.sqrt(p[0] * p[0] + p[1] * p[1] + dz * dz)
    if distance == 0.0:
        return -radius, 1.0, 0.0, 0.0
    over = 1.0 / distance
    return distance - radius, over * p[0], over * p[1], over * dz
