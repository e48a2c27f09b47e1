"""Cubic splines: Hermite curves in time with exact extrema, uniform B-splines, not-a-knot interpolation.

`planner/motion` evaluates trajectories and splines by it: limits, certificates and replies speak of these very curves.
docs/certify.md promises "not a knot"; `spline_rates` in `planner/motion/submitted_motion.py` does two or three samples.
"""

from __future__ import annotations

import numpy as np

from guidefield.kernels.jit.arrays import Row, RowOut, Rows, RowsOut
from guidefield.kernels.jit.decorators import exact_kernel, inlined, kernel


@kernel
def piece_peaks(times: Row, positions: Rows, velocities: Rows, speeds_out: RowsOut, accelerations_out: RowsOut) -> None:
    """Write the largest |velocity| and |acceleration| of every coordinate on every piece, shapes (n - 1, c).

    With the mean velocity m over the duration T of a piece, and v, w the velocities at its ends, the acceleration is
    linear between a = (6 m - 4 v - 2 w) / T and b = (2 v + 4 w - 6 m) / T, so largest at an end. The velocity is
    quadratic: largest at an end or, where the acceleration changes sign, at its zero: v + a² T / (2 (a - b)). Times
    (n,) increase strictly [s], positions and velocities have the shape (n, c).
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


@exact_kernel
def largest_shares(
    times: Row,
    positions: Rows,
    velocities: Rows,
    velocity_limits: Row,
    acceleration_limits: Row,
    jerk_limits: Row,
    out: RowOut,
) -> None:
    """Write the largest velocity, acceleration and jerk of a curve, as shares (3,) of their limits: see `piece_peaks`.

    Limits have the shape (c,) and are positive; those of jerk may be infinite.
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


@kernel
def states_at(
    times: Row,
    positions: Rows,
    velocities: Rows,
    accelerations: Rows,
    jerks: Rows,
    asked: Row,
    positions_out: RowsOut,
    velocities_out: RowsOut,
    accelerations_out: RowsOut,
) -> None:
    """Write position, velocity and acceleration (k, c) at times (k,) [s].

    Before the first knot and after the last it rests. Knots have times (n,), two at least, increasing strictly,
    positions and velocities (n, c), the accelerations where pieces begin, and pieces' jerks (n - 1, c); quickest where
    the times asked for are in order.
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


@kernel
def spline_points(points: Rows, places: Row, points_out: RowsOut) -> None:
    """Write where a spline of control points (m + 3, nv) is at places (k,), in pieces from 0 to m; (k, nv)."""
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


@kernel
def spline_slopes(points: Rows, places: Row, slopes_out: RowsOut) -> None:
    """Write its derivatives by the place, (k, nv); arguments are those of `spline_points`."""
    last = points.shape[0] - 4
    for k in range(places.shape[0]):
        piece = min(max(int(places[k]), 0), last)
        t = places[k] - piece
        s = 1.0 - t
        a, b, c, d = -0.5 * s * s, 0.5 * t * (3.0 * t - 4.0), 0.5 * s * (4.0 - 3.0 * s), 0.5 * t * t
        for j in range(points.shape[1]):
            value = a * points[piece, j] + b * points[piece + 1, j]
            slopes_out[k, j] = value + c * points[piece + 2, j] + d * points[piece + 3, j]


@kernel
def slopes(steps: Row, values: Rows, pivots_out: RowOut, above_out: RowOut, slopes_out: RowsOut) -> None:
    """Write first derivatives s (n, c) at knots of the C² piecewise cubic through values (n, c), "not a knot" at ends.

    The two first pieces are one cubic, and so are the two last ones. Continuity of the second derivative at inner knot
    i, with chords d_i = (y_{i+1} - y_i) / h_i, is

        h_i s_{i-1} + 2 (h_{i-1} + h_i) s_i + h_{i-1} s_{i+1} = 3 (h_i d_{i-1} + h_{i-1} d_i)

    and continuity of the third one at knot 1 makes the first row, with w = h_0 + h_1,

        h_1 s_0 + w s_1 = ((h_0 + 2 w) h_1 d_0 + h_0² d_1) / w

    and the last row its mirror image (de Boor, A Practical Guide to Splines, 2001, chapter IV). After the first row is
    eliminated the system is diagonally dominant but for the last row, whose pivot stays positive: no pivoting. Steps h
    (n - 1,), n >= 4, are positive; work space has the shape (n,).
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
