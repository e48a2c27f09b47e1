"""Solve M y = g for a tree of joints in time proportional to their number, without the matrix M: articulated bodies.

M = sum_i s_i J_i^T J_i + ridge 1, with point masses s_i that the joints carry, is the mass matrix of a tree of bodies
whose rotors weigh `ridge` each: articulated-body inertias factor it (R. Featherstone, Rigid Body Dynamics Algorithms,
2008, chapter 7). All twists and wrenches are at the world's origin, linear part first. `kernels/guide/descent.py` makes
its steps by it, with inertias as `kernels/field/energy.py` sums them up; no proof relies on it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import Floats
from guidefield.kernels.jit.decorators import inlined
from guidefield.kernels.kinematics.forward_kinematics import JointTable
from guidefield.kernels.linalg.small_systems import invert


class TreeFactors(NamedTuple):
    """Factors of M for n joints with m tangents."""

    subspaces: Floats  # (m, 6) twist of each tangent; zero for one that takes no part
    inertias: Floats  # (n, 6, 6) articulated inertia of each joint
    carried: Floats  # (m, 6) what it does against each tangent
    inverses: Floats  # (n, 6, 6) inverse of what a joint's own tangents feel


@inlined
def empty_factors(n: int, m: int) -> Any:
    """Return uninitialized factors."""
    return TreeFactors(np.empty((m, 6)), np.empty((n, 6, 6)), np.empty((m, 6)), np.empty((n, 6, 6)))


@inlined
def _write_inertia(inertia: Floats, out: Floats) -> None:
    """Write the 6 x 6 inertia of points of total weight s, first moments c and second moments Q at the origin.

    force = s v + omega x c, moment = c x v + (tr(Q) 1 - Q) omega.
    """
    s, x, y, z = inertia[0], inertia[1], inertia[2], inertia[3]
    xx, xy, xz, yy, yz, zz = inertia[4], inertia[5], inertia[6], inertia[7], inertia[8], inertia[9]
    out[:, :] = 0.0
    out[0, 0], out[1, 1], out[2, 2] = s, s, s
    out[0, 4], out[0, 5], out[1, 3], out[1, 5], out[2, 3], out[2, 4] = z, -y, -z, x, y, -x
    out[4, 0], out[5, 0], out[3, 1], out[5, 1], out[3, 2], out[4, 2] = z, -y, -z, x, y, -x
    out[3, 3], out[4, 4], out[5, 5] = yy + zz, xx + zz, xx + yy
    out[3, 4], out[3, 5], out[4, 5] = -xy, -xz, -yz
    out[4, 3], out[5, 3], out[5, 4] = -xy, -xz, -yz


@inlined
def trace(joints: JointTable, subspaces: Floats, inertias: Floats, scratch: Floats) -> float:
    """Sum M's diagonal without the ridge, by tangents' twists (m, 6) and inertias (n, 10) of joints."""
    scratch[:, :] = inertias
    total = 0.0
    for i in range(joints.parents.shape[0] - 1, 0, -1):
        s, cx, cy, cz = scratch[i, 0], scratch[i, 1], scratch[i, 2], scratch[i, 3]
        xx, xy, xz, yy, yz, zz = (
            scratch[i, 4], scratch[i, 5], scratch[i, 6], scratch[i, 7], scratch[i, 8], scratch[i, 9],
        )  # fmt: skip
        for r in range(joints.idx_v[i], joints.idx_v[i] + joints.nv[i]):
            S = subspaces[r]
            vx, vy, vz, wx, wy, wz = S[0], S[1], S[2], S[3], S[4], S[5]
            total += s * (vx * vx + vy * vy + vz * vz)
            total += 2.0 * (vx * (wy * cz - wz * cy) + vy * (wz * cx - wx * cz) + vz * (wx * cy - wy * cx))
            total += (yy + zz) * wx * wx + (xx + zz) * wy * wy + (xx + yy) * wz * wz
            total -= 2.0 * (xy * wx * wy + xz * wx * wz + yz * wy * wz)
        for c in range(10):
            scratch[joints.parents[i], c] += scratch[i, c]
    return total


@inlined
def _project_inertia(A: Floats, S: Floats, first: int, size: int, ridge: float, U: Floats, D: Floats) -> None:
    """U = A S of a joint's tangents, and D = S^T U + ridge 1, what they feel."""
    for k in range(first, first + size):
        for r in range(6):
            value = 0.0
            for c in range(6):
                value += A[r, c] * S[k, c]
            U[k, r] = value
    for k in range(size):
        for m in range(size):
            value = ridge if k == m else 0.0
            for c in range(6):
                value += S[first + k, c] * U[first + m, c]
            D[k, m] = value


