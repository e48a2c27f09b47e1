"""The solution of a banded system with a border against a dense one."""

import numpy as np
from hypothesis import given, strategies as st

from guidefield.kernels.linalg.bordered_band import (
    COUPLED,
    BorderedFactor,
    allocate_factor,
    factorize_bordered,
    solve_factorized,
)


def system(blocks: int, size: int, more: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Blocks of a random positive definite system, its right side, and the whole matrix, the border's rows last."""
    rng = np.random.default_rng(seed)
    n = blocks * size
    root = np.tril(rng.normal(size=(n, n)))
    for f in range(blocks):
        root[f * size : (f + 1) * size, : max(f - COUPLED, 0) * size] = 0.0
    band = root @ root.T + 0.1 * np.eye(n)
    of_blocks = np.zeros((blocks, size, (COUPLED + 1) * size))
    for f in range(blocks):
        for c in range(COUPLED + 1):
            if (k := f - COUPLED + c) >= 0:
                rows, columns = slice(f * size, (f + 1) * size), slice(k * size, (k + 1) * size)
                of_blocks[f, :, c * size : (c + 1) * size] = band[rows, columns]
    border, root = rng.normal(size=(more, n)), rng.normal(size=(more, more))
    corner = border @ np.linalg.solve(band, border.T) + 0.1 * root @ root.T + np.eye(more)
    return of_blocks, rng.normal(size=n + more), np.block([[band, border.T], [border, corner]])


def factorized(
    of_blocks: np.ndarray, matrix: np.ndarray, damping: float, groups: tuple[int, ...] = ()
) -> BorderedFactor | None:
    """The factors, with the border of the whole matrix; None where the system isn't positive definite."""
    n, size, _ = of_blocks.shape
    rows, more = n * size, len(matrix) - n * size
    factor = allocate_factor(n, size, more)
    border, corner = (np.ascontiguousarray(part) for part in (matrix[rows:, :rows], matrix[rows:, rows:]))
    return (
        factor
        if factorize_bordered(of_blocks, np.array(groups or (0, size)), border, corner, damping, factor)
        else None
    )


@given(st.integers(1, 12), st.integers(1, 5), st.integers(1, 2), st.integers(0, 1000), st.sampled_from([0.0, 0.3]))
def test_agrees_with_a_dense_solution(blocks: int, size: int, more: int, seed: int, damping: float) -> None:
    of_blocks, right, matrix = system(blocks, size, more, seed)
    factor, solution = factorized(of_blocks, matrix, damping), np.empty(len(right))
    assert factor is not None
    for one in (right, right[::-1].copy()):
        solve_factorized(factor, len(of_blocks), one, solution)
        expected = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), one)
        np.testing.assert_allclose(solution, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


@given(st.integers(2, 8), st.integers(1, 20), st.integers(0, 1000), st.floats(0.0, 1.0))
def test_what_is_not_coupled_makes_no_difference(blocks: int, size: int, seed: int, share: float) -> None:
    of_blocks, right, matrix = system(blocks, size, 1, seed)
    n, rng = blocks * size, np.random.default_rng(seed)
    coupled = np.kron(np.ones((blocks, blocks)), np.eye(size)) + (rng.uniform(size=(n, n)) < share)
    coupled = (coupled + coupled.T > 0.0) * matrix[:n, :n]
    matrix[:n, :n] = coupled + np.diag(np.abs(coupled).sum(axis=1))
    for f in range(blocks):
        for c in range(COUPLED + 1):
            if (k := f - COUPLED + c) >= 0:
                rows, columns = slice(f * size, (f + 1) * size), slice(k * size, (k + 1) * size)
                of_blocks[f, :, c * size : (c + 1) * size] = matrix[rows, columns]
    matrix[-1, -1] += matrix[-1, :n] @ np.linalg.solve(matrix[:n, :n], matrix[:n, -1])
    factor, solution = factorized(of_blocks, matrix, 0.0), np.empty(len(right))
    assert factor is not None
    solve_factorized(factor, len(of_blocks), right, solution)
    np.testing.assert_allclose(matrix @ solution, right, atol=1e-8 * np.abs(matrix).max())
