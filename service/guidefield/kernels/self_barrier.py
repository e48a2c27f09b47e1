"""The barrier between points of links and capsules about others at one configuration.

A capsule's own motion takes away what the point's adds: only the joints between the two links change the distance.
"""

from __future__ import annotations

import math

from numba import void

from guidefield.kernels.barrier import barrier
from guidefield.kernels.distance import TABLES, DistanceTables
from guidefield.kernels.sampled_robot import ROBOT, SampledRobot, Workspace, moved, place, workspace
from guidefield.kernels.shape_distance import capsule_distance
from guidefield.kernels.signatures import VECTOR, VECTOR_OUT, Floats, Vector3, compiled, inlined

SELF_RANGE = 0.03
"""Range of the barrier between links [m]."""


@inlined
def self_barrier(robot: SampledRobot, work: Workspace) -> float:
    """The barrier of all pairs; adds to the workspace's gradient and Hessian.

    Args:
        robot: The robot.
        work: Scratch, up to date with the configuration.

    Returns:
        Sum of the weighted barriers.
    """
    total = 0.0
    for k in range(robot.pairs.shape[0]):
        g, other = robot.pairs[k, 0], robot.pairs[k, 1]
        a, along = _capsule(robot, other, work)
        radius = robot.capsules[other, 6] - robot.slacks[k]
        T = work.world[robot.groups[g, 0]]
        centre = moved(T, robot.balls[g, 0], robot.balls[g, 1], robot.balls[g, 2])
        if _to_capsule(centre, a, along, radius)[0] >= SELF_RANGE + robot.balls[g, 3]:
            continue
        for i in range(robot.groups[g, 1], robot.groups[g, 2]):
            p = moved(T, robot.points[0, i], robot.points[1, i], robot.points[2, i])
            d, n = _to_capsule(p, a, along, radius)
            if d < SELF_RANGE:
                value, slope, curvature = barrier(d, SELF_RANGE)
                w = robot.weights[i]
                total += w * value
                _row(robot, robot.groups[g, 0], robot.capsule_joints[other], p, n, work)
                _add(w * slope, w * curvature, work)
    return total


@inlined
def _capsule(robot: SampledRobot, k: int, work: Workspace) -> tuple[Vector3, Vector3]:
    """A capsule's first end in the world, and the way to its other end."""
    T, C = work.world[robot.capsule_joints[k]], robot.capsules[k]
    a = moved(T, C[0], C[1], C[2])
    b = moved(T, C[3], C[4], C[5])
    return a, (b[0] - a[0], b[1] - a[1], b[2] - a[2])


@inlined
def _to_capsule(p: Vector3, a: Vector3, along: Vector3, radius: float) -> tuple[float, Vector3]:
    """Signed distance of a point to a capsule, and the unit vector along which it grows."""
    arm = (p[0] - a[0], p[1] - a[1], p[2] - a[2])
    square = along[0] * along[0] + along[1] * along[1] + along[2] * along[2]
    share = arm[0] * along[0] + arm[1] * along[1] + arm[2] * along[2]
    share = min(max(share / square, 0.0), 1.0) if square > 0.0 else 0.0
    away = (arm[0] - share * along[0], arm[1] - share * along[1], arm[2] - share * along[2])
    d, nx, ny, nz = capsule_distance(away, radius, 0.0)
    return d, (nx, ny, nz)


@inlined
def _row(robot: SampledRobot, joint: int, other: int, p: Vector3, n: Vector3, work: Workspace) -> None:
    """Gradient of the distance of a point that moves with a joint, along n, to what moves with another."""
    parents, idx_v, S = robot.joints.parents, robot.joints.idx_v, work.subspaces
    m = (p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0])
    work.row[:] = 0.0
    for sign, end in ((1.0, joint), (-1.0, other)):
        j = end
        while j > 0:
            for v in range(idx_v[j], idx_v[j] + robot.joints.nv[j]):
                linear = S[v, 0] * n[0] + S[v, 1] * n[1] + S[v, 2] * n[2]
                work.row[v] += sign * (linear + S[v, 3] * m[0] + S[v, 4] * m[1] + S[v, 5] * m[2])
            j = parents[j]


@inlined
def _add(slope: float, curvature: float, work: Workspace) -> None:
    """Add a distance's share to gradient and Hessian."""
    for r in range(work.row.shape[0]):
        work.gradient[r] += slope * work.row[r]
        for c in range(work.row.shape[0]):
            work.hessian[r, c] += curvature * work.row[r] * work.row[c]


@compiled(void(ROBOT, TABLES, VECTOR, VECTOR_OUT))
def pair_distances(robot: SampledRobot, tables: DistanceTables, z: Floats, distances_out: Floats) -> None:
    """Smallest distance from the points to the capsule of every pair, slacks left out.

    Args:
        robot: The robot.
        tables: Any obstacles.
        z: Chart coordinates, shape (nv,).
        distances_out: Shape (k,) [m].
    """
    work = workspace(robot, tables)
    place(robot, z, work)
    for k in range(robot.pairs.shape[0]):
        g, other = robot.pairs[k, 0], robot.pairs[k, 1]
        T = work.world[robot.groups[g, 0]]
        a, along = _capsule(robot, other, work)
        distances_out[k] = math.inf
        for i in range(robot.groups[g, 1], robot.groups[g, 2]):
            p = moved(T, robot.points[0, i], robot.points[1, i], robot.points[2, i])
            distances_out[k] = min(distances_out[k], _to_capsule(p, a, along, robot.capsules[other, 6])[0])
