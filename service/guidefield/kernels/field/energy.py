"""Potential of a whole robot, its generalised force and the curvature metric, in one backward pass of wrenches.

U(q) = sum_i w_i Phi(x_i(q)) over the charged points of the moving links, plus the self-repulsion of link pairs: points
of one link in the closed-form field of the other's capsule. Forces gather as one spatial force a joint, the metric
M = sum_i s_i J_i^T J_i as one spatial inertia a joint; both are carried from the tip to the root.

The field is evaluated in the precision of its tables and about their origin, everything else in double precision.
Minimizers (`kernels/guide`) descend by it and compare what `forces` and `potential` return, which has to be the same U;
`potential.py` answers for single configurations.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import void

from guidefield.kernels.field.box import capsule_at
from guidefield.kernels.field.field import CAPSULE_RADIUS, LANES, TABLES, TABLES_32, add_field, add_potential
from guidefield.kernels.jit.arrays import (
    BLOCKS_OUT,
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    VECTOR,
    VECTOR_OUT,
    Floats,
    IndexRows,
    Indices,
    Row,
    Rows,
    numba_type,
)
from guidefield.kernels.jit.decorators import compiled, inlined, optimized
from guidefield.kernels.kinematics.forward_kinematics import JOINTS, JointTable, joint_placements, motion_subspaces
from guidefield.kernels.kinematics.poses import moved_by
from guidefield.kernels.simd.vector import lane_count, load, select, store, total


@inlined
def nothing(zero: Any) -> Any:
    """Sums of a joint before any point."""
    return (zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero)


@inlined
def _add_point(sums: Any, x: Any, y: Any, z: Any, gx: Any, gy: Any, gz: Any, s: Any) -> Any:
    """Sums of a joint with points added: force -g, its moment, and the inertia of curvature s.

    Inertia: total, first moments, second moments xx xy xz yy yz zz.
    """
    sx, sy, sz = s * x, s * y, s * z
    return (
        sums[0] - gx, sums[1] - gy, sums[2] - gz,
        sums[3] - (y * gz - z * gy), sums[4] - (z * gx - x * gz), sums[5] - (x * gy - y * gx),
        sums[6] + s, sums[7] + sx, sums[8] + sy, sums[9] + sz,
        sums[10] + sx * x, sums[11] + sx * y, sums[12] + sx * z,
        sums[13] + sy * y, sums[14] + sy * z, sums[15] + sz * z,
    )  # fmt: skip


@inlined
def give(sums: Any, joint: int, sign: float, wrenches: Floats, inertias: Floats) -> None:
    """Add a joint's summed lanes to its spatial force and inertia.

    Args:
        sums: As `_add_point` has them.
        joint: Which joint.
        sign: 1, or -1 for what is repelled.
        wrenches: Forces and moments, shape (n, 6); added to.
        inertias: Shape (n, 10); added to.
    """
    for k, lanes in enumerate(sums):
        if k < 6:
            wrenches[joint, k] += sign * total(lanes)
        else:
            inertias[joint, k - 6] += total(lanes)


@inlined
def _respond(inertia: Floats, S: Floats, response_out: Floats) -> None:
    """Spatial force of an inertia moved with the twist S, both at the world's origin.

    A point x of curvature s moves with v + omega x x and answers with s times that; summed: force = s v + omega x c,
    moment = c x v + (tr(Q) 1 - Q) omega with first moments c and second moments Q.
    """
    s, cx, cy, cz = inertia[0], inertia[1], inertia[2], inertia[3]
    xx, xy, xz, yy, yz, zz = inertia[4], inertia[5], inertia[6], inertia[7], inertia[8], inertia[9]
    vx, vy, vz, wx, wy, wz = S[0], S[1], S[2], S[3], S[4], S[5]
    response_out[0] = s * vx + wy * cz - wz * cy
    response_out[1] = s * vy + wz * cx - wx * cz
    response_out[2] = s * vz + wx * cy - wy * cx
    response_out[3] = cy * vz - cz * vy + (yy + zz) * wx - xy * wy - xz * wz
    response_out[4] = cz * vx - cx * vz - xy * wx + (xx + zz) * wy - yz * wz
    response_out[5] = cx * vy - cy * vx - xz * wx - yz * wy + (xx + yy) * wz


@inlined
def project(
    joints: JointTable,
    world: Floats,
    wrenches: Floats,
    inertias: Floats,
    total: int,
    gradient_out: Floats,
    metric_out: Floats,
) -> None:
    """Carry wrenches and inertias to the root, project them on the motion subspaces.

    gradient = -S^T F of the subtree; metric_jk = S_j^T I_k S_k for every joint j at or above k.

    Args:
        joints: The n joints.
        world: Placements of joints, about any origin, shape (n, 3, 4) [m].
        wrenches: Force [1] and moment about that origin [m] at each joint, shape (n, 6).
        inertias: Of each joint, shape (n, 10); becomes those of the subtrees.
        total: How many tangent values there are.
        gradient_out: Shape (total,).
        metric_out: Shape (total, total).
    """
    parents, idx_v, nv = joints.parents, joints.idx_v, joints.nv
    n = parents.shape[0]
    subspaces = np.empty((total, 6))
    motion_subspaces(joints, world, subspaces)
    carried = wrenches.copy()
    metric_out[:, :] = 0.0
    response = np.empty(6)
    for i in range(n - 1, 0, -1):
        for k in range(nv[i]):
            row = idx_v[i] + k
            S = subspaces[row]
            g = 0.0
            for c in range(6):
                g -= S[c] * carried[i, c]
            gradient_out[row] = g
            _respond(inertias[i], S, response)
            j = i
            while j > 0:
                for m in range(nv[j]):
                    column = idx_v[j] + m
                    value = 0.0
                    for c in range(6):
                        value += subspaces[column, c] * response[c]
                    metric_out[row, column] = value
                    metric_out[column, row] = value
                j = parents[j]
        for c in range(6):
            carried[parents[i], c] += carried[i, c]
        for c in range(10):
            inertias[parents[i], c] += inertias[i, c]


class ChargedRobot(NamedTuple):
    """A robot's charged points and capsules."""

    points: Rows  # in the frame of their joint, shape (p, 3) [m]
    weights: Row  # area that each represents, shape (p,) [m^2]
    point_joints: Indices  # index of the joint that moves each, shape (p,)
    # in the frame of their joint: both ends (2 x 3), and the radius at `CAPSULE_RADIUS`; shape (c, 7) [m]
    capsules: Rows
    capsule_joints: Indices  # index of the joint that moves each, shape (c,)
    pairs: IndexRows  # first point, one past the last point (all of one joint), capsule that repels them; shape (k, 3)
    runs: IndexRows  # the same with points of several joints that stand together as one, if they move; shape (r, 3)


