"""The clearance of a motion as a barrier on samples along it, with gradient and Hessian by its control points.

A sample at the fraction t of piece i of a uniform cubic B-spline is at z = sum over a of B_a(t) P_{i+a}, B the basis.
Its Hessian H by z couples four control points: the block of points i + a and i + b is B_a B_b H. So a model keeps H
alone of each sample that is near something; blocks are made where a system is solved. A barrier of the distance is
`robot_barrier`.

Obstacles that move are where they are at the sample's time, t0 + (i + t) h: its derivatives by u = log h, h the length
of a piece, and by the departure t0 are (i + t) h and 1. With them the barrier's derivatives by time become those by
both; of the second ones there is what Gauss and Newton's Hessian keeps.

It costs far more than all other terms. So it is evaluated seldom: in between `ClearanceModel` represents it, its
quadratic expansion, as far as `newton_descent` trusts it. Its fields, in the order of `clearance_along`'s outputs, are
filled in planner/optimize/interior_point.py; `expanded` and `expanded_value` have to be the same function. Blocks are
laid out alike in `penalties`, `limit_barrier` and `bordered_band`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.distance.distance import TABLES, DistanceTables
from guidefield.kernels.jit.arrays import (
    BLOCKS_OUT,
    INDICES_OUT,
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    VECTOR_OUT,
    Blocks,
    Floats,
    Indices,
    Integers,
    Row,
    Rows,
    numba_type,
)
from guidefield.kernels.jit.decorators import compiled, uncounted
from guidefield.kernels.optimize.barrier import MOVING, ROBOT, MovingBodies, SampledRobot, moved_bodies, workspace
from guidefield.kernels.optimize.obstacle_barrier import NEAR_BODIES, NearBodies
from guidefield.kernels.optimize.robot_barrier import robot_barrier


class MotionSamples(NamedTuple):
    """Places on a motion where the clearance is measured."""

    pieces: Indices  # (s,) piece of each
    places: Row  # (s,) the same with the fraction of it
    basis: Rows  # (s, 4) the basis there, of the piece's four control points
    weights: Row  # (s,) how much each counts
    ranges: Row  # (s,) range of the barrier against obstacles there [m]
    floors: Row  # (s,) distance below which points cost more there [m]
    shares: Row  # (s,) factor of the barrier between links there; where it is 0 that isn't evaluated


SAMPLES = numba_type(MotionSamples)


class ClearanceModel(NamedTuple):
    """The clearance of a motion about control points at which it was evaluated."""

    value: float  # there
    points: Rows  # these control points, shape (n, nv) [rad or m]
    step: float  # length of pieces there [s]
    begin: float  # departure there [s]
    gradient: Rows  # by the control points, shape (n, nv)
    places: int  # of how many places on the motion there is a Hessian, at most s
    pieces: Indices  # the piece of each, which is the first of its four control points, shape (s,)
    basis: Rows  # the basis there, shape (s, 4)
    hessians: Blocks  # Gauss and Newton's Hessian of each by z, weighted, shape (s, nv, nv)
    border: Blocks  # the same by control points and (u, t0), shape (2, n, nv)
    by_times: Row  # gradient by (u, t0), shape (2,)
    corner: Rows  # hessian by these, shape (2, 2)


CLEARANCE = numba_type(ClearanceModel)


@uncounted
def add_gradient(k: int, basis: Floats, weight: float, slope: Floats, gradient_out: Floats) -> None:
    """Add a place's weighted gradient by z, shape (nv,), to that by the control points from k on, shape (n, nv)."""
    for a in range(4):
        share, into = weight * basis[a], gradient_out[k + a]
        for p in range(slope.shape[0]):
            into[p] += share * slope[p]


@uncounted
def add_hessian(k: int, basis: Floats, weight: float, hessian: Floats, row: Floats, blocks_out: Floats) -> None:
    """Add a place's weighted Hessian by z to that by the control points from k on; `row` is scratch, shape (4 nv,).

    Of the blocks, [i, p, q] couples coordinate p of point i with q % nv of point i - 3 + q // nv; those on the diagonal
    are whole.
    """
    nv = hessian.shape[0]
    for p in range(nv):
        for b in range(4):
            of_b = row[b * nv : (b + 1) * nv]
            for q in range(nv):
                of_b[q] = basis[b] * hessian[p, q]
        for a in range(4):
            share = weight * basis[a]
            into = blocks_out[k + a, p, (3 - a) * nv :]  # blocks k to k + a, side by side
            for q in range(into.shape[0]):
                into[q] += share * row[q]


