"""Travelled length of a motion of Bezier curves in local coordinates, the time at a length, and the turning."""

from __future__ import annotations

import math

import numpy as np
from numba import types

from guidefield.kernels.jit.signatures import BLOCKS, VECTOR, VECTOR_OUT, Floats, compiled, inlined


@inlined
def _write_powers(pieces: Floats, piece: int, row: Floats, powers_out: Floats) -> None:
    """Write a curve's coefficients by powers of its share, shape (order, nv): binomials times forward differences."""
    order = pieces.shape[1]
    for j in range(pieces.shape[2]):
        for i in range(order):
            row[i] = pieces[piece, i, j]
        binomial = 1.0
        for power in range(order):
            powers_out[power, j] = binomial * row[0]
            binomial *= (order - 1.0 - power) / (power + 1.0)
            for i in range(order - 1 - power):
                row[i] = row[i + 1] - row[i]


@inlined
def _step_to(
    pieces: Floats, times: Floats, time: float, piece: int, row: Floats, powers: Floats, point: Floats
) -> tuple[int, float]:
    """Go to where a motion is at a time no earlier than before: the curve there, and how far that is from the point.

    Of the curve that is returned the coefficients are in `powers`; `piece`, that of before, is -1 at first.
    """
    last, order = pieces.shape[0] - 1, pieces.shape[1]
    here = max(piece, 0)
    while here < last and times[here + 1] <= time:
        here += 1
    if here != piece:
        _write_powers(pieces, here, row, powers)
    span = times[here + 1] - times[here]
    share = min(max((time - times[here]) / span, 0.0), 1.0) if span > 0.0 else 0.0
    square = 0.0
    for j in range(point.shape[0]):
        value = powers[order - 1, j]
        for power in range(order - 2, -1, -1):
            value = value * share + powers[power, j]
        square += (value - point[j]) ** 2
        point[j] = value
    return here, math.sqrt(square)


@inlined
def _add_steps(powers: Floats, shares: Floats, before: float, values: Floats, squares: Floats) -> None:
    """Add the squared steps of one coordinate to those of places on a curve, the first from where it was before.

    Args:
        powers: The coordinate's coefficients by powers of the share, shape (order,).
        shares: Of the places, shape (k,).
        before: The coordinate at the place before them.
        values: The coordinate at them is written here, shape (k,).
        squares: What is added to, shape (k,).
    """
    order, count = powers.shape[0], shares.shape[0]
    for k in range(count):
        values[k] = powers[order - 1]
    for power in range(order - 2, -1, -1):
        for k in range(count):
            values[k] = values[k] * shares[k] + powers[power]
    squares[0] += (values[0] - before) ** 2
    for k in range(1, count):
        squares[k] += (values[k] - values[k - 1]) ** 2


@compiled(types.void(BLOCKS, VECTOR, VECTOR, VECTOR_OUT))
def travelled(pieces: Floats, times: Floats, asked: Floats, lengths_out: Floats) -> None:
    """Lengths of the chords from one to the next of some places of a motion, added up.

    Args:
        pieces: Control points of its curves, shape (m, order, nv) [rad or m].
        times: When they begin and the last one ends, shape (m + 1,) [s].
        asked: The times of the places, in order, shape (k,) [s].
        lengths_out: Since the first of them, shape (k,) [rad or m].
    """
    row, powers, before = np.empty(pieces.shape[1]), np.empty(pieces.shape[1:]), np.zeros(pieces.shape[2])
    count, first, piece = asked.shape[0], 0, 0
    shares, values, squares = np.empty(count), np.empty(count), np.empty(count)
    while first < count:  # all places on a piece at once: loops over them are vector loops
        while piece < pieces.shape[0] - 1 and times[piece + 1] <= asked[first]:
            piece += 1
        past = first + 1
        while past < count and (piece == pieces.shape[0] - 1 or asked[past] < times[piece + 1]):
            past += 1
        _write_powers(pieces, piece, row, powers)
        span = times[piece + 1] - times[piece]
        for k in range(first, past):
            shares[k] = min(max((asked[k] - times[piece]) / span, 0.0), 1.0) if span > 0.0 else 0.0
            squares[k] = 0.0
        for j in range(pieces.shape[2]):
            _add_steps(powers[:, j], shares[first:past], before[j], values[first:past], squares[first:past])
            before[j] = values[past - 1]
        first = past
    length = 0.0
    for k in range(count):
        length += math.sqrt(squares[k]) if k > 0 else 0.0
        lengths_out[k] = length


@compiled(types.void(BLOCKS, VECTOR, VECTOR, VECTOR, types.int64, VECTOR_OUT))
def when_travelled(
    pieces: Floats, times: Floats, known: Floats, lengths: Floats, steps: int, whens_out: Floats
) -> None:
    """Return when a motion has travelled some lengths.

    Args:
        pieces: See `travelled`.
        times: See there.
        known: Times in order, two at least, shape (k,) [s].
        lengths: What it has travelled by then, shape (k,) [rad or m].
        steps: Between two of them it is looked at so many chords.
        whens_out: Lengths between the first and the last, shape (n,) [rad or m]; when they are is written in their
            place [s].
    """
    row, powers, point = np.empty(pieces.shape[1]), np.empty(pieces.shape[1:]), np.empty(pieces.shape[2])
    for n in range(whens_out.shape[0]):
        wanted, k = whens_out[n], 0
        while k < known.shape[0] - 2 and lengths[k + 1] < wanted:
            k += 1
        since, stride = known[k], (known[k + 1] - known[k]) / steps
        piece, passed = _step_to(pieces, times, since, -1, row, powers, point)
        passed = lengths[k]
        whens_out[n] = known[k + 1]
        for i in range(1, steps + 1):
            piece, step = _step_to(pieces, times, since + i * stride, piece, row, powers, point)
            if passed + step >= wanted:
                share = (wanted - passed) / step if step > 0.0 else 1.0
                whens_out[n] = since + (i - 1 + share) * stride
                break
            passed += step


@compiled(types.float64(BLOCKS, VECTOR, VECTOR))
def squared_turns(pieces: Floats, times: Floats, asked: Floats) -> float:
    """The squared angles between chords from one to the next of some places of a motion, added up [rad^2].

    Args:
        pieces: See `travelled`.
        times: See there.
        asked: The times of the places, in order, shape (k,) [s].
    """
    nv = pieces.shape[2]
    row, powers, point = np.empty(pieces.shape[1]), np.empty(pieces.shape[1:]), np.zeros(nv)
    before, last, gone = np.empty(nv), np.empty(nv), 0.0
    piece, total = -1, 0.0
    for k in range(asked.shape[0]):
        for j in range(nv):
            last[j] = point[j]
        piece, step = _step_to(pieces, times, asked[k], piece, row, powers, point)
        cosine = 0.0
        for j in range(nv):
            cosine += (point[j] - last[j]) * before[j] if k > 1 else 0.0
            before[j] = point[j] - last[j]
        if k > 1:
            cosine /= max(step * gone, 1e-30)
            total += math.acos(min(max(cosine, -1.0), 1.0)) ** 2
        gone = step
    return total
