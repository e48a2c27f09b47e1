"""The barrier that keeps a robot away from obstacles and from itself at one configuration, with gradient and Hessian.

A point at the signed distance d costs b(d / range), b(x) = (1 - x)^2 / x^3 below 1 and 0 beyond, once continuously
differentiable. Below `SOFT` it is the parabola that continues it, so that what is inside an obstacle is pushed out with a
finite force. Near the surface it is the field's law to a higher power, cut off at a range: the field itself, 2 pi/d plus
what is far away, was measured to be the wrong objective for a path.

The Hessian is Gauss and Newton's: b'' times the square of the distance's gradient, never negative. Each point gives a
spatial force f = (n, x x n) of unit size; b' f and b'' f f^T gather at the joint that moves the point and are carried to
the root, as forces and inertias are.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types, void

from guidefield.kernels.distance import (
    INDEX_MATRIX,
    INDICES_OUT,
    TABLES,
    DistanceTables,
    bodies_near,
    capsule_distance,
    nearest_body,
)
from guidefield.kernels.signatures import MATRIX, MATRIX_OUT, SCALAR, VECTOR, VECTOR_OUT, Floats, Vector3, compiled, inlined
from guidefield.kernels.tree_kinematics import (
    BLOCKS,
    BLOCKS_OUT,
    CONTINUOUS,
    INDICES,
    JointTable,
    joint_placements,
    motion_subspaces,
)

SOFT = 0.01
"""Below this distance the barrier is its parabola [m]."""

SELF_RANGE = 0.03
"""Range of the barrier between links [m]."""

FLAGS = types.Array(types.boolean, 2, "C", readonly=True)
JOINTS = types.NamedTuple((INDICES, INDICES, MATRIX, BLOCKS, INDICES, INDICES, INDICES), JointTable)


class SampledRobot(NamedTuple):
    """A robot as points on its surface and capsules about its links; revolute, continuous and prismatic joints.

    Attributes:
        joints: Joints of the robot's model, followers included.
        drivers, multipliers, offsets: (model nv,) value i of the model is multipliers[i] z[drivers[i]] + offsets[i].
        points: (3, p) on moving links, in the frame of their joint [m]; those of a group stand together.
        weights: (p,) how much each counts.
        groups: (g, 3) joint, first point, one past the last point.
        balls: (g, 4) centre and radius of a ball about a group's points, in the frame of the joint [m].
        ignored: (g, obstacles) whether a group's distance to an obstacle doesn't count.
        capsules: (c, 7) ends and radius in the frame of their joint [m].
        capsule_joints: (c,) joint of each capsule.
        pairs: (k, 2) group and capsule of links that are kept apart.
        slacks: (k,) added to the distance of each pair [m].
    """

    joints: JointTable
    drivers: np.ndarray
    multipliers: Floats
    offsets: Floats
    points: Floats
    weights: Floats
    groups: np.ndarray
    balls: Floats
    ignored: np.ndarray
    capsules: Floats
    capsule_joints: np.ndarray
    pairs: np.ndarray
    slacks: Floats


ROBOT = types.NamedTuple(
    (JOINTS, INDICES, VECTOR, VECTOR, MATRIX, VECTOR, INDEX_MATRIX, MATRIX, FLAGS, MATRIX, INDICES, INDEX_MATRIX, VECTOR),
    SampledRobot,
)


class Workspace(NamedTuple):
    """Scratch of `barrier_at`, overwritten by every call.

    Attributes:
        q: Configuration of the model.
        values: Values of the model's joints.
        row: Gradient of one distance by those values.
        gradient, hessian: Sums by those values.
        world: Placements of the joints.
        subspaces: Their motion subspaces.
        forces, inertias: What has gathered at each joint, (n, 6) and (n, 6, 6) of which the upper triangle is used.
        candidates: Bodies near a group.
        gaps: Square of the distance from a group's points to the nearest box about a body.
    """

    q: Floats
    values: Floats
    row: Floats
    gradient: Floats
    hessian: Floats
    world: Floats
    subspaces: Floats
    forces: Floats
    inertias: Floats
    candidates: np.ndarray
    gaps: Floats


WORKSPACE = types.NamedTuple(
    (
        VECTOR_OUT,
        VECTOR_OUT,
        VECTOR_OUT,
        VECTOR_OUT,
        MATRIX_OUT,
        BLOCKS_OUT,
        MATRIX_OUT,
        MATRIX_OUT,
        BLOCKS_OUT,
        INDICES_OUT,
        VECTOR_OUT,
    ),
    Workspace,
)


@inlined
def workspace(robot: SampledRobot, tables: DistanceTables) -> Workspace:
    """Scratch for a robot among some bodies."""
    n, nv = robot.joints.parents.shape[0], robot.offsets.shape[0]
    return Workspace(
        np.empty(2 * nv),
        np.empty(nv),
        np.empty(nv),
        np.empty(nv),
        np.empty((nv, nv)),
        np.empty((n, 3, 4)),
        np.empty((nv, 6)),
        np.empty((n, 6)),
        np.empty((n, 6, 6)),
        np.empty(tables.kinds.shape[0], np.int64),
        np.empty(robot.points.shape[1]),
    )


@inlined
def barrier(distance: float, reach: float) -> tuple[float, float, float]:
    """The barrier of range `reach` at a distance: value, first and second derivative by the distance."""
    if distance >= reach:
        return 0.0, 0.0, 0.0
    soft = min(SOFT, 0.5 * reach)
    x = max(distance, soft) / reach
    over = 1.0 / x
    cube = over * over * over
    gap = 1.0 - x
    value = gap * gap * cube
    slope = -(2.0 * gap + 3.0 * gap * gap * over) * cube / reach
    curvature = (2.0 + 12.0 * gap * over + 12.0 * gap * gap * over * over) * cube / (reach * reach)
    deeper = min(distance - soft, 0.0)
    return value + deeper * (slope + 0.5 * deeper * curvature), slope + deeper * curvature, curvature


@inlined
def _moved(T: Floats, x: float, y: float, z: float) -> Vector3:
    """A point of a placed frame in the world."""
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3],
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3],
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3],
    )


@inlined
def place(robot: SampledRobot, z: Floats, work: Workspace) -> None:
    """Placements and motion subspaces of the joints at chart coordinates z."""
    joints = robot.joints
    for i in range(robot.offsets.shape[0]):
        work.values[i] = robot.multipliers[i] * z[robot.drivers[i]] + robot.offsets[i]
    for i in range(1, joints.parents.shape[0]):
        value, at = work.values[joints.idx_v[i]], joints.idx_q[i]
        if joints.kinds[i] == CONTINUOUS:
            work.q[at] = math.cos(value)
            work.q[at + 1] = math.sin(value)
        else:
            work.q[at] = value
    joint_placements(joints.parents, joints.kinds, joints.axes, joints.placements, joints.idx_q, work.q, work.world)
    motion_subspaces(joints.kinds, joints.axes, joints.idx_v, joints.nv, work.world, work.subspaces)


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


@inlined
def _obstacles(robot: SampledRobot, tables: DistanceTables, reach: float, clearance: float, work: Workspace) -> float:
    """The barrier between the robot's points and obstacles; forces and inertias gather in the workspace."""
    total = 0.0
    for g in range(robot.groups.shape[0]):
        joint = robot.groups[g, 0]
        T = work.world[joint]
        cx, cy, cz = _moved(T, robot.balls[g, 0], robot.balls[g, 1], robot.balls[g, 2])
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
            x, y, z = _moved(T, robot.points[0, i], robot.points[1, i], robot.points[2, i])
            d, nx, ny, nz, body = nearest_body(x, y, z, work.candidates, count, tables, reach + clearance)
            if body < 0:
                continue
            value, slope, curvature = barrier(d - clearance, reach)
            w = robot.weights[i]
            total += w * value
            _gather(joint, (x, y, z), (nx, ny, nz), w * slope, w * curvature, work)
    return total


