"""Forward kinematics of a tree of joints in float64, from tables: one compiled kernel for every robot.

Joint kinds and their motion subspaces are Pinocchio's (linear part first): a revolute or continuous joint turns about
its axis, a prismatic one slides along it, a planar one moves in its x-y plane and turns about z, a spherical one turns
freely, a floating one does everything; the last three have tangents in the moved frame.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import void

from guidefield.kernels.jit.fields import Blocks, Indices, Rows, numba_type
from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import BLOCKS_OUT, MATRIX_OUT, VECTOR, Floats, compiled, inlined

REVOLUTE, CONTINUOUS, PRISMATIC, PLANAR, SPHERICAL, FLOATING = range(6)
"""Codes of joint kinds in `JointTable.kinds`."""


class JointTable(NamedTuple):
    """The joints of a tree, parents before children; row 0 is the world.

    Attributes:
        parents: Index of each joint's parent, shape (n,).
        kinds: Code of what it can do, shape (n,).
        axes: Its axis in its own frame, shape (n, 3).
        placements: Rotation and translation of the joint frame in the parent's, shape (n, 3, 4) [m].
        idx_q, idx_v, nv: Where its values stand, and how many tangent values it has, each of shape (n,).
    """

    parents: Indices
    kinds: Indices
    axes: Rows
    placements: Blocks
    idx_q: Indices
    idx_v: Indices
    nv: Indices


JOINTS = numba_type(JointTable)


@inlined
def axis_rotation(ax: float, ay: float, az: float, c: float, s: float, rotation_out: Floats) -> None:
    """Rodrigues: rotation about a unit axis by an angle of cosine c and sine s.

    Args:
        ax: The axis, with ay and az.
        ay: See ax.
        az: See ax.
        c: Cosine.
        s: Sine.
        rotation_out: Shape (3, 3).
    """
    d = 1.0 - c
    rotation_out[0, 0] = c + ax * ax * d
    rotation_out[0, 1] = ax * ay * d - az * s
    rotation_out[0, 2] = ax * az * d + ay * s
    rotation_out[1, 0] = ay * ax * d + az * s
    rotation_out[1, 1] = c + ay * ay * d
    rotation_out[1, 2] = ay * az * d - ax * s
    rotation_out[2, 0] = az * ax * d - ay * s
    rotation_out[2, 1] = az * ay * d + ax * s
    rotation_out[2, 2] = c + az * az * d


@inlined
def _quaternion_rotation(x: float, y: float, z: float, w: float, rotation_out: Floats) -> None:
    """Rotation of a unit quaternion."""
    rotation_out[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    rotation_out[0, 1] = 2.0 * (x * y - z * w)
    rotation_out[0, 2] = 2.0 * (x * z + y * w)
    rotation_out[1, 0] = 2.0 * (x * y + z * w)
    rotation_out[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    rotation_out[1, 2] = 2.0 * (y * z - x * w)
    rotation_out[2, 0] = 2.0 * (x * z - y * w)
    rotation_out[2, 1] = 2.0 * (y * z + x * w)
    rotation_out[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@inlined
def quaternion_of(R: Floats, q_out: Floats, at: int) -> None:
    """Write the unit quaternion (x, y, z, w) of a rotation (3, 3), or of a placement (3, 4), to `q_out[at:]`.

    As Eigen does: from w where that is the safe one, else from the largest of the others (Shepperd 1978).
    """
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    if trace > 0.0:
        s = 2.0 * math.sqrt(1.0 + trace)
        x, y, z, w = (R[2, 1] - R[1, 2]) / s, (R[0, 2] - R[2, 0]) / s, (R[1, 0] - R[0, 1]) / s, 0.25 * s
    elif R[0, 0] >= R[1, 1] and R[0, 0] >= R[2, 2]:
        s = 2.0 * math.sqrt(1.0 + R[0, 0] - R[1, 1] - R[2, 2])
        x, y, z, w = 0.25 * s, (R[0, 1] + R[1, 0]) / s, (R[0, 2] + R[2, 0]) / s, (R[2, 1] - R[1, 2]) / s
    elif R[1, 1] >= R[2, 2]:
        s = 2.0 * math.sqrt(1.0 + R[1, 1] - R[0, 0] - R[2, 2])
        x, y, z, w = (R[0, 1] + R[1, 0]) / s, 0.25 * s, (R[1, 2] + R[2, 1]) / s, (R[0, 2] - R[2, 0]) / s
    else:
        s = 2.0 * math.sqrt(1.0 + R[2, 2] - R[0, 0] - R[1, 1])
        x, y, z, w = (R[0, 2] + R[2, 0]) / s, (R[1, 2] + R[2, 1]) / s, 0.25 * s, (R[1, 0] - R[0, 1]) / s
    over = 1.0 / math.sqrt(x * x + y * y + z * z + w * w)
    q_out[at], q_out[at + 1], q_out[at + 2], q_out[at + 3] = over * x, over * y, over * z, over * w


@inlined
def compose(parent: Floats, fixed: Floats, rotation: Floats, translation: Floats, placement_out: Floats) -> None:
    """Write the product of placements: parent * fixed * (rotation, translation), shapes (3, 4), (3, 3) and (3,)."""
    for r in range(3):
        r0 = parent[r, 0] * fixed[0, 0] + parent[r, 1] * fixed[1, 0] + parent[r, 2] * fixed[2, 0]
        r1 = parent[r, 0] * fixed[0, 1] + parent[r, 1] * fixed[1, 1] + parent[r, 2] * fixed[2, 1]
        r2 = parent[r, 0] * fixed[0, 2] + parent[r, 1] * fixed[1, 2] + parent[r, 2] * fixed[2, 2]
        t = parent[r, 3] + parent[r, 0] * fixed[0, 3] + parent[r, 1] * fixed[1, 3] + parent[r, 2] * fixed[2, 3]
        placement_out[r, 0] = r0 * rotation[0, 0] + r1 * rotation[1, 0] + r2 * rotation[2, 0]
        placement_out[r, 1] = r0 * rotation[0, 1] + r1 * rotation[1, 1] + r2 * rotation[2, 1]
        placement_out[r, 2] = r0 * rotation[0, 2] + r1 * rotation[1, 2] + r2 * rotation[2, 2]
        placement_out[r, 3] = t + r0 * translation[0] + r1 * translation[1] + r2 * translation[2]


@uncounted
def place_joints(joints: JointTable, q: Floats, rotation: Floats, translation: Floats, placements_out: Floats) -> None:
    """`joint_placements` with scratch of shapes (3, 3) and (3,), for kernels that place joints again and again."""
    parents, kinds, axes, placements, idx_q, _, _ = joints
    for r in range(3):
        for c in range(4):
            placements_out[0, r, c] = 1.0 if r == c else 0.0
    for i in range(1, parents.shape[0]):
        at = idx_q[i]
        translation[:] = 0.0
        kind = kinds[i]
        if kind == PRISMATIC:
            rotation[:, :] = 0.0
            for k in range(3):
                rotation[k, k] = 1.0
                translation[k] = axes[i, k] * q[at]
        elif kind == REVOLUTE:
            axis_rotation(axes[i, 0], axes[i, 1], axes[i, 2], math.cos(q[at]), math.sin(q[at]), rotation)
        elif kind == CONTINUOUS:
            axis_rotation(axes[i, 0], axes[i, 1], axes[i, 2], q[at], q[at + 1], rotation)
        elif kind == PLANAR:
            translation[0] = q[at]
            translation[1] = q[at + 1]
            axis_rotation(0.0, 0.0, 1.0, q[at + 2], q[at + 3], rotation)
        elif kind == SPHERICAL:
            _quaternion_rotation(q[at], q[at + 1], q[at + 2], q[at + 3], rotation)
        else:
            for k in range(3):
                translation[k] = q[at + k]
            _quaternion_rotation(q[at + 3], q[at + 4], q[at + 5], q[at + 6], rotation)
        compose(placements_out[parents[i]], placements[i], rotation, translation, placements_out[i])


@compiled(void(JOINTS, VECTOR, BLOCKS_OUT))
def joint_placements(joints: JointTable, q: Floats, placements_out: Floats) -> None:
    """World placement of every joint's moved frame: T_world_i = T_world_parent T_parent_joint T_joint(q_i).

    Args:
        joints: The n joints.
        q: Configuration, shape (nq,).
        placements_out: Rotation and translation, shape (n, 3, 4) [m, world]; row 0 is the world itself.
    """
    place_joints(joints, q, np.empty((3, 3)), np.empty(3), placements_out)


@uncounted
def place_subspaces(joints: JointTable, placements: Floats, subspaces_out: Floats) -> None:
    """`motion_subspaces` within kernels."""
    _, kinds, axes, _, _, idx_v, nv = joints
    for i in range(1, kinds.shape[0]):
        for k in range(nv[i]):
            row = idx_v[i] + k
            lx, ly, lz, wx, wy, wz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            kind = kinds[i]
            if kind in (REVOLUTE, CONTINUOUS):
                wx, wy, wz = axes[i, 0], axes[i, 1], axes[i, 2]
            elif kind == PRISMATIC:
                lx, ly, lz = axes[i, 0], axes[i, 1], axes[i, 2]
            else:
                code = k
                if kind == PLANAR and k == 2:
                    code = 5
                if kind == SPHERICAL:
                    code = 3 + k
                lx, ly, lz = 1.0 * (code == 0), 1.0 * (code == 1), 1.0 * (code == 2)
                wx, wy, wz = 1.0 * (code == 3), 1.0 * (code == 4), 1.0 * (code == 5)
            T = placements[i]
            ax = T[0, 0] * wx + T[0, 1] * wy + T[0, 2] * wz
            ay = T[1, 0] * wx + T[1, 1] * wy + T[1, 2] * wz
            az = T[2, 0] * wx + T[2, 1] * wy + T[2, 2] * wz
            # velocity at the world's origin = rotated linear part - omega x t = linear + t x omega
            subspaces_out[row, 0] = T[0, 0] * lx + T[0, 1] * ly + T[0, 2] * lz + T[1, 3] * az - T[2, 3] * ay
            subspaces_out[row, 1] = T[1, 0] * lx + T[1, 1] * ly + T[1, 2] * lz + T[2, 3] * ax - T[0, 3] * az
            subspaces_out[row, 2] = T[2, 0] * lx + T[2, 1] * ly + T[2, 2] * lz + T[0, 3] * ay - T[1, 3] * ax
            subspaces_out[row, 3] = ax
            subspaces_out[row, 4] = ay
            subspaces_out[row, 5] = az


@compiled(void(JOINTS, BLOCKS_OUT, MATRIX_OUT))
def motion_subspaces(joints: JointTable, placements: Floats, subspaces_out: Floats) -> None:
    """Motion subspace of every tangent value, at the world's origin in the world's axes.

    Args:
        joints: The n joints.
        placements: Of the joints in the world, as `joint_placements` has them, shape (n, 3, 4) [m].
        subspaces_out: Row v is the twist (linear velocity of the point at the world's origin, then angular velocity)
            that the v-th tangent value causes, shape (total nv, 6).
    """
    place_subspaces(joints, placements, subspaces_out)
