"""Pairs of joints whose bodies' distance depends on few coordinates: the cells of those that keep them apart.

Bodies that follow each other closely in a chain are near each other at most configurations, but how they stand to each
other depends on three coordinates at most. Once a cell of these is known to keep them apart, or to have them touch,
wherever in it a configuration is, nothing more need be asked there. A cell is judged when one of its configurations is
met first, several of the largest together before each by itself: at its middle the bodies must keep apart by more than
any motion within the cell moves them, or balls inside them lie deeper in each other. The verdict depends on nothing
else, and so no answer on what was asked before.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import int64

from guidefield.kernels.collide.cell_verdict import APART, TOUCHING, UNJUDGED, UNKNOWN, judged
from guidefield.kernels.collide.layout import (
    BAND,
    BODIES,
    CHILDREN,
    COUNT,
    DIVIDED,
    DRIVER,
    GRID_NUMBERS,
    GRID_PLACES,
    GRID_SIDES,
    LEAST,
    LEVELS,
    PER_LENGTH,
    SCRATCH_MEMORY,
    SIDE,
    START,
    STEP,
    TOGETHER,
    WRAPS,
    LaneBodies,
    Scratch,
)
from guidefield.kernels.collide.parts import POINTED_PARTS, Parts
from guidefield.kernels.jit.signatures import FLOAT_POINTER, Floats32, lane_part, lane_step
from guidefield.kernels.kinematics.batch_forward_kinematics import JOINTS, LaneJoints
from guidefield.kernels.simd.atomic_allocator import claimed
from guidefield.kernels.simd.vector import LANES, below, first_lane, largest_of, load, rint, smallest_of, splat, store

_TURN = 6.283185307179586


@lane_step(int64(JOINTS, BODIES, POINTED_PARTS, int64, int64, int64, int64, int64, SCRATCH_MEMORY))
def _judged_first(
    joints: LaneJoints,
    bodies: LaneBodies,
    parts: Parts,
    meeting: int,
    a: int,
    b: int,
    c: int,
    shift: int,
    scratch: Scratch,
) -> int:
    """What is known of one of a grid's largest cells when it is met first: by as many of them together, or by itself.

    Most of what searches meet is far from contact, and many of the largest cells are judged at once there. Arguments
    as for `judged`.
    """
    grids, cells, place = bodies.grids, bodies.cells, GRID_PLACES * meeting
    larger, at = shift + grids[place + DIVIDED], 0
    for side in range(GRID_SIDES):
        index = a if side == 0 else b if side == 1 else c
        at = at * ((grids[place + SIDE * side + COUNT] - 1 >> larger) + 1) + (index >> larger)
    at += grids[place + TOGETHER]
    if cells[at] == UNJUDGED:
        cells[at] = judged(joints, bodies, parts, meeting, a, b, c, larger, BAND, scratch)
    known = int(cells[at])
    return known if known != UNKNOWN else judged(joints, bodies, parts, meeting, a, b, c, shift, BAND, scratch)


@lane_part
def _known(joints: LaneJoints, bodies: LaneBodies, parts: Parts, meeting: int, chosen: int, scratch: Scratch) -> int:
    """What is known of a meeting's bodies at the configuration of a lane, by the smallest cell that has to be asked."""
    grids, cells, places, place = bodies.grids, bodies.cells, scratch.places, GRID_PLACES * meeting
    a, b, c = int(places[chosen]), int(places[LANES + chosen]), int(places[2 * LANES + chosen])
    divided, largest = grids[place + DIVIDED], grids[place + START] + int(places[GRID_SIDES * LANES + chosen])
    shift, last, at = divided * grids[place + LEVELS], (1 << divided) - 1, largest
    while True:
        known = int(cells[at])
        if known == UNJUDGED:
            if at == largest:
                known = _judged_first(joints, bodies, parts, meeting, a, b, c, shift, scratch)
            else:
                known = judged(joints, bodies, parts, meeting, a, b, c, shift, BAND, scratch)
            if known == UNKNOWN and shift > 0:
                known = max(UNKNOWN, claimed(cells, CHILDREN, bodies.n_cells))
            cells[at] = known
        if known <= TOUCHING:
            if known == APART and at == largest:
                # a bit that another thread sets at the same time may be lost: it is set when the cell is asked again
                bodies.apart[at >> 5] |= np.uint32(1) << np.uint32(at & 31)
            return known
        shift -= divided
        at = known + grids[place + STEP] * (a >> shift & last)
        at += grids[place + SIDE + STEP] * (b >> shift & last) + grids[place + 2 * SIDE + STEP] * (c >> shift & last)


@lane_part
def _apart_by_largest(apart: Any, start: int, places: Floats32) -> int:
    """The lanes whose largest cell keeps the bodies apart; without a branch, as most of the time goes by for memory."""
    mask = 0
    for k in range(LANES):
        cell = start + int(places[GRID_SIDES * LANES + k])
        mask |= (int(apart[cell >> 5]) >> (cell & 31) & 1) << k
    return mask


@lane_step(int64(JOINTS, BODIES, POINTED_PARTS, int64, int64, FLOAT_POINTER, SCRATCH_MEMORY))
def left_of_cells(
    joints: LaneJoints,
    bodies: LaneBodies,
    parts: Parts,
    meeting: int,
    mask: int,
    coordinates: Floats32,
    scratch: Scratch,
) -> int:
    """The lanes of a mask where nothing is known of a meeting's bodies by their cells, -1 if they touch in any.

    Shapes as in `block_touches`.
    """
    grids, numbers, places = bodies.grids, bodies.grid_numbers, scratch.places
    place, at, cells, inside = GRID_PLACES * meeting, GRID_NUMBERS * meeting, splat(0.0), mask
    if grids[place + COUNT] == 0:
        return mask
    divisions = 1 << grids[place + LEVELS] * grids[place + DIVIDED]
    share, down = 1.0 / divisions, 0.5 / divisions - 0.5
    for side in range(GRID_SIDES):
        count, n = float(grids[place + SIDE * side + COUNT]), at + SIDE * side
        value = load(coordinates, grids[place + SIDE * side + DRIVER] * LANES)
        along = (value - rint(value * numbers[n + WRAPS]) * _TURN - numbers[n + LEAST]) * numbers[n + PER_LENGTH]
        inside &= below(along, splat(count)) & ~below(along, splat(0.0))
        index = smallest_of(largest_of(rint(along - 0.5), splat(0.0)), splat(count - 1.0))
        store(places, side * LANES, index)
        cells = cells * (count * share) + rint(index * share + down)
    store(places, GRID_SIDES * LANES, cells)
    left, mask = mask & ~inside, inside & ~_apart_by_largest(bodies.apart, grids[place + START], places)
    while mask:
        chosen = first_lane(mask)
        mask &= mask - 1
        known = _known(joints, bodies, parts, meeting, chosen, scratch)
        if known == TOUCHING:
            return -1
        if known != APART:
            left |= 1 << chosen
    return left