@inlined
def _carry(joints: JointTable, work: Workspace) -> None:
    """Carry forces and inertias to the root; gradient and Hessian by the model's joint values."""
    S = work.subspaces
    work.hessian[:, :] = 0.0
    for i in range(joints.parents.shape[0] - 1, 0, -1):
        row, A = joints.idx_v[i], work.inertias[i]
        value = 0.0
        for c in range(6):
            value += S[row, c] * work.forces[i, c]
        work.gradient[row] = value
        r0 = r1 = r2 = r3 = r4 = r5 = 0.0
        for c in range(6):
            s = S[row, c]
            r0 += s * A[0, c]
            r1 += s * A[min(1, c), max(1, c)]
            r2 += s * A[min(2, c), max(2, c)]
            r3 += s * A[min(3, c), max(3, c)]
            r4 += s * A[min(4, c), max(4, c)]
            r5 += s * A[c, 5]
        j = i
        while j > 0:
            column = joints.idx_v[j]
            value = S[column, 0] * r0 + S[column, 1] * r1 + S[column, 2] * r2
            value += S[column, 3] * r3 + S[column, 4] * r4 + S[column, 5] * r5
            work.hessian[row, column] = value
            work.hessian[column, row] = value
            j = joints.parents[j]
        parent = joints.parents[i]
        for r in range(6):
            work.forces[parent, r] += work.forces[i, r]
            for c in range(r, 6):
                work.inertias[parent, r, c] += A[r, c]


