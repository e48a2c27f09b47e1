"""The barrier of a robot at one configuration and time, against obstacles and between its links, with derivatives.

Forces that `obstacle_barrier` gathers are carried to the root, which makes them derivatives by coordinates. Links are
coarse things to each other: of a group's points the first few stand for all, as
`planner/optimize/clearance_samples.py` chooses them. The other link's own motion takes away what the point's adds: only
the joints between the two change the distance.

The optimizer (`clearance_model`) relies on derivatives that are those of the value; no proof reads any of it, so that
another barrier leads to other motions, and not to others that count as free.
"""

from __future__ import annotations

import math

from numba import void

from guidefield.kernels.distance.distance import TABLES, DistanceTables, body_distance, bounds_near
from guidefield.kernels.jit.arrays import VECTOR, VECTOR_OUT, Floats, Vector3
from guidefield.kernels.jit.decorators import compiled, uncounted
from guidefield.kernels.kinematics.forward_kinematics import JointTable
from guidefield.kernels.kinematics.poses import moved_by
from guidefield.kernels.optimize.barrier import (
    FIRST,
    JOINT,
    PAST,
    PAST_FEW,
    ROBOT,
    MovedBodies,
    MovingBodies,
    SampledRobot,
    Workspace,
    barrier,
    lower_gaps,
    place,
    place_link,
    workspace,
)
from guidefield.kernels.optimize.obstacle_barrier import NearBodies, obstacle_barrier


@uncounted
def robot_barrier(
    robot: SampledRobot,
    tables: DistanceTables,
    moving: MovingBodies,
    s: int,
    z: Floats,
    time: float,
    walls: Vector3,
    share: float,
    near: NearBodies,
    work: Workspace,
    moved: MovedBodies,
    gradient_out: Floats,
    hessian_out: Floats,
    across_out: Floats,
) -> float:
    """The barrier of a robot at one configuration and time; its derivatives by time alone are left in `moved`.

    Args:
        s: Index of the configuration's sample in `near`, where bodies near it are remembered from call to call.
        z: Local coordinates, shape (nv,) [rad or m].
        time: When those that move are met [s].
        walls: Of the barrier against obstacles: its range, the distance from them at which its wall stands, and the
            floor, the distance below which points cost more [m]; see `obstacle_barrier`.
        share: Factor of the barrier between links; where it is 0 that isn't evaluated.
        gradient_out: Its gradient by z, shape (nv,); nothing is written where the barrier is 0.
        hessian_out: Gauss and Newton's approximation of its Hessian, shape (nv, nv); the same.
        across_out: That by z and time, shape (nv,) [1/s]; the same.

    Returns:
        Sum of the weighted barriers of all points.
    """
    joints = robot.joints
    place(robot, z, work)
    work.forces[:, :] = 0.0
    work.inertias[:, :, :] = 0.0
    total = obstacle_barrier(robot, tables, moving, s, time, walls, near, work, moved)
    if total > 0.0:
        _carry(joints.table, work)
    else:
        work.gradient[:] = 0.0
        work.hessian[:, :] = 0.0
    if share > 0.0:
        total += self_barrier(robot, share, work)
    if total == 0.0:
        return total
    _reduce(robot, work, gradient_out, hessian_out)
    across_out[:] = 0.0
    if moving.motions.shape[0] > 0:
        _carry_by_time(joints.table, work, moved)
        for i in range(joints.sources.shape[0]):
            across_out[joints.sources[i]] += joints.multipliers[i] * moved.row[i]
    return total


@uncounted
def _reduce(robot: SampledRobot, work: Workspace, gradient_out: Floats, hessian_out: Floats) -> None:
    """Gradient and Hessian by the group's local coordinates, of those by the model's; mostly these are the same."""
    joints = robot.joints
    same = joints.sources.shape[0] == gradient_out.shape[0]
    for i in range(joints.sources.shape[0]):
        same &= joints.sources[i] == i and joints.multipliers[i] == 1.0
    if same:
        for i in range(gradient_out.shape[0]):
            gradient_out[i] = work.gradient[i]
            for j in range(gradient_out.shape[0]):
                hessian_out[i, j] = work.hessian[i, j]
        return
    gradient_out[:] = 0.0
    hessian_out[:, :] = 0.0
    for i in range(joints.sources.shape[0]):
        row, m = joints.sources[i], joints.multipliers[i]
        gradient_out[row] += m * work.gradient[i]
        for j in range(joints.sources.shape[0]):
            hessian_out[row, joints.sources[j]] += m * joints.multipliers[j] * work.hessian[i, j]


