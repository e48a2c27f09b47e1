"""The clearance of a motion as a barrier on samples along it, with gradient and Hessian by its control points.

A sample at the fraction t of piece i of a uniform cubic B-spline is at z = sum over a of B_a(t) P_{i+a}, B the basis;
its Hessian couples four control points. A barrier of the distance is `robot_barrier`.

Obstacles that move are where they are at the sample's time, t0 + (i + t) h: its derivatives by u = log h, h the length
of a piece, and by the departure t0 are (i + t) h and 1. With them the barrier's derivatives by time become those by
both; of the second ones there is what Gauss and Newton's Hessian keeps.

It costs far more than all else that an optimisation looks at. So it is looked at seldom: between two looks
`ClearanceModel` stands for it, its quadratic expansion.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types, void

from guidefield.kernels.barrier.moving_bodies import MOVING, MovingBodies, moved_bodies
from guidefield.kernels.barrier.robot_barrier import robot_barrier
from guidefield.kernels.barrier.sampled_robot import ROBOT, SampledRobot, workspace
from guidefield.kernels.barrier.verlet_list import NEAR_BODIES, NearBodies
from guidefield.kernels.distance.distance import TABLES, DistanceTables
from guidefield.kernels.jit.fields import Blocks, Indices, Row, Rows, numba_type
from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import (
    BLOCKS_OUT,
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    VECTOR,
    VECTOR_OUT,
    Floats,
    compiled,
)


class MotionSamples(NamedTuple):
    """Where on a motion the clearance is looked at.

    Attributes:
        pieces: (s,) piece of each.
        places: (s,) the same with the fraction of it.
        basis: (s, 4) the basis there, of the piece's four control points.
        weights: (s,) how much each counts.
        ranges: (s,) range of the barrier against obstacles there [m].
        floors: (s,) distance below which points cost more there [m].
        shares: (s,) factor of the barrier between links there; where it is 0 that isn't looked at.
    """

    pieces: Indices
    places: Row
    basis: Rows
    weights: Row
    ranges: Row
    floors: Row
    shares: Row


SAMPLES = numba_type(MotionSamples)


class ClearanceModel(NamedTuple):
    """The clearance of a motion about control points at which it was looked at.

    Attributes:
        value: There.
        points: These control points, shape (n, nv) [rad or m].
        step: Length of pieces there [s].
        begin: Departure there [s].
        gradient: By the control points, shape (n, nv).
        blocks: Gauss and Newton's Hessian: [i, p, q] couples coordinate p of point i with q % nv of point
            i - 3 + q // nv; shape (n, nv, 4 nv). The blocks on the diagonal are whole.
        border: The same by control points and (u, t0), shape (2, n, nv).
        by_times: Gradient by (u, t0), shape (2,).
        corner: Hessian by these, shape (2, 2).
    """

    value: float
    points: Rows
    step: float
    begin: float
    gradient: Rows
    blocks: Blocks
    border: Blocks
    by_times: Row
    corner: Rows


CLEARANCE = numba_type(ClearanceModel)


@uncounted
def add_sample(
    k: int,
    basis: Floats,
    weight: float,
    slope: Floats,
    hessian: Floats,
    row: Floats,
    gradient_out: Floats,
    blocks_out: Floats,
) -> None:
    """Add a sample's weighted gradient and Hessian by z to those by the control points from k on; `row` is scratch."""
    nv = slope.shape[0]
    for p in range(nv):
        for b in range(4):
            of_b = row[b * nv : (b + 1) * nv]
            for q in range(nv):
                of_b[q] = basis[b] * hessian[p, q]
        for a in range(4):
            share = weight * basis[a]
            gradient_out[k + a, p] += share * slope[p]
            into = blocks_out[k + a, p, (3 - a) * nv :]  # blocks k to k + a, side by side
            for q in range(into.shape[0]):
                into[q] += share * row[q]


@compiled(void(types.int64, VECTOR, SCALAR, VECTOR, MATRIX, MATRIX_OUT, BLOCKS_OUT))
def add_place(
    k: int, basis: Floats, weight: float, slope: Floats, hessian: Floats, gradient_out: Floats, blocks_out: Floats
) -> None:
    """Add what depends on the motion at one place alone, as a sample of the clearance does.

    Args:
        k: The first of the four control points that the place depends on.
        basis: Its share of each, shape (4,).
        weight: Factor of all.
        slope: Its gradient by z, shape (nv,).
        hessian: Its Hessian by z, shape (nv, nv).
        gradient_out: By the control points, shape (n, nv).
        blocks_out: Hessian, see `ClearanceModel`, shape (n, nv, 4 nv).
    """
    add_sample(k, basis, weight, slope, hessian, np.empty(4 * slope.shape[0]), gradient_out, blocks_out)


