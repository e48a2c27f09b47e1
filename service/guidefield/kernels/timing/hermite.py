"""A cubic Hermite curve in time: where it is, and exact extrema of velocity and acceleration on its pieces."""

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
