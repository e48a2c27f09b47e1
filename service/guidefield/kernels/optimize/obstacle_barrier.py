"""The barrier between a robot's points and obstacles at one configuration and time, as forces on its joints.

The Hessian is Gauss and Newton's: b'' times the square of the distance's gradient, never negative. A point at x that is
pushed along n gives the spatial force f = (n, x x n); b' f and b'' f f^T gather at the joint that moves the point.

Obstacles that move are where they are at the time. From what moves there with the velocity v the distance d of a point
changes by

    ∂d/∂t = -n · v

so that the barrier has a derivative by time, and Gauss and Newton's Hessian one by time and configuration.

The optimizer lowers it and no proof reads it: another formula leads to other motions. `MARGIN` and `MOST` cost time
and memory alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.distance.distance import TABLES, DistanceTables, bodies_near, bounds_near, nearest_body
from guidefield.kernels.distance.points_distance import BatchVector3, signed_distance_of_each
from guidefield.kernels.distance.triangle_distance import box_gap_squared
from guidefield.kernels.jit.arrays import (
    SCALAR,
    VECTOR,
    BlocksOut,
    Floats,
    IndexBlocksOut,
    IndexRowsOut,
    Integers,
    Vector3,
    numba_type,
)
from guidefield.kernels.jit.decorators import compiled, uncounted
from guidefield.kernels.kinematics.poses import moved_by
from guidefield.kernels.optimize.barrier import (
    FIRST,
    JOINT,
    MOVING,
    PAST,
    RADIUS,
    ROBOT,
    MovedBodies,
    MovingBodies,
    SampledRobot,
    Workspace,
    barrier,
    deficit,
    lower_gaps,
    moved_bodies,
    place,
    place_moved,
    workspace,
)
from guidefield.kernels.simd.vector import LANES_64, Vector, load, select, store, total as total_of

MARGIN = 0.04  # a group may move this far before bodies near it are searched again [m], at size 1
MOST = 24  # bodies that are remembered of a group; with more about it they are searched each time


class NearBodies(NamedTuple):
    """Bodies near s configurations of a motion, by group; overwritten by every search."""

    centres: BlocksOut  # where each group's ball was when bodies were searched, shape (s, g, 3) [m]
    counts: IndexRowsOut  # how many there were, shape (s, g); -1 where nothing is remembered
    bodies: IndexBlocksOut  # their indices, shape (s, g, `MOST`)


NEAR_BODIES = numba_type(NearBodies)


def nothing_remembered(configurations: int, groups: int) -> NearBodies:
    """Return memory of no bodies near any of some configurations and groups."""
    return NearBodies(
        np.zeros((configurations, groups, 3)),
        np.full((configurations, groups), -1),
        np.zeros((configurations, groups, MOST), np.int64),
    )


@uncounted
def bodies_that_count(robot: SampledRobot, tables: DistanceTables, g: int, reach: float, work: Workspace) -> int:
    """Return how many bodies that count may be within reach of a group; the first of the candidates are they."""
    x, y, z = work.centres[g, 0], work.centres[g, 1], work.centres[g, 2]
    near, count = bodies_near(x, y, z, robot.balls[g, 3] + reach, tables, work.candidates), 0
    for k in range(near):
        if not robot.ignored[g, tables.obstacles[work.candidates[k]]]:
            work.candidates[count] = work.candidates[k]
            count += 1
    return count


@uncounted
def remembered_bodies(
    robot: SampledRobot, tables: DistanceTables, s: int, g: int, reach: float, near: NearBodies, work: Workspace
) -> int:
    """`bodies_that_count` near configuration s, remembered while the group stays near; for the same reach each time."""
    x, y, z = work.centres[g, 0], work.centres[g, 1], work.centres[g, 2]
    dx, dy, dz = x - near.centres[s, g, 0], y - near.centres[s, g, 1], z - near.centres[s, g, 2]
    margin = MARGIN * robot.size
    if near.counts[s, g] < 0 or dx * dx + dy * dy + dz * dz > margin * margin:
        found = bodies_that_count(robot, tables, g, reach + margin, work)
        near.counts[s, g] = found if found <= MOST else -1
        near.centres[s, g, 0], near.centres[s, g, 1], near.centres[s, g, 2] = x, y, z
        for k in range(min(found, MOST)):
            near.bodies[s, g, k] = work.candidates[k]
        if found > MOST:
            return found
    count, far = 0, (robot.balls[g, 3] + reach) ** 2
    for k in range(near.counts[s, g]):
        body = near.bodies[s, g, k]
        if box_gap_squared(x, y, z, tables.boxes, body) < far:
            work.candidates[count] = body
            count += 1
    return count


_NOWHERE = 1e6  # coordinates of lanes without a point: too far away to be measured to anything but what is as large [m]


@uncounted
def obstacle_barrier(
    robot: SampledRobot,
    tables: DistanceTables,
    moving: MovingBodies,
    s: int,
    time: float,
    walls: Vector3,
    near: NearBodies,
    work: Workspace,
    moved: MovedBodies,
) -> float:
    """The barrier between the robot's points and obstacles.

    Args:
        s: Under which number bodies near the configuration are remembered.
        time: When those that move are met [s].
        walls: Range of the barrier, positive; distance from obstacles at which its wall stands; floor, the distance
            below which points cost more, positive [m].
        work: Scratch, up to date with the configuration; forces and inertias gather in it.
        moved: Scratch; in it gathers how the barrier changes with time.

    Returns:
        Sum of the weighted barriers.
    """
    total = 0.0
    farthest = max(walls[0] + walls[1], walls[2])
    for g in range(robot.groups.shape[0]):
        count = remembered_bodies(robot, tables, s, g, farthest, near, work)
        if count == 0 or not _some_block_near(robot, g, tables, work.candidates, count, farthest, work):
            continue
        joint, first, last = robot.groups[g, JOINT], robot.groups[g, FIRST], robot.groups[g, PAST]
        T, block = work.joints.poses[joint], robot.first_blocks[g]
        work.sums[:] = 0.0
        for at in range(first, last, LANES_64):
            if _is_near(robot, block, farthest, work):
                x, y, z, w = _block(robot, at, last, work.block)
                p = moved_by(T, x, y, z)
                d, nx, ny, nz = signed_distance_of_each(p, work.candidates, count, tables, farthest, work.lanes)
                _add_block(p, d, (nx, ny, nz), w, walls, robot.size, work.sums)
            block += 1
        total += _gather(joint, work)
    if moving.motions.shape[0] > 0:
        total += _moving_barrier(robot, moving, time, walls, work, moved)
    return total


@uncounted
def _moving_barrier(
    robot: SampledRobot, moving: MovingBodies, time: float, walls: Vector3, work: Workspace, moved: MovedBodies
) -> float:
    place_moved(moving, time, moved)
    moved.forces[:, :] = 0.0
    moved.by_time[:] = 0.0
    total = 0.0
    farthest = max(walls[0] + walls[1], walls[2])
    for g in range(robot.groups.shape[0]):
        count = _near_group(robot, g, farthest, work, moved)
        if count == 0 or not _some_block_near(robot, g, moved.bodies, moved.candidates, count, farthest, work):
            continue
        joint, first, last = robot.groups[g, JOINT], robot.groups[g, FIRST], robot.groups[g, PAST]
        T, block = work.joints.poses[joint], robot.first_blocks[g]
        work.sums[:] = 0.0
        moved.sums[:] = 0.0
        for at in range(first, last, LANES_64):
            if _is_near(robot, block, farthest, work):
                x, y, z, w = _block(robot, at, last, work.block)
                p = moved_by(T, x, y, z)
                d, n, velocity = _nearest_moved(p, moving, count, farthest, work, moved)
                slope, curvature = _add_block(p, d, n, w, walls, robot.size, work.sums)
                _add_by_time(p, n, velocity, slope, curvature, moved.sums)
            block += 1
        total += _gather(joint, work)
        for k in range(2):
            moved.by_time[k] += total_of(load(moved.sums, k * LANES_64))
        for r in range(6):
            moved.forces[joint, r] += total_of(load(moved.sums, (2 + r) * LANES_64))
    return total


@uncounted
def _near_group(robot: SampledRobot, g: int, reach: float, work: Workspace, moved: MovedBodies) -> int:
    """Return how many moving bodies that count may be within reach of a group; the first candidates are they."""
    x, y, z, count = work.centres[g, 0], work.centres[g, 1], work.centres[g, 2], 0
    for body in range(moved.candidates.shape[0]):
        counts = not robot.ignored[g, moved.bodies.obstacles[body]]
        if counts and bounds_near(x, y, z, body, moved.bodies, robot.balls[g, 3] + reach):
            moved.candidates[count] = body
            count += 1
    return count


@uncounted
def _nearest_moved(
    p: BatchVector3, moving: MovingBodies, count: int, farthest: float, work: Workspace, moved: MovedBodies
) -> tuple[Vector, BatchVector3, tuple[Vector, ...]]:
    """Distance, unit vector and spatial velocity of the nearest moving candidate of each point; one motion's at once.

    Candidates of a motion stand together.
    """
    nothing, first = 0.0 * p[0], 0
    d, nx, ny, nz = nothing + farthest, nothing, nothing, nothing
    lx, ly, lz, wx, wy, wz = nothing, nothing, nothing, nothing, nothing, nothing
    while first < count:
        motion, past = moving.motions[moved.candidates[first]], first + 1
        while past < count and moving.motions[moved.candidates[past]] == motion:
            past += 1
        other, ox, oy, oz = signed_distance_of_each(
            p, moved.candidates[first:], past - first, moved.bodies, farthest, work.lanes
        )
        nearer, v = other < d, moved.velocities[motion]
        d, nx, ny, nz = select(nearer, other, d), select(nearer, ox, nx), select(nearer, oy, ny), select(nearer, oz, nz)
        lx, ly, lz = select(nearer, v[0], lx), select(nearer, v[1], ly), select(nearer, v[2], lz)
        wx, wy, wz = select(nearer, v[3], wx), select(nearer, v[4], wy), select(nearer, v[5], wz)
        first = past
    return d, (nx, ny, nz), (lx, ly, lz, wx, wy, wz)


@uncounted
def _add_by_time(
    p: BatchVector3, n: BatchVector3, velocity: tuple[Vector, ...], slope: Vector, curvature: Vector, sums: Floats
) -> None:
    """Add how points' barriers change with time, and their forces, of what moves with a spatial velocity."""
    mx, my, mz = p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0]
    lx, ly, lz, wx, wy, wz = velocity
    rate = -(n[0] * lx + n[1] * ly + n[2] * lz + mx * wx + my * wy + mz * wz)
    across = curvature * rate
    store(sums, 0, load(sums, 0) + slope * rate)
    store(sums, LANES_64, load(sums, LANES_64) + across * rate)
    _add_row(sums, 2 * LANES_64, across, (n[0], n[1], n[2], mx, my, mz))


