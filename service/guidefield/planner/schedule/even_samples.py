"""The cubic curve through even samples in time that is twice continuously differentiable, at rest at both ends."""

from __future__ import annotations

from typing import cast

import numpy as np

from guidefield.robot.model.spaces import ChartPoints, ChartRates


def smooth(times: np.ndarray, positions: ChartPoints) -> tuple[ChartPoints, ChartRates]:
    """Positions and velocities (n, nv) of the C² cubic through points at even times, at rest at both ends.

    No acceleration at an end takes away the freedom of the point next to it, which moves a little. With step h and
    v = 0 at both ends the velocities solve v_{i-1} + 4 v_i + v_{i+1} = 3 (q_{i+1} - q_{i-1}) / h; q_1 = q_0 + h v_1 / 3
    makes the acceleration at the start vanish, and the same holds at the end.
    """
    n, h = len(times), float(times[1] - times[0])
    right = 3.0 * (positions[2:] - positions[:-2]) / h
    lower, upper = np.ones(n - 2), np.ones(n - 2)
    lower[1], right[1] = 2.0, 3.0 * (positions[3] - positions[0]) / h
    upper[-2], right[-2] = 2.0, 3.0 * (positions[-1] - positions[-4]) / h
    velocities = cast(ChartRates, np.zeros_like(positions))
    velocities[1:-1] = _tridiagonal(lower, 4.0, upper, right)
    moved = positions.copy()
    moved[1] = positions[0] + h * velocities[1] / 3.0
    moved[-2] = positions[-1] - h * velocities[-2] / 3.0
    return moved, velocities


def _tridiagonal(lower: np.ndarray, diagonal: float, upper: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve a diagonally dominant tridiagonal system for several right-hand sides (n, c), by Thomas' algorithm."""
    n = len(right)
    pivots, solution = np.full(n, diagonal), right.copy()
    for i in range(1, n):
        ratio = lower[i] / pivots[i - 1]
        pivots[i] -= ratio * upper[i - 1]
        solution[i] -= ratio * solution[i - 1]
    solution[-1] /= pivots[-1]
    for i in range(n - 2, -1, -1):
        solution[i] = (solution[i] - upper[i] * solution[i + 1]) / pivots[i]
    return solution
