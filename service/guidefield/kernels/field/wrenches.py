"""Forces and curvature of points gathered at joints, and carried from the tip to the root of a tree of joints."""

from __future__ import annotations

from typing import Any

import numpy as np

from guidefield.kernels.jit.signatures import Floats, inlined
from guidefield.kernels.kinematics.forward_kinematics import JointTable, motion_subspaces
from guidefield.kernels.simd.vector import total


@inlined
def nothing(zero: Any) -> Any:
    """Sums of a joint before any point."""
    return (zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero)


@inlined
def gathered(sums: Any, x: Any, y: Any, z: Any, gx: Any, gy: Any, gz: Any, s: Any) -> Any:
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
        sums: As `gathered` has them.
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