@uncounted
def _add_block(
    p: BatchVector3, d: Vector, n: BatchVector3, w: Vector, walls: Vector3, size: float, sums: Floats
) -> tuple[Vector, Vector]:
    """Add the barriers of points at distances d, pushed along n, to a group's sums; their weighted derivatives by d."""
    reach, clearance, floor = walls
    value, slope, curvature = barrier(d - clearance, reach, size)
    more, more_slope, more_curvature = deficit(d, floor)
    store(sums, 0, load(sums, 0) + w * (value + more))
    slope, curvature = w * (slope + more_slope), w * (curvature + more_curvature)
    _sum_up(p, n, slope, curvature, sums)
    return slope, curvature


@uncounted
def _some_block_near(
    robot: SampledRobot,
    g: int,
    tables: DistanceTables,
    candidates: Integers,
    count: int,
    farthest: float,
    work: Workspace,
) -> bool:
    """Tell if any block of a group may be within range of the candidates; finds how far the boxes about them are."""
    T, first = work.joints.poses[robot.groups[g, JOINT]], robot.first_blocks[g]
    last = first + (robot.groups[g, PAST] - robot.groups[g, FIRST] + LANES_64 - 1) // LANES_64
    work.block_gaps[first:last] = math.inf
    for k in range(count):
        lower_gaps(T, robot.blocks, first, last, tables, candidates[k], work.block_gaps)
    some = False
    for block in range(first, last):
        some |= _is_near(robot, block, farthest, work)
    return some


