"""Penalties of a motion at samples, quadratic in what exceeds limits: of its loads, and of its path constraints.

Both are evaluated anew in each of Newton's steps, unlike the clearance, so that a step knows of what begins to exceed
its limit, and of constraints that bend. They lead the optimizer alone: whether limits are kept is checked by
`planner/task`, on bounds, and path constraints by the certificate.

*Loads.* A load is a torque, or the speed of a point in space, as a share of its limit. Those near their limits are
expanded where they were evaluated (`load_expansions`): torques, and the three components of velocities, are q = q0 +
a · z + b · z' + c · z''. The penalty is

    1/2 w · sum of max(0, |q| - s)²

At the share t of a piece of length h, z = B P, z' = B' P / h and z'' = B'' P / h², with B the basis of the piece's four
control points. By u = log h a load changes by -b · z' - 2 c · z''. The Hessian is Gauss and Newton's of torques; that
of speeds, which are convex in velocities, has their curvature too. Another form has to be that of
`largest_torque_loads` and `largest_speed_loads`, too, by half of whose sums interior_point.py gives candidates up.

*Path constraints.* A constraint's number (`kernels/tree/path_constraints.py`) is v, its limit L. Each of s samples
along the motion at which it is asked for adds

    w / (2 s) · max(v / L - room, 0)²

with the share `room` of a limit that costs nothing. Constraints may be alternatives: of several groups of them a sample
keeps the one that costs least there. The Hessian is Gauss and Newton's, of what is beyond. Where nothing is, a step
would not know of the constraint, and would cross a narrow tolerance at once: there a number counts as if it were
beyond, times min(1, (tight / L)²).
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
    Blocks,
    Floats,
    IndexRows,
    Indices,
    Row,
    Rows,
    numba_type,
)
from guidefield.kernels.jit.decorators import compiled, inlined, kernel, uncounted
from guidefield.kernels.kinematics.tip_chain import LANES
from guidefield.kernels.optimize.clearance_model import add_gradient, add_hessian
from guidefield.kernels.tree.path_constraints import KeptFrames, Measured, allocate_measured, number, place, write_row


class LoadModel(NamedTuple):
    """Loads of a motion about control points where they were evaluated, in k rows, the first `rows` of which count.

    Torques have a row each, and after them velocities three.
    """

    torques: int  # how many
    rows: int
    weight: float  # w
    share: float  # s
    bases: Blocks  # of samples on a piece of length 1: the basis and its first two derivatives, shape (s, 3, 4)
    pieces: Indices  # the piece of each row, shape (k,)
    samples: Indices  # its sample on that piece, shape (k,)
    values: Row  # q0, shape (k,)
    slopes: Blocks  # a, b and c, shape (k, 3, nv)


LOADS = numba_type(LoadModel)


@uncounted
def _place(loads: LoadModel, k: int, points: Floats, step: float, state: Floats) -> None:
    """Write point, velocity and acceleration at a row's sample, shape (3, nv), unless they are there from the last."""
    piece, sample = loads.pieces[k], loads.samples[k]
    if k > 0 and loads.pieces[k - 1] == piece and loads.samples[k - 1] == sample:
        return
    for order in range(3):
        over = 1.0 if order == 0 else (1.0 / step if order == 1 else 1.0 / (step * step))
        b0, b1, b2, b3 = (
            over * loads.bases[sample, order, 0],
            over * loads.bases[sample, order, 1],
            over * loads.bases[sample, order, 2],
            over * loads.bases[sample, order, 3],
        )
        for p in range(points.shape[1]):
            value = b0 * points[piece, p] + b1 * points[piece + 1, p]
            state[order, p] = value + b2 * points[piece + 2, p] + b3 * points[piece + 3, p]


@uncounted
def _expand(loads: LoadModel, k: int, state: Floats) -> tuple[float, float]:
    """Return what a row comes to at a state, and its derivative by u."""
    by, value, of_dz, of_ddz = loads.slopes[k], loads.values[k], 0.0, 0.0
    for p in range(state.shape[1]):
        value += by[0, p] * state[0, p]
        of_dz += by[1, p] * state[1, p]
        of_ddz += by[2, p] * state[2, p]
    return value + of_dz + of_ddz, -of_dz - 2.0 * of_ddz


