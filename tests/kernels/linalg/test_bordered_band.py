"""The solution of a banded system with a border against a dense one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from guidefield.kernels.linalg.bordered_band import (
    AT_ONCE,
    COUPLED,
    BorderedFactor,
    factorize_bordered,
    solve_factorized,
)


def system(blocks: int, size: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Blocks of a random positive definite system, its right side, and the whole matrix, the border last."""
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
    border = rng.normal(size=n)
    corner = border @ np.linalg.solve(band, border) + 1.0
    return of_blocks, rng.normal(size=n + 1), np.block([[band, border[:, None]], [border[None], np.array([[corner]])]])


def factorized(of_blocks: np.ndarray, border: np.ndarray, corner: float, damping: float) -> BorderedFactor | None:
    """The factors; None where the system isn't positive definite."""
    n, size, width = of_blocks.shape
    band, (one, other) = np.empty((n * size, width + AT_ONCE - 1)), np.empty((2, n * size))
    factor = BorderedFactor(band, one, other, np.empty(1))
    return factor if factorize_bordered(of_blocks, border, corner, damping, factor) else None


@given(st.integers(1, 12), st.integers(1, 5), st.integers(0, 1000), st.sampled_from([0.0, 0.3]))
def test_agrees_with_a_dense_solution(blocks: int, size: int, seed: int, damping: float) -> None:
    of_blocks, right, matrix = system(blocks, size, seed)
    factor, solution = factorized(of_blocks, matrix[-1, :-1].copy(), matrix[-1, -1], damping), np.empty(len(right))
    assert factor is not None
    for one in (right, right[::-1].copy()):
        solve_factorized(factor, one, solution)
        expected = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), one)
        np.testing.assert_allclose(solution, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("place", [(2, 1), None])
def test_what_is_not_positive_definite_is_refused(place: tuple[int, int] | None) -> None:
    of_blocks, _, matrix = system(5, 3, 0)
    corner = matrix[-1, -1]
    if place is None:
        corner -= 2.0  # less than what the border takes
    else:
        of_blocks[place[0], place[1], COUPLED * 3 + place[1]] = -1.0
    assert factorized(of_blocks, matrix[-1, :-1].copy(), corner, 0.0) is None


def test_inputs_are_left_alone() -> None:
    of_blocks, right, matrix = system(6, 2, 3)
    arrays = of_blocks, matrix[-1, :-1].copy(), right
    for array in arrays:
        array.setflags(write=False)
    factor = factorized(arrays[0], arrays[1], matrix[-1, -1], 0.0)
    assert factor is not None
    solve_factorized(factor, arrays[2], np.empty(len(right)))
