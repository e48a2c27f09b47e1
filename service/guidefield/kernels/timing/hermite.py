"""Exact extrema of velocity and acceleration on the pieces of a cubic Hermite curve in time."""

from __future__ import annotations

from numba import void

from guidefield.kernels.jit.signatures import MATRIX, MATRIX_OUT, VECTOR, Floats, compiled


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
