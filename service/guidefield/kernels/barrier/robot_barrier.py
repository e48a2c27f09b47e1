"""The barrier of a robot against obstacles and against itself at one configuration and time, with its derivatives.

The optimizer (`kernels/optimize/clearance_model.py`) relies on derivatives that are those of the value; no proof reads
any of it, so that another barrier leads to other motions, and not to others that count as free.
"""

from __future__ import annotations

from guidefield.kernels.barrier.moving_bodies import MovedBodies, MovingBodies
from guidefield.kernels.barrier.obstacle_barrier import NearBodies, obstacle_barrier
from guidefield.kernels.barrier.sampled_robot import SampledRobot, Workspace, place
from guidefield.kernels.barrier.self_barrier import self_barrier
from guidefield.kernels.distance.distance import DistanceTables
from guidefield.kernels.jit.arrays import Floats, Vector3
from guidefield.kernels.jit.decorators import uncounted
from guidefield.kernels.kinematics.forward_kinematics import JointTable


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
