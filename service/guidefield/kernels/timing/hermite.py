"""Cubic splines: Hermite curves in time with exact extrema, uniform B-splines, not-a-knot interpolation."""

from __future__ import annotations

import numpy as np
from numba import void

from guidefield.kernels.jit.signatures import (
    MATRIX,
    MATRIX_OUT,
    VECTOR,
    VECTOR_OUT,
    Floats,
    compiled,
    exact_kernel,
    inlined,
)


@compiled(void(VECTOR, MATRIX, MATRIX, MATRIX_OUT, MATRIX_OUT))
def piece_peaks(
    times: Floats, positions: Floats, velocities: Floats, speeds_out: Floats, accelerations_out: Floats
) -> None:
    """Largest |velocity| and |acceleration| of every coordinate on every piece.

    With the mean velocity m over the duration T of a piece, and v, w the velocities at its ends, the acceleration is
    linear between a = (6 m - 4 v - 2 w) / T and b = (2 v + 4 w - 6 m) / T, so largest at an end. The velocity is
    quadratic: largest at an end or, where the acceleration changes sign, at its zero: v + a² T / (2 (a - b)).

    Args:
        times: Shape (n,), strictly increasing [s].
        positions: Shape (n, c) [rad or m].
        velocities: Shape (n, c) [rad/s or m/s].
        speeds_out: Shape (n - 1, c) [rad/s or m/s].
        accelerations_out: Shape (n - 1, c) [rad/s^2 or m/s^2].
    """
    for i in range(times.shape[0] - 1):
        duration = times[i + 1] - times[i]
        for c in range(positions.shape[1]):
            v, w = velocities[i, c], velocities[i + 1, c]
            mean = (positions[i + 1, c] - positions[i, c]) / duration
            a = (6.0 * mean - 4.0 * v - 2.0 * w) / duration
            b = (2.0 * v + 4.0 * w - 6.0 * mean) / duration
            speed = max(abs(v), abs(w))
            if a * b < 0.0:
                speed = max(speed, abs(v + a * a * duration / (2.0 * (a - b))))
            speeds_out[i, c] = speed
            accelerations_out[i, c] = max(abs(a), abs(b))


@exact_kernel(void(VECTOR, MATRIX, MATRIX, VECTOR, VECTOR, VECTOR, VECTOR_OUT))
def largest_shares(
    times: Floats,
    positions: Floats,
    velocities: Floats,
    velocity_limits: Floats,
    acceleration_limits: Floats,
    jerk_limits: Floats,
    out: Floats,
) -> None:
    """The largest velocity, acceleration and jerk of a curve, as shares of their limits: see `piece_peaks`.

    Args:
        times: Shape (n,), strictly increasing [s].
        positions: Shape (n, c) [rad or m].
        velocities: Shape (n, c) [rad/s or m/s].
        velocity_limits: Shape (c,), positive [rad/s or m/s].
        acceleration_limits: Shape (c,), positive [rad/s² or m/s²].
        jerk_limits: Shape (c,), positive or infinite [rad/s³ or m/s³].
        out: The three shares, shape (3,).
    """
    pieces, coordinates = times.shape[0] - 1, positions.shape[1]
    speeds, accelerations = np.empty((pieces, coordinates)), np.empty((pieces, coordinates))
    piece_peaks(times, positions, velocities, speeds, accelerations)
    out[:] = 0.0
    for i in range(pieces):
        duration = times[i + 1] - times[i]
        for c in range(coordinates):
            v, w = velocities[i, c], velocities[i + 1, c]
            mean = (positions[i + 1, c] - positions[i, c]) / duration
            a = (6.0 * mean - 4.0 * v - 2.0 * w) / duration
            b = (2.0 * v + 4.0 * w - 6.0 * mean) / duration
            out[0] = max(out[0], speeds[i, c] / velocity_limits[c])
            out[1] = max(out[1], accelerations[i, c] / acceleration_limits[c])
            out[2] = max(out[2], abs(b - a) / duration / jerk_limits[c])


@inlined
def place_and_rate(q: float, v: float, a: float, jerk: float, t: float) -> tuple[float, float]:
    """Position and velocity of a coordinate at a time in a piece, by those and its acceleration where it begins."""
    return q + t * (v + t * (a / 2.0 + t * jerk / 6.0)), v + t * (a + t * jerk / 2.0)