ROBOT = numba_type(ChargedRobot)


@inlined
def place_points(robot: Any, world: Floats, points_out: Floats) -> None:
    """Write the charged points at placements of joints (n, 3, 4), shape (3, lanes) [m]; the last fills up the lanes."""
    count = robot.points.shape[0]
    for i in range(points_out.shape[1]):
        source = min(i, count - 1)
        T, p = world[robot.point_joints[source]], robot.points[source]
        points_out[0, i], points_out[1, i], points_out[2, i] = moved_by(T, p[0], p[1], p[2])


@inlined
def _place(joints: Any, robot: Any, origin: Floats, q: Floats, world: Any, points: Any, weights: Any) -> None:
    """Placements of joints and positions of points relative to the origin; positions fill up their lanes."""
    joint_placements(joints, q, world)
    for i in range(world.shape[0]):
        for r in range(3):
            world[i, r, 3] -= origin[r]
    place_points(robot, world, points)
    count = robot.points.shape[0]
    for i in range(weights.shape[0]):
        weights[i] = robot.weights[i] if i < count else 0.0


@inlined
def _counting(tables: Any) -> Any:
    """0, 1, 2 ... in the precision of the tables, one for each lane."""
    counting = np.empty(LANES, tables.boxes.dtype)
    for i in range(LANES):
        counting[i] = i
    return counting


@inlined
def _first_moving(robot: Any) -> int:
    """The first of the points that move; those of the base usually lead."""
    first = 0
    while first < robot.points.shape[0] and robot.point_joints[first] == 0:
        first += 1
    return first