@uncounted
def _carry(joints: JointTable, work: Workspace) -> None:
    """Carry forces and inertias to the root; gradient and Hessian by the model's local coordinates."""
    S = work.joints.twists
    work.hessian[:, :] = 0.0
    for row in range(S.shape[0]):
        for c in range(6):
            work.columns[c, row] = S[row, c]
    for i in range(joints.parents.shape[0] - 1, 0, -1):
        A = work.inertias[i]
        for row in range(joints.idx_v[i], joints.idx_v[i] + joints.nv[i]):
            value = 0.0
            r0 = r1 = r2 = r3 = r4 = r5 = 0.0
            for c in range(6):
                s = S[row, c]
                value += s * work.forces[i, c]
                r0 += s * A[0, c]
                r1 += s * A[min(1, c), max(1, c)]
                r2 += s * A[min(2, c), max(2, c)]
                r3 += s * A[min(3, c), max(3, c)]
                r4 += s * A[min(4, c), max(4, c)]
                r5 += s * A[c, 5]
            work.gradient[row] = value
            j = i
            while j > 0:
                past, first = joints.idx_v[j] + joints.nv[j], joints.idx_v[j]
                while joints.parents[j] > 0 and joints.idx_v[joints.parents[j]] + joints.nv[joints.parents[j]] == first:
                    j = joints.parents[j]
                    first = joints.idx_v[j]
                _multiply(work.columns, first, past, (r0, r1, r2, r3, r4, r5), work.hessian[row])
                j = joints.parents[j]
        parent = joints.parents[i]
        for r in range(6):
            work.forces[parent, r] += work.forces[i, r]
            for c in range(r, 6):
                work.inertias[parent, r, c] += A[r, c]
    for row in range(S.shape[0]):
        for column in range(row):
            work.hessian[column, row] = work.hessian[row, column]


@uncounted
def _multiply(
    columns: Floats, first: int, past: int, r: tuple[float, float, float, float, float, float], row_out: Floats
) -> None:
    """Products of subspaces, by columns of (6, nv), with a force r; a vector loop."""
    c0, c1, c2 = columns[0, first:past], columns[1, first:past], columns[2, first:past]
    c3, c4, c5, row = columns[3, first:past], columns[4, first:past], columns[5, first:past], row_out[first:past]
    for k in range(row.shape[0]):
        row[k] = r[0] * c0[k] + r[1] * c1[k] + r[2] * c2[k] + r[3] * c3[k] + r[4] * c4[k] + r[5] * c5[k]


@uncounted
def _carry_by_time(joints: JointTable, work: Workspace, moved: MovedBodies) -> None:
    """Carry the forces' derivatives by time to the root; their row by the model's local coordinates."""
    for i in range(joints.parents.shape[0] - 1, 0, -1):
        for row in range(joints.idx_v[i], joints.idx_v[i] + joints.nv[i]):
            value = 0.0
            for c in range(6):
                value += work.joints.twists[row, c] * moved.forces[i, c]
            moved.row[row] = value
        for c in range(6):
            moved.forces[joints.parents[i], c] += moved.forces[i, c]


