"""Pairs of joints whose bodies' distance hangs on few coordinates: the cells of those that keep them apart.

Bodies that follow each other closely in a chain are near each other at most configurations, but how they stand to each
other hangs on up to three coordinates. Once a cell of these is known to keep them apart, or to have them touch,
wherever in it a configuration is, nothing more need be asked there. A cell is judged when one of its configurations is
met first: at its middle the bodies must keep apart by more than any motion within the cell moves them, or balls inside
them lie deeper in each other. The verdict hangs on nothing else, so that no answer depends on what was asked before.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import boolean, int64, types

from guidefield.kernels.claim import claimed
from guidefield.kernels.lane_axes import one_pose
from guidefield.kernels.lane_kinematics import JOINTS, LaneJoints, lane_placements
from guidefield.kernels.lane_math import Floats32
from guidefield.kernels.lane_tables import (
    BAND,
    BODIES,
    CHILDREN,
    GRID_NUMBERS,
    GRID_PLACES,
    GRID_SIDES,
    SCRATCH_MEMORY,
    LaneBodies,
    Scratch,
)
from guidefield.kernels.lanes import (
    DOUBLE_POINTER,
    FLOAT_POINTER,
    LANES,
    below,
    first_lane,
    lane_part,
    lane_step,
    largest_of,
    load,
    rint,
    smallest_of,
    splat,
    store,
)
from guidefield.kernels.separation import AXIS, POINTED_PARTS, Parts, parts_apart
from guidefield.kernels.signatures import Floats

UNJUDGED, APART, UNKNOWN, TOUCHING = range(4)
"""What is known of a cell: bodies keep apart wherever in it, they touch wherever in it, or neither is known.

A larger number says that neither is known of the cell as a whole, and where its children are.
"""

START, LEVELS, DIVIDED = range(3 * GRID_SIDES, GRID_PLACES)
"""Where in a grid's whole numbers it stands where its largest cells begin, how often they are divided, by how much."""

_TURN = 6.283185307179586


@lane_part
def _balls_apart(
    balls: Floats32, a: int, pose_a: Floats, others: Floats32, b: int, pose_b: Floats, margin: float
) -> bool:
    """Whether two balls of bodies that are placed so (12) are farther apart than a margin."""
    square = 0.0
    for r in range(3):
        apart = pose_a[4 * r + 3] - pose_b[4 * r + 3]
        for k in range(3):
            apart += pose_a[4 * r + k] * balls[4 * a + k] - pose_b[4 * r + k] * others[4 * b + k]
        square += apart * apart
    reach = balls[4 * a + 3] + others[4 * b + 3] + margin
    return bool(square > reach * reach)


@lane_part
def _begin_between(balls: Floats32, a: int, pose_a: Floats, b: int, pose_b: Floats, work: Floats) -> None:
    """Let GJK begin with the axis between the middles of two balls of bodies that are placed so (12)."""
    for r in range(3):
        apart = pose_a[4 * r + 3] - pose_b[4 * r + 3]
        for k in range(3):
            apart += pose_a[4 * r + k] * balls[4 * a + k] - pose_b[4 * r + k] * balls[4 * b + k]
        work[AXIS + r] = apart


@lane_step(boolean(BODIES, int64, DOUBLE_POINTER, int64, DOUBLE_POINTER, types.float64))
def _reaches_out(bodies: LaneBodies, a: int, pose_a: Floats, b: int, pose_b: Floats, margin: float) -> bool:
    """Whether a ball inside a body has its middle farther than a margin from another body, by that one's cover."""
    first, last = bodies.covers[bodies.groups[b]], bodies.covers[bodies.groups[b + 1]]
    for ball in range(bodies.inners[a], bodies.inners[a + 1]):
        outside = True
        for other in range(first, last):
            reach = margin - bodies.inner[4 * ball + 3]
            if not _balls_apart(bodies.inner, ball, pose_a, bodies.cover, other, pose_b, reach):
                outside = False
                break
        if outside:
            return True
    return False


@lane_step(boolean(BODIES, int64, int64, types.float64, SCRATCH_MEMORY))
def _inner_meet(bodies: LaneBodies, first: int, second: int, depth: float, scratch: Scratch) -> bool:
    """Whether a ball inside each of two bodies, placed by the scratch's poses, lie that deep in each other.

    Neither body may be inside the other: a mesh that swallows another doesn't touch it.
    """
    pose_a, pose_b, inner = scratch.pose_a, scratch.pose_b, bodies.inner
    if _balls_apart(bodies.bounds, first, pose_a, bodies.bounds, second, pose_b, -depth):
        return False
    for a in range(bodies.inners[first], bodies.inners[first + 1]):
        for b in range(bodies.inners[second], bodies.inners[second + 1]):
            if inner[4 * a + 3] + inner[4 * b + 3] <= depth:
                continue
            if not _balls_apart(inner, a, pose_a, inner, b, pose_b, -depth):
                out = _reaches_out(bodies, first, pose_a, second, pose_b, depth)
                return bool(out and _reaches_out(bodies, second, pose_b, first, pose_a, depth))
    return False


