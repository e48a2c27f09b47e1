"""Descent of the potential on the manifold of configurations whose tip keeps a constraint: the minimizer Projected.

service/docs/algorithm.md, "Projected". A step is ``v = -(y - Z C y)`` with ``y = M^-1 g`` and ``Z = M^-1 C^T (C M^-1
C^T)^-1``: Newton's step in the metric M of nearby faces' curvature, less the part that would leave the constraint. It
is taken back onto the constraint by at most `_CORRECTIONS` steps with the same Z. `planner/guide/rounds.py` and
`plane_rounds` call it; settings are theirs. Constants change which path it finds; each motion is tested on the way.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.collide.swept_bounds import SWEPT, motion_apart
from guidefield.kernels.distance.distance import TABLES as BODIES
from guidefield.kernels.field.energy import ROBOT, forces, potential
from guidefield.kernels.field.field import TABLES_32
from guidefield.kernels.guide.tip_constraint import (
    CONSTRAINT,
    COUNTS_OUT,
    EVALUATIONS,
    GUARD,
    JUDGED,
    STEPS,
    allows,
    constraint_error,
    constraint_rows,
)
from guidefield.kernels.jit.arrays import MATRIX_OUT, SCALAR, VECTOR, VECTOR_OUT, Floats, numba_type
from guidefield.kernels.jit.decorators import compiled, inlined
from guidefield.kernels.kinematics.articulated_body import empty_factors, factorize, solve, trace
from guidefield.kernels.kinematics.forward_kinematics import joint_placements, local_values, motion_subspaces
from guidefield.kernels.kinematics.integrate import MOVER, clamp, integrate, tip_position
from guidefield.kernels.linalg.small_systems import invert

_AT_LIMIT = 1e-9  # a value this close to a limit is at it [rad or m]


class State(NamedTuple):
    """A configuration and what the field does there; all about the tables' origin."""

    q: Floats  # configuration of the model, shape (nq,)
    world: Floats  # placements of joints, shape (n, 3, 4) [m]
    wrenches: Floats  # force [1] and moment [m] on what each joint itself carries, shape (n, 6)
    inertias: Floats  # weight by curvature, first and second moments of that, shape (n, 10)


class Step(NamedTuple):
    """Buffers of a step; m tangents of the model, nv of the group."""

    gradient: Floats  # dU/dv, shape (nv,)
    v: Floats  # the step, shape (nv,)
    rows: Floats  # C, the constraint's derivative, shape (kind, nv)
    products: Floats  # y = M^-1 g, then M^-1 times each row of C, shape (1 + kind, nv)
    Z: Floats  # shape (kind, nv)
    jacobian: Floats  # scratch, shape (6, nv)
    gram: Floats  # C M^-1 C^T and its inverse, shape (kind, kind)
    error: Floats  # how far the constraint's numbers are from zero, shape (kind,)
    blocked: Any  # 1 where a joint is at a limit that v would push it beyond, shape (nv,)
    right: Floats  # scratch, shape (m,)
    # forces, scratch: What gathers at joints, shapes (n, 6) and (n, 10)
    forces: Floats
    scratch: Floats
    tangent: Floats  # scratch, shape (nv,)


@inlined
def allocate_state(nq: int, n: int) -> Any:
    """Allocate a state: length of a configuration, count of joints."""
    return State(np.empty(nq), np.empty((n, 3, 4)), np.empty((n, 6)), np.empty((n, 10)))


