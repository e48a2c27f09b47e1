"""Lengths of a motion's way in its chart and of a frame's way, by chords."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types, void

from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import MATRIX, SCALAR, VECTOR, VECTOR_OUT, Floats, compiled
from guidefield.kernels.kinematics.group_joints import (
    CARRIED_POINT,
    CarriedPoint,
    JointPlaces,
    joint_places,
    place_point,
)
from guidefield.kernels.timing.hermite import place_and_rate

IN_CHART, OF_FRAME, WAYS = range(3)
"""Numbers of the two lengths; then how many there are."""

STRIDES = 3
"""Each part is measured by all of its chords, by every second and by every fourth of its points."""

AGAINST, LOOK = WAYS * STRIDES, WAYS * STRIDES + 1
"""Numbers of a look at a part, behind the lengths of both ways: how far the motion may go back and forth within its
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
def chord_lengths(points: Floats, at: int, look_out: Floats) -> None:
    """Write the lengths of a polyline (k, d), and through every second and every fourth point, from a number on."""
    stride = 1
    for level in range(STRIDES):
        total = 0.0
        for k in range(stride, points.shape[0], stride):
            square = 0.0
            for d in range(points.shape[1]):
                square += (points[k, d] - points[k - stride, d]) ** 2
            total += math.sqrt(square)
        look_out[at + level] = total
        stride *= 2


@uncounted
def against_chords(points: Floats, rates: Floats, step: float) -> float:
    """Return how far a motion may go back and forth within its chords: each that it goes against at an end counts.

    Args:
        points: Ends of chords, shape (k, nv) [rad or m].
        rates: Velocities there, shape (k, nv).
        step: How long each takes [s].
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
def _look(
    tables: _Tables,
    tip: CarriedPoint,
    piece: int,
    begin: float,
    end: float,
    goes_on: bool,
    scratch: _Scratch,
    look_out: Floats,
) -> None:
    """Look at a part of a piece, between two times [s]: shape (LOOK,). `goes_on`: where the last one ended."""
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
    chord_lengths(points, IN_CHART * STRIDES, look_out)
    chord_lengths(scratch.places, OF_FRAME * STRIDES, look_out)
    look_out[AGAINST] = against_chords(points, rates, (end - begin) / steps)


@uncounted
def _length(look: Floats, way: int) -> float:
    """The length of a way by Richardson's extrapolation of all chords and every second point's."""
    return float((4.0 * look[way * STRIDES] - look[way * STRIDES + 1]) / 3.0)


@uncounted
def _unsure(look: Floats, way: int) -> float:
    """By how much a length may be off: by how much it is another one by the longer chords, or by going back."""
    before = (4.0 * look[way * STRIDES + 1] - look[way * STRIDES + 2]) / 3.0
    return float(max(abs(_length(look, way) - before), look[AGAINST]))


@uncounted
def _asked_length(looks: Floats, asked: Floats, way: int) -> float:
    """The length of a way of those parts of which it is asked, (k, LOOK) and (k, WAYS)."""
    total = 0.0
    for k in range(looks.shape[0]):
        total += _length(looks[k], way) if asked[k, way] > 0.0 else 0.0
    return total


@uncounted
def _is_asked(asked: Floats, k: int) -> bool:
    """Tell if some way of a part is asked, of (k, WAYS)."""
    return bool(asked[k, IN_CHART] > 0.0 or asked[k, OF_FRAME] > 0.0)


@uncounted
def _leave_unsure(looks: Floats, asked: Floats, most: Floats, done: Floats) -> int:
    """Ask no more for lengths that are off by no more than some, (WAYS,), and add them up; of how many parts it is.

    Args:
        looks: At parts, shape (k, LOOK).
        asked: Whether a way of each is asked, 1 or 0, shape (k, WAYS); changed.
        most: By how much a length may be off, shape (WAYS,).
        done: The lengths of what isn't asked any more, shape (WAYS,); changed.

    Returns:
        Of how many parts some way is still asked.
    """
    count = 0
    for k in range(looks.shape[0]):
        for way in range(WAYS):
            if asked[k, way] > 0.0 and not _unsure(looks[k], way) > most[way]:
                asked[k, way] = 0.0
                done[way] += _length(looks[k], way)
        count += 1 if _is_asked(asked, k) else 0
    return count


@compiled(
    void(
        VECTOR, MATRIX, MATRIX, MATRIX, MATRIX, CARRIED_POINT, types.int64, SCALAR, types.int64, VECTOR_OUT,
    )
)  # fmt: skip
def way_lengths(
    times: Floats,
    positions: Floats,
    velocities: Floats,
    accelerations: Floats,
    jerks: Floats,
    tip: CarriedPoint,
    steps: int,
    share: float,
    levels: int,
    lengths_out: Floats,
) -> None:
    """Lengths of a motion's ways, by Richardson's extrapolation of chords; parts are halved where that is off.

    Args:
        times: Of the knots, shape (n,), strictly increasing [s].
        positions: As in `hermite.states_at`, shape (n, nv), and so are the next three.
        velocities: See there.
        accelerations: See there.
        jerks: See there, shape (n - 1, nv).
        tip: The frame's origin.
        steps: Chords of each part, a multiple of four.
        share: Parts of which all together the lengths are off by no more than this share of the whole aren't halved.
        levels: So often at most it is looked.
        lengths_out: In the chart [rad or m] and of the frame [m], shape (WAYS,).
    """
    tables = _Tables(times, positions, velocities, accelerations, jerks)
    pieces, nv = times.shape[0] - 1, positions.shape[1]
    points, rates, places = np.empty((steps + 1, nv)), np.empty((steps + 1, nv)), np.empty((steps + 1, 3))
    scratch = _Scratch(points, rates, places, joint_places(tip.joints))
    looks, parts, asked = np.empty((pieces, LOOK)), np.empty((pieces, 3)), np.ones((pieces, WAYS))
    for piece in range(pieces):
        parts[piece, 0], parts[piece, 1], parts[piece, 2] = piece, times[piece], times[piece + 1]
        _look(tables, tip, piece, times[piece], times[piece + 1], piece > 0, scratch, looks[piece])
    done, most = np.zeros(WAYS), np.empty(WAYS)
    for _ in range(levels):
        for way in range(WAYS):
            lengths_out[way] = _asked_length(looks, asked, way)
            most[way] = share / max(1, pieces) * (done[way] + lengths_out[way])
        count = _leave_unsure(looks, asked, most, done)
        halves, looked, wanted = np.empty((2 * count, 3)), np.empty((2 * count, LOOK)), np.empty((2 * count, WAYS))
        half = 0
        for way in range(WAYS):
            lengths_out[way] = done[way]
        for k in range(looks.shape[0]):
            if not _is_asked(asked, k):
                continue
            piece, begin, end = int(parts[k, 0]), parts[k, 1], parts[k, 2]
            middle = 0.5 * (begin + end)
            for way in range(WAYS):
                lengths_out[way] += _length(looks[k], way) if asked[k, way] > 0.0 else 0.0
            for side in range(2):
                since, until = (begin, middle) if side == 0 else (middle, end)
                halves[half, 0], halves[half, 1], halves[half, 2] = piece, since, until
                for way in range(WAYS):
                    wanted[half, way] = asked[k, way]
                _look(tables, tip, piece, since, until, side == 1, scratch, looked[half])
                half += 1
        if count == 0:
            break
        looks, parts, asked = looked, halves, wanted
