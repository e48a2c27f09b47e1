"""Pairs of joints whose bodies keep apart wherever their coordinates are: nothing need be asked of them again."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import boolean, int64, types, void

from guidefield.kernels.collide.cell_verdict import APART, TOUCHING, judged
from guidefield.kernels.collide.layout import (
    COUNT,
    DIVIDED,
    GRID_PLACES,
    GRID_SIDES,
    LEVELS,
    SIDE,
    LaneBodies,
    Scratch,
    pairs_of,
)
from guidefield.kernels.collide.parts import Parts
from guidefield.kernels.jit.fields import numba_type
from guidefield.kernels.jit.signatures import INDICES, INDICES_OUT, INTEGER_POINTER, Integers, lane_kernel, lane_step
from guidefield.kernels.kinematics.batch_forward_kinematics import LaneJoints
from guidefield.kernels.simd.packing import Words, pointed, pointers, unpacked

BEYOND = 1e-3
"""What bodies keep besides [m]: configurations may be a little beyond the limits of their joints."""

CELL = GRID_SIDES + 1
"""Numbers of a cell that waits to be judged: the indices of its first smallest cell, the logarithm of its sides."""


class LaneAlone(NamedTuple):
    """A robot without obstacles.

    Attributes:
        joints, bodies, parts: The robot.
        scratch: Memory.
    """

    joints: LaneJoints
    bodies: LaneBodies
    parts: Parts
    scratch: Scratch


_ALONE = numba_type(LaneAlone)

_alone_of = unpacked(_ALONE)


@lane_step(boolean(pointed(_ALONE), int64, int64, INTEGER_POINTER))
def _never(robot: LaneAlone, meeting: int, most: int, stack: Integers) -> bool:
    """Whether a meeting's bodies keep apart in all of its grid, as far as so many cells tell; others are halved."""
    grids, place = robot.bodies.grids, GRID_PLACES * meeting
    largest, longest = grids[place + LEVELS] * grids[place + DIVIDED], 0
    for side in range(GRID_SIDES):
        while 1 << longest < grids[place + SIDE * side + COUNT]:
            longest += 1
    stack[0], stack[1], stack[2], stack[3] = 0, 0, 0, longest
    top = 1
    while top > 0:
        top -= 1
        a, b, c, shift = stack[CELL * top], stack[CELL * top + 1], stack[CELL * top + 2], stack[CELL * top + 3]
        most -= 1
        known = judged(robot.joints, robot.bodies, robot.parts, meeting, a, b, c, shift, BEYOND, robot.scratch)
        if known == APART:
            continue
        if known == TOUCHING or most <= 0 or shift <= largest:
            return False
        half = 1 << shift - 1
        for child in range(1 << GRID_SIDES):
            u, v, w = a + half * (child & 1), b + half * (child >> 1 & 1), c + half * (child >> 2)
            inside = u < grids[place + COUNT] and v < grids[place + SIDE + COUNT]
            if inside and w < grids[place + 2 * SIDE + COUNT]:
                at = CELL * top
                stack[at], stack[at + 1], stack[at + 2], stack[at + 3] = u, v, w, shift - 1
                top += 1
    return True


STACK = CELL * 256
"""Numbers of the memory for cells that wait: fewer than 8 more of each size."""


@lane_kernel(void(INDICES, int64, INDICES_OUT, types.Array(types.boolean, 1, "C")))
def never_touching(words: Words, most: int, stack: Integers, never_out: np.ndarray) -> None:
    """Of each meeting whether its bodies are known to keep apart wherever their coordinates are within their limits.

    Args:
        words: A packed `LaneAlone`.
        most: So many cells are judged for each, fewer where several pairs of bodies meet.
        stack: Memory, shape (STACK,).
        never_out: Shape (n_meetings,).
    """
    robot = _alone_of(pointers(words))
    for meeting in range(len(never_out)):
        first, past = pairs_of(robot.bodies, meeting)
        gridded = robot.bodies.grids[GRID_PLACES * meeting + COUNT] > 0
        never_out[meeting] = gridded and _never(robot, meeting, most // (past - first), pointers(stack))
