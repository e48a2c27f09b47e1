"""The principal axes of points: a singular value decomposition by rotations between pairs of columns.

One column for each coordinate; each rotation makes two of them orthogonal, until all are. What is thin comes out as
exactly as what is long. Source: M. R. Hestenes, "Inversion of matrices by biorthogonalization and related results",
Journal of the Society for Industrial and Applied Mathematics 6(1), 1958.
"""

from __future__ import annotations

import math

from numba import void

from guidefield.kernels.jit.signatures import MATRIX_OUT, VECTOR_OUT, Floats, compiled, inlined

_ORTHOGONAL = 1e-15
"""Cosine of columns that count as orthogonal."""

_SWEEPS = 30
"""Most rounds over all pairs; four or five are usual."""


@inlined
def _rotation(points: Floats, p: int, q: int) -> tuple[float, float]:
    """Cosine and sine of the rotation that makes two columns orthogonal; 1 and 0 if they are."""
    first = second = both = 0.0
    for i in range(points.shape[0]):
        x, y = points[i, p], points[i, q]
        first += x * x
        second += y * y
        both += x * y
    if first == 0.0 or second == 0.0 or abs(both) <= _ORTHOGONAL * math.sqrt(first) * math.sqrt(second):
        return 1.0, 0.0
    cotangent = 0.5 * (second - first) / both
    tangent = math.copysign(1.0, cotangent) / (abs(cotangent) + math.hypot(1.0, cotangent))
    cosine = 1.0 / math.hypot(1.0, tangent)
    return cosine, cosine * tangent


@inlined
def _sort(spread_out: Floats, axes_out: Floats) -> None:
    """Put the largest first."""
    for p in (0, 1, 0):
        if spread_out[p] < spread_out[p + 1]:
            spread_out[p], spread_out[p + 1] = spread_out[p + 1], spread_out[p]
            for k in range(3):
                axes_out[p, k], axes_out[p + 1, k] = axes_out[p + 1, k], axes_out[p, k]


@compiled(void(MATRIX_OUT, VECTOR_OUT, MATRIX_OUT))
def principal_axes(points: Floats, spread_out: Floats, axes_out: Floats) -> None:
    """Find the singular values and right singular vectors of points, the largest first.

    Args:
        points: Shape (n, 3), in any unit; left turned into the axes.
        spread_out: Gets the singular values, shape (3,), in that unit.
        axes_out: Gets unit vectors, one in each row, shape (3, 3).
    """
    for k in range(9):
        axes_out[k // 3, k % 3] = 1.0 if k % 4 == 0 else 0.0
    for _ in range(_SWEEPS):
        turned = False
        for p, q in ((0, 1), (0, 2), (1, 2)):
            cosine, sine = _rotation(points, p, q)
            if sine == 0.0:
                continue
            turned = True
            for i in range(points.shape[0]):
                x, y = points[i, p], points[i, q]
                points[i, p], points[i, q] = cosine * x - sine * y, sine * x + cosine * y
            for k in range(3):
                x, y = axes_out[p, k], axes_out[q, k]
                axes_out[p, k], axes_out[q, k] = cosine * x - sine * y, sine * x + cosine * y
        if not turned:
            break
    for p in range(3):
        square = 0.0
        for i in range(points.shape[0]):
            square += points[i, p] * points[i, p]
        spread_out[p] = math.sqrt(square)
    _sort(spread_out, axes_out)