@kernel
def load_penalty(loads: LoadModel, points: Rows, step: float) -> float:
    """Return the penalty at control points (n, nv), for pieces of a length [s]."""
    total, square, state = 0.0, 0.0, np.empty((3, points.shape[1]))
    for k in range(loads.rows):
        _place(loads, k, points, step, state)
        value = _expand(loads, k, state)[0]
        square += value * value
        if k < loads.torques or (k - loads.torques) % 3 == 2:
            beyond = math.sqrt(square) - loads.share
            square = 0.0
            if beyond > 0.0:
                total += beyond * beyond
    return 0.5 * loads.weight * total


@uncounted
def _write_row(loads: LoadModel, k: int, step: float, by_points_out: Floats) -> None:
    """Write the derivatives of a row by the four control points of its piece, shape (4 nv,)."""
    by, bases = loads.slopes[k], loads.bases[loads.samples[k]]
    nv = by.shape[1]
    for a in range(4):
        b0, b1, b2 = bases[0, a], bases[1, a] / step, bases[2, a] / (step * step)
        for p in range(nv):
            by_points_out[a * nv + p] = b0 * by[0, p] + b1 * by[1, p] + b2 * by[2, p]


@uncounted
def _add_square(
    piece: int, weight: float, of_u: float, by_points: Floats, blocks_out: Floats, border_out: Floats
) -> None:
    """Add the Hessian of half a row's square by control points, and by these and u."""
    nv = border_out.shape[1]
    for a in range(4):
        for p in range(nv):
            here = weight * by_points[a * nv + p]
            border_out[piece + a, p] += of_u * here
            into = blocks_out[piece + a, p, (3 - a) * nv :]
            for q in range((a + 1) * nv):
                into[q] += here * by_points[q]


@uncounted
def add_load_penalty(
    loads: LoadModel,
    points: Floats,
    step: float,
    rows: Floats,
    gradient_out: Floats,
    blocks_out: Floats,
    border_out: Floats,
) -> tuple[float, float, float]:
    """Add the penalty to derivatives by all control points; return its value, first and second derivative by u.

    Args:
        loads: The loads.
        points: Control points, shape (n, nv).
        step: h [s].
        rows: Scratch, shape (3, 4 nv).
        gradient_out: By the control points, shape (n, nv).
        blocks_out: Hessian as in `clearance_model.add_hessian`, shape (n, nv, 4 nv).
        border_out: Hessian by control points and u, shape (n, nv).
    """
    nv, total, by_u, by_uu, k = points.shape[1], 0.0, 0.0, 0.0, 0
    row, along, state = rows[0], rows[1], rows[2, : 3 * nv].reshape(3, nv)
    while k < loads.rows:
        width = 1 if k < loads.torques else 3
        _place(loads, k, points, step, state)
        square = 0.0
        for c in range(width):
            square += _expand(loads, k + c, state)[0] ** 2
        load = math.sqrt(square)
        beyond, piece = load - loads.share, loads.pieces[k]
        if beyond > 0.0:
            total += beyond * beyond
            along[:] = 0.0
            along_u, bend = 0.0, loads.weight * beyond / load
            for c in range(width):
                value, of_u = _expand(loads, k + c, state)
                _write_row(loads, k + c, step, row)
                along_u += value / load * of_u
                for q in range(4 * nv):
                    along[q] += value / load * row[q]
                if width > 1:  # what is across
                    by_uu += bend * of_u * of_u
                    _add_square(piece, bend, of_u, row, blocks_out, border_out)
            weight = loads.weight if width == 1 else loads.weight - bend
            by_u += loads.weight * beyond * along_u
            by_uu += weight * along_u * along_u
            _add_square(piece, weight, along_u, along, blocks_out, border_out)
            for a in range(4):
                for p in range(nv):
                    gradient_out[piece + a, p] += loads.weight * beyond * along[a * nv + p]
        k += width
    return 0.5 * loads.weight * total, by_u, by_uu


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
def _place_from(kept: KeptSamples, s: int, points: Floats, measured: Measured) -> int:
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
    measured = allocate_measured(kept.frames)
    for s in range(0, kept.pieces.shape[0], LANES):
        for lane in range(_place_from(kept, s, points, measured)):
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
    measured = allocate_measured(kept.frames)
    row, slope, hessian, scratch = np.empty(nv), np.empty(nv), np.empty((nv, nv)), np.empty(4 * nv)
    weight: float = kept.weight / kept.pieces.shape[0]
    for s in range(0, kept.pieces.shape[0], LANES):
        for lane in range(_place_from(kept, s, points, measured)):
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
