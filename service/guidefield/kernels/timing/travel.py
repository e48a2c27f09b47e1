"""Travelled lengths of a motion and of its tip, the time at a length, and the turning: path metrics of replies.

Lengths are of cubic Hermite tables (`path_lengths`, to a share that it is given) or of Bezier curves by chords
(`travelled`, too short by what lies between the places asked for).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import Blocks, Floats, Row, RowOut, Rows
from guidefield.kernels.jit.decorators import inlined, kernel, uncounted
from guidefield.kernels.kinematics.forward_kinematics import CarriedPoint, JointPlaces, joint_places, place_point
from guidefield.kernels.timing.hermite import place_and_rate

IN_LOCAL, OF_FRAME, LENGTHS = range(3)  # numbers of the lengths in local coordinates and of the tip; then how many
STRIDES = 3  # a part is measured by all of its chords, by every second and every fourth of its points; no setting

AGAINST, MEASURES = LENGTHS * STRIDES, LENGTHS * STRIDES + 1
"""Numbers of a measured part, behind both lengths by three strides: how far the motion may go back and forth within its
chords, as it goes against them at an end; then how many there are."""


class _Tables(NamedTuple):
    """A motion as `hermite.states_at` has it."""

    times: Floats
    positions: Floats
    velocities: Floats
    accelerations: Floats
    jerks: Floats


class _Scratch(NamedTuple):
    """Points and rates of a part, each of shape (k, nv), and where the frame is, shape (k, 3)."""

    points: Floats
    rates: Floats
    places: Floats
    joints: JointPlaces


@uncounted
def chord_lengths(points: Floats, at: int, measures_out: Floats) -> None:
    """Write the lengths of a polyline (k, d), and through every second and every fourth point, from a number on."""
    stride = 1
    for level in range(STRIDES):
        total = 0.0
        for k in range(stride, points.shape[0], stride):
            square = 0.0
            for d in range(points.shape[1]):
                square += (points[k, d] - points[k - stride, d]) ** 2
            total += math.sqrt(square)
        measures_out[at + level] = total
        stride *= 2


@uncounted
def against_chords(points: Floats, rates: Floats, step: float) -> float:
    """Return how far a motion may go back and forth within its chords: each that it goes against at an end counts.

    `points` (k, nv) are ends of chords, `rates` (k, nv) velocities there; each takes `step` [s].
    """
    total = 0.0
    for k in range(points.shape[0] - 1):
        for end in range(2):
            along, square = 0.0, 0.0
            for j in range(points.shape[1]):
                rate = rates[k + end, j]
                along += rate * (points[k + 1, j] - points[k, j])
                square += rate * rate
            total += math.sqrt(square) if along < 0.0 else 0.0
    return total * step


@uncounted
def _measure_part(
    tables: _Tables,
    tip: CarriedPoint,
    piece: int,
    begin: float,
    end: float,
    goes_on: bool,
    scratch: _Scratch,
    measures_out: Floats,
) -> None:
    """Measure a part of a piece, between two times [s]: shape (MEASURES,). `goes_on`: where the last one ended."""
    points, rates, steps = scratch.points, scratch.rates, scratch.points.shape[0] - 1
    if goes_on:
        for j in range(points.shape[1]):
            points[0, j], rates[0, j] = points[steps, j], rates[steps, j]
        for d in range(3):
            scratch.places[0, d] = scratch.places[steps, d]
    for k in range(1 if goes_on else 0, steps + 1):
        t = begin + (end - begin) * (k / steps) - tables.times[piece]
        for j in range(points.shape[1]):
            points[k, j], rates[k, j] = place_and_rate(
                tables.positions[piece, j],
                tables.velocities[piece, j],
                tables.accelerations[piece, j],
                tables.jerks[piece, j],
                t,
            )
        scratch.places[k, 0], scratch.places[k, 1], scratch.places[k, 2] = place_point(tip, points[k], scratch.joints)
    chord_lengths(points, IN_LOCAL * STRIDES, measures_out)
    chord_lengths(scratch.places, OF_FRAME * STRIDES, measures_out)
    measures_out[AGAINST] = against_chords(points, rates, (end - begin) / steps)


@uncounted
def _length(measures: Floats, which: int) -> float:
    """A length by Richardson's extrapolation of all chords and every second point's."""
    return float((4.0 * measures[which * STRIDES] - measures[which * STRIDES + 1]) / 3.0)


@uncounted
def _unsure(measures: Floats, which: int) -> float:
    """Bound the error of a length: its difference from that by longer chords, or by going back and forth."""
    before = (4.0 * measures[which * STRIDES + 1] - measures[which * STRIDES + 2]) / 3.0
    return float(max(abs(_length(measures, which) - before), measures[AGAINST]))


@uncounted
def _sum_lengths(rows: Floats, asked: Floats, which: int) -> float:
    """Sum a length over the parts of which it is asked, (k, MEASURES) and (k, LENGTHS)."""
    total = 0.0
    for k in range(rows.shape[0]):
        total += _length(rows[k], which) if asked[k, which] > 0.0 else 0.0
    return total


@uncounted
def _is_asked(asked: Floats, k: int) -> bool:
    return bool(asked[k, IN_LOCAL] > 0.0 or asked[k, OF_FRAME] > 0.0)


@uncounted
def _leave_unsure(rows: Floats, asked: Floats, most: Floats, done: Floats) -> int:
    """Settle and add up lengths whose error is small enough.

    Args:
        rows: Of each measured part, shape (k, MEASURES).
        asked: Whether a length of each is asked, 1 or 0, shape (k, LENGTHS); changed.
        most: By how much a length may be off, shape (LENGTHS,).
        done: The lengths of what isn't asked any more, shape (LENGTHS,); changed.

    Returns:
        The number of parts of which some length is still asked.
    """
    count = 0
    for k in range(rows.shape[0]):
        for which in range(LENGTHS):
            if asked[k, which] > 0.0 and not _unsure(rows[k], which) > most[which]:
                asked[k, which] = 0.0
                done[which] += _length(rows[k], which)
        count += 1 if _is_asked(asked, k) else 0
    return count


@kernel
def path_lengths(
    times: Row,
    positions: Rows,
    velocities: Rows,
    accelerations: Rows,
    jerks: Rows,
    tip: CarriedPoint,
    steps: int,
    share: float,
    levels: int,
    lengths_out: RowOut,
) -> None:
    """Write a motion's lengths (LENGTHS,) by Richardson's extrapolation of chords; parts are halved where that is off.

    The motion is as in `hermite.states_at`, with knots at times (n,); each part has `steps` chords, a multiple of four.
    Parts of which all together the lengths are off by at most `share` of the whole aren't halved, and none more than
    `levels` times.
    """
    tables = _Tables(times, positions, velocities, accelerations, jerks)
    pieces, nv = times.shape[0] - 1, positions.shape[1]
    points, rates, places = np.empty((steps + 1, nv)), np.empty((steps + 1, nv)), np.empty((steps + 1, 3))
    scratch = _Scratch(points, rates, places, joint_places(tip.joints))
    rows, parts, asked = np.empty((pieces, MEASURES)), np.empty((pieces, 3)), np.ones((pieces, LENGTHS))
    for piece in range(pieces):
        parts[piece, 0], parts[piece, 1], parts[piece, 2] = piece, times[piece], times[piece + 1]
        _measure_part(tables, tip, piece, times[piece], times[piece + 1], piece > 0, scratch, rows[piece])
    done, most = np.zeros(LENGTHS), np.empty(LENGTHS)
    for _ in range(levels):
        for which in range(LENGTHS):
            lengths_out[which] = _sum_lengths(rows, asked, which)
            most[which] = share / max(1, pieces) * (done[which] + lengths_out[which])
        count = _leave_unsure(rows, asked, most, done)
        halves, wanted = np.empty((2 * count, 3)), np.empty((2 * count, LENGTHS))
        half_rows = np.empty((2 * count, MEASURES))
        half = 0
        for which in range(LENGTHS):
            lengths_out[which] = done[which]
        for k in range(rows.shape[0]):
            if not _is_asked(asked, k):
                continue
            piece, begin, end = int(parts[k, 0]), parts[k, 1], parts[k, 2]
            middle = 0.5 * (begin + end)
            for which in range(LENGTHS):
                lengths_out[which] += _length(rows[k], which) if asked[k, which] > 0.0 else 0.0
            for side in range(2):
                since, until = (begin, middle) if side == 0 else (middle, end)
                halves[half, 0], halves[half, 1], halves[half, 2] = piece, since, until
                for which in range(LENGTHS):
                    wanted[half, which] = asked[k, which]
                _measure_part(tables, tip, piece, since, until, side == 1, scratch, half_rows[half])
                half += 1
        if count == 0:
            break
        rows, parts, asked = half_rows, halves, wanted


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
    """Add the squared steps of one coordinate to those of places on a curve, the first from where it was before."""
    order, count = powers.shape[0], shares.shape[0]
    for k in range(count):
        values[k] = powers[order - 1]
    for power in range(order - 2, -1, -1):
        for k in range(count):
            values[k] = values[k] * shares[k] + powers[power]
    squares[0] += (values[0] - before) ** 2
    for k in range(1, count):
        squares[k] += (values[k] - values[k - 1]) ** 2


@kernel
def travelled(pieces: Blocks, times: Row, asked: Row, lengths_out: RowOut) -> None:
    """Write the chords' lengths added up, (k,), between places of a motion at times (k,) in order [rad or m].

    Curves have control points (m, order, nv) and begin, and end, at times (m + 1,) [s].
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


@kernel
def when_travelled(pieces: Blocks, times: Row, known: Row, lengths: Row, steps: int, whens_out: RowOut) -> None:
    """Replace lengths (n,) by the times when a motion has travelled them [s].

    By the times `known` (k,), two at least, it has travelled `lengths` (k,) [rad or m]; between two of them `steps`
    chords are examined. The motion is as in `travelled`.
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


@kernel
def squared_turns(pieces: Blocks, times: Row, asked: Row) -> float:
    """Sum the squared angles between chords from one to the next of places of a motion, at times (k,) [rad^2].

    The motion is as in `travelled`.
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
