"""Vectors of three numbers, and of two."""

from __future__ import annotations

import math

from guidefield.kernels.jit.signatures import Vector3, inlined, lane_part


@inlined
def dot(a: Vector3, b: Vector3) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Vector3, b: Vector3) -> Vector3:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@lane_part
def unit_in_plane(x: float, y: float) -> tuple[float, float]:
    """The unit vector along a vector of any length in a plane; 0 for the vector 0."""
    size = max(abs(x), abs(y))
    if not size > 0.0:
        return 0.0, 0.0
    x, y = x / size, y / size  # squares of what is smaller than 1e-154 would vanish
    length = math.sqrt(x * x + y * y)
    return x / length, y / length