@compiled(void(VECTOR, MATRIX, MATRIX, MATRIX, MATRIX, VECTOR, MATRIX_OUT, MATRIX_OUT, MATRIX_OUT))
def states_at(
    times: Floats,
    positions: Floats,
    velocities: Floats,
    accelerations: Floats,
    jerks: Floats,
    asked: Floats,
    positions_out: Floats,
    velocities_out: Floats,
    accelerations_out: Floats,
) -> None:
    """Position, velocity and acceleration at some times; before the first knot and after the last one it is at rest.

    Args:
        times: Of the knots, two at least, shape (n,), strictly increasing [s].
        positions: At the knots, shape (n, c) [rad or m].
        velocities: Shape (n, c) [rad/s or m/s].
        accelerations: Where each piece begins, shape (n, c), the last row isn't read [rad/s^2 or m/s^2].
        jerks: Of the pieces, shape (n - 1, c) [rad/s^3 or m/s^3].
        asked: The times, shape (k,) [s]; quickest in order.
        positions_out: Shape (k, c).
        velocities_out: Shape (k, c).
        accelerations_out: Shape (k, c).
    """
    last, piece = times.shape[0] - 1, 0
    for row in range(asked.shape[0]):
        time = asked[row]
        inside = min(max(time, times[0]), times[last])
        if not times[piece] <= inside < times[piece + 1]:
            low, high = 0, last
            while high - low > 1:
                middle = (low + high) // 2
                if times[middle] <= inside:
                    low = middle
                else:
                    high = middle
            piece = low
        t, rests = inside - times[piece], time < times[0] or time > times[last]
        for c in range(positions.shape[1]):
            q, v, a, jerk = positions[piece, c], velocities[piece, c], accelerations[piece, c], jerks[piece, c]
            at, rate = place_and_rate(q, v, a, jerk, t)
            positions_out[row, c] = positions[last, c] if inside == times[last] else at
            velocities_out[row, c] = 0.0 if rests else rate
            accelerations_out[row, c] = 0.0 if rests else a + t * jerk


@compiled(void(MATRIX, VECTOR, MATRIX_OUT))
def spline_points(points: Floats, places: Floats, points_out: Floats) -> None:
    """Return where a spline is.

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


@compiled(void(VECTOR, MATRIX, VECTOR_OUT, VECTOR_OUT, MATRIX_OUT))
def slopes(steps: Floats, values: Floats, pivots_out: Floats, above_out: Floats, slopes_out: Floats) -> None:
    """First derivatives s at the knots of the C² piecewise cubic through values, "not a knot" at its ends.

    The two first pieces are one cubic, and so are the two last ones. Continuity of the second derivative at inner knot
    i, with chords d_i = (y_{i+1} - y_i) / h_i, is

        h_i s_{i-1} + 2 (h_{i-1} + h_i) s_i + h_{i-1} s_{i+1} = 3 (h_i d_{i-1} + h_{i-1} d_i)

    and continuity of the third one at knot 1 makes the first row, with w = h_0 + h_1,

        h_1 s_0 + w s_1 = ((h_0 + 2 w) h_1 d_0 + h_0² d_1) / w

    and the last row its mirror image (de Boor, A Practical Guide to Splines, 2001, chapter IV). After the first row is
    eliminated the system is diagonally dominant but for the last row, whose pivot stays positive: no pivoting.

    Args:
        steps: Differences h between knots, shape (n - 1,), n >= 4, positive.
        values: Values y at the knots, shape (n, c).
        pivots_out: Work space, shape (n,).
        above_out: Work space, shape (n,).
        slopes_out: The result s, shape (n, c).
    """
    last = steps.shape[0]
    h0, h1 = steps[0], steps[1]
    wide = h0 + h1
    pivots_out[0], above_out[0] = h1, wide
    for c in range(values.shape[1]):
        first, second = (values[1, c] - values[0, c]) / h0, (values[2, c] - values[1, c]) / h1
        slopes_out[0, c] = ((h0 + 2.0 * wide) * h1 * first + h0 * h0 * second) / wide
    for i in range(1, last):
        before, after = steps[i - 1], steps[i]
        ratio = after / pivots_out[i - 1]
        pivots_out[i], above_out[i] = 2.0 * (before + after) - ratio * above_out[i - 1], before
        for c in range(values.shape[1]):
            first, second = (values[i, c] - values[i - 1, c]) / before, (values[i + 1, c] - values[i, c]) / after
            slopes_out[i, c] = 3.0 * (after * first + before * second) - ratio * slopes_out[i - 1, c]
    h0, h1 = steps[last - 1], steps[last - 2]
    wide = h0 + h1
    ratio = wide / pivots_out[last - 1]
    pivots_out[last] = h1 - ratio * above_out[last - 1]
    for c in range(values.shape[1]):
        first, second = (values[last, c] - values[last - 1, c]) / h0, (values[last - 1, c] - values[last - 2, c]) / h1
        right = ((h0 + 2.0 * wide) * h1 * first + h0 * h0 * second) / wide
        slopes_out[last, c] = (right - ratio * slopes_out[last - 1, c]) / pivots_out[last]
    for i in range(last - 1, -1, -1):
        for c in range(values.shape[1]):
            slopes_out[i, c] = (slopes_out[i, c] - above_out[i] * slopes_out[i + 1, c]) / pivots_out[i]