@inlined
def ends_at(capsule: Floats, T: Floats) -> Any:
    """A capsule's ends [m], its row of `ChargedRobot.capsules` (7,) moved by its joint's placement (3, 4)."""
    return moved_by(T, capsule[0], capsule[1], capsule[2]) + moved_by(T, capsule[3], capsule[4], capsule[5])


@inlined
def _field_forces(
    robot: Any, points: Any, weights: Any, field: Any, counting: Any, wrenches: Any, inertias: Any
) -> Any:
    """The scene's field on the moving points, gathered joint by joint; their potential."""
    count, step = robot.points.shape[0], lane_count(weights)
    x, y, z = points[0], points[1], points[2]
    phi, gx, gy, gz, curvature = field[0], field[1], field[2], field[3], field[4]
    lane = load(counting, 0)
    potential = 0.0
    first = 0
    while first < count:
        joint = robot.point_joints[first]
        past = first + 1
        while past < count and robot.point_joints[past] == joint:
            past += 1
        if joint > 0:
            zero = 0.0 * lane
            sums = nothing(zero)
            U = zero
            for i in range(first, past, step):
                w = select(lane < past - i, load(weights, i), 0.0)
                U += w * load(phi, i)
                sums = _add_point(
                    sums, load(x, i), load(y, i), load(z, i), w * load(gx, i), w * load(gy, i), w * load(gz, i),
                    w * load(curvature, i),
                )  # fmt: skip
            potential += total(U)
            give(sums, joint, 1.0, wrenches, inertias)
        first = past
    return potential


@optimized
def _repulsion(
    robot: Any, k: int, world: Any, points: Any, weights: Any, counting: Any, field: Any, wrenches: Any, inertias: Any
) -> Any:
    """Add the repulsion of a run of points by another link's capsule to their field; return its part of the potential.

    Its link gets opposite forces. Points that don't move have no field: their forces are given at once.
    """
    first, past, capsule = robot.runs[k, 0], robot.runs[k, 1], robot.runs[k, 2]
    other = robot.capsule_joints[capsule]
    a0, a1, a2, b0, b1, b2 = ends_at(robot.capsules[capsule], world[other])
    radius = robot.capsules[capsule, CAPSULE_RADIUS]
    x, y, z = points[0], points[1], points[2]
    of_x, of_y, of_z, curvatures = field[1], field[2], field[3], field[4]
    lane = load(counting, 0)
    zero = 0.0 * lane
    sums = nothing(zero)
    U = zero
    for i in range(first, past, lane_count(weights)):
        X, Y, Z, within = load(x, i), load(y, i), load(z, i), lane < past - i
        w = select(within, load(weights, i), 0.0)
        phi, gx, gy, gz = capsule_at(X, Y, Z, a0, a1, a2, b0, b1, b2, radius)
        U += w * phi
        gx, gy, gz = select(within, gx, 0.0), select(within, gy, 0.0), select(within, gz, 0.0)
        curvature = 2.0 * (gx * gx + gy * gy + gz * gz) / phi
        store(of_x, i, load(of_x, i) + gx)
        store(of_y, i, load(of_y, i) + gy)
        store(of_z, i, load(of_z, i) + gz)
        store(curvatures, i, load(curvatures, i) + curvature)
        sums = _add_point(sums, X, Y, Z, w * gx, w * gy, w * gz, w * curvature)
    give(sums, other, -1.0, wrenches, inertias)
    if robot.point_joints[first] == 0:
        give(sums, 0, 1.0, wrenches, inertias)
    return total(U)