@inlined
def allocate_step(n: int, m: int, nv: int, kind: int) -> Any:
    """Allocate the buffers of a step: joints, tangents of the model, of the group, rows of the constraint."""
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
def _divide(mover: Any, factors: Any, right: Floats, buffers: Any, out: Floats) -> None:
    """M^-1 of a row of the group (nv,): mimic joints share what acts on their source, and answer instead of it."""
    for r in range(mover.leaders.shape[0]):
        k = mover.leaders[r]
        buffers.right[r] = mover.factors[r] / mover.norms[k] * right[k]
    solve(mover.joints, factors, buffers.right, buffers.forces, buffers.right)
    out[:] = 0.0
    for r in range(mover.leaders.shape[0]):
        k = mover.leaders[r]
        out[k] += mover.factors[r] / mover.norms[k] * buffers.right[r]


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
def _project(mover: Any, factors: Any, buffers: Any) -> None:
    """V = -(y - Z C y) over the joints that are not blocked."""
    nv, kind = buffers.v.shape[0], buffers.error.shape[0]
    for k in range(nv):
        buffers.tangent[k] = 0.0 if buffers.blocked[k] == 1 else buffers.gradient[k]
    y = buffers.products[0]
    _divide(mover, factors, buffers.tangent, buffers, y)
    for a in range(kind):
        for k in range(nv):
            buffers.tangent[k] = 0.0 if buffers.blocked[k] == 1 else buffers.rows[a, k]
        _divide(mover, factors, buffers.tangent, buffers, buffers.products[1 + a])
    for a in range(kind):
        for b in range(kind):
            value = 0.0
            for k in range(nv):
                value += buffers.rows[a, k] * buffers.products[1 + b, k]
            buffers.gram[a, b] = value
    _inverse(buffers.gram)
    for k in range(nv):
        for a in range(kind):
            value = 0.0
            for b in range(kind):
                value += buffers.gram[a, b] * buffers.products[1 + b, k]
            buffers.Z[a, k] = value
        buffers.v[k] = -y[k]
    for a in range(kind):
        value = 0.0
        for k in range(nv):
            value += buffers.rows[a, k] * y[k]
        for k in range(nv):
            buffers.v[k] += buffers.Z[a, k] * value


@inlined
def _newly_blocked(mover: Any, q: Floats, buffers: Any) -> int:
    """Block the joints at a limit beyond which v would push them; how many new ones there are."""
    found = 0
    for k in range(buffers.v.shape[0]):
        at = mover.values[k]
        if at >= 0 and mover.stops[k] == 1 and buffers.blocked[k] == 0:
            low = q[at] <= mover.lower[k] + _AT_LIMIT and buffers.v[k] < 0.0
            high = q[at] >= mover.upper[k] - _AT_LIMIT and buffers.v[k] > 0.0
            if low or high:
                buffers.blocked[k] = 1
                found += 1
    return found


@inlined
def _count_by_size(mover: Any, subspaces: Floats) -> None:
    """Scale tangents (m, 6) by the robot's size, so that slides of robots of any size go as far for one step."""
    for r in range(mover.leaders.shape[0]):
        for c in range(6):
            subspaces[r, c] *= mover.sizes[mover.leaders[r]]


@inlined
def _from_counted(mover: Any, buffers: Any) -> None:
    """Give a step, and what takes it back onto the constraint, in the group's own tangents."""
    for k in range(buffers.v.shape[0]):
        buffers.v[k] *= mover.sizes[k]
        for a in range(buffers.error.shape[0]):
            buffers.Z[a, k] *= mover.sizes[k]


@inlined
def direction(mover: Any, constraint: Any, regularization: float, here: Any, factors: Any, buffers: Any) -> float:
    """The projected step into `buffers`, no joint beyond its longest; its slope g.v, 0 where there is none."""
    joints = mover.joints
    motion_subspaces(joints, here.world, factors.subspaces)
    _count_by_size(mover, factors.subspaces)
    _gradient(mover, factors.subspaces, here.wrenches, buffers.forces, buffers.gradient)
    constraint_rows(constraint, mover, here.world, factors.subspaces, buffers.jacobian, buffers.rows)
    buffers.blocked[:] = 0
    free = buffers.v.shape[0]
    for _ in range(buffers.v.shape[0]):
        mean = trace(joints, factors.subspaces, here.inertias, buffers.scratch) / free
        if not mean < math.inf:
            return 0.0
        factorize(joints, here.inertias, max(regularization * mean, 1e-12), factors)
        _project(mover, factors, buffers)
        newly = _newly_blocked(mover, here.q, buffers)
        free -= newly
        if newly == 0 or free == 0:
            break
        for r in range(mover.leaders.shape[0]):
            if buffers.blocked[mover.leaders[r]] == 1:
                factors.subspaces[r, :] = 0.0
    if free == 0:
        return 0.0
    slope, longest = 0.0, 1.0
    for k in range(buffers.v.shape[0]):
        slope += buffers.gradient[k] * buffers.v[k]
        longest = max(longest, abs(buffers.v[k]) / mover.largest[k])
    if not -slope < math.inf or not longest < math.inf:
        return 0.0
    for k in range(buffers.v.shape[0]):
        buffers.v[k] /= longest
    _from_counted(mover, buffers)
    return slope / longest


