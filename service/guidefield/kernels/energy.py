"""Potential of a whole robot, its generalised force and the curvature metric, in one backward pass of wrenches.

U(q) = sum_i w_i Phi(x_i(q)) over the charged points of the moving links, plus the self-repulsion of link pairs: points
of one link in the closed-form field of the other's capsule. Forces gather as one spatial force a joint, the metric
M = sum_i s_i J_i^T J_i as one spatial inertia a joint; both are carried from the tip to the root.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.field import field_at
from guidefield.kernels.primitives import capsule_at
from guidefield.kernels.signatures import MATRIX, MATRIX_OUT, SCALAR, VECTOR, VECTOR_OUT, Floats, compiled, inlined
from guidefield.kernels.tree_kinematics import BLOCKS, INDICES, Integers, joint_placements, motion_subspaces

INDEX_MATRIX = types.Array(types.int64, 2, "C", readonly=True)


class ChargedRobot(NamedTuple):
    """A robot's charged points and capsules.

    Attributes:
        points: (p, 3) in the frame of their joint [m].
        weights: (p,) area that each stands for [m^2].
        point_joints: (p,) index of the joint that moves each.
        capsules: (c, 7) ends and radius in the frame of their joint [m].
        capsule_joints: (c,) index of the joint that moves each.
        pairs: (k, 3) first point, one past the last point, capsule: who repels whom.
    """

    points: np.ndarray
    weights: np.ndarray
    point_joints: np.ndarray
    capsules: np.ndarray
    capsule_joints: np.ndarray
    pairs: np.ndarray


@inlined
def _add_force(joint: int, x: float, y: float, z: float, fx: float, fy: float, fz: float, wrenches: Floats) -> None:
    """Add a force at a world point to a joint's spatial force (force, moment about the world's origin)."""
    wrenches[joint, 0] += fx
    wrenches[joint, 1] += fy
    wrenches[joint, 2] += fz
    wrenches[joint, 3] += y * fz - z * fy
    wrenches[joint, 4] += z * fx - x * fz
    wrenches[joint, 5] += x * fy - y * fx


@inlined
def _add_inertia(joint: int, x: float, y: float, z: float, s: float, inertias: Floats) -> None:
    """Add a point of curvature s to a joint's inertia: total, first moments, second moments xx xy xz yy yz zz."""
    inertias[joint, 0] += s
    inertias[joint, 1] += s * x
    inertias[joint, 2] += s * y
    inertias[joint, 3] += s * z
    inertias[joint, 4] += s * x * x
    inertias[joint, 5] += s * x * y
    inertias[joint, 6] += s * x * z
    inertias[joint, 7] += s * y * y
    inertias[joint, 8] += s * y * z
    inertias[joint, 9] += s * z * z


@inlined
def _repulsion(
    first: int, past: int, capsule: Floats, capsule_joint: int, world: Floats, positions: Floats,
    weights: Floats, point_joints: Integers, wrenches: Floats, inertias: Floats,
) -> float:  # fmt: skip
    """Repulsion of points by a capsule of another link; the capsule's link gets the opposite force."""
    T = world[capsule_joint]
    ends = np.empty(6)
    for e in range(2):
        cx, cy, cz = capsule[3 * e], capsule[3 * e + 1], capsule[3 * e + 2]
        for r in range(3):
            ends[3 * e + r] = T[r, 0] * cx + T[r, 1] * cy + T[r, 2] * cz + T[r, 3]
    potential = 0.0
    for i in range(first, past):
        x, y, z, w, joint = positions[i, 0], positions[i, 1], positions[i, 2], weights[i], point_joints[i]
        phi, gx, gy, gz = capsule_at(x, y, z, ends[0], ends[1], ends[2], ends[3], ends[4], ends[5], capsule[6])
        potential += w * phi
        _add_force(joint, x, y, z, -w * gx, -w * gy, -w * gz, wrenches)
        _add_force(capsule_joint, x, y, z, w * gx, w * gy, w * gz, wrenches)
        curvature = 2.0 * w * (gx * gx + gy * gy + gz * gz) / phi
        _add_inertia(joint, x, y, z, curvature, inertias)
        _add_inertia(capsule_joint, x, y, z, curvature, inertias)
    return potential


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
def _project(
    parents: Integers, kinds: Integers, axes: Floats, idx_v: Integers, nv: Integers, world: Floats,
    wrenches: Floats, inertias: Floats, total: int, gradient_out: Floats, metric_out: Floats,
) -> None:  # fmt: skip
    """Carry wrenches and inertias to the root, project them on the motion subspaces.

    gradient = -S^T F of the subtree; metric_jk = S_j^T I_k S_k for every joint j at or above k.
    """
    n = parents.shape[0]
    subspaces = np.empty((total, 6))
    motion_subspaces(kinds, axes, idx_v, nv, world, subspaces)
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