@compiled([SCALAR(JOINTS, ROBOT, t, VECTOR, BLOCKS_OUT, MATRIX_OUT, MATRIX_OUT) for t in (TABLES, TABLES_32)])
def forces(
    joints: Any, robot: Any, tables: Any, q: Floats, world_out: Floats, wrenches_out: Floats, inertias_out: Floats
) -> float:
    """Return the potential U of a robot at q (nq,) [m].

    Write what the field does to its links, about the tables' origin. Placements of joints (n, 3, 4) [m]; force and
    moment on the points that each joint itself carries (n, 6); their weight by curvature, first moments, second moments
    xx xy xz yy yz zz (n, 10).
    """
    kind, counting = tables.boxes.dtype, _counting(tables)
    # A vector may begin at the last point.
    lanes = robot.points.shape[0] + lane_count(counting) - 1
    points, weights = np.empty((3, lanes), kind), np.empty(lanes, kind)
    _place(joints, robot, tables.origin, q, world_out, points, weights)
    field = np.zeros((6, lanes), kind)
    add_field(tables, points, _first_moving(robot), field)
    inertias_out[:, :] = 0.0
    wrenches_out[:, :] = 0.0
    between = 0.0
    for k in range(robot.runs.shape[0]):
        between += _repulsion(robot, k, world_out, points, weights, counting, field, wrenches_out, inertias_out)
    return between + float(_field_forces(robot, points, weights, field, counting, wrenches_out, inertias_out))


@compiled([SCALAR(JOINTS, ROBOT, t, VECTOR, VECTOR_OUT, MATRIX_OUT, MATRIX_OUT) for t in (TABLES, TABLES_32)])
def energy(
    joints: Any, robot: Any, tables: Any, q: Floats, gradient_out: Floats, metric_out: Floats, wrenches_out: Floats
) -> float:
    """Return the potential U of a robot at q (nq,) [m].

    Write its gradient (nv,), curvature metric M (nv, nv), and wrenches. `wrenches_out` (n, 6) are force [1] and moment
    about the world's origin [m], in its axes, on the link that each joint moves: on its own points only, not those of
    links beyond it.
    """
    n = joints.parents.shape[0]
    world, inertias = np.empty((n, 3, 4)), np.empty((n, 10))
    potential = forces(joints, robot, tables, q, world, wrenches_out, inertias)
    project(joints, world, wrenches_out, inertias, gradient_out.shape[0], gradient_out, metric_out)
    o = tables.origin
    for i in range(n):
        fx, fy, fz = wrenches_out[i, 0], wrenches_out[i, 1], wrenches_out[i, 2]
        wrenches_out[i, 3] += o[1] * fz - o[2] * fy
        wrenches_out[i, 4] += o[2] * fx - o[0] * fz
        wrenches_out[i, 5] += o[0] * fy - o[1] * fx
    return potential


@compiled(SCALAR(JOINTS, ROBOT, TABLES_32, VECTOR))
def potential(joints: Any, robot: Any, tables: Any, q: Floats) -> float:
    """Potential U alone of a robot at a configuration q, shape (nq,) [m]; as descents ask for it."""
    count = robot.points.shape[0]
    kind, counting = tables.boxes.dtype, _counting(tables)
    step, lane = lane_count(counting), load(counting, 0)
    lanes = count + step - 1
    world, points, weights = (
        np.empty((joints.parents.shape[0], 3, 4)),
        np.empty((3, lanes), kind),
        np.empty(lanes, kind),
    )
    phi = np.zeros(lanes, kind)
    first_moving = _first_moving(robot)
    _place(joints, robot, tables.origin, q, world, points, weights)
    add_potential(tables, points, first_moving, phi)
    U = 0.0 * lane
    for i in range(first_moving, count):
        if robot.point_joints[i] == 0:
            phi[i] = 0.0
    for i in range(first_moving, count, step):
        U += load(weights, i) * load(phi, i)
    x, y, z = points[0], points[1], points[2]
    for k in range(robot.runs.shape[0]):
        first, past, capsule = robot.runs[k, 0], robot.runs[k, 1], robot.runs[k, 2]
        a0, a1, a2, b0, b1, b2 = ends_at(robot.capsules[capsule], world[robot.capsule_joints[capsule]])
        radius = robot.capsules[capsule, CAPSULE_RADIUS]
        for i in range(first, past, step):
            at = capsule_at(load(x, i), load(y, i), load(z, i), a0, a1, a2, b0, b1, b2, radius)
            U += select(lane < past - i, load(weights, i), 0.0) * at[0]
    return float(total(U))