@lane_step(boolean(BODIES, POINTED_PARTS, int64, int64, types.float64, SCRATCH_MEMORY))
def _pair_apart(bodies: LaneBodies, parts: Parts, first: int, second: int, margin: float, scratch: Scratch) -> bool:
    """Whether two bodies, placed by the scratch's poses, are farther apart than a margin, by what contains them.

    GJK begins with the axis that the scratch's `work` holds, unless that is 0.
    """
    work, pose_a, pose_b = scratch.work, scratch.pose_a, scratch.pose_b
    pieces, roots = bodies.pieces, bodies.piece_roots
    if _balls_apart(bodies.bounds, first, pose_a, bodies.bounds, second, pose_b, margin):
        return True
    hull_a, hull_b = parts.links[3 * bodies.roots[first] + 2], parts.links[3 * bodies.roots[second] + 2]
    if work[AXIS] == 0.0 and work[AXIS + 1] == 0.0 and work[AXIS + 2] == 0.0:
        _begin_between(bodies.bounds, first, pose_a, second, pose_b, work)
    if hull_a >= 0 and hull_b >= 0 and parts_apart(parts, hull_a, pose_a, parts, hull_b, pose_b, margin, work):
        return True
    for a in range(pieces[first], pieces[first + 1]):
        for b in range(pieces[second], pieces[second + 1]):
            if _balls_apart(bodies.piece_bounds, a, pose_a, bodies.piece_bounds, b, pose_b, margin):
                continue
            part_a, part_b = parts.links[3 * roots[a] + 2], parts.links[3 * roots[b] + 2]
            _begin_between(bodies.piece_bounds, a, pose_a, b, pose_b, work)
            if part_a < 0 or part_b < 0 or not parts_apart(parts, part_a, pose_a, parts, part_b, pose_b, margin, work):
                return False
    return True


@lane_step(int64(JOINTS, BODIES, POINTED_PARTS, int64, int64, int64, int64, int64, types.float64, SCRATCH_MEMORY))
def judged(
    joints: LaneJoints,
    bodies: LaneBodies,
    parts: Parts,
    meeting: int,
    a: int,
    b: int,
    c: int,
    shift: int,
    besides: float,
    scratch: Scratch,
) -> int:
    """What is known of the bodies of a meeting wherever in a cell of its grid the coordinates are.

    Args:
        joints: The robot's joints.
        bodies: Its bodies.
        parts: Their shapes.
        meeting: Which one.
        a: Index of one of the smallest cells in it along the first coordinate.
        b: Along the second.
        c: Along the third.
        shift: The cell's sides are 2^shift as long as those of the smallest.
        besides: What bodies have to keep besides, or to lie in each other [m], at least `BAND`.
        scratch: Memory.
    """
    grids, numbers, place, at = bodies.grids, bodies.grid_numbers, GRID_PLACES * meeting, GRID_NUMBERS * meeting
    for side in range(GRID_SIDES):
        n, index = at + 3 * side, a if side == 0 else b if side == 1 else c
        if numbers[n + 1] > 0.0:
            middle = ((index >> shift) + 0.5) * (1 << shift)
            store(scratch.middle, grids[place + 3 * side] * LANES, splat(numbers[n] + middle / numbers[n + 1]))
    lane_placements(joints, scratch.middle, scratch.middle_poses)
    one_pose(scratch.middle_poses, bodies.carrying[bodies.meetings[4 * meeting]], 0, scratch.pose_a)
    one_pose(scratch.middle_poses, bodies.carrying[bodies.meetings[4 * meeting + 1]], 0, scratch.pose_b)
    divisions = grids[place + LEVELS] * grids[place + DIVIDED]
    verdict, moved = APART, numbers[at + 3 * GRID_SIDES] * (1 << shift) / (1 << divisions) + besides
    for k in range(3):  # the axis between the last bodies that were apart may do for the next
        scratch.work[AXIS + k] = 0.0
    for pair in range(bodies.meetings[4 * meeting + 2], bodies.meetings[4 * meeting + 3]):
        first, second = bodies.pairs[3 * pair], bodies.pairs[3 * pair + 1]
        if verdict == APART and _pair_apart(bodies, parts, first, second, moved, scratch):
            continue
        if _inner_meet(bodies, first, second, moved + 2.0 * BAND, scratch):
            return TOUCHING
        verdict = UNKNOWN
    return verdict


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
        at = known + grids[place + 2] * (a >> shift & last)
        at += grids[place + 5] * (b >> shift & last) + grids[place + 8] * (c >> shift & last)


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
    if grids[place + 1] == 0:
        return mask
    divisions = 1 << grids[place + LEVELS] * grids[place + DIVIDED]
    share, down = 1.0 / divisions, 0.5 / divisions - 0.5
    for side in range(GRID_SIDES):
        count, n = float(grids[place + 3 * side + 1]), at + 3 * side
        value = load(coordinates, grids[place + 3 * side] * LANES)
        along = (value - rint(value * numbers[n + 2]) * _TURN - numbers[n]) * numbers[n + 1]
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
