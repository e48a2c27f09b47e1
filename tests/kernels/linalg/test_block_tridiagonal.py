"""The block-tridiagonal solution against a dense one."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.kernels.linalg.block_tridiagonal import solve_free


def system(blocks: int, size: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Blocks of a random positive definite system, its right side, and the whole matrix."""
    rng = np.random.default_rng(seed)
    n = blocks * size
    root = np.zeros((n, n))
    for k in range(blocks):
        rows = slice(k * size, (k + 1) * size)
        root[rows, rows.start : min(n, rows.stop + size)] = rng.normal(
            size=root[rows, rows.start : rows.stop + size].shape
        )
    matrix = root.T @ root + 0.1 * np.eye(n)
    cells = matrix.reshape(blocks, size, blocks, size).transpose(0, 2, 1, 3)
    diagonal = np.ascontiguousarray([cells[k, k] for k in range(blocks)])
    upper = np.array([cells[k, k + 1] for k in range(blocks - 1)]).reshape(-1, size, size)
    return diagonal, upper, rng.normal(size=(blocks, size)), matrix


@pytest.mark.parametrize(("blocks", "size"), [(1, 1), (1, 7), (2, 3), (9, 7), (33, 2)])
def test_agrees_with_a_dense_solution(blocks: int, size: int) -> None:
    diagonal, upper, right, matrix = system(blocks, size, blocks)
    solution = np.empty((blocks, size))
    damping = np.linspace(0.0, 2.0, size)
    assert solve_free(diagonal, upper, right, np.ones((blocks, size)), damping, solution)
    matrix = matrix + np.diag(np.tile(damping, blocks))
    np.testing.assert_allclose(solution.ravel(), np.linalg.solve(matrix, right.ravel()), rtol=1e-8, atol=1e-10)


def test_unknowns_that_are_not_free_stay_zero_and_the_others_solve_what_is_left() -> None:
    diagonal, upper, right, matrix = system(6, 4, 3)
    free = np.random.default_rng(0).integers(0, 2, (6, 4)).astype(float)
    free[0] = free[-1] = 0.0
    solution = np.empty((6, 4))
    assert solve_free(diagonal, upper, right, free, np.zeros(4), solution)
    kept = free.ravel() > 0.0
    assert (solution.ravel()[~kept] == 0.0).all()
    expected = np.linalg.solve(matrix[np.ix_(kept, kept)], right.ravel()[kept])
    np.testing.assert_allclose(solution.ravel()[kept], expected, rtol=1e-8, atol=1e-10)


def test_inputs_are_left_alone() -> None:
    arrays = system(4, 3, 1)[:3]
    for array in arrays:
        array.setflags(write=False)
    assert solve_free(*arrays, np.ones((4, 3)), np.zeros(3), np.empty((4, 3)))


def test_what_is_not_positive_definite_is_refused_until_it_is_damped() -> None:
    diagonal, upper, right, matrix = system(4, 3, 2)
    diagonal = diagonal - 2.0 * np.abs(matrix).sum() * np.eye(3)
    assert not solve_free(diagonal, upper, right, np.ones((4, 3)), np.zeros(3), np.empty((4, 3)))
    assert solve_free(diagonal, upper, right, np.ones((4, 3)), np.full(3, 4.0 * np.abs(matrix).sum()), np.empty((4, 3)))
