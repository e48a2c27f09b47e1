"""Coordinates fall into groups exactly where no Hessian couples them."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st

from guidefield.kernels.linalg.bordered_band import TILE
from guidefield.kernels.optimize.clearance_model import ClearanceModel
from guidefield.kernels.optimize.newton_descent import coupled_groups

PLACES = st.lists(st.tuples(st.integers(0, 39), st.integers(0, 39)), max_size=6)


def model(nv: int, coupled: list[tuple[int, int]]) -> ClearanceModel:
    """One whose places couple a pair of coordinates each."""
    hessians = np.zeros((len(coupled) + 1, nv, nv))
    hessians[-1] = 1.0  # memory behind the last place
    for hessian, (p, q) in zip(hessians, coupled, strict=False):
        hessian[[p, p, q, q], [p, q, p, q]] = 1.0
    points, nothing = np.zeros((7, nv)), np.zeros(2)
    places = len(coupled), np.zeros(len(hessians), np.int64), np.zeros((len(hessians), 4)), hessians
    return ClearanceModel(0.0, points, 1.0, 0.0, points, *places, np.zeros((2, 7, nv)), nothing, np.zeros((2, 2)))


def groups_of(nv: int, coupled: list[tuple[int, int]], constrained: bool = False) -> list[int]:
    """The groups' bounds."""
    found = np.full(-(-nv // TILE) + 1, -1)
    coupled_groups(model(nv, coupled), constrained, found)
    return found[: int(np.flatnonzero(found == nv)[0]) + 1].tolist()


@given(st.integers(1, 40), PLACES)
def test_a_group_ends_exactly_where_nothing_is_coupled_across(nv: int, coupled: list[tuple[int, int]]) -> None:
    within = [(p, q) for p, q in coupled if max(p, q) < nv]
    found = groups_of(nv, within)
    bounds = [b for b in range(TILE, nv, TILE) if not any(min(pair) < b <= max(pair) for pair in within)]
    assert found == [0, *bounds, nv]
