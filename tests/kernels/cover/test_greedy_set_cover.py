from itertools import combinations

import numpy as np
from hypothesis import given, settings, strategies as st

from guidefield.kernels.cover.ball_cover import greedy_choice


def packed(rows: np.ndarray) -> np.ndarray:
    """Rows of truth values as bits, 64 to a word."""
    padded = np.zeros((len(rows), 64 * max(1, -(-rows.shape[1] // 64))), bool)
    padded[:, : rows.shape[1]] = rows
    return np.packbits(padded, axis=1, bitorder="little").view(np.uint64)


def chosen_by_greed(rows: np.ndarray) -> np.ndarray:
    chosen = np.empty(len(rows), np.int64)
    return chosen[: greedy_choice(packed(rows), chosen)]


def fewest(rows: np.ndarray) -> int:
    """By trying all choices."""
    wanted = rows.any(axis=0)
    for count in range(len(rows) + 1):
        if any((rows[list(some)].any(axis=0) == wanted).all() for some in combinations(range(len(rows)), count)):
            return count
    raise AssertionError


problems = st.tuples(st.integers(0, 10**6), st.integers(1, 9), st.integers(1, 140), st.floats(0.02, 0.6)).map(
    lambda drawn: np.random.default_rng(drawn[0]).random((drawn[1], drawn[2])) < drawn[3]
)


@settings(max_examples=24)
@given(problems)
def test_all_that_can_be_contained_is_by_few_sets(rows: np.ndarray) -> None:
    """The greedy choice has at most the harmonic number of the largest set times as many as needed (Chvatal 1979)."""
    choice = chosen_by_greed(rows)
    assert len(set(choice.tolist())) == len(choice)
    assert (rows[choice].any(axis=0) == rows.any(axis=0)).all()
    harmonic = (1.0 / np.arange(1, rows.sum(axis=1).max(initial=1) + 1)).sum()
    assert len(choice) <= harmonic * fewest(rows) + 1e-9
