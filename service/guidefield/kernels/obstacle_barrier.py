"""The barrier between a robot's points and obstacles at one configuration, as forces and inertias on its joints.

The Hessian is Gauss and Newton's: b'' times the square of the distance's gradient, never negative. A point at x that is
pushed along n gives the spatial force f = (n, x x n); b' f and b'' f f^T gather at the joint that moves the point.
"""

from __future__ import annotations

import math

from guidefield.kernels.barrier import barrier
from guidefield.kernels.distance import DistanceTables, bodies_near, nearest_body
from guidefield.kernels.sampled_robot import SampledRobot, Workspace, moved
from guidefield.kernels.signatures import Floats, Vector3, inlined


@inlined
def obstacle_barrier(
    robot: SampledRobot, tables: DistanceTables, reach: float, clearance: float, work: Workspace
) -> float:
    """The barrier between the robot's points and obstacles.

    Args:
        robot: The robot.
        tables: Obstacles.
        reach: Range of the barrier [m], positive.
        clearance: Distance from obstacles at which its wall stands [m].
        work: Scratch, up to date with the configuration; forces and inertias gather in it.

    Returns:
        Sum of the weighted barriers.
    """
    total = 0.0
    for g in range(robot.groups.shape[0]):
        joint = robot.groups[g, 0]
        T = work.world[joint]
        cx, cy, cz = moved(T, robot.balls[g, 0], robot.balls[g, 1], robot.balls[g, 2])
        near = bodies_near(cx, cy, cz, robot.balls[g, 3] + reach + clearance, tables, work.candidates)
        count = 0
        for k in range(near):
            if not robot.ignored[g, tables.obstacles[work.candidates[k]]]:
                work.candidates[count] = work.candidates[k]
                count += 1
        if count == 0:
            continue
        first, last = robot.groups[g, 1], robot.groups[g, 2]
        work.gaps[first:last] = math.inf
        for k in range(count):
            _box_gaps(robot, g, T, tables, work.candidates[k], work.gaps)
        for i in range(first, last):
            if work.gaps[i] >= (reach + clearance) ** 2:
                continue
            x, y, z = moved(T, robot.points[0, i], robot.points[1, i], robot.points[2, i])
            d, nx, ny, nz, body = nearest_body(x, y, z, work.candidates, count, tables, reach + clearance)
            if body < 0:
                continue
            value, slope, curvature = barrier(d - clearance, reach)
            w = robot.weights[i]
            total += w * value
            _gather(joint, (x, y, z), (nx, ny, nz), w * slope, w * curvature, work)
    return total


@inlined
def _gather(joint: int, p: Vector3, n: Vector3, slope: float, curvature: float, work: Workspace) -> None:
    """Add a point's force and inertia to a joint's."""
    f = (n[0], n[1], n[2], p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0])
    for r in range(6):
        work.forces[joint, r] += slope * f[r]
        for c in range(r, 6):
            work.inertias[joint, r, c] += curvature * f[r] * f[c]


@inlined
def _box_gaps(robot: SampledRobot, g: int, T: Floats, tables: DistanceTables, body: int, gaps_out: Floats) -> None:
    """Lower the gaps of a group's points to those to the box about a body; a vector loop."""
    B, bounds = tables.placements[body], tables.bounds[body]
    r00 = B[0, 0] * T[0, 0] + B[1, 0] * T[1, 0] + B[2, 0] * T[2, 0]
    r01 = B[0, 0] * T[0, 1] + B[1, 0] * T[1, 1] + B[2, 0] * T[2, 1]
    r02 = B[0, 0] * T[0, 2] + B[1, 0] * T[1, 2] + B[2, 0] * T[2, 2]
    r10 = B[0, 1] * T[0, 0] + B[1, 1] * T[1, 0] + B[2, 1] * T[2, 0]
    r11 = B[0, 1] * T[0, 1] + B[1, 1] * T[1, 1] + B[2, 1] * T[2, 1]
    r12 = B[0, 1] * T[0, 2] + B[1, 1] * T[1, 2] + B[2, 1] * T[2, 2]
    r20 = B[0, 2] * T[0, 0] + B[1, 2] * T[1, 0] + B[2, 2] * T[2, 0]
    r21 = B[0, 2] * T[0, 1] + B[1, 2] * T[1, 1] + B[2, 2] * T[2, 1]
    r22 = B[0, 2] * T[0, 2] + B[1, 2] * T[1, 2] + B[2, 2] * T[2, 2]
    dx, dy, dz = T[0, 3] - B[0, 3], T[1, 3] - B[1, 3], T[2, 3] - B[2, 3]
    tx = B[0, 0] * dx + B[1, 0] * dy + B[2, 0] * dz
    ty = B[0, 1] * dx + B[1, 1] * dy + B[2, 1] * dz
    tz = B[0, 2] * dx + B[1, 2] * dy + B[2, 2] * dz
    lx, ly, lz, hx, hy, hz = bounds[0], bounds[1], bounds[2], bounds[3], bounds[4], bounds[5]
    px, py, pz = robot.points[0], robot.points[1], robot.points[2]
    for i in range(robot.groups[g, 1], robot.groups[g, 2]):
        x = r00 * px[i] + r01 * py[i] + r02 * pz[i] + tx
        y = r10 * px[i] + r11 * py[i] + r12 * pz[i] + ty
        z = r20 * px[i] + r21 * py[i] + r22 * pz[i] + tz
        ex = max(lx - x, x - hx, 0.0)
        ey = max(ly - y, y - hy, 0.0)
        ez = max(lz - z, z - hz, 0.0)
        gaps_out[i] = min(gaps_out[i], ex * ex + ey * ey + ez * ez)
