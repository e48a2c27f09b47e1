"""The clearance of a motion as a barrier on samples along it, with gradient and Hessian by its control points.

A sample at the fraction t of piece i of a uniform cubic B-spline is at z = sum over a of B_a(t) P_{i+a}, B the basis;
its Hessian couples four control points. A barrier of the distance is `robot_barrier`.

It costs far more than all else that an optimisation looks at. So it is looked at seldom: between two looks
`ClearanceModel` stands for it, its quadratic expansion.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.kernels.barrier.robot_barrier import robot_barrier
from guidefield.kernels.barrier.sampled_robot import ROBOT, SampledRobot, workspace
from guidefield.kernels.barrier.verlet_list import NEAR_BODIES, NearBodies
from guidefield.kernels.distance.distance import TABLES, DistanceTables
from guidefield.kernels.jit.fields import Blocks, Indices, Row, Rows, numba_type
from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import BLOCKS_OUT, MATRIX, MATRIX_OUT, SCALAR, Floats, compiled


class MotionSamples(NamedTuple):
    """Where on a motion the clearance is looked at.

    Attributes:
        pieces: (s,) piece of each.
        basis: (s, 4) the basis there, of the piece's four control points.
        weights: (s,) how much each counts.
        ranges: (s,) range of the barrier against obstacles there [m].
        floors: (s,) distance below which points cost more there [m].
        shares: (s,) factor of the barrier between links there; where it is 0 that isn't looked at.
    """

    pieces: Indices
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
        gradient: By them, shape (n, nv).
        blocks: Gauss and Newton's Hessian: [i, p, q] couples coordinate p of point i with q % nv of point
            i - 3 + q // nv; shape (n, nv, 4 nv). The blocks on the diagonal are whole.
    """

    value: float
    points: Rows
    gradient: Rows
    blocks: Blocks


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


@compiled(SCALAR(ROBOT, TABLES, SAMPLES, MATRIX, SCALAR, NEAR_BODIES, MATRIX_OUT, BLOCKS_OUT))
def clearance_along(
    robot: SampledRobot,
    tables: DistanceTables,
    samples: MotionSamples,
    points: Floats,
    clearance: float,
    near: NearBodies,
    gradient_out: Floats,
    blocks_out: Floats,
) -> float:
    """The weighted barrier of a motion's samples, its gradient and Hessian, see `ClearanceModel`.

    Args:
        robot: The robot.
        tables: Obstacles.
        samples: Where the clearance is looked at.
        points: Control points, shape (n, nv) [rad or m].
        clearance: Distance from obstacles at which the barrier's wall stands [m].
        near: What is remembered of the samples; of the same motion, moved, and the same ranges.
        gradient_out: Shape (n, nv).
        blocks_out: Shape (n, nv, 4 nv).

    Returns:
        The barrier.
    """
    gradient_out[:, :] = 0.0
    blocks_out[:, :, :] = 0.0
    nv = points.shape[1]
    z, slope, hessian, row = np.empty(nv), np.empty(nv), np.empty((nv, nv)), np.empty(4 * nv)
    work = workspace(robot, tables)
    total = 0.0
    for s in range(samples.pieces.shape[0]):
        k, basis = samples.pieces[s], samples.basis[s]
        for j in range(nv):
            z[j] = basis[0] * points[k, j] + basis[1] * points[k + 1, j]
            z[j] += basis[2] * points[k + 2, j] + basis[3] * points[k + 3, j]
        walls = (samples.ranges[s], clearance, samples.floors[s])
        value = robot_barrier(robot, tables, s, z, walls, samples.shares[s], near, work, slope, hessian)
        if value > 0.0:
            total += samples.weights[s] * value
            add_sample(k, basis, samples.weights[s], slope, hessian, row, gradient_out, blocks_out)
    return total


@uncounted
def expanded(model: ClearanceModel, points: Floats, gradient_out: Floats) -> float:
    """A model's value, and its gradient (n, nv), at other control points (n, nv)."""
    n, nv = points.shape
    gradient_out[:, :] = 0.0
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
    return total
