"""Fewer sets that together contain all elements: local search from a first choice.

A set is taken out, another put in, and the elements that are missing get more and more weight. What a set that isn't
chosen is worth is only summed where it may be put in: few elements are missing at any time. Source: C. Gao, X. Yao,
T. Weise and J. Li, "An efficient local search heuristic with row weighting for the unicost set covering problem",
European Journal of Operational Research 246, 2015.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types, uint64
from numpy.typing import NDArray

from guidefield.kernels.cover.greedy_set_cover import WORDS, lowest
from guidefield.kernels.jit.signatures import INDICES_OUT, Integers, compiled, inlined

_SEED = 88172645463325252
"""Of the random choice among missing elements: the same sets give the same choice."""

_LOW_HALF = 0x00000000FFFFFFFF


class CoverSearch(NamedTuple):
    """State of the search; i counts sets, j elements.

    Attributes:
        bits: Which set contains which element, shape (n, words).
        columns: Which element is in which set, shape (m, set words).
        absent: Which elements are in no chosen set, shape (words,).
        fresh: Which elements the set that was put in last was the first to contain, shape (words,).
        weights: Weight of each element, shape (m,).
        times: In how many chosen sets it is, shape (m,).
        sums: Sum of their indices: the index itself where there is one, shape (m,).
        missing: The elements in no chosen set come first, shape (m,).
        places: Where a missing element stands in `missing`, shape (m,).
        scores: Weight of what a chosen set alone contains, shape (n,).
        chosen: The chosen sets come first, shape (n,).
        stamps: When a set was last put in or taken out, shape (n,).
        frozen: Whether a set was taken out and nothing it contains has been put in since, shape (n,).
        held: The frozen sets come first, shape (n,).
        near: Words with missing elements, shape (words,).
        counts: How many are chosen, missing, frozen; how many words `near`.
    """

    bits: np.ndarray
    columns: np.ndarray
    absent: np.ndarray
    fresh: np.ndarray
    weights: Integers
    times: Integers
    sums: Integers
    missing: Integers
    places: Integers
    scores: Integers
    chosen: Integers
    stamps: Integers
    frozen: NDArray[np.bool_]
    held: Integers
    near: Integers
    counts: Integers


@inlined
def _transpose(block: np.ndarray) -> None:
    """Exchange rows and columns of 64 words. Source: H. S. Warren, Hacker's Delight, 2002, section 7-3."""
    mask, j = uint64(_LOW_HALF), 32
    while j > 0:
        for k in range(64):
            if not k & j:
                other = ((block[k] >> uint64(j)) ^ block[k | j]) & mask
                block[k] ^= other << uint64(j)
                block[k | j] ^= other
        j >>= 1
        mask ^= mask << uint64(j)