@compiled(void(JOINTS, ROBOT, TABLES_32, MATRIX, VECTOR_OUT))
def potentials(joints: Any, robot: Any, tables: Any, qs: Floats, potentials_out: Floats) -> None:
    """`potential` at many configurations (m, nq), shape (m,) [m]."""
    for m in range(qs.shape[0]):
        potentials_out[m] = potential(joints, robot, tables, qs[m])


@inlined
def _add(wrench: Floats, sign: float, f: Any) -> None:
    for c in range(6):
        wrench[c] += sign * f[c]


@inlined
def _from_scene(robot: Any, tables: Any, points: Floats, low: int, high: int, wrenches: Floats) -> None:
    """Forces of the scene on points whose joints are from `low` to `high`, which stand together."""
    first, past = 0, robot.points.shape[0]
    while first < past and robot.point_joints[first] < low:
        first += 1
    while past > first and robot.point_joints[past - 1] > high:
        past -= 1
    if first == past:
        return
    width = past - first + (first - past) % LANES
    some, field = np.empty((3, width), points.dtype), np.zeros((6, width), points.dtype)
    for r in range(3):
        for i in range(width):
            some[r, i] = points[r, min(first + i, past - 1)]
    add_field(tables, some, 0, field)
    for i in range(past - first):
        w, joint = robot.weights[first + i], robot.point_joints[first + i]
        x, y, z = some[0, i], some[1, i], some[2, i]
        fx, fy, fz = -w * field[1, i], -w * field[2, i], -w * field[3, i]
        wrench = wrenches[joint]
        wrench[0] += fx
        wrench[1] += fy
        wrench[2] += fz
        wrench[3] += y * fz - z * fy
        wrench[4] += z * fx - x * fz
        wrench[5] += x * fy - y * fx


@inlined
def _between(
    robot: Any, k: int, world: Floats, points: Floats, weights: Floats, counting: Any, wrenches: Floats
) -> None:
    """Repulsion of a pair, on both links."""
    first, past, c = robot.pairs[k, 0], robot.pairs[k, 1], robot.pairs[k, 2]
    other = robot.capsule_joints[c]
    ax, ay, az, bx, by, bz = ends_at(robot.capsules[c], world[other])
    x, y, z = points[0], points[1], points[2]
    lane = load(counting, 0)
    zero = 0.0 * lane
    fx, fy, fz, mx, my, mz = zero, zero, zero, zero, zero, zero
    for i in range(first, past, lane_count(counting)):
        X, Y, Z = load(x, i), load(y, i), load(z, i)
        w = select(lane < past - i, load(weights, i), 0.0)
        _, gx, gy, gz = capsule_at(X, Y, Z, ax, ay, az, bx, by, bz, robot.capsules[c, CAPSULE_RADIUS])
        gx, gy, gz = w * gx, w * gy, w * gz
        fx, fy, fz = fx - gx, fy - gy, fz - gz
        mx, my, mz = mx - (Y * gz - Z * gy), my - (Z * gx - X * gz), mz - (X * gy - Y * gx)
    wrench = (total(fx), total(fy), total(fz), total(mx), total(my), total(mz))
    _add(wrenches[robot.point_joints[first]], 1.0, wrench)
    _add(wrenches[other], -1.0, wrench)


@inlined
def link_wrenches(
    robot: Any, tables: Any, world: Floats, points: Floats, weights: Floats, low: int, high: int, counting: Any,
    wrenches_out: Floats,
) -> None:  # fmt: skip
    """Write force [1] and moment [m] about the tables' origin on what joints from `low` to `high` carry, (n, 6).

    Points (3, lanes) of a joint stand together, in the order of joints, with the areas `weights` (lanes,) [m^2];
    `world` (n, 3, 4) are placements about that origin [m]. Rows of other joints have no meaning.
    """
    wrenches_out[:, :] = 0.0
    _from_scene(robot, tables, points, low, high, wrenches_out)
    for k in range(robot.pairs.shape[0]):
        own, other = robot.point_joints[robot.pairs[k, 0]], robot.capsule_joints[robot.pairs[k, 2]]
        if low <= own <= high or low <= other <= high:
            _between(robot, k, world, points, weights, counting, wrenches_out)
