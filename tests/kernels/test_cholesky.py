"""Definite systems against numpy."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.kernels.cholesky import solve_definite


@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 3), (18, 2), (130, 5)])
def test_it_solves_what_numpy_solves(n: int, m: int) -> None:
    rng = np.random.default_rng(n)
    half, right, solution = rng.normal(size=(n, n)), rng.normal(size=(n, m)), np.empty((n, m))
    matrix = half @ half.T + 0.1 * np.eye(n)
    assert solve_definite(matrix, right, solution)
    np.testing.assert_allclose(solution, np.linalg.solve(matrix, right), rtol=1e-7, atol=1e-9)
    assert solve_definite(np.tril(matrix), right, solution)


@pytest.mark.parametrize("worst", [0.0, -1.0, np.nan])
def test_what_is_not_definite_is_said(worst: float) -> None:
    assert not solve_definite(np.diag([1.0, worst, 2.0]), np.ones((3, 1)), np.empty((3, 1)))
