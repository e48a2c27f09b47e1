"""Fewer sets that together contain all elements: local search from a first choice.

A set is taken out, another put in, and the elements that are missing get more and more weight. Source: C. Gao, X. Yao,
T. Weise and J. Li, "An efficient local search heuristic with row weighting for the unicost set covering problem",
European Journal of Operational Research 246, 2015.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types, uint64
from numpy.typing import NDArray

from guidefield.kernels.cover.greedy_set_cover import WORDS, lowest, ones
from guidefield.kernels.jit.signatures import INDICES_OUT, Integers, compiled, inlined

_SEED = 88172645463325252
"""Of the random choice among missing elements: the same sets give the same choice."""


class CoverSearch(NamedTuple):
    """State of the search; i counts sets, j elements.

    Attributes:
        first: Where the elements of each set begin in `elements`, shape (n + 1,).
        elements: Elements of all sets.
        first_set: Where the sets that contain each element begin in `sets`, shape (m + 1,).
        sets: Sets of all elements.
        weights: Weight of each element, shape (m,).
        times: In how many chosen sets it is, shape (m,).
        sums: Sum of their indices: the index itself where there is one, shape (m,).
        missing: The elements in no chosen set come first, shape (m,).
        places: Where a missing element stands in `missing`, shape (m,).
        scores: Weight of what a chosen set alone contains, or of what another would be the first to, shape (n,).
        chosen: The chosen sets come first, shape (n,).
        stamps: When a set was last put in or taken out, shape (n,).
        frozen: Whether a set was taken out and nothing it contains has changed since, shape (n,).
        counts: How many are chosen, how many missing.
    """

    first: Integers
    elements: NDArray[np.int32]
    first_set: Integers
    sets: NDArray[np.int32]
    weights: Integers
    times: Integers
    sums: Integers
    missing: Integers
    places: Integers
    scores: Integers
    chosen: Integers
    stamps: Integers
    frozen: NDArray[np.bool_]
    counts: Integers


@inlined
def _search(bits: np.ndarray) -> CoverSearch:
    """The state with nothing chosen."""
    rows, columns = bits.shape[0], 64 * bits.shape[1]
    first, first_set = np.zeros(rows + 1, np.int64), np.zeros(columns + 1, np.int64)
    for i in range(rows):
        first[i + 1] = first[i]
        for w in range(bits.shape[1]):
            word = bits[i, w]
            first[i + 1] += ones(word)
            while word != uint64(0):
                first_set[64 * w + lowest(word) + 1] += 1
                word &= word - uint64(1)
    missing, places = np.empty(columns, np.int64), np.full(columns, -1, np.int64)
    absent = 0
    for j in range(columns):
        if first_set[j + 1] > 0:
            missing[absent] = j
            places[j] = absent
            absent += 1
        first_set[j + 1] += first_set[j]
    elements, sets = np.empty(first[rows], np.int32), np.empty(first[rows], np.int32)
    filled, k = first_set.copy(), 0
    for i in range(rows):
        for w in range(bits.shape[1]):
            word = bits[i, w]
            while word != uint64(0):
                j = 64 * w + lowest(word)
                word &= word - uint64(1)
                elements[k] = j
                k += 1
                sets[filled[j]] = i
                filled[j] += 1
    return CoverSearch(
        first,
        elements,
        first_set,
        sets,
        np.ones(columns, np.int64),
        np.zeros(columns, np.int64),
        np.zeros(columns, np.int64),
        missing,
        places,
        first[1:] - first[:-1],
        np.empty(rows, np.int64),
        np.full(rows, -rows - 1, np.int64),
        np.zeros(rows, np.bool_),
        np.array([0, absent]),
    )


@inlined
def _put_in(search: CoverSearch, i: int, now: int) -> None:
    """Choose a set."""
    own = 0
    for k in range(search.first[i], search.first[i + 1]):
        j = search.elements[k]
        weight = search.weights[j]
        search.times[j] += 1
        if search.times[j] == 1:
            own += weight
            search.counts[1] -= 1
            last, place = search.missing[search.counts[1]], search.places[j]
            search.missing[place] = last
            search.places[last] = place
            for s in range(search.first_set[j], search.first_set[j + 1]):
                search.scores[search.sets[s]] -= weight
                search.frozen[search.sets[s]] = False
        elif search.times[j] == 2:
            search.scores[search.sums[j]] -= weight
        search.sums[j] += i
    search.scores[i] = own
    search.stamps[i] = now
    search.chosen[search.counts[0]] = i
    search.counts[0] += 1


@inlined
def _take_out(search: CoverSearch, place: int, now: int) -> None:
    """No longer choose the set at a place of `chosen`."""
    i = search.chosen[place]
    search.counts[0] -= 1
    search.chosen[place] = search.chosen[search.counts[0]]
    own = 0
    for k in range(search.first[i], search.first[i + 1]):
        j = search.elements[k]
        weight = search.weights[j]
        search.times[j] -= 1
        search.sums[j] -= i
        if search.times[j] == 0:
            own += weight
            search.places[j] = search.counts[1]
            search.missing[search.counts[1]] = j
            search.counts[1] += 1
            for s in range(search.first_set[j], search.first_set[j + 1]):
                search.scores[search.sets[s]] += weight
        elif search.times[j] == 1:
            search.scores[search.sums[j]] += weight
    search.scores[i] = own
    search.stamps[i] = now
    search.frozen[i] = True


@inlined
def _better(search: CoverSearch, i: int, best: int, sign: int) -> bool:
    """Whether set i has a higher score (sign 1) or a lower one (-1) than the best so far, or the same for longer."""
    if best < 0:
        return True
    ahead = sign * (search.scores[i] - search.scores[best])
    better: bool = ahead > 0 or (ahead == 0 and search.stamps[i] < search.stamps[best])
    return better


@inlined
def _least_missed(search: CoverSearch, spared: int) -> int:
    """Place in `chosen` of the set that is missed least, another than `spared`; -1 if there is none."""
    best, place = -1, -1
    for k in range(search.counts[0]):
        i = search.chosen[k]
        if i != spared and _better(search, i, best, -1):
            best, place = i, k
    return place


@inlined
def _most_wanted(search: CoverSearch, j: int) -> int:
    """The set with element j that is worth most, among those not frozen if there is one."""
    best = -1
    for s in range(search.first_set[j], search.first_set[j + 1]):
        i = search.sets[s]
        if not search.frozen[i] and _better(search, i, best, 1):
            best = i
    wanted = best
    if best < 0:
        wanted = search.sets[search.first_set[j]]
    return wanted


@inlined
def _weigh_missing(search: CoverSearch) -> None:
    """Give every missing element more weight."""
    for k in range(search.counts[1]):
        j = search.missing[k]
        search.weights[j] += 1
        for s in range(search.first_set[j], search.first_set[j + 1]):
            search.scores[search.sets[s]] += 1


@compiled(types.int64(WORDS, types.int64, types.int64, INDICES_OUT))
def fewer(bits: np.ndarray, count: int, steps: int, chosen_out: Integers) -> int:
    """Look for fewer sets that contain all that some sets do.

    Args:
        bits: Which set contains which element, shape (n, words).
        count: How many sets are chosen to begin with; together they must contain every element that any set contains.
        steps: How many exchanges to try.
        chosen_out: The chosen sets, shape (n,); gets the best choice found.

    Returns:
        How many that are.
    """
    if count <= 1:
        return count
    search = _search(bits)
    for k in range(count):
        _put_in(search, chosen_out[k], k - count)
    best: int = count
    last, state = -1, uint64(_SEED)
    for step in range(steps):
        while search.counts[1] == 0:
            best = search.counts[0]
            chosen_out[:best] = search.chosen[:best]
            if best <= 1:
                return best
            _take_out(search, _least_missed(search, -1), step)
        place = _least_missed(search, last)
        if place < 0:
            return best
        _take_out(search, place, step)
        state ^= state << uint64(13)
        state ^= state >> uint64(7)
        state ^= state << uint64(17)
        wanted = search.missing[np.int64(state >> uint64(1)) % search.counts[1]]
        last = _most_wanted(search, wanted)
        _put_in(search, last, step)
        _weigh_missing(search)
    return best