ENDED, UNDECIDED, OUT_OF_STEPS = range(3)
"""Ends of a call of the descent: at its end; for the caller to judge a motion; after all the steps it may take."""

_REFUSED, _TAKEN, _TO_JUDGE = range(3)  # verdicts on a trial

_CORRECTIONS = 3  # steps back onto the constraint, at most
_TRIALS = 10  # halvings of a step, at most
_SUFFICIENT_DECREASE = 1e-4  # least share of the promised decrease that a trial has to bring (Armijo)


class Settings(NamedTuple):
    """Settings of a descent."""

    regularization: float  # share of the metric's mean diagonal added to it
    on_constraint: float  # how near a trial comes to the constraint [m or rad]
    tolerance: float  # it ends where a step promises, or brings, less than this share of U .
    fine: float  # .. and, where the robot is then nearer to obstacles than `close`, less than this share.
    close: float  # see `fine` [m]
    margin: float  # distance kept from obstacles [m]
    self_margin: float  # what capsules of the robot keep from each other [m]
    floor: float  # motions are halved down to this [m]
    exact: int  # 1 where the capsules are the links themselves, so that a motion that they refuse isn't free


SETTINGS = numba_type(Settings)

SHARE, REACHED, TRIAL = range(3)
"""Numbers of a trial that the caller has to judge: its share of the step, and U there [m]; then how many there are."""


@inlined
def _retract(
    mover: Any, constraint: Any, settings: Any, origin: Floats, q: Floats, alpha: float, buffers: Any, there: Any
) -> bool:
    """The configuration along v, brought back onto the constraint and into the limits; whether that succeeds."""
    joints = mover.joints
    for k in range(buffers.v.shape[0]):
        buffers.tangent[k] = alpha * buffers.v[k]
    integrate(mover, q, buffers.tangent, there.q)
    for correction in range(_CORRECTIONS + 1):
        if not clamp(mover, there.q, buffers.tangent):
            return False
        joint_placements(joints, there.q, there.world)
        for i in range(joints.parents.shape[0]):
            for r in range(3):
                there.world[i, r, 3] -= origin[r]
        constraint_error(constraint, mover, there.world, origin, buffers.error)
        worst = 0.0
        for a in range(buffers.error.shape[0]):
            worst = max(worst, abs(buffers.error[a]))
        if worst <= 0.1 * settings.on_constraint:
            return True
        if correction == _CORRECTIONS:
            return bool(worst <= settings.on_constraint)
        for k in range(buffers.v.shape[0]):
            value = 0.0
            for a in range(buffers.error.shape[0]):
                value -= buffers.Z[a, k] * buffers.error[a]
            buffers.tangent[k] = value
        integrate(mover, there.q, buffers.tangent, there.q)
    return False


@inlined
def _take(
    mover: Any, robot: Any, tables: Any, swept: Any, bodies: Any, guard: Any, settings: Any, z0: Floats, z1: Floats,
    U: float, alpha: float, slope: float, there: Any, counts_out: Any,
) -> tuple[int, float]:  # fmt: skip
    """Tell if a trial is refused, taken, or to be taken if its motion is free; and its potential [m].

    Of one that is taken `there` has all that the next step needs: full steps are nearly always taken.
    """
    tip, origin = tip_position(mover, there.world), tables.origin
    if not allows(guard, (tip[0] + origin[0], tip[1] + origin[1], tip[2] + origin[2])):
        return _REFUSED, 0.0
    local_values(mover.joints, there.q, swept.origin, z0, z1)
    counts_out[JUDGED] += 1
    free = motion_apart(swept, bodies, z0, z1, settings.margin, settings.self_margin, settings.floor)
    if not free and settings.exact == 1:
        return _REFUSED, 0.0
    counts_out[EVALUATIONS] += 1
    whole = alpha == 1.0
    if whole:
        reached = forces(mover.joints, robot, tables, there.q, there.world, there.wrenches, there.inertias)
    else:
        reached = potential(mover.joints, robot, tables, there.q)
    if not reached <= U + _SUFFICIENT_DECREASE * alpha * slope:
        return _REFUSED, 0.0
    if not free:
        return _TO_JUDGE, reached
    if not whole:
        counts_out[EVALUATIONS] += 1
        reached = forces(mover.joints, robot, tables, there.q, there.world, there.wrenches, there.inertias)
    return _TAKEN, reached


