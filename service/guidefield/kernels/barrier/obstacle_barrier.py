"""The barrier between a robot's points and obstacles at one configuration, as forces and inertias on its joints.

The Hessian is Gauss and Newton's: b'' times the square of the distance's gradient, never negative. A point at x that is
pushed along n gives the spatial force f = (n, x x n); b' f and b'' f f^T gather at the joint that moves the point.
"""

from __future__ import annotations

import math

from guidefield.kernels.barrier.barrier import barrier, deficit
from guidefield.kernels.barrier.sampled_robot import (
    FIRST,
    JOINT,
    PAST,
    ROBOT,
    SampledRobot,
    Workspace,
    lower_gaps,
    nearest_candidate,
    place,
    workspace,
)
from guidefield.kernels.barrier.verlet_list import NearBodies, bodies_that_count, remembered_bodies
from guidefield.kernels.distance.distance import TABLES, DistanceTables, nearest_body
from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import SCALAR, VECTOR, Floats, Vector3, compiled
from guidefield.kernels.kinematics.poses import moved_by


@uncounted
def obstacle_barrier(
    robot: SampledRobot,
    tables: DistanceTables,
    s: int,
    walls: Vector3,
    near: NearBodies,
    work: Workspace,
) -> float:
    """The barrier between the robot's points and obstacles.

    Args:
        robot: The robot.
        tables: Obstacles.
        s: Under which number bodies near the configuration are remembered.
        walls: Range of the barrier, positive; distance from obstacles at which its wall stands; floor, the distance
            below which points cost more, positive [m].
        near: What is remembered.
        work: Scratch, up to date with the configuration; forces and inertias gather in it.

    Returns:
        Sum of the weighted barriers.
    """
    total = 0.0
    reach, clearance, floor = walls
    farthest = max(reach + clearance, floor)
    for g in range(robot.groups.shape[0]):
        joint = robot.groups[g, JOINT]
        T = work.world[joint]
        count = remembered_bodies(robot, tables, s, g, farthest, near, work)
        if count == 0:
            continue
        first, last = robot.groups[g, FIRST], robot.groups[g, PAST]
        work.gaps[first:last] = math.inf
        for k in range(count):
            lower_gaps(robot, g, last, tables, work.candidates[k], k, work)
        for i in range(first, last):
            if work.gaps[i] >= farthest * farthest:
                continue
            p = moved_by(T, robot.points[0, i], robot.points[1, i], robot.points[2, i])
            d, nx, ny, nz, body = nearest_candidate(p, i - first, work.candidates, count, tables, farthest, work)
            if body < 0:
                continue
            value, slope, curvature = barrier(d - clearance, reach)
            more, more_slope, more_curvature = deficit(d, floor)
            w = robot.weights[i]
            total += w * (value + more)
            gather(joint, p, (nx, ny, nz), w * (slope + more_slope), w * (curvature + more_curvature), work)
    return total


@uncounted
def gather(joint: int, p: Vector3, n: Vector3, slope: float, curvature: float, work: Workspace) -> None:
    """Add a point's force and inertia to a joint's: it is at p, and pushed along n [m]."""
    f = (n[0], n[1], n[2], p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0])
    for r in range(6):
        work.forces[joint, r] += slope * f[r]
        for c in range(r, 6):
            work.inertias[joint, r, c] += curvature * f[r] * f[c]


@compiled(SCALAR(ROBOT, TABLES, VECTOR, SCALAR))
def obstacle_distance(robot: SampledRobot, tables: DistanceTables, z: Floats, cutoff: float) -> float:
    """Smallest distance from the robot's points to obstacles at one configuration [m].

    Args:
        robot: The robot.
        tables: Obstacles.
        z: Chart coordinates, shape (nv,).
        cutoff: What is returned where nothing is nearer [m], positive.
    """
    work = workspace(robot, tables, 1)
    place(robot, z, work)
    best = cutoff
    for g in range(robot.groups.shape[0]):
        count = bodies_that_count(robot, tables, g, max(best, 0.0), work)
        T = work.world[robot.groups[g, JOINT]]
        for i in range(robot.groups[g, FIRST], robot.groups[g, PAST]):
            x, y, z_ = moved_by(T, robot.points[0, i], robot.points[1, i], robot.points[2, i])
            best = min(best, nearest_body(x, y, z_, work.candidates, count, tables, best)[0])
    return best