@inlined
def _capsule(robot: SampledRobot, k: int, work: Workspace) -> tuple[Vector3, Vector3, float]:
    """A capsule's first end in the world, the way to its other end, its radius."""
    T, C = work.world[robot.capsule_joints[k]], robot.capsules[k]
    a = _moved(T, C[0], C[1], C[2])
    b = _moved(T, C[3], C[4], C[5])
    return a, (b[0] - a[0], b[1] - a[1], b[2] - a[2]), C[6]


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


@compiled(void(ROBOT, TABLES, VECTOR, VECTOR_OUT))
def pair_distances(robot: SampledRobot, tables: DistanceTables, z: Floats, distances_out: Floats) -> None:
    """Smallest distance from the points to the capsule of every pair at chart coordinates z, slacks left out [m]."""
    work = workspace(robot, tables)
    place(robot, z, work)
    for k in range(robot.pairs.shape[0]):
        g = robot.pairs[k, 0]
        T = work.world[robot.groups[g, 0]]
        a, along, radius = _capsule(robot, robot.pairs[k, 1], work)
        distances_out[k] = math.inf
        for i in range(robot.groups[g, 1], robot.groups[g, 2]):
            p = _moved(T, robot.points[0, i], robot.points[1, i], robot.points[2, i])
            distances_out[k] = min(distances_out[k], _to_capsule(p, a, along, radius)[0])


@inlined
def _selves(robot: SampledRobot, work: Workspace) -> float:
    """The barrier between points of links and capsules about others; adds to gradient and Hessian.

    The capsule's own motion takes away what the point's adds: only joints between the two links count.
    """
    total = 0.0
    parents, idx_v, S = robot.joints.parents, robot.joints.idx_v, work.subspaces
    for k in range(robot.pairs.shape[0]):
        g, other = robot.pairs[k, 0], robot.pairs[k, 1]
        a, along, radius = _capsule(robot, other, work)
        radius -= robot.slacks[k]
        joint = robot.groups[g, 0]
        T = work.world[joint]
        centre = _moved(T, robot.balls[g, 0], robot.balls[g, 1], robot.balls[g, 2])
        if _to_capsule(centre, a, along, radius)[0] >= SELF_RANGE + robot.balls[g, 3]:
            continue
        for i in range(robot.groups[g, 1], robot.groups[g, 2]):
            p = _moved(T, robot.points[0, i], robot.points[1, i], robot.points[2, i])
            d, n = _to_capsule(p, a, along, radius)
            if d >= SELF_RANGE:
                continue
            value, slope, curvature = barrier(d, SELF_RANGE)
            total += robot.weights[i] * value
            mx, my, mz = p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0]
            work.row[:] = 0.0
            for sign, end in ((1.0, joint), (-1.0, robot.capsule_joints[other])):
                j = end
                while j > 0:
                    v = idx_v[j]
                    value = S[v, 0] * n[0] + S[v, 1] * n[1] + S[v, 2] * n[2]
                    work.row[v] += sign * (value + S[v, 3] * mx + S[v, 4] * my + S[v, 5] * mz)
                    j = parents[j]
            for r in range(work.row.shape[0]):
                work.gradient[r] += robot.weights[i] * slope * work.row[r]
                for c in range(work.row.shape[0]):
                    work.hessian[r, c] += robot.weights[i] * curvature * work.row[r] * work.row[c]
    return total


@inlined
def barrier_at(
    robot: SampledRobot,
    tables: DistanceTables,
    z: Floats,
    reach: float,
    clearance: float,
    work: Workspace,
    gradient_out: Floats,
    hessian_out: Floats,
) -> float:
    """The barrier of a robot at one configuration.

    Args:
        robot: The robot.
        tables: Obstacles.
        z: Chart coordinates, shape (nv,) [rad or m].
        reach: Range of the barrier against obstacles [m], positive.
        clearance: Distance from obstacles at which its wall stands [m].
        work: Scratch.
        gradient_out: Its gradient by z, shape (nv,).
        hessian_out: Gauss and Newton's approximation of its Hessian, shape (nv, nv).

    Returns:
        Sum of the weighted barriers of all points.
    """
    place(robot, z, work)
    work.forces[:, :] = 0.0
    work.inertias[:, :, :] = 0.0
    total = _obstacles(robot, tables, reach, clearance, work)
    _carry(robot.joints, work)
    total += _selves(robot, work)
    gradient_out[:] = 0.0
    hessian_out[:, :] = 0.0
    for i in range(robot.drivers.shape[0]):
        row, m = robot.drivers[i], robot.multipliers[i]
        gradient_out[row] += m * work.gradient[i]
        for j in range(robot.drivers.shape[0]):
            hessian_out[row, robot.drivers[j]] += m * robot.multipliers[j] * work.hessian[i, j]
    return total