@inlined
def _is_close(swept: Any, bodies: Any, settings: Any, z: Floats) -> bool:
    """Tell if the capsules at local coordinates are nearer to obstacles than `settings.close`, or can't tell."""
    return not motion_apart(swept, bodies, z, z, settings.close, settings.self_margin, settings.floor)


@compiled(
    types.int64(
        *(MOVER, ROBOT, TABLES_32, SWEPT, BODIES, CONSTRAINT, GUARD, SETTINGS),
        *(VECTOR, SCALAR, MATRIX_OUT, VECTOR_OUT, VECTOR_OUT, COUNTS_OUT),
    )
)
def descend(
    mover: Any, robot: Any, tables: Any, swept: Any, bodies: Any, constraint: Any, guard: Any, settings: Any,
    q: Floats, longest: float, path_out: Floats, potentials_out: Floats, trial_out: Floats, counts_out: Any,
) -> int:  # fmt: skip
    """Reduce U while the tip keeps a constraint, by at most as many steps as `path_out` holds.

    From q (nq,) on the constraint, with the share `longest` of the first step tried first; `tables` are in single
    precision. Writes configurations accepted (steps, nq), behind them an undecided trial and its numbers (TRIAL,); U at
    the start and after each (steps + 1,) [m]; and counts (COUNTS,).

    Returns ENDED, UNDECIDED (capsules can't tell whether the motion from the last accepted configuration to the trial
    is free, and U says it should be taken), or OUT_OF_STEPS.
    """
    n, nv, m = mover.joints.parents.shape[0], mover.values.shape[0], mover.leaders.shape[0]
    here, there = allocate_state(q.shape[0], n), allocate_state(q.shape[0], n)
    buffers, factors = allocate_step(n, m, nv, constraint.kind), empty_factors(n, m)
    zero, z0, z1 = np.zeros(m), np.empty(m), np.empty(m)
    here.q[:] = q
    U = forces(mover.joints, robot, tables, here.q, here.world, here.wrenches, here.inertias)
    counts_out[STEPS], counts_out[EVALUATIONS], counts_out[JUDGED] = 0, 1, 0
    potentials_out[0] = U
    alpha, tolerance = longest, settings.tolerance
    while counts_out[STEPS] < path_out.shape[0]:
        slope = direction(mover, constraint, settings.regularization, here, factors, buffers)
        local_values(mover.joints, here.q, swept.origin, zero, z0)
        if -slope < tolerance * U and tolerance > settings.fine and _is_close(swept, bodies, settings, z0):
            tolerance = settings.fine
        if -slope < tolerance * U or slope >= 0.0:
            return ENDED
        verdict, reached = _REFUSED, 0.0
        while verdict == _REFUSED and alpha > 0.5**_TRIALS:
            if _retract(mover, constraint, settings, tables.origin, here.q, alpha, buffers, there):
                verdict, reached = _take(
                    mover, robot, tables, swept, bodies, guard, settings, z0, z1, U, alpha, slope, there, counts_out
                )
            alpha *= 0.5
        if verdict == _REFUSED:
            return ENDED
        path_out[counts_out[STEPS]] = there.q
        if verdict == _TO_JUDGE:
            trial_out[SHARE], trial_out[REACHED] = 2.0 * alpha, reached
            return UNDECIDED
        counts_out[STEPS] += 1
        before, U, alpha = U, reached, 1.0
        potentials_out[counts_out[STEPS]] = U
        here, there = there, here
        if before - U < tolerance * before:
            if tolerance <= settings.fine or not _is_close(swept, bodies, settings, z1):
                return ENDED
            tolerance = settings.fine
    return OUT_OF_STEPS