@inlined
def _subtract(share: float, u: Floats, w: Floats, B: Floats) -> None:
    for r in range(6):
        part = share * u[r]
        for c in range(6):
            B[r, c] -= part * w[c]


@inlined
def factorize(joints: JointTable, inertias: Floats, ridge: float, factors: Any) -> None:
    """Factor M for inertias (n, 10) of joints' own points: weight, first moments, second moments xx xy xz yy yz zz.

    The positive `ridge` is added to the diagonal; the subspaces of `factors` are read, the rest is written.
    """
    n = joints.parents.shape[0]
    for i in range(n):
        _write_inertia(inertias[i], factors.inertias[i])
    for i in range(n - 1, 0, -1):
        A, B, D = factors.inertias[i], factors.inertias[joints.parents[i]], factors.inverses[i]
        first, size = joints.idx_v[i], joints.nv[i]
        _project_inertia(A, factors.subspaces, first, size, ridge, factors.carried, D)
        invert(D, size)
        for r in range(6):
            for c in range(6):
                B[r, c] += A[r, c]
        for k in range(size):
            for m in range(size):
                _subtract(D[k, m], factors.carried[first + k], factors.carried[first + m], B)


@inlined
def solve(joints: JointTable, factors: Any, right: Floats, forces: Floats, solution: Floats) -> None:
    """Solve M y = g (m,) by its factors; scratch (n, 6), the solution may be the right side itself."""
    S, U, D = factors.subspaces, factors.carried, factors.inverses
    n = joints.parents.shape[0]
    forces[:, :] = 0.0
    for i in range(n - 1, 0, -1):
        first, size, parent = joints.idx_v[i], joints.nv[i], joints.parents[i]
        for k in range(size):
            value = right[first + k]
            for c in range(6):
                value -= S[first + k, c] * forces[i, c]
            solution[first + k] = value
        for c in range(6):
            forces[parent, c] += forces[i, c]
        for k in range(size):
            value = 0.0
            for m in range(size):
                value += D[i, k, m] * solution[first + m]
            for c in range(6):
                forces[parent, c] += value * U[first + k, c]
    # from here on the rows of `forces` are the joints' accelerations
    forces[0, :] = 0.0
    for i in range(1, n):
        first, size, parent = joints.idx_v[i], joints.nv[i], joints.parents[i]
        for c in range(6):
            forces[i, c] = forces[parent, c]
        for k in range(size):
            for c in range(6):
                solution[first + k] -= U[first + k, c] * forces[parent, c]
        _accelerate(i, first, size, D, S, forces, solution)


@inlined
def _accelerate(i: int, first: int, size: int, D: Floats, S: Floats, forces: Floats, solution: Floats) -> None:
    """Y = D^-1 u of joint i in place of u, for up to six tangents; its acceleration is the parent's and S y."""
    y0, y1, y2, y3, y4, y5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for m in range(size):
        u = solution[first + m]
        y0 += D[i, 0, m] * u
        if size > 1:
            y1 += D[i, 1, m] * u
            y2 += D[i, 2, m] * u
        if size > 3:
            y3 += D[i, 3, m] * u
            y4 += D[i, 4, m] * u
            y5 += D[i, 5, m] * u
    for k in range(size):
        y = y0 if k == 0 else y1 if k == 1 else y2 if k == 2 else y3 if k == 3 else y4 if k == 4 else y5
        solution[first + k] = y
        for c in range(6):
            forces[i, c] += S[first + k, c] * y
