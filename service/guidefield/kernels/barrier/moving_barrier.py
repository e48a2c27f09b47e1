"""The barrier between a robot's points and obstacles that move, at one configuration and time.

It is that of obstacles at rest, where they are then. With the time its distances change too: a point at x that is
pushed along n is left by what moves there with the velocity v, and its distance d changes by

    ∂d/∂t = -n · v

so that the barrier has a derivative by time, and Gauss and Newton's Hessian one by time and configuration.
"""

from __future__ import annotations

import math

from guidefield.kernels.barrier.barrier import barrier, deficit
from guidefield.kernels.barrier.moving_bodies import MOVING, MovedBodies, MovingBodies, moved_bodies, place_moved
from guidefield.kernels.barrier.sampled_robot import (
    FIRST,
    JOINT,
    PAST,
    ROBOT,
    SampledRobot,
    Workspace,
    lower_gaps,
    place,
    workspace,
)
from guidefield.kernels.distance.distance import bounds_near, nearest_body
from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import SCALAR, VECTOR, Floats, Vector3, compiled
from guidefield.kernels.kinematics.poses import moved_by


@uncounted
def moving_barrier(
    robot: SampledRobot, moving: MovingBodies, time: float, walls: Vector3, work: Workspace, moved: MovedBodies
) -> float:
    """The barrier between the robot's points and obstacles that move.

    Args:
        robot: The robot.
        moving: The obstacles.
        time: When they are met [s].
        walls: As in `obstacle_barrier` [m].
        work: Scratch, up to date with the configuration; forces and inertias gather in it.
        moved: Scratch; in it gathers how the barrier changes with time.

    Returns:
        Sum of the weighted barriers.
    """
    place_moved(moving, time, moved)
    moved.forces[:, :] = 0.0
    moved.by_time[:] = 0.0
    total = 0.0
    reach, clearance, floor = walls
    farthest = max(reach + clearance, floor)
    for g in range(robot.groups.shape[0]):
        count = _near_group(robot, g, farthest, work, moved)
        if count == 0:
            continue
        joint, first, last = robot.groups[g, JOINT], robot.groups[g, FIRST], robot.groups[g, PAST]
        T = work.joints.poses[joint]
        work.gaps[first:last] = math.inf
        for k in range(count):
            lower_gaps(T, robot.points, first, last, moved.bodies, moved.candidates[k], work.gaps)
        for i in range(first, last):
            if work.gaps[i] >= farthest * farthest:
                continue
            p = moved_by(T, robot.points[0, i], robot.points[1, i], robot.points[2, i])
            d, nx, ny, nz, body = nearest_body(p[0], p[1], p[2], moved.candidates, count, moved.bodies, farthest)
            if body < 0:
                continue
            value, slope, curvature = barrier(d - clearance, reach)
            more, more_slope, more_curvature = deficit(d, floor)
            w = robot.weights[i]
            total += w * (value + more)
            slope, curvature = w * (slope + more_slope), w * (curvature + more_curvature)
            n = (nx, ny, nz)
            _gather(joint, p, n, slope, curvature, work)
            _gather_by_time(joint, p, n, moved.velocities[moving.motions[body]], slope, curvature, moved)
    return total


@uncounted
def _near_group(robot: SampledRobot, g: int, reach: float, work: Workspace, moved: MovedBodies) -> int:
    """How many bodies that count may be within reach of a group; the first of the candidates are they."""
    x, y, z, count = work.centres[g, 0], work.centres[g, 1], work.centres[g, 2], 0
    for body in range(moved.candidates.shape[0]):
        counts = not robot.ignored[g, moved.bodies.obstacles[body]]
        if counts and bounds_near(x, y, z, body, moved.bodies, robot.balls[g, 3] + reach):
            moved.candidates[count] = body
            count += 1
    return count


@uncounted
def _gather(joint: int, p: Vector3, n: Vector3, slope: float, curvature: float, work: Workspace) -> None:
    """Add a point's force and inertia to a joint's: it is at p, and pushed along n [m]."""
    f = (n[0], n[1], n[2], p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0])
    for r in range(6):
        work.forces[joint, r] += slope * f[r]
        for c in range(r, 6):
            work.inertias[joint, r, c] += curvature * f[r] * f[c]


@uncounted
def _gather_by_time(
    joint: int, p: Vector3, n: Vector3, velocity: Floats, slope: float, curvature: float, moved: MovedBodies
) -> None:
    """Add how a point's barrier changes with time, and its force, of what moves with a velocity (6,)."""
    m = (p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0])
    rate = -(n[0] * velocity[0] + n[1] * velocity[1] + n[2] * velocity[2])
    rate -= m[0] * velocity[3] + m[1] * velocity[4] + m[2] * velocity[5]
    moved.by_time[0] += slope * rate
    moved.by_time[1] += curvature * rate * rate
    for r in range(3):
        moved.forces[joint, r] += curvature * rate * n[r]
        moved.forces[joint, 3 + r] += curvature * rate * m[r]


@compiled(SCALAR(ROBOT, MOVING, VECTOR, SCALAR, SCALAR))
def moving_distance(robot: SampledRobot, moving: MovingBodies, z: Floats, time: float, cutoff: float) -> float:
    """Smallest distance from the robot's points to obstacles that move, at one configuration and time [m].

    Args:
        robot: The robot.
        moving: The obstacles.
        z: Chart coordinates, shape (nv,).
        time: When [s].
        cutoff: What is returned where nothing is nearer [m], positive.
    """
    work = workspace(robot, moving.bodies)
    moved = moved_bodies(moving, robot.joints.table.parents.shape[0], robot.joints.offsets.shape[0])
    place(robot, z, work)
    place_moved(moving, time, moved)
    best = cutoff
    for g in range(robot.groups.shape[0]):
        count = _near_group(robot, g, max(best, 0.0), work, moved)
        if count == 0:
            continue
        T, first, last = work.joints.poses[robot.groups[g, JOINT]], robot.groups[g, FIRST], robot.groups[g, PAST]
        work.gaps[first:last] = math.inf
        for k in range(count):
            lower_gaps(T, robot.points, first, last, moved.bodies, moved.candidates[k], work.gaps)
        for i in range(first, last):
            if work.gaps[i] > 0.0 and (best <= 0.0 or work.gaps[i] >= best * best):
                continue
            x, y, z_ = moved_by(T, robot.points[0, i], robot.points[1, i], robot.points[2, i])
            best = min(best, nearest_body(x, y, z_, moved.candidates, count, moved.bodies, best)[0])
    return best