@uncounted
def self_barrier(robot: SampledRobot, share: float, work: Workspace) -> float:
    """The barrier of all pairs; adds to the workspace's gradient and Hessian.

    Args:
        work: Scratch, up to date with the configuration.

    Returns:
        Sum of the weighted barriers.
    """
    total = 0.0
    links = _place_links(robot, work)
    for k in range(robot.pairs.shape[0]):
        g, other, reach = robot.pairs[k, 0], robot.pairs[k, 1], robot.pair_ranges[k]
        x, y, z = work.centres[g, 0], work.centres[g, 1], work.centres[g, 2]
        dx, dy, dz = x - work.link_centres[other, 0], y - work.link_centres[other, 1], z - work.link_centres[other, 2]
        near = robot.balls[g, 3] + reach
        if dx * dx + dy * dy + dz * dz >= (near + robot.link_balls[other, 3]) ** 2:
            continue
        place_link(robot, other, work)
        if not bounds_near(x, y, z, other, links, near):
            continue
        T = work.joints.poses[robot.groups[g, JOINT]]
        first, last = robot.groups[g, FIRST], robot.groups[g, PAST_FEW]
        work.gaps[first:last] = math.inf
        lower_gaps(T, robot.points, first, last, links, other, work.gaps)
        for i in range(first, last):
            if work.gaps[i] >= reach * reach:
                continue
            p = moved_by(T, robot.points[0, i], robot.points[1, i], robot.points[2, i])
            d, nx, ny, nz = body_distance(p[0], p[1], p[2], other, links, reach, reach)
            if d < reach:
                value, slope, curvature = barrier(d, reach, robot.size)
                w = share * robot.weights[i] * (robot.groups[g, PAST] - first) / (last - first)
                total += w * value
                _write_row(robot, robot.groups[g, JOINT], robot.link_joints[other], p, (nx, ny, nz), work)
                _add_distance(w * slope, w * curvature, work)
    return total


@uncounted
def _place_links(robot: SampledRobot, work: Workspace) -> DistanceTables:
    """The links' bodies where they are in the world; only for what doesn't count references either."""
    t, moved = robot.links, work.links
    return DistanceTables(
        t.kinds, t.obstacles, moved, t.sizes, t.bounds, t.boxes, t.spans, t.anchors, t.nodes, t.surfaces, t.clouds
    )


@uncounted
def _write_row(robot: SampledRobot, joint: int, other: int, p: Vector3, n: Vector3, work: Workspace) -> None:
    """Gradient of the distance of a point that moves with a joint, along n, to what moves with another."""
    parents, idx_v, S = robot.joints.table.parents, robot.joints.table.idx_v, work.joints.twists
    m = (p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0])
    work.row[:] = 0.0
    for sign, end in ((1.0, joint), (-1.0, other)):
        j = end
        while j > 0:
            for v in range(idx_v[j], idx_v[j] + robot.joints.table.nv[j]):
                linear = S[v, 0] * n[0] + S[v, 1] * n[1] + S[v, 2] * n[2]
                work.row[v] += sign * (linear + S[v, 3] * m[0] + S[v, 4] * m[1] + S[v, 5] * m[2])
            j = parents[j]


@uncounted
def _add_distance(slope: float, curvature: float, work: Workspace) -> None:
    """Add a distance's share to gradient and Hessian; of a long chain only few joints are between two links."""
    first, past = 0, work.row.shape[0]
    while first < past and work.row[first] == 0.0:
        first += 1
    while past > first and work.row[past - 1] == 0.0:
        past -= 1
    row, gradient = work.row[first:past], work.gradient[first:past]
    for r in range(row.shape[0]):
        gradient[r] += slope * row[r]
        share, of_row = curvature * row[r], work.hessian[first + r, first:past]
        for c in range(row.shape[0]):
            of_row[c] += share * row[c]


@uncounted
def _pair_distances(robot: SampledRobot, work: Workspace, distances_out: Floats) -> None:
    """`pair_distances` of a robot that is placed."""
    links = _place_links(robot, work)
    for k in range(robot.pairs.shape[0]):
        g, other, best = robot.pairs[k, 0], robot.pairs[k, 1], robot.pair_ranges[k]
        T = work.joints.poses[robot.groups[g, JOINT]]
        place_link(robot, other, work)
        distances_out[k] = math.inf
        for i in range(robot.groups[g, FIRST], robot.groups[g, PAST_FEW]):
            p = moved_by(T, robot.points[0, i], robot.points[1, i], robot.points[2, i])
            d = body_distance(p[0], p[1], p[2], other, links, best, best)[0]
            if d < best:
                best = d
                distances_out[k] = d


@compiled(void(ROBOT, TABLES, VECTOR, VECTOR_OUT))
def pair_distances(robot: SampledRobot, tables: DistanceTables, z: Floats, distances_out: Floats) -> None:
    """Smallest distance from the points to the other link of every pair, as far as it is below the pair's range.

    Args:
        z: Local coordinates, shape (nv,).
        distances_out: Shape (k,) [m]; infinite where nothing is within range.
    """
    work = workspace(robot, tables)
    place(robot, z, work)
    _pair_distances(robot, work, distances_out)