@compiled(
    SCALAR(
        # joints: parents, kinds, axes, placements, idx_q, idx_v, nv
        INDICES, INDICES, MATRIX, BLOCKS, INDICES, INDICES, INDICES,
        # charged robot: points, weights, point_joints, capsules, capsule_joints, pairs
        MATRIX, VECTOR, INDICES, MATRIX, INDICES, INDEX_MATRIX,
        # field: triangles, spheres, capsules, planes
        MATRIX, MATRIX, MATRIX, MATRIX,
        VECTOR,
        # gradient (nv,), metric (nv, nv), wrenches (n, 6)
        VECTOR_OUT, MATRIX_OUT, MATRIX_OUT,
    )
)  # fmt: skip
def energy(
    parents: Integers, kinds: Integers, axes: Floats, placements: Floats,
    idx_q: Integers, idx_v: Integers, nv: Integers,
    points: Floats, weights: Floats, point_joints: Integers,
    capsules: Floats, capsule_joints: Integers, pairs: Integers,
    field_triangles: Floats, field_spheres: Floats, field_capsules: Floats, field_planes: Floats,
    q: Floats,
    gradient_out: Floats, metric_out: Floats, wrenches_out: Floats,
) -> float:  # fmt: skip
    """Potential U of a robot at q, its gradient, curvature metric, and the field's wrench on every link.

    `wrenches_out` (n, 6) gets, per joint, the force and the moment about the world's origin that act on the link it
    moves (its own points only, not those of links beyond it).

    Returns:
        U [m].
    """
    n, total = parents.shape[0], gradient_out.shape[0]
    world = np.empty((n, 3, 4))
    joint_placements(parents, kinds, axes, placements, idx_q, q, world)
    inertias = np.zeros((n, 10))
    wrenches_out[:, :] = 0.0
    potential = 0.0
    positions = np.empty((points.shape[0], 3))
    for i in range(points.shape[0]):
        joint = point_joints[i]
        T = world[joint]
        x = T[0, 0] * points[i, 0] + T[0, 1] * points[i, 1] + T[0, 2] * points[i, 2] + T[0, 3]
        y = T[1, 0] * points[i, 0] + T[1, 1] * points[i, 1] + T[1, 2] * points[i, 2] + T[1, 3]
        z = T[2, 0] * points[i, 0] + T[2, 1] * points[i, 1] + T[2, 2] * points[i, 2] + T[2, 3]
        positions[i, 0], positions[i, 1], positions[i, 2] = x, y, z
        if joint == 0:
            continue
        w = weights[i]
        phi, gx, gy, gz, curvature, _ = field_at(x, y, z, field_triangles, field_spheres, field_capsules, field_planes)
        potential += w * phi
        _add_force(joint, x, y, z, -w * gx, -w * gy, -w * gz, wrenches_out)
        _add_inertia(joint, x, y, z, w * curvature, inertias)
    for k in range(pairs.shape[0]):
        potential += _repulsion(
            pairs[k, 0], pairs[k, 1], capsules[pairs[k, 2]], capsule_joints[pairs[k, 2]],
            world, positions, weights, point_joints, wrenches_out, inertias,
        )  # fmt: skip
    _project(parents, kinds, axes, idx_v, nv, world, wrenches_out, inertias, total, gradient_out, metric_out)
    return potential
