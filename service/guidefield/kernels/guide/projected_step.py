"""One step of Projected: Newton's, in the metric of nearby faces' curvature, along the tip's constraint.

service/docs/algorithm.md, "Projected": ``v = -(y - Z C y)`` with ``y = M^-1 g`` and ``Z = M^-1 C^T (C M^-1 C^T)^-1``.
Joints at a limit beyond which v would push them leave g, M and C.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from guidefield.kernels.guide.tip_constraint import constraint_rows
from guidefield.kernels.jit.signatures import Floats, inlined
from guidefield.kernels.kinematics.articulated_body import factorize, solve, trace
from guidefield.kernels.kinematics.forward_kinematics import motion_subspaces
from guidefield.kernels.linalg.small_systems import invert

_AT_LIMIT = 1e-9
"""A value this close to a limit is at it [rad or m]."""


class State(NamedTuple):
    """A configuration and what the field does there; all about the tables' origin.

    Attributes:
        q: Configuration of the model, shape (nq,).
        world: Placements of joints, shape (n, 3, 4) [m].
        wrenches: Force [1] and moment [m] on what each joint itself carries, shape (n, 6).
        inertias: Weight by curvature, first and second moments of that, shape (n, 10).
    """

    q: Floats
    world: Floats
    wrenches: Floats
    inertias: Floats


class Step(NamedTuple):
    """Room for a step; m tangents of the model, nv of the group.

    Attributes:
        gradient: dU/dv, shape (nv,).
        v: The step, shape (nv,).
        rows: C, the constraint's derivative, shape (kind, nv).
        products: y = M^-1 g, then M^-1 times each row of C, shape (1 + kind, nv).
        Z: Shape (kind, nv).
        jacobian: Scratch, shape (6, nv).
        gram: C M^-1 C^T and its inverse, shape (kind, kind).
        error: How far the constraint's numbers are from zero, shape (kind,).
        blocked: 1 where a joint is at a limit that v would push it beyond, shape (nv,).
        right: Scratch, shape (m,).
        forces, scratch: What gathers at joints, shapes (n, 6) and (n, 10).
        tangent: Scratch, shape (nv,).
    """

    gradient: Floats
    v: Floats
    rows: Floats
    products: Floats
    Z: Floats
    jacobian: Floats
    gram: Floats
    error: Floats
    blocked: Any
    right: Floats
    forces: Floats
    scratch: Floats
    tangent: Floats


@inlined
def state_room(nq: int, n: int) -> Any:
    """Room for a state: length of a configuration, count of joints."""
    return State(np.empty(nq), np.empty((n, 3, 4)), np.empty((n, 6)), np.empty((n, 10)))


@inlined
def step_room(n: int, m: int, nv: int, kind: int) -> Any:
    """Room for a step: joints, tangents of the model, of the group, rows of the constraint."""
    return Step(
        np.empty(nv), np.empty(nv), np.empty((kind, nv)), np.empty((1 + kind, nv)), np.empty((kind, nv)),
        np.empty((6, nv)), np.empty((kind, kind)), np.empty(kind), np.zeros(nv, np.int64), np.empty(m),
        np.empty((n, 6)), np.empty((n, 10)), np.empty(nv),
    )  # fmt: skip


@inlined
def _gradient(mover: Any, subspaces: Floats, wrenches: Floats, carried: Floats, gradient_out: Floats) -> None:
    """dU/dv of the group: minus the wrenches of each joint's subtree along its tangents."""
    joints = mover.joints
    carried[:, :] = wrenches
    gradient_out[:] = 0.0
    for i in range(joints.parents.shape[0] - 1, 0, -1):
        for r in range(joints.idx_v[i], joints.idx_v[i] + joints.nv[i]):
            value = 0.0
            for c in range(6):
                value -= subspaces[r, c] * carried[i, c]
            gradient_out[mover.leaders[r]] += mover.factors[r] * value
        for c in range(6):
            carried[joints.parents[i], c] += carried[i, c]


