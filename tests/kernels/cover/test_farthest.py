from __future__ import annotations

import numpy as np
import pytest

from guidefield.kernels.cover.pieces import BLOCK, farthest_first


def plainly(candidates: np.ndarray, start: int, spacing: float) -> tuple[list[int], np.ndarray]:
    """All distances to every new point."""
    chosen, nearest = [start], np.full(len(candidates), np.inf)
    owner = np.zeros(len(candidates), np.int64)
    while True:
        squares = ((candidates - candidates[chosen[-1]]) ** 2).sum(axis=1)
        owner[squares < nearest] = len(chosen) - 1
        nearest = np.minimum(nearest, squares)
        if nearest.max() < spacing**2 or len(chosen) == len(candidates):
            return chosen, owner
        chosen.append(int(nearest.argmax()))


@pytest.mark.parametrize("count", [1, BLOCK - 1, BLOCK, 1000])
@pytest.mark.parametrize("spacing", [0.02, 0.3, 5.0])
def test_chooses_what_all_distances_choose(count: int, spacing: float) -> None:
    candidates = np.random.default_rng(count).uniform(size=(count, 3))
    candidates = np.ascontiguousarray(candidates[np.argsort(candidates[:, 0])])
    chosen, owner = np.empty(count, np.int64), np.empty(count, np.int64)
    number = farthest_first(candidates, count // 2, spacing, chosen, owner)
    expected, expected_owner = plainly(candidates, count // 2, spacing)
    assert chosen[:number].tolist() == expected
    assert (owner == expected_owner).all()


def test_candidates_in_one_place_are_chosen_once() -> None:
    chosen, owner = np.empty(70, np.int64), np.empty(70, np.int64)
    assert farthest_first(np.ones((70, 3)), 3, 0.1, chosen, owner) == 1
    assert not owner.any()
