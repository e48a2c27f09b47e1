"""The tridiagonal solve against a dense one."""

import numpy as np
import pytest

from guidefield.kernels.timing.natural_spline import second_derivatives


def solved(kernel, steps, values):
    second = np.full_like(values, np.nan)
    kernel(steps, values, np.full(len(values), np.nan), second)
    return second


def dense(steps, values):
    n = len(values)
    system, right = np.eye(n), np.zeros_like(values)
    chords = np.diff(values, axis=0) / steps[:, None]
    for i in range(1, n - 1):
        system[i, i - 1 : i + 2] = steps[i - 1], 2.0 * (steps[i - 1] + steps[i]), steps[i]
        right[i] = 6.0 * (chords[i] - chords[i - 1])
    return np.linalg.solve(system, right)


@pytest.mark.parametrize("n", [2, 3, 4, 40])
def test_agrees_with_a_dense_solve(n):
    rng = np.random.default_rng(n)
    steps, values = 10.0 ** rng.uniform(-2, 1, n - 1), rng.normal(size=(n, 3))
    second = solved(second_derivatives, steps, values)
    expected = dense(steps, values)
    # the system's rows are graded over the steps' three decades
    np.testing.assert_allclose(second, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
    np.testing.assert_allclose(solved(second_derivatives.py_func, steps, values), second, rtol=1e-12, atol=1e-12)


def test_a_straight_line_has_none():
    steps = np.array([0.1, 2.0, 0.5])
    values = np.concatenate([[0.0], np.cumsum(steps)])[:, None] * np.array([1.0, -2.0])
    np.testing.assert_allclose(solved(second_derivatives, steps, values), 0.0, atol=1e-12)
