"""The objective of a motion as a uniform cubic B-spline in time, with gradient and Hessian by control points and u.

    exp(u - u0) + λ · sum over samples of w barrier(z) + μ · limit barrier,      u = log h, h the length of a piece

A sample at the fraction t of piece i is at z = sum over a of B_a(t) P_{i+a}, B the uniform cubic B-spline's basis; its
Hessian couples four control points. The first three and the last three control points are the ends': they are moved by
u alone, by `slopes`. A barrier of the distance is `robot_barrier`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.kernels.distance.distance import TABLES, DistanceTables
from guidefield.kernels.jit.fields import Indices, Row, Rows, numba_type
from guidefield.kernels.jit.signatures import BLOCKS_OUT, MATRIX, SCALAR, VECTOR_OUT, Floats, compiled, inlined
from guidefield.kernels.optimize.limit_barrier import LIMITS, MotionLimits, add_limit_barrier
from guidefield.kernels.relax.robot_barrier import robot_barrier
from guidefield.kernels.relax.sampled_robot import ROBOT, SampledRobot, workspace
from guidefield.kernels.relax.verlet_list import NEAR_BODIES, NearBodies

ENDS = 3
"""Control points at each end that are the end's."""


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


@inlined
def _add_sample(
    k: int, basis: Floats, weight: float, slope: Floats, hessian: Floats, gradient_out: Floats, blocks_out: Floats
) -> None:
    """Add a sample's weighted gradient and Hessian by z to those by the control points from k on."""
    nv = slope.shape[0]
    for a in range(4):
        share = weight * basis[a]
        for p in range(nv):
            gradient_out[k + a, p] += share * slope[p]
            for b in range(a + 1):
                both = share * basis[b]
                row = blocks_out[k + a, p, (3 - a + b) * nv : (4 - a + b) * nv]
                for q in range(nv):
                    row[q] += both * hessian[p, q]


@inlined
def _ends_to_border(blocks: Floats, slopes: Floats, border_out: Floats) -> float:
    """Add what the ends' motion with u couples to the border; its own share of the second derivative by u."""
    n, nv = border_out.shape
    last = n - ENDS
    total = 0.0
    for i in range(n):
        for c in range(4):
            k = i - 3 + c
            if k < 0 or (ENDS <= i < last and ENDS <= k < last):
                continue
            of_i = i if i < ENDS else i - last + ENDS
            of_k = k if k < ENDS else k - last + ENDS
            for p in range(nv):
                for q in range(nv):
                    value = blocks[i, p, c * nv + q]
                    if ENDS <= i < last:
                        border_out[i, p] += value * slopes[of_k, q]
                    elif ENDS <= k < last:
                        border_out[k, q] += value * slopes[of_i, p]
                    else:
                        total += (1.0 if k == i else 2.0) * value * slopes[of_i, p] * slopes[of_k, q]
    return total


@inlined
def _add_clearance(
    robot: SampledRobot,
    tables: DistanceTables,
    samples: MotionSamples,
    points: Floats,
    clearance: float,
    near: NearBodies,
    gradient_out: Floats,
    blocks_out: Floats,
) -> float:
    """Add the samples' barrier to gradient and Hessian by all control points; its value."""
    nv = points.shape[1]
    z, slope, hessian = np.empty(nv), np.empty(nv), np.empty((nv, nv))
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
            _add_sample(k, basis, samples.weights[s], slope, hessian, gradient_out, blocks_out)
    return total


@compiled(
    SCALAR(
        ROBOT,
        TABLES,
        SAMPLES,
        LIMITS,
        MATRIX,
        MATRIX,
        SCALAR,
        SCALAR,
        SCALAR,
        SCALAR,
        NEAR_BODIES,
        BLOCKS_OUT,
        VECTOR_OUT,
        VECTOR_OUT,
    )
)
def motion_objective(
    robot: SampledRobot,
    tables: DistanceTables,
    samples: MotionSamples,
    limits: MotionLimits,
    points: Floats,
    slopes: Floats,
    step: float,
    first_step: float,
    limit_weight: float,
    clearance: float,
    near: NearBodies,
    blocks_out: Floats,
    border_out: Floats,
    gradient_out: Floats,
) -> float:
    """The objective of a motion, its gradient and Hessian by the free control points and u.

    Args:
        robot: The robot.
        tables: Obstacles.
        samples: Where the clearance is looked at; their weights hold λ.
        limits: What is kept.
        points: Control points, shape (n, nv), n > 6, strictly within limits [rad or m].
        slopes: Derivatives of the ends' control points by u, the first three and the last three, shape (6, nv).
        step: h [s].
        first_step: exp(u0) [s].
        limit_weight: μ.
        clearance: Distance from obstacles at which the barrier's wall stands [m].
        near: What is remembered of the samples; of the same motion, moved, and the same ranges.
        blocks_out: Hessian of the n - 6 free points, as in `bordered_band`, shape (n - 6, nv, 4 nv).
        border_out: By these and u, and by u alone, shape ((n - 6) nv + 1,).
        gradient_out: By these and u, shape ((n - 6) nv + 1,).

    Returns:
        The objective.
    """
    n, nv = points.shape
    gradient, border = np.zeros((n, nv)), np.zeros((n, nv))
    blocks = np.zeros((n, nv, 4 * nv))
    of_limits, by_u, by_uu = add_limit_barrier(points, step, limits, limit_weight, gradient, blocks, border)
    total = of_limits + _add_clearance(robot, tables, samples, points, clearance, near, gradient, blocks)
    duration = step / first_step
    total += duration
    by_u += duration
    by_uu += duration
    last = n - ENDS
    for i in range(n):  # the ends' points move with u
        if ENDS <= i < last:
            continue
        row = i if i < ENDS else i - last + ENDS
        for p in range(nv):
            by_u += slopes[row, p] * gradient[i, p]
            by_uu += 2.0 * slopes[row, p] * border[i, p]
    by_uu += _ends_to_border(blocks, slopes, border)
    free = nv * (n - 2 * ENDS)
    blocks_out[:, :, :] = blocks[ENDS:last]
    for i in range(ENDS, last):
        for p in range(nv):
            border_out[(i - ENDS) * nv + p] = border[i, p]
            gradient_out[(i - ENDS) * nv + p] = gradient[i, p]
    border_out[free], gradient_out[free] = by_uu, by_u
    return total
