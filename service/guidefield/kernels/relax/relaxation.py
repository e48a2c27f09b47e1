"""The objective of relaxing a path: how stretched it is, and how close to obstacles; with gradient and Hessian blocks.

J = sum over segments of (z_{k+1} - z_k)^T S (z_{k+1} - z_k) / 2 + sum over samples of w barrier(z).

A sample lies on a segment, at the fraction t from its start k to its end k + 1; it moves with both, by 1 - t and t. So
the Hessian couples neighbours only: it is block tridiagonal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.kernels.distance.distance import TABLES, DistanceTables
from guidefield.kernels.jit.fields import Indices, Row, numba_type
from guidefield.kernels.jit.signatures import BLOCKS_OUT, MATRIX, MATRIX_OUT, SCALAR, VECTOR, Floats, compiled
from guidefield.kernels.relax.robot_barrier import robot_barrier
from guidefield.kernels.relax.sampled_robot import ROBOT, SampledRobot, workspace
from guidefield.kernels.relax.verlet_list import NEAR_BODIES, NearBodies


class PathSamples(NamedTuple):
    """Where on a path the barrier is evaluated.

    Attributes:
        segments: (s,) segment of each; the last waypoint is at the fraction 1 of the last segment.
        fractions: (s,) where on the segment, from 0 to 1.
        weights: (s,) how much each counts.
        ranges: (s,) range of the barrier against obstacles there [m].
        shares: (s,) factor of the barrier between links there; where it is 0 that isn't looked at.
    """

    segments: Indices
    fractions: Row
    weights: Row
    ranges: Row
    shares: Row


SAMPLES = numba_type(PathSamples)


@compiled(SCALAR(MATRIX, VECTOR, MATRIX_OUT, BLOCKS_OUT, BLOCKS_OUT))
def _stretch(path: Floats, stiffness: Floats, gradient_out: Floats, diagonal_out: Floats, upper_out: Floats) -> float:
    """The first sum, its gradient and blocks; overwrites the outputs."""
    n, nv = path.shape
    gradient_out[:, :] = 0.0
    diagonal_out[:, :, :] = 0.0
    upper_out[:, :, :] = 0.0
    total = 0.0
    for k in range(n - 1):
        for j in range(nv):
            pull = stiffness[j] * (path[k + 1, j] - path[k, j])
            total += 0.5 * pull * (path[k + 1, j] - path[k, j])
            gradient_out[k, j] -= pull
            gradient_out[k + 1, j] += pull
            diagonal_out[k, j, j] += stiffness[j]
            diagonal_out[k + 1, j, j] += stiffness[j]
            upper_out[k, j, j] -= stiffness[j]
    return total


@compiled(
    SCALAR(ROBOT, TABLES, SAMPLES, MATRIX, VECTOR, SCALAR, SCALAR, NEAR_BODIES, MATRIX_OUT, BLOCKS_OUT, BLOCKS_OUT)
)
def objective(
    robot: SampledRobot,
    tables: DistanceTables,
    samples: PathSamples,
    path: Floats,
    stiffness: Floats,
    clearance: float,
    floor: float,
    near: NearBodies,
    gradient_out: Floats,
    diagonal_out: Floats,
    upper_out: Floats,
) -> float:
    """The objective of a path.

    Args:
        robot: The robot.
        tables: Obstacles.
        samples: Where the barrier is evaluated.
        path: Chart coordinates, shape (n, nv) [rad or m], n >= 2.
        stiffness: Diagonal of S, shape (nv,).
        clearance: Distance from obstacles at which the barrier's wall stands [m].
        floor: Distance from obstacles below which points cost more [m], positive.
        near: What is remembered of the samples; of the same path, moved, and the same walls.
        gradient_out: Shape (n, nv).
        diagonal_out: Hessian blocks of the waypoints, shape (n, nv, nv).
        upper_out: Hessian blocks that couple a waypoint with the next one, shape (n - 1, nv, nv).

    Returns:
        J.
    """
    nv = path.shape[1]
    z, gradient, hessian = np.empty(nv), np.empty(nv), np.empty((nv, nv))
    work = workspace(robot, tables)
    total = _stretch(path, stiffness, gradient_out, diagonal_out, upper_out)
    for s in range(samples.segments.shape[0]):
        k, t, w = samples.segments[s], samples.fractions[s], samples.weights[s]
        for j in range(nv):
            z[j] = path[k, j] + t * (path[k + 1, j] - path[k, j])
        walls = (samples.ranges[s], clearance, floor)
        value = robot_barrier(robot, tables, s, z, walls, samples.shares[s], near, work, gradient, hessian)
        if value == 0.0:
            continue
        total += w * value
        for i in range(nv):
            gradient_out[k, i] += w * (1.0 - t) * gradient[i]
            gradient_out[k + 1, i] += w * t * gradient[i]
            for j in range(nv):
                h = w * hessian[i, j]
                diagonal_out[k, i, j] += (1.0 - t) * (1.0 - t) * h
                diagonal_out[k + 1, i, j] += t * t * h
                upper_out[k, i, j] += t * (1.0 - t) * h
    return total