@uncounted
def _is_near(robot: SampledRobot, block: int, farthest: float, work: Workspace) -> bool:
    reach = farthest + robot.blocks[RADIUS, block]
    near: bool = work.block_gaps[block] < reach * reach
    return near


@uncounted
def _block(robot: SampledRobot, at: int, last: int, scratch: Floats) -> tuple[Vector, Vector, Vector, Vector]:
    """A block of a group's points, in the frame of their joint [m], and their weights: 0 where there is none."""
    if at + LANES_64 <= last:
        points = robot.points
        return load(points[0], at), load(points[1], at), load(points[2], at), load(robot.weights, at)
    for i in range(LANES_64):
        there, is_point = min(at + i, last - 1), at + i < last
        for r in range(3):
            scratch[r * LANES_64 + i] = robot.points[r, there] if is_point else _NOWHERE
        scratch[3 * LANES_64 + i] = robot.weights[there] if is_point else 0.0
    return load(scratch, 0), load(scratch, LANES_64), load(scratch, 2 * LANES_64), load(scratch, 3 * LANES_64)


@uncounted
def _sum_up(p: BatchVector3, n: BatchVector3, slope: Vector, curvature: Vector, sums: Floats) -> None:
    """Add forces and inertias of points at p that are pushed along n [m] to a group's sums, lane by lane."""
    nx, ny, nz = n
    mx, my, mz = p[1] * nz - p[2] * ny, p[2] * nx - p[0] * nz, p[0] * ny - p[1] * nx
    at = LANES_64
    for one in (nx, ny, nz, mx, my, mz):
        store(sums, at, load(sums, at) + slope * one)
        at += LANES_64
    at = _add_row(sums, at, curvature * nx, (nx, ny, nz, mx, my, mz))
    at = _add_row(sums, at, curvature * ny, (ny, nz, mx, my, mz))
    at = _add_row(sums, at, curvature * nz, (nz, mx, my, mz))
    at = _add_row(sums, at, curvature * mx, (mx, my, mz))
    at = _add_row(sums, at, curvature * my, (my, mz))
    _add_row(sums, at, curvature * mz, (mz,))