@inlined
def _divided(mover: Any, factors: Any, right: Floats, room: Any, out: Floats) -> None:
    """M^-1 of a row of the group (nv,): followers share what acts on their leader, and answer in its place."""
    for r in range(mover.leaders.shape[0]):
        k = mover.leaders[r]
        room.right[r] = mover.factors[r] / mover.norms[k] * right[k]
    solve(mover.joints, factors, room.right, room.forces, room.right)
    out[:] = 0.0
    for r in range(mover.leaders.shape[0]):
        k = mover.leaders[r]
        out[k] += mover.factors[r] / mover.norms[k] * room.right[r]


@inlined
def _inverse(gram: Floats) -> None:
    """Replace a small symmetric matrix by its inverse; a ridge keeps it where two rows ask for the same."""
    size = gram.shape[0]
    diagonal = 0.0
    for k in range(size):
        diagonal += gram[k, k]
    if diagonal <= 0.0:
        gram[:, :] = 0.0
        return
    for k in range(size):
        gram[k, k] += 1e-10 * diagonal
    invert(gram, size)


@inlined
def _project(mover: Any, factors: Any, room: Any) -> None:
    """V = -(y - Z C y) over the joints that are not blocked."""
    nv, kind = room.v.shape[0], room.error.shape[0]
    for k in range(nv):
        room.tangent[k] = 0.0 if room.blocked[k] == 1 else room.gradient[k]
    y = room.products[0]
    _divided(mover, factors, room.tangent, room, y)
    for a in range(kind):
        for k in range(nv):
            room.tangent[k] = 0.0 if room.blocked[k] == 1 else room.rows[a, k]
        _divided(mover, factors, room.tangent, room, room.products[1 + a])
    for a in range(kind):
        for b in range(kind):
            value = 0.0
            for k in range(nv):
                value += room.rows[a, k] * room.products[1 + b, k]
            room.gram[a, b] = value
    _inverse(room.gram)
    for k in range(nv):
        for a in range(kind):
            value = 0.0
            for b in range(kind):
                value += room.gram[a, b] * room.products[1 + b, k]
            room.Z[a, k] = value
        room.v[k] = -y[k]
    for a in range(kind):
        value = 0.0
        for k in range(nv):
            value += room.rows[a, k] * y[k]
        for k in range(nv):
            room.v[k] += room.Z[a, k] * value


@inlined
def _newly_blocked(mover: Any, q: Floats, room: Any) -> int:
    """Block the joints at a limit beyond which v would push them; how many new ones there are."""
    found = 0
    for k in range(room.v.shape[0]):
        at = mover.values[k]
        if at >= 0 and mover.stops[k] == 1 and room.blocked[k] == 0:
            low = q[at] <= mover.lower[k] + _AT_LIMIT and room.v[k] < 0.0
            high = q[at] >= mover.upper[k] - _AT_LIMIT and room.v[k] > 0.0
            if low or high:
                room.blocked[k] = 1
                found += 1
    return found


@inlined
def direction(mover: Any, constraint: Any, regularization: float, here: Any, factors: Any, room: Any) -> float:
    """The projected step into `room`, no joint beyond its longest; its slope g.v, 0 where there is none."""
    joints = mover.joints
    motion_subspaces(joints, here.world, factors.subspaces)
    _gradient(mover, factors.subspaces, here.wrenches, room.forces, room.gradient)
    constraint_rows(constraint, mover, here.world, factors.subspaces, room.jacobian, room.rows)
    room.blocked[:] = 0
    free = room.v.shape[0]
    for _ in range(room.v.shape[0]):
        mean = trace(joints, factors.subspaces, here.inertias, room.scratch) / free
        if not mean < math.inf:
            return 0.0
        factorize(joints, here.inertias, max(regularization * mean, 1e-12), factors)
        _project(mover, factors, room)
        newly = _newly_blocked(mover, here.q, room)
        free -= newly
        if newly == 0 or free == 0:
            break
        for r in range(mover.leaders.shape[0]):
            if room.blocked[mover.leaders[r]] == 1:
                factors.subspaces[r, :] = 0.0
    if free == 0:
        return 0.0
    slope, longest = 0.0, 1.0
    for k in range(room.v.shape[0]):
        slope += room.gradient[k] * room.v[k]
        longest = max(longest, abs(room.v[k]) / mover.largest[k])
    if not -slope < math.inf or not longest < math.inf:
        return 0.0
    for k in range(room.v.shape[0]):
        room.v[k] /= longest
    return slope / longest