@uncounted
def _add_sample_by_times(
    k: int,
    basis: Floats,
    weight: float,
    since: float,
    across: Floats,
    by_time: Floats,
    border_out: Floats,
    by_times_out: Floats,
    corner_out: Floats,
) -> None:
    """Add a sample's weighted derivatives by its time, `since` after the departure [s], to those by u and t0."""
    for e in range(2):
        of_e = since if e == 0 else 1.0
        by_times_out[e] += weight * of_e * by_time[0]
        corner_out[e, 0] += weight * of_e * since * by_time[1]
        corner_out[e, 1] += weight * of_e * by_time[1]
        for a in range(4):
            for p in range(across.shape[0]):
                border_out[e, k + a, p] += weight * of_e * basis[a] * across[p]


@compiled(
    types.Tuple((types.float64, types.int64))(
        ROBOT,
        TABLES,
        MOVING,
        SAMPLES,
        MATRIX,
        SCALAR,
        SCALAR,
        SCALAR,
        SCALAR,
        NEAR_BODIES,
        MATRIX_OUT,
        INDICES_OUT,
        MATRIX_OUT,
        BLOCKS_OUT,
        BLOCKS_OUT,
        VECTOR_OUT,
        MATRIX_OUT,
    )
)
def clearance_along(
    robot: SampledRobot,
    tables: DistanceTables,
    moving: MovingBodies,
    samples: MotionSamples,
    points: Floats,
    step: float,
    begin: float,
    clearance: float,
    most: float,
    near: NearBodies,
    gradient_out: Floats,
    pieces_out: Integers,
    basis_out: Floats,
    hessians_out: Floats,
    border_out: Floats,
    by_times_out: Floats,
    corner_out: Floats,
) -> tuple[float, int]:
    """The weighted barrier of a motion's samples, its gradient and Hessian, see `ClearanceModel`.

    Args:
        robot: The robot.
        tables: Obstacles that rest.
        moving: Obstacles that move.
        samples: Where the clearance is examined.
        points: Control points, shape (n, nv) [rad or m].
        step: h [s].
        begin: t0 [s].
        clearance: Distance from obstacles at which the barrier's wall stands [m].
        most: Value above which the result isn't wanted.
        near: What is remembered of the samples; of the same motion, moved, and the same ranges.
        gradient_out: Shape (n, nv).
        pieces_out: Shape (s,), at least one for each sample, as are the next two.
        basis_out: Shape (s, 4).
        hessians_out: Shape (s, nv, nv).
        border_out: Shape (2, n, nv).
        by_times_out: Shape (2,).
        corner_out: Shape (2, 2).

    Returns:
        The barrier, infinite, and derivatives that mean nothing, if it is more than wanted; of how many samples there
        is a Hessian.
    """
    gradient_out[:, :] = 0.0
    border_out[:, :, :] = 0.0
    by_times_out[:] = 0.0
    corner_out[:, :] = 0.0
    nv = points.shape[1]
    z, slope, across = np.empty(nv), np.empty(nv), np.empty(nv)
    work = workspace(robot, tables)
    moved = moved_bodies(moving, robot.joints.table.parents.shape[0], robot.joints.offsets.shape[0])
    total, count = 0.0, 0
    for s in range(samples.pieces.shape[0]):
        k, basis = samples.pieces[s], samples.basis[s]
        for j in range(nv):
            z[j] = basis[0] * points[k, j] + basis[1] * points[k + 1, j]
            z[j] += basis[2] * points[k + 2, j] + basis[3] * points[k + 3, j]
        walls = (samples.ranges[s], clearance, samples.floors[s])
        weight, since, share = samples.weights[s], samples.places[s] * step, samples.shares[s]
        hessian = hessians_out[count]
        value = robot_barrier(
            robot, tables, moving, s, z, begin + since, walls, share, near, work, moved, slope, hessian, across
        )
        if value > 0.0:
            total += weight * value
            if total > most:
                return math.inf, count
            add_gradient(k, basis, weight, slope, gradient_out)
            pieces_out[count], basis_out[count] = k, basis
            for p in range(nv):
                for q in range(nv):
                    hessian[p, q] *= weight
            count += 1
            if moving.motions.shape[0] > 0:
                _add_sample_by_times(
                    k, basis, weight, since, across, moved.by_time, border_out, by_times_out, corner_out
                )
    return total, count


