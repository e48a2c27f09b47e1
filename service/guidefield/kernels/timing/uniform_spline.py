"""Places on a uniform cubic B-spline."""

from __future__ import annotations

from numba import void

from guidefield.kernels.jit.signatures import MATRIX, MATRIX_OUT, VECTOR, Floats, compiled


@compiled(void(MATRIX, VECTOR, MATRIX_OUT))
def spline_points(points: Floats, places: Floats, points_out: Floats) -> None:
    """Where a spline is.

    Args:
        points: Control points of m pieces, shape (m + 3, nv) [rad or m].
        places: In pieces from the start, from 0 to m, shape (k,).
        points_out: Shape (k, nv) [rad or m].
    """
    last = points.shape[0] - 4
    for k in range(places.shape[0]):
        piece = min(max(int(places[k]), 0), last)
        t = places[k] - piece
        s = 1.0 - t
        a, d = s * s * s / 6.0, t * t * t / 6.0
        b, c = (4.0 + t * t * (3.0 * t - 6.0)) / 6.0, (4.0 + s * s * (3.0 * s - 6.0)) / 6.0
        for j in range(points.shape[1]):
            value = a * points[piece, j] + b * points[piece + 1, j]
            points_out[k, j] = value + c * points[piece + 2, j] + d * points[piece + 3, j]


@compiled(void(MATRIX, VECTOR, MATRIX_OUT))
def spline_slopes(points: Floats, places: Floats, slopes_out: Floats) -> None:
    """Its derivatives by the place.

    Args:
        points: Control points, shape (m + 3, nv) [rad or m].
        places: As in `spline_points`, shape (k,).
        slopes_out: Shape (k, nv) [rad or m].
    """
    last = points.shape[0] - 4
    for k in range(places.shape[0]):
        piece = min(max(int(places[k]), 0), last)
        t = places[k] - piece
        s = 1.0 - t
        a, b, c, d = -0.5 * s * s, 0.5 * t * (3.0 * t - 4.0), 0.5 * s * (4.0 - 3.0 * s), 0.5 * t * t
        for j in range(points.shape[1]):
            value = a * points[piece, j] + b * points[piece + 1, j]
            slopes_out[k, j] = value + c * points[piece + 2, j] + d * points[piece + 3, j]
