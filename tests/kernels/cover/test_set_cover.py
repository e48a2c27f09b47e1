from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.kernels.cover.greedy_set_cover import greedy_choice
from guidefield.kernels.cover.set_cover import fewer


def packed(rows: np.ndarray) -> np.ndarray:
    """Rows of truth values as bits, 64 to a word."""
    padded = np.zeros((len(rows), 64 * max(1, -(-rows.shape[1] // 64))), bool)
    padded[:, : rows.shape[1]] = rows
    return np.packbits(padded, axis=1, bitorder="little").view(np.uint64)


def chosen_by_greed(rows: np.ndarray) -> np.ndarray:
    chosen = np.empty(len(rows), np.int64)
    return chosen[: greedy_choice(packed(rows), chosen)]


def improved(rows: np.ndarray, first: np.ndarray, steps: int) -> np.ndarray:
    chosen = np.empty(len(rows), np.int64)
    chosen[: len(first)] = first
    return chosen[: fewer(packed(rows), len(first), steps, chosen)]


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


@settings(deadline=None, max_examples=80)
@given(problems)
def test_all_that_can_be_contained_is(rows: np.ndarray) -> None:
    first = chosen_by_greed(rows)
    best = improved(rows, first, 200)
    for choice in (first, best):
        assert len(set(choice.tolist())) == len(choice)
        assert (rows[choice].any(axis=0) == rows.any(axis=0)).all()
    assert len(best) <= len(first)
    assert len(best) == fewest(rows)


def test_the_greedy_choice_takes_the_most_fruitful_first() -> None:
    rows = np.zeros((4, 100), bool)
    rows[0, :60], rows[1, 50:90], rows[2, 30:55], rows[3, 88:] = True, True, True, True
    assert chosen_by_greed(rows).tolist() == [0, 1, 3]


def test_the_search_finds_what_greed_misses() -> None:
    # Two sets of 14 contain everything; greed takes the 16, 8 and 4 across them first.
    rows = np.zeros((5, 28), bool)
    rows[0, :14], rows[1, 14:] = True, True
    rows[2, [*range(8), *range(14, 22)]] = True
    rows[3, [*range(8, 12), *range(22, 26)]] = True
    rows[4, [12, 13, 26, 27]] = True
    first = chosen_by_greed(rows)
    assert first.tolist() == [2, 3, 4]
    assert sorted(improved(rows, first, 50).tolist()) == [0, 1]


@pytest.mark.parametrize("rows", [np.zeros((0, 5), bool), np.zeros((3, 5), bool)], ids=["no set", "empty sets"])
def test_nothing_is_chosen_where_there_is_nothing(rows: np.ndarray) -> None:
    assert len(chosen_by_greed(rows)) == 0
    assert len(improved(rows, np.empty(0, np.int64), 10)) == 0


def test_the_same_sets_give_the_same_choice() -> None:
    rows = np.random.default_rng(5).random((300, 1000)) < 0.05
    first = chosen_by_greed(rows)
    assert (improved(rows, first, 500) == improved(rows, first, 500)).all()
    assert len(improved(rows, first, 500)) < len(first)


def plainly_improved(rows: np.ndarray, chosen: list[int], steps: int) -> list[int]:
    """The same search, every worth summed anew whenever it is asked for."""
    count, elements = rows.shape
    weights, stamps, frozen = np.ones(elements, int), np.full(count, -count - 1), np.zeros(count, bool)
    held, missing = list[int](), list(np.flatnonzero(rows.any(axis=0)))
    state, spared, best = 88172645463325252, -1, list(chosen)

    def put_in(i: int, now: int) -> None:
        for j in [j for j in np.flatnonzero(rows[i]) if not rows[held, j].any()]:
            missing[missing.index(j)] = missing[-1]
            missing.pop()
            frozen[rows[:, j]] = False
        held.append(i)
        stamps[i] = now

    def take_out(spared: int, now: int) -> bool:
        own = {i: weights[rows[i] & (rows[held].sum(axis=0) == 1)].sum() for i in held if i != spared}
        if not own:
            return False
        i = min(own, key=lambda i: (own[i], stamps[i]))
        place = held.index(i)
        held[place] = held[-1]
        held.pop()
        missing.extend(j for j in np.flatnonzero(rows[i]) if not rows[held, j].any())
        stamps[i], frozen[i] = now, True
        return True

    for k, i in enumerate(chosen):
        put_in(i, k - len(chosen))
    for step in range(steps):
        while not missing:
            best = list(held)
            if len(best) <= 1:
                return best
            take_out(-1, step)
        if not take_out(spared, step):
            return best
        for shift in (13, -7, 17):
            state = (state ^ (state << shift if shift > 0 else state >> -shift)) & (2**64 - 1)
        wanted = missing[(state >> 1) % len(missing)]
        having = [i for i in np.flatnonzero(rows[:, wanted]) if not frozen[i]]
        worth = {i: weights[[j for j in missing if rows[i, j]]].sum() for i in having}
        spared = min(having, key=lambda i: (-worth[i], stamps[i], i)) if having else int(rows[:, wanted].argmax())
        put_in(spared, step)
        weights[missing] += 1
    return best


@pytest.mark.parametrize("seed", range(8))
def test_the_search_is_the_one_that_is_meant(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places, centres = rng.random(150), rng.random(70)
    rows = np.abs(places - centres[:, None]) < rng.uniform(0.03, 0.15, (70, 1))
    first = chosen_by_greed(rows)
    assert improved(rows, first, 300).tolist() == plainly_improved(rows, first.tolist(), 300)
