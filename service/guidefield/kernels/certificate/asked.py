"""Which pairs Coal has to judge in parts of a motion: how much closer they can come there, and which may be so near."""

from __future__ import annotations

import numpy as np
from numba import int64

from guidefield.kernels.certificate.losses import find_losses
from guidefield.kernels.certificate.near import FIRST, PAIR, ROW, find_near
from guidefield.kernels.certificate.tables import OBSTACLES, ROBOT, CertifiedObstacles, CertifiedRobot
from guidefield.kernels.jit.no_refcount import lane_uncounted
from guidefield.kernels.jit.signatures import (
    BLOCKS,
    INDEX_MATRIX,
    INDEX_MATRIX_OUT,
    INDICES,
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    Floats,
    Integers,
    lane_kernel,
)

APART, BOUND, MARGIN, TOLD = range(4)
"""Numbers of a pair that is asked: how far apart it is at most, as `find_near` tells it, how much closer it can come,
and what to ask Coal; then how many there are."""


@lane_uncounted
def _add_error(distances: Floats, kept: float, relative: float, accuracy: float, margins: Floats) -> None:
    """What Coal has to say, so that bodies are distances and what they keep apart at least, shapes (s, k) [m]."""
    for row in range(distances.shape[0]):
        for k in range(distances.shape[1]):
            apart = distances[row, k] + kept
            margins[row, k] = apart + relative * abs(apart) + accuracy


@lane_kernel(
    int64(
        ROBOT, OBSTACLES, BLOCKS, BLOCKS, MATRIX, MATRIX, MATRIX, MATRIX, SCALAR, SCALAR, SCALAR, INDICES, INDEX_MATRIX,
        INDEX_MATRIX_OUT, MATRIX_OUT,
    )
)  # fmt: skip
def find_asked(
    robot: CertifiedRobot,
    obstacles: CertifiedObstacles,
    jacobians: Floats,
    placements: Floats,
    half_widths: Floats,
    chords: Floats,
    moves: Floats,
    off: Floats,
    kept: float,
    relative: float,
    accuracy: float,
    starts: Integers,
    left: Integers,
    asked: Integers,
    told: Floats,
) -> int:
    """Find the pairs in s parts of a motion that balls, boxes and slabs can't tell apart.

    Args:
        robot: The robot.
        obstacles: The obstacles.
        jacobians: As of `find_losses`, shape (s, 6, n); and so are the next five.
        placements: Shape (s, joints, 12) [m].
        half_widths: Shape (s, nv) [rad or m].
        chords: Shape (s, nv) [rad or m].
        moves: Shape (s, n).
        off: Shape (s, nv) [rad or m].
        kept: What robot and obstacles must keep apart; the robot and itself must only not touch [m].
        relative: How far off Coal's distances may be, for each metre of them.
        accuracy: And besides [m].
        starts: As of `find_near`, shape (s + 1,); and so are the next two.
        left: Shape (k, 3).
        asked: Out: shape (room, `ASKED`).
        told: Out: of each of those pairs its `APART`, `BOUND` and `MARGIN`, shape (room, `TOLD`) [m].

    Returns:
        How many there are; those for which there is no room are not written.
    """
    s, r, p = placements.shape[0], robot.radii.shape[0], robot.own.shape[0]
    centres, own, mixed = np.empty((s, r, 3)), np.empty((s, p)), np.empty((s, r))
    own_margins, margins, apart = np.empty((s, p)), np.empty((s, r)), np.empty(asked.shape[0])
    find_losses(robot, jacobians, placements, half_widths, chords, moves, off, centres, own, mixed)
    _add_error(own, 0.0, relative, accuracy, own_margins)
    _add_error(mixed, kept, relative, accuracy, margins)
    count = find_near(robot, obstacles, placements, centres, own_margins, margins, starts, left, asked, apart)
    for k in range(min(count, asked.shape[0])):
        row, pair, first = asked[k, ROW], asked[k, PAIR], asked[k, FIRST]
        told[k, APART] = apart[k]
        if pair < p:
            told[k, BOUND], told[k, MARGIN] = own[row, pair], own_margins[row, pair]
        else:
            told[k, BOUND], told[k, MARGIN] = mixed[row, first], margins[row, first]
    return int(count)