@uncounted
def add_hessians(model: ClearanceModel, scratch: Floats, blocks_out: Floats) -> None:
    """Add a model's Hessian to one by the control points, with scratch as `add_hessian`, shape (n, nv, 4 nv)."""
    for s in range(model.places):
        add_hessian(model.pieces[s], model.basis[s], 1.0, model.hessians[s], scratch, blocks_out)


@uncounted
def _write_move(model: ClearanceModel, s: int, points: Floats, move_out: Floats) -> None:
    """Write how far a motion has moved at a place of a model, shape (nv,)."""
    k, basis = model.pieces[s], model.basis[s]
    move_out[:] = 0.0
    for a in range(4):
        here, there = points[k + a], model.points[k + a]
        for p in range(move_out.shape[0]):
            move_out[p] += basis[a] * (here[p] - there[p])


@uncounted
def _by_times(model: ClearanceModel, points: Floats, step: float, begin: float) -> tuple[float, float, float]:
    """Share of a model's value and its derivatives by (u, t0) of times elsewhere, but for these derivatives there."""
    longer, later = math.log(step / model.step), begin - model.begin
    by_u, by_begin = 0.0, 0.0
    for i in range(points.shape[0]):
        for p in range(points.shape[1]):
            move = points[i, p] - model.points[i, p]
            by_u += model.border[0, i, p] * move
            by_begin += model.border[1, i, p] * move
    more_by_u = longer * model.corner[0, 0] + later * model.corner[0, 1]
    more_by_begin = longer * model.corner[1, 0] + later * model.corner[1, 1]
    by_u += model.by_times[0]
    by_begin += model.by_times[1]
    total = longer * (by_u + 0.5 * more_by_u) + later * (by_begin + 0.5 * more_by_begin)
    return total, by_u + more_by_u, by_begin + more_by_begin


@uncounted
def _bend(model: ClearanceModel, s: int, move: Floats, slope: Floats, total: float) -> float:
    """A value with what a sample's Hessian adds to it for a move (nv,) of its coordinates; out: slope, shape (nv,)."""
    nv = move.shape[0]
    for p in range(nv):
        row, value = model.hessians[s, p], 0.0
        for q in range(nv):
            value += row[q] * move[q]
        slope[p] = value
        total += 0.5 * move[p] * value
    return float(total)


@uncounted
def expanded_value(model: ClearanceModel, points: Floats, step: float, begin: float, scratch: Floats) -> float:
    """A model elsewhere: its value alone, see `expanded`."""
    n, nv = points.shape
    total, move, slope = model.value, scratch[:nv], scratch[nv : 2 * nv]
    for i in range(n):
        for p in range(nv):
            total += model.gradient[i, p] * (points[i, p] - model.points[i, p])
    for s in range(model.places):
        _write_move(model, s, points, move)
        total = _bend(model, s, move, slope, total)
    return total + _by_times(model, points, step, begin)[0]


@uncounted
def expanded(
    model: ClearanceModel, points: Floats, step: float, begin: float, scratch: Floats, gradient_out: Floats
) -> tuple[float, float, float]:
    """A model elsewhere: its value, and its derivatives by u and t0.

    `points` (n, nv) are control points [rad or m], `step` is the length of pieces [s], `begin` the departure [s];
    `scratch` has shape (4 nv,), `gradient_out` gets its gradient by the control points, shape (n, nv).
    """
    n, nv = points.shape
    total, longer, later = model.value, math.log(step / model.step), begin - model.begin
    for i in range(n):
        for p in range(nv):
            total += model.gradient[i, p] * (points[i, p] - model.points[i, p])
            gradient_out[i, p] = model.gradient[i, p] + longer * model.border[0, i, p] + later * model.border[1, i, p]
    move, slope = scratch[:nv], scratch[nv : 2 * nv]
    for s in range(model.places):
        _write_move(model, s, points, move)
        total = _bend(model, s, move, slope, total)
        add_gradient(model.pieces[s], model.basis[s], 1.0, slope, gradient_out)
    of_times, by_u, by_begin = _by_times(model, points, step, begin)
    return total + of_times, by_u, by_begin
