"""Descent of the potential on the manifold of configurations whose tip keeps a constraint: kernel of Projected.

planner.md section 3; findings-seed.md section 3. A step is ``v = -(y - Z C y)`` with ``y = M^-1 g`` and
``Z = M^-1 C^T (C M^-1 C^T)^-1``: Newton's step in the metric M of nearby faces' curvature, less the part that would
leave the constraint. It is taken back onto the constraint by up to three corrections with the same Z.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.chart_values import chart_values
from guidefield.kernels.distance import TABLES as BODIES
from guidefield.kernels.energy import ROBOT, forces, potential
from guidefield.kernels.field_tables import TABLES, TABLES_32
from guidefield.kernels.mover import MOVER, clamp, integrate, tip_position
from guidefield.kernels.projected_step import direction, state_room, step_room
from guidefield.kernels.signatures import MATRIX_OUT, SCALAR, VECTOR, VECTOR_OUT, Floats, compiled, inlined
from guidefield.kernels.swept import SWEPT, motion_apart
from guidefield.kernels.tip_constraint import CONSTRAINT, constraint_error
from guidefield.kernels.tip_guard import GUARD, allows
from guidefield.kernels.tree_kinematics import joint_placements
from guidefield.kernels.tree_metric import empty_factors

ENDED, UNDECIDED, OUT_OF_STEPS = range(3)
"""How a descent comes back: at its end; for the caller to judge a motion; after all the steps it may take."""

_CORRECTIONS = 3
_TRIALS = 10
_SUFFICIENT_DECREASE = 1e-4


class Settings(NamedTuple):
    """How a descent goes.

    Attributes:
        regularization: Share of the metric's mean diagonal added to it.
        on_constraint: How near a trial comes to the constraint [m or rad].
        tolerance: It ends where a step promises, or brings, less than this share of U.
        margin: Distance kept from obstacles [m].
        self_margin: What capsules of the robot keep from each other [m].
        floor: Motions are halved down to this [m].
        exact: 1 where a no of the capsules is a no.
    """

    regularization: float
    on_constraint: float
    tolerance: float
    margin: float
    self_margin: float
    floor: float
    exact: int


SETTINGS = types.NamedTuple((SCALAR, SCALAR, SCALAR, SCALAR, SCALAR, SCALAR, types.int64), Settings)
COUNTS_OUT = types.Array(types.int64, 1, "C")


@inlined
def _retracted(
    mover: Any, constraint: Any, settings: Any, origin: Floats, q: Floats, alpha: float, room: Any, there: Any
) -> bool:
    """The configuration along v, brought back onto the constraint and into the limits; whether that succeeds."""
    joints = mover.joints
    for k in range(room.v.shape[0]):
        room.tangent[k] = alpha * room.v[k]
    integrate(mover, q, room.tangent, there.q)
    for correction in range(_CORRECTIONS + 1):
        if not clamp(mover, there.q, room.tangent):
            return False
        joint_placements(
            joints.parents, joints.kinds, joints.axes, joints.placements, joints.idx_q, there.q, there.world
        )
        for i in range(joints.parents.shape[0]):
            for r in range(3):
                there.world[i, r, 3] -= origin[r]
        constraint_error(constraint, mover, there.world, origin, room.error)
        worst = 0.0
        for a in range(room.error.shape[0]):
            worst = max(worst, abs(room.error[a]))
        if worst <= 0.1 * settings.on_constraint:
            return True
        if correction == _CORRECTIONS:
            return worst <= settings.on_constraint
        for k in range(room.v.shape[0]):
            value = 0.0
            for a in range(room.error.shape[0]):
                value -= room.Z[a, k] * room.error[a]
            room.tangent[k] = value
        integrate(mover, there.q, room.tangent, there.q)
    return False


@compiled(
    [
        types.int64(
            *(MOVER, ROBOT, t, SWEPT, BODIES, CONSTRAINT, GUARD, SETTINGS),
            *(VECTOR, SCALAR, MATRIX_OUT, VECTOR_OUT, VECTOR_OUT, COUNTS_OUT),
        )
        for t in (TABLES, TABLES_32)
    ]
)
def descend(
    mover: Any, robot: Any, tables: Any, swept: Any, bodies: Any, constraint: Any, guard: Any, settings: Any,
    q: Floats, longest: float, path_out: Floats, potentials_out: Floats, trial_out: Floats, counts_out: Any,
) -> int:  # fmt: skip
    """Reduce U while the tip keeps a constraint, by at most as many steps as `path_out` has room for.

    Args:
        mover: The joints that move.
        robot: What is charged on them.
        tables: What repels it, in double or single precision.
        swept: The robot's capsules.
        bodies: The obstacles.
        constraint: What the tip keeps.
        guard: Where it may be.
        settings: How it goes.
        q: Configuration of the model on the constraint, shape (nq,).
        longest: Share of the first step that is tried first.
        path_out: Configurations accepted, shape (steps, nq); where it comes back undecided the trial stands behind.
        potentials_out: U at the start and after each of them, shape (steps + 1,) [m].
        trial_out: Of an undecided trial: its share of the step, and U [m]; shape (2,).
        counts_out: Steps, evaluations of U, motions judged; shape (3,).

    Returns:
        ENDED, UNDECIDED (capsules can't tell whether the motion from the last accepted configuration to the trial is
        free, and U says it should be taken), or OUT_OF_STEPS.
    """
    n, nv, kind = mover.joints.parents.shape[0], mover.values.shape[0], constraint.kind
    here, there = state_room(q.shape[0], n), state_room(q.shape[0], n)
    room = step_room(n, mover.leaders.shape[0], nv, kind)
    factors = empty_factors(n, mover.leaders.shape[0])
    origin = tables.origin
    zero = np.zeros(q.shape[0])
    z0, z1 = np.empty(mover.leaders.shape[0]), np.empty(mover.leaders.shape[0])
    here.q[:] = q
    U = forces(mover.joints, robot, tables, here.q, here.world, here.wrenches, here.inertias)
    steps, evaluations, motions = 0, 1, 0
    potentials_out[0] = U
    answer = OUT_OF_STEPS
    alpha = longest
    while steps < path_out.shape[0]:
        counts_out[0], counts_out[1], counts_out[2] = steps, evaluations, motions
        slope = direction(mover, constraint, settings.regularization, here, factors, room)
        if -slope < settings.tolerance * U or slope >= 0.0:
            answer = ENDED
            break
        chart_values(mover.joints, here.q, swept.origin, zero, z0)
        reached = -1.0
        while alpha > 0.5**_TRIALS:
            if _retracted(mover, constraint, settings, origin, here.q, alpha, room, there):
                tip = tip_position(mover, there.world)
                if allows(guard, (tip[0] + origin[0], tip[1] + origin[1], tip[2] + origin[2])):
                    chart_values(mover.joints, there.q, swept.origin, z0, z1)
                    motions += 1
                    free = motion_apart(
                        swept, bodies, z0, z1, settings.margin, settings.self_margin, settings.floor
                    )
                    if free or settings.exact == 0:
                        evaluations += 1
                        whole = alpha == 1.0  # full steps are nearly always taken: with all that the next one needs
                        if whole:
                            reached = forces(
                                mover.joints, robot, tables, there.q, there.world, there.wrenches, there.inertias
                            )
                        else:
                            reached = potential(mover.joints, robot, tables, there.q)
                        if reached <= U + _SUFFICIENT_DECREASE * alpha * slope:
                            path_out[steps] = there.q
                            if not free:
                                trial_out[0], trial_out[1] = alpha, reached
                                counts_out[1], counts_out[2] = evaluations, motions
                                return UNDECIDED
                            if not whole:
                                evaluations += 1
                                reached = forces(
                                    mover.joints, robot, tables, there.q, there.world, there.wrenches, there.inertias
                                )
                            break
                        reached = -1.0
            alpha *= 0.5
        if reached < 0.0:
            answer = ENDED
            break
        steps += 1
        alpha = 1.0
        before, U = U, reached
        potentials_out[steps] = U
        here, there = there, here
        if before - U < settings.tolerance * before:
            answer = ENDED
            break
    counts_out[0], counts_out[1], counts_out[2] = steps, evaluations, motions
    return answer
