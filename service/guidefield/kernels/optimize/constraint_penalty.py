"""The penalty of a motion that leaves path constraints, by the control points of its uniform cubic B-spline.

A constraint's number is v, its limit L. Each of s samples along the motion at which it is asked for adds

    w / (2 s) · max(v / L - room, 0)²

with the share `room` of a limit that costs nothing. Constraints may be alternatives: of several groups of them a sample
keeps the one that costs least there. Unlike the clearance it is cheap, eight samples at once: it is evaluated in each
of Newton's steps, and a motion can follow a constraint that bends. Numbers are those of
`kernels/tree/path_constraints.py`.

The Hessian is Gauss and Newton's, of what is beyond. Where nothing is, a step would not know of the constraint, and
would cross a narrow tolerance at once: there a number counts as if it were beyond, times min(1, (tight / L)²).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import (
    BLOCKS_OUT,
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    Floats,
    IndexRows,
    Indices,
    Rows,
    numba_type,
)
from guidefield.kernels.jit.decorators import compiled, inlined
from guidefield.kernels.kinematics.tip_chain import LANES
from guidefield.kernels.optimize.clearance_model import add_gradient, add_hessian
from guidefield.kernels.tree.path_constraints import KeptFrames, Measured, number, place, room_to_measure, write_row


class KeptSamples(NamedTuple):
    """Places on a motion where path constraints are measured."""

    frames: KeptFrames  # the constraints; none: nothing is examined
    pieces: Indices  # (s,) piece of each sample
    basis: Rows  # (s, 4) the basis there, of the piece's four control points
    groups: Indices  # (k,) which group of alternatives each constraint is of, in ascending order; -1: it has none
    asked: IndexRows  # (s, k) whether each constraint is examined there: 1, or 0
    room: float  # share of a limit up to which a number costs nothing
    weight: float  # w
    tight: float  # limits up to this count in Newton's steps all through [rad or m]


KEPT_SAMPLES = numba_type(KeptSamples)


@inlined
def _placed_from(kept: KeptSamples, s: int, points: Floats, measured: Measured) -> int:
    """Place the frames at the samples from one on, one for each lane; how many samples that are."""
    count: int = min(LANES, kept.pieces.shape[0] - s)
    for lane in range(LANES):
        at = s + min(lane, count - 1)
        k, basis = kept.pieces[at], kept.basis[at]
        for j in range(points.shape[1]):
            value = basis[0] * points[k, j] + basis[1] * points[k + 1, j]
            measured.zs[j * LANES + lane] = value + basis[2] * points[k + 2, j] + basis[3] * points[k + 3, j]
    place(kept.frames, measured)
    return count


@inlined
def _beyond(kept: KeptSamples, c: int, measured: Measured, lane: int) -> float:
    """Excess of a constraint's number over what costs nothing, as a share of its limit."""
    beyond: float = max(number(kept.frames, c, measured, lane) / kept.frames.limits[c] - kept.room, 0.0)
    return beyond


@inlined
def _cheapest(kept: KeptSamples, at: int, measured: Measured, lane: int) -> tuple[float, int]:
    """Sum squared violations at a sample, and find the group of alternatives that costs least, the first of several."""
    always, least, chosen, cost, before = 0.0, math.inf, -1, 0.0, -1
    for c in range(kept.groups.shape[0]):
        if kept.asked[at, c] == 0:
            continue
        group, beyond = kept.groups[c], _beyond(kept, c, measured, lane)
        if group < 0:
            always += beyond * beyond
            continue
        if group != before:
            if before >= 0 and cost < least:
                least, chosen = cost, before
            cost, before = 0.0, group
        cost += beyond * beyond
    if before >= 0 and cost < least:
        least, chosen = cost, before
    return always + (0.0 if chosen < 0 else least), chosen


@compiled(SCALAR(KEPT_SAMPLES, MATRIX))
def constraint_penalty(kept: KeptSamples, points: Floats) -> float:
    """The penalty of a motion with control points (n, nv) [rad or m]."""
    total = 0.0
    if kept.groups.shape[0] == 0:
        return total
    measured = room_to_measure(kept.frames)
    for s in range(0, kept.pieces.shape[0], LANES):
        for lane in range(_placed_from(kept, s, points, measured)):
            total += _cheapest(kept, s + lane, measured, lane)[0]
    weight: float = kept.weight / kept.pieces.shape[0]
    return 0.5 * weight * total


@compiled(SCALAR(KEPT_SAMPLES, MATRIX, MATRIX_OUT, BLOCKS_OUT))
def add_constraint_penalty(kept: KeptSamples, points: Floats, gradient_out: Floats, blocks_out: Floats) -> float:
    """Add the penalty's derivatives to those of an objective.

    Args:
        kept: Where constraints are examined.
        points: Control points, shape (n, nv) [rad or m].
        gradient_out: By these, shape (n, nv).
        blocks_out: Hessian, as in `add_hessian`, shape (n, nv, 4 nv).

    Returns:
        The penalty.
    """
    nv, total = points.shape[1], 0.0
    if kept.groups.shape[0] == 0:
        return total
    measured = room_to_measure(kept.frames)
    row, slope, hessian, scratch = np.empty(nv), np.empty(nv), np.empty((nv, nv)), np.empty(4 * nv)
    weight: float = kept.weight / kept.pieces.shape[0]
    for s in range(0, kept.pieces.shape[0], LANES):
        for lane in range(_placed_from(kept, s, points, measured)):
            at = s + lane
            cost, chosen = _cheapest(kept, at, measured, lane)
            total += cost
            slope[:], hessian[:, :] = 0.0, 0.0
            for c in range(kept.groups.shape[0]):
                if kept.asked[at, c] == 0 or (kept.groups[c] >= 0 and kept.groups[c] != chosen):
                    continue
                write_row(kept.frames, c, measured, lane, row)
                over, beyond = 1.0 / kept.frames.limits[c], _beyond(kept, c, measured, lane)
                stiffness = over * over * (1.0 if beyond > 0.0 else min((kept.tight * over) ** 2, 1.0))
                for p in range(nv):
                    slope[p] += beyond * over * row[p]
                    for q in range(nv):
                        hessian[p, q] += stiffness * row[p] * row[q]
            add_gradient(kept.pieces[at], kept.basis[at], weight, slope, gradient_out)
            add_hessian(kept.pieces[at], kept.basis[at], weight, hessian, scratch, blocks_out)
    return 0.5 * weight * total