@compiled(
    SCALAR(
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
    blocks_out: Floats,
    border_out: Floats,
    by_times_out: Floats,
    corner_out: Floats,
) -> float:
    """The weighted barrier of a motion's samples, its gradient and Hessian, see `ClearanceModel`.

    Args:
        robot: The robot.
        tables: Obstacles that rest.
        moving: Obstacles that move.
        samples: Where the clearance is looked at.
        points: Control points, shape (n, nv) [rad or m].
        step: h [s].
        begin: t0 [s].
        clearance: Distance from obstacles at which the barrier's wall stands [m].
        most: What it comes to at most if it is wanted.
        near: What is remembered of the samples; of the same motion, moved, and the same ranges.
        gradient_out: Shape (n, nv).
        blocks_out: Shape (n, nv, 4 nv).
        border_out: Shape (2, n, nv).
        by_times_out: Shape (2,).
        corner_out: Shape (2, 2).

    Returns:
        The barrier; infinite, and derivatives that mean nothing, if it is more than wanted.
    """
    gradient_out[:, :] = 0.0
    blocks_out[:, :, :] = 0.0
    border_out[:, :, :] = 0.0
    by_times_out[:] = 0.0
    corner_out[:, :] = 0.0
    nv = points.shape[1]
    z, slope, hessian, row = np.empty(nv), np.empty(nv), np.empty((nv, nv)), np.empty(4 * nv)
    across = np.empty(nv)
    work = workspace(robot, tables)
    moved = moved_bodies(moving, robot.joints.parents.shape[0], robot.offsets.shape[0])
    total = 0.0
    for s in range(samples.pieces.shape[0]):
        k, basis = samples.pieces[s], samples.basis[s]
        for j in range(nv):
            z[j] = basis[0] * points[k, j] + basis[1] * points[k + 1, j]
            z[j] += basis[2] * points[k + 2, j] + basis[3] * points[k + 3, j]
        walls = (samples.ranges[s], clearance, samples.floors[s])
        weight, since, share = samples.weights[s], samples.places[s] * step, samples.shares[s]
        value = robot_barrier(
            robot, tables, moving, s, z, begin + since, walls, share, near, work, moved, slope, hessian, across
        )
        if value > 0.0:
            total += weight * value
            if total > most:
                return math.inf
            add_sample(k, basis, weight, slope, hessian, row, gradient_out, blocks_out)
            if moving.motions.shape[0] > 0:
                _add_sample_by_times(
                    k, basis, weight, since, across, moved.by_time, border_out, by_times_out, corner_out
                )
    return total


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


@uncounted
def expanded_value(model: ClearanceModel, points: Floats, step: float, begin: float) -> float:
    """A model elsewhere: its value alone, see `expanded`."""
    n, nv = points.shape
    total = model.value
    longer, later = math.log(step / model.step), begin - model.begin
    for i in range(n):
        before = max(3 - i, 0)
        for p in range(nv):
            move = points[i, p] - model.points[i, p]
            if move == 0.0:
                continue
            of_point, others = 0.0, 0.0
            for q in range(nv):
                of_point += model.blocks[i, p, 3 * nv + q] * (points[i, q] - model.points[i, q])
            for c in range(before, 3):
                row, here, there = model.blocks[i, p, c * nv :], points[i - 3 + c], model.points[i - 3 + c]
                for q in range(nv):
                    others += row[q] * (here[q] - there[q])
            by_times = longer * model.border[0, i, p] + later * model.border[1, i, p]
            total += move * (model.gradient[i, p] + 0.5 * of_point + others + by_times)
    for e in range(2):
        of_e = longer if e == 0 else later
        total += of_e * (model.by_times[e] + 0.5 * (longer * model.corner[e, 0] + later * model.corner[e, 1]))
    return total


@uncounted
def _is_there(model: ClearanceModel, points: Floats, step: float, begin: float, gradient_out: Floats) -> bool:
    """Whether a motion is the one that was looked at; then its gradient is the model's."""
    same = step == model.step and begin == model.begin
    for i in range(points.shape[0]):
        for p in range(points.shape[1]):
            same &= points[i, p] == model.points[i, p]
            gradient_out[i, p] = model.gradient[i, p] if same else 0.0
    if not same:
        gradient_out[:, :] = 0.0
    return same


@uncounted
def expanded(
    model: ClearanceModel, points: Floats, step: float, begin: float, gradient_out: Floats
) -> tuple[float, float, float]:
    """A model elsewhere: its value, and its derivatives by u and t0.

    Args:
        model: The model.
        points: Control points, shape (n, nv) [rad or m].
        step: Length of pieces [s].
        begin: Departure [s].
        gradient_out: Its gradient by the control points, shape (n, nv).
    """
    n, nv = points.shape
    if _is_there(model, points, step, begin, gradient_out):
        return model.value, model.by_times[0], model.by_times[1]
    for i in range(n):
        for p in range(nv):
            move = points[i, p] - model.points[i, p]
            value = 0.0
            for c in range(max(3 - i, 0), 3):
                k = i - 3 + c
                for q in range(nv):
                    coupling = model.blocks[i, p, c * nv + q]
                    value += coupling * (points[k, q] - model.points[k, q])
                    gradient_out[k, q] += coupling * move
            for q in range(nv):
                value += model.blocks[i, p, 3 * nv + q] * (points[i, q] - model.points[i, q])
            gradient_out[i, p] += value
    total = model.value
    for i in range(n):
        for p in range(nv):
            total += (points[i, p] - model.points[i, p]) * (model.gradient[i, p] + 0.5 * gradient_out[i, p])
            gradient_out[i, p] += model.gradient[i, p]
    longer, later = math.log(step / model.step), begin - model.begin
    by_u, by_begin = model.by_times[0], model.by_times[1]
    for i in range(n):
        for p in range(nv):
            move = points[i, p] - model.points[i, p]
            by_u += model.border[0, i, p] * move
            by_begin += model.border[1, i, p] * move
            gradient_out[i, p] += longer * model.border[0, i, p] + later * model.border[1, i, p]
    more_by_u = longer * model.corner[0, 0] + later * model.corner[0, 1]
    more_by_begin = longer * model.corner[1, 0] + later * model.corner[1, 1]
    total += longer * (by_u + 0.5 * more_by_u) + later * (by_begin + 0.5 * more_by_begin)
    return total, by_u + more_by_u, by_begin + more_by_begin