@uncounted
def _add_row(sums: Floats, at: int, share: Vector, row: tuple[Vector, ...]) -> int:
    """Add a row of the inertias' upper triangle; where the next one begins."""
    for one in row:
        store(sums, at, load(sums, at) + share * one)
        at += LANES_64
    return at


@uncounted
def _gather(joint: int, work: Workspace) -> float:
    """Add a group's sums to the force and the inertia of its joint; its barrier."""
    at = LANES_64
    for r in range(6):
        work.forces[joint, r] += total_of(load(work.sums, at))
        at += LANES_64
    for r in range(6):
        for c in range(r, 6):
            work.inertias[joint, r, c] += total_of(load(work.sums, at))
            at += LANES_64
    barrier_of_all: float = total_of(load(work.sums, 0))
    return barrier_of_all


@uncounted
def _nearest_of_group(
    robot: SampledRobot, g: int, tables: DistanceTables, candidates: Integers, count: int, best: float, work: Workspace
) -> float:
    """Return the smallest distance of a group's points from candidates, `best` at most [m]."""
    if count > 0:
        T = work.joints.poses[robot.groups[g, JOINT]]
        for i in range(robot.groups[g, FIRST], robot.groups[g, PAST]):
            x, y, z = moved_by(T, robot.points[0, i], robot.points[1, i], robot.points[2, i])
            best = min(best, nearest_body(x, y, z, candidates, count, tables, best)[0])
    return best


@compiled(SCALAR(ROBOT, TABLES, VECTOR, SCALAR))
def obstacle_distance(robot: SampledRobot, tables: DistanceTables, z: Floats, cutoff: float) -> float:
    """Smallest distance from the robot's points to obstacles that rest, at one configuration [m].

    Args:
        z: Local coordinates, shape (nv,).
        cutoff: What is returned where nothing is nearer [m], positive.
    """
    work = workspace(robot, tables)
    place(robot, z, work)
    best = cutoff
    for g in range(robot.groups.shape[0]):
        count = bodies_that_count(robot, tables, g, max(best, 0.0), work)
        best = _nearest_of_group(robot, g, tables, work.candidates, count, best, work)
    return best


@compiled(SCALAR(ROBOT, MOVING, VECTOR, SCALAR, SCALAR))
def moving_distance(robot: SampledRobot, moving: MovingBodies, z: Floats, time: float, cutoff: float) -> float:
    """Smallest distance to obstacles that move, at local coordinates (nv,) and a time [s]; else `obstacle_distance`."""
    work = workspace(robot, moving.bodies)
    moved = moved_bodies(moving, robot.joints.table.parents.shape[0], robot.joints.offsets.shape[0])
    place(robot, z, work)
    place_moved(moving, time, moved)
    best = cutoff
    for g in range(robot.groups.shape[0]):
        count = _near_group(robot, g, max(best, 0.0), work, moved)
        best = _nearest_of_group(robot, g, moved.bodies, moved.candidates, count, best, work)
    return best