@inlined
def _columns(bits: np.ndarray) -> np.ndarray:
    """Which element is in which set, shape (64 words, set words), from `bits`, shape (n, words)."""
    rows, words = bits.shape
    columns = np.empty((64 * words, (rows + 63) // 64), np.uint64)
    block = np.empty(64, np.uint64)
    for v in range(columns.shape[1]):
        for w in range(words):
            for k in range(64):
                block[k] = bits[64 * v + k, w] if 64 * v + k < rows else uint64(0)
            _transpose(block)
            for k in range(64):
                columns[64 * w + k, v] = block[k]
    return columns


@inlined
def _search(bits: np.ndarray) -> CoverSearch:
    """The state with nothing chosen."""
    rows, words = bits.shape
    columns = 64 * words
    absent = np.zeros(words, np.uint64)
    for i in range(rows):
        for w in range(words):
            absent[w] |= bits[i, w]
    missing, places = np.empty(columns, np.int64), np.full(columns, -1, np.int64)
    count = 0
    for w in range(words):
        word = absent[w]
        while word != uint64(0):
            j = 64 * w + lowest(word)
            word &= word - uint64(1)
            missing[count] = j
            places[j] = count
            count += 1
    return CoverSearch(
        bits,
        _columns(bits),
        absent,
        np.zeros(words, np.uint64),
        np.ones(columns, np.int64),
        np.zeros(columns, np.int64),
        np.zeros(columns, np.int64),
        missing,
        places,
        np.zeros(rows, np.int64),
        np.empty(rows, np.int64),
        np.full(rows, -rows - 1, np.int64),
        np.zeros(rows, np.bool_),
        np.empty(rows, np.int64),
        np.empty(words, np.int64),
        np.array([0, count, 0, 0]),
    )


@inlined
def _put_in(search: CoverSearch, i: int, now: int) -> None:
    """Choose a set."""
    own = 0
    for w in range(search.bits.shape[1]):
        word = search.bits[i, w]
        search.fresh[w] = word & search.absent[w]
        search.absent[w] &= ~word
        while word != uint64(0):
            j = 64 * w + lowest(word)
            word &= word - uint64(1)
            weight = search.weights[j]
            search.times[j] += 1
            if search.times[j] == 1:
                own += weight
                search.counts[1] -= 1
                last, place = search.missing[search.counts[1]], search.places[j]
                search.missing[place] = last
                search.places[last] = place
            elif search.times[j] == 2:
                search.scores[search.sums[j]] -= weight
            search.sums[j] += i
    search.scores[i] = own
    search.stamps[i] = now
    search.chosen[search.counts[0]] = i
    search.counts[0] += 1
    _thaw(search)


@inlined
def _thaw(search: CoverSearch) -> None:
    """Sets that contain what the set that was put in is the first to contain are no longer frozen."""
    kept = 0
    for k in range(search.counts[2]):
        i, met = search.held[k], False
        for w in range(search.bits.shape[1]):
            if search.bits[i, w] & search.fresh[w] != uint64(0):
                met = True
                break
        if met:
            search.frozen[i] = False
        else:
            search.held[kept] = i
            kept += 1
    search.counts[2] = kept


@inlined
def _take_out(search: CoverSearch, place: int, now: int) -> None:
    """No longer choose the set at a place of `chosen`."""
    i = search.chosen[place]
    search.counts[0] -= 1
    search.chosen[place] = search.chosen[search.counts[0]]
    for w in range(search.bits.shape[1]):
        word = search.bits[i, w]
        while word != uint64(0):
            bit = lowest(word)
            j = 64 * w + bit
            word &= word - uint64(1)
            search.times[j] -= 1
            search.sums[j] -= i
            if search.times[j] == 0:
                search.absent[w] |= uint64(1) << uint64(bit)
                search.places[j] = search.counts[1]
                search.missing[search.counts[1]] = j
                search.counts[1] += 1
            elif search.times[j] == 1:
                search.scores[search.sums[j]] += search.weights[j]
    search.stamps[i] = now
    search.frozen[i] = True
    search.held[search.counts[2]] = i
    search.counts[2] += 1


@inlined
def _least_missed(search: CoverSearch, spared: int) -> int:
    """Place in `chosen` of the set that is missed least, the longest there of several; another than `spared`.

    -1 if there is none.
    """
    best, place = -1, -1
    for k in range(search.counts[0]):
        i = search.chosen[k]
        if i == spared:
            continue
        ahead = search.scores[best] - search.scores[i] if best >= 0 else 1
        if ahead > 0 or (ahead == 0 and search.stamps[i] < search.stamps[best]):
            best, place = i, k
    return place


@inlined
def _worth(search: CoverSearch, i: int) -> int:
    """Weight of the missing elements that a set contains."""
    worth = 0
    for k in range(search.counts[3]):
        w = search.near[k]
        word = search.bits[i, w] & search.absent[w]
        while word != uint64(0):
            worth += search.weights[64 * w + lowest(word)]
            word &= word - uint64(1)
    return worth


@inlined
def _most_wanted(search: CoverSearch, j: int) -> int:
    """The set with element j that is worth most, among those not frozen if there is one; of several the longest out."""
    search.counts[3] = 0
    for w in range(search.absent.shape[0]):
        if search.absent[w] != uint64(0):
            search.near[search.counts[3]] = w
            search.counts[3] += 1
    first, best, most = -1, -1, -1
    for v in range(search.columns.shape[1]):
        word = search.columns[j, v]
        while word != uint64(0):
            i = 64 * v + lowest(word)
            word &= word - uint64(1)
            first = i if first < 0 else first
            if not search.frozen[i]:
                worth = _worth(search, i)
                if worth > most or (worth == most and search.stamps[i] < search.stamps[best]):
                    best, most = i, worth
    return best if best >= 0 else first


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
        for k in range(search.counts[1]):
            search.weights[search.missing[k]] += 1
    return best
