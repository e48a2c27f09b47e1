"""Pairs of joints whose bodies' distance hangs on one or two coordinates: the cells of those that keep them apart.

Bodies that follow each other closely in a chain are near each other at most configurations, but how they stand to each
other hangs on few coordinates. Once a cell of these is known to keep them apart, wherever in it a configuration is,
nothing more need be asked there. A cell is judged when one of its configurations is met first: at its middle the bodies
must keep apart by more than any motion within the cell moves them. The verdict hangs on nothing else, so that no answer
depends on what was asked before.
"""

from __future__ import annotations

import numpy as np
from numba import boolean, int64, types

from guidefield.kernels.lane_axes import one_pose
from guidefield.kernels.lane_kinematics import JOINTS, LaneJoints, lane_placements
from guidefield.kernels.lane_math import Floats32
from guidefield.kernels.lane_tables import (
    BODIES,
    GRID_NUMBERS,
    GRID_PLACES,
    SCRATCH_MEMORY,
    LaneBodies,
    Scratch,
)
from guidefield.kernels.lanes import (
    FLOAT_POINTER,
    LANES,
    Vector,
    first_lane,
    lane_part,
    lane_step,
    load,
    rint,
    splat,
    store,
)
from guidefield.kernels.separation import AXIS, POINTED_PARTS, Parts, parts_apart
from guidefield.kernels.signatures import Floats

UNJUDGED, APART, UNKNOWN = range(3)
"""What is known of a cell; it is `UNKNOWN` whether bodies touch somewhere in a cell that isn't `APART`."""

_TURN = 6.283185307179586


@lane_part
def _balls_apart(balls: Floats32, a: int, pose_a: Floats, b: int, pose_b: Floats, margin: float) -> bool:
    """Whether two balls of bodies that are placed so (12) are farther apart than a margin."""
    square = 0.0
    for r in range(3):
        apart = pose_a[4 * r + 3] - pose_b[4 * r + 3]
        for k in range(3):
            apart += pose_a[4 * r + k] * balls[4 * a + k] - pose_b[4 * r + k] * balls[4 * b + k]
        square += apart * apart
    reach = balls[4 * a + 3] + balls[4 * b + 3] + margin
    return bool(square > reach * reach)


@lane_step(boolean(BODIES, POINTED_PARTS, int64, int64, types.float64, SCRATCH_MEMORY))
def _pair_apart(bodies: LaneBodies, parts: Parts, first: int, second: int, margin: float, scratch: Scratch) -> bool:
    """Whether two bodies, placed by the scratch's poses, are farther apart than a margin, by what contains them."""
    work, pose_a, pose_b = scratch.work, scratch.pose_a, scratch.pose_b
    pieces, roots = bodies.pieces, bodies.piece_roots
    if _balls_apart(bodies.bounds, first, pose_a, second, pose_b, margin):
        return True
    for a in range(pieces[first], pieces[first + 1]):
        for b in range(pieces[second], pieces[second + 1]):
            if _balls_apart(bodies.piece_bounds, a, pose_a, b, pose_b, margin):
                continue
            part_a, part_b = parts.links[3 * roots[a] + 2], parts.links[3 * roots[b] + 2]
            work[AXIS] = work[AXIS + 1] = work[AXIS + 2] = 0.0
            if part_a < 0 or part_b < 0 or not parts_apart(parts, part_a, pose_a, parts, part_b, pose_b, margin, work):
                return False
    return True


@lane_part
def _write_coordinate(grids: np.ndarray, numbers: Floats32, at: int, place: int, cell: float, block: Floats32) -> None:
    """Write the middle of a cell as one of its coordinates, in all lanes."""
    if numbers[at + 1] > 0.0:
        store(block, grids[place] * LANES, splat(numbers[at] + (cell + 0.5) / numbers[at + 1]))


@lane_step(int64(JOINTS, BODIES, POINTED_PARTS, int64, types.float64, types.float64, SCRATCH_MEMORY))
def _judged(
    joints: LaneJoints, bodies: LaneBodies, parts: Parts, meeting: int, i: float, k: float, scratch: Scratch
) -> int:
    """Whether the bodies of a meeting keep apart wherever in a cell the coordinates are."""
    grids, numbers, place, at = bodies.grids, bodies.grid_numbers, GRID_PLACES * meeting, GRID_NUMBERS * meeting
    _write_coordinate(grids, numbers, at, place, i, scratch.middle)
    _write_coordinate(grids, numbers, at + 3, place + 2, k, scratch.middle)
    lane_placements(joints, scratch.middle, scratch.middle_poses)
    one_pose(scratch.middle_poses, bodies.carrying[bodies.meetings[4 * meeting]], 0, scratch.pose_a)
    one_pose(scratch.middle_poses, bodies.carrying[bodies.meetings[4 * meeting + 1]], 0, scratch.pose_b)
    for pair in range(bodies.meetings[4 * meeting + 2], bodies.meetings[4 * meeting + 3]):
        first, second = bodies.pairs[3 * pair], bodies.pairs[3 * pair + 1]
        if not _pair_apart(bodies, parts, first, second, numbers[at + 6], scratch):
            return UNKNOWN
    return APART


@lane_part
def _place(coordinates: Floats32, driver: int, numbers: Floats32, at: int) -> Vector:
    """Where on a grid's side sixteen values of a coordinate are, in cells."""
    value = load(coordinates, driver * LANES)
    return (value - rint(value * numbers[at + 2]) * _TURN - numbers[at]) * numbers[at + 1]


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
    """The lanes of a mask whose cells are not known to keep a meeting's bodies apart; shapes as in `block_touches`."""
    grids, numbers, places, verdicts = bodies.grids, bodies.grid_numbers, scratch.places, bodies.verdicts
    place, at, left = GRID_PLACES * meeting, GRID_NUMBERS * meeting, 0
    count_u, count_v, start = grids[place + 1], grids[place + 3], grids[place + 4]
    if count_u == 0:
        return mask
    store(places, 0, _place(coordinates, grids[place], numbers, at))
    store(places, LANES, _place(coordinates, grids[place + 2], numbers, at + 3))
    while mask:
        chosen = first_lane(mask)
        mask &= mask - 1
        u, v = places[chosen], places[LANES + chosen]
        if not (u >= 0.0 and v >= 0.0 and u < count_u and v < count_v):
            left |= 1 << chosen
            continue
        i, k = int(u), int(v)
        cell = start + i * count_v + k
        if verdicts[cell] == UNJUDGED:
            verdicts[cell] = _judged(joints, bodies, parts, meeting, float(i), float(k), scratch)
        if verdicts[cell] != APART:
            left |= 1 << chosen
    return left
