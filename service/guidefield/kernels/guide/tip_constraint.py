"""What the tip has to keep while a robot descends: its plane, its plane and orientation, or its place."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import void

from guidefield.kernels.jit.fields import RowOut, RowsOut, numba_type
from guidefield.kernels.jit.signatures import MATRIX_OUT, VECTOR, VECTOR_OUT, Floats, compiled, inlined
from guidefield.kernels.kinematics.forward_kinematics import joint_placements, motion_subspaces
from guidefield.kernels.kinematics.integrate import MOVER, Mover, tip_jacobian, tip_position

ON_PLANE, HELD, SLIDING = 1, 3, 4
"""Kinds, by the count of numbers that stay zero: height above a plane; displacement from a point; height, rotation."""


class TipConstraint(NamedTuple):
    """Some numbers about the tip that stay zero.

    Attributes:
        kind: Which, and how many.
        point: A point of the plane, or where the tip is held, shape (3,) [m].
        normal: The plane's unit normal, shape (3,).
        rotation: The orientation that is kept while sliding, shape (3, 3).
    """

    kind: int
    point: RowOut
    normal: RowOut
    rotation: RowsOut


CONSTRAINT = numba_type(TipConstraint)
"""Its arrays may be written to: a kernel moves it from round to round."""


@inlined
def constraint_error(constraint: TipConstraint, mover: Mover, world: Floats, origin: Floats, error_out: Floats) -> None:
    """How far a constraint's numbers are from zero.

    Args:
        constraint: The constraint.
        mover: The joints that move.
        world: Placements of joints about `origin`, shape (n, 3, 4) [m].
        origin: In the world, shape (3,) [m].
        error_out: Shape (kind,) [m or rad].
    """
    tip, point, normal = tip_position(mover, world), constraint.point, constraint.normal
    dx, dy, dz = tip[0] + origin[0] - point[0], tip[1] + origin[1] - point[1], tip[2] + origin[2] - point[2]
    if constraint.kind == HELD:
        error_out[0], error_out[1], error_out[2] = dx, dy, dz
        return
    error_out[0] = normal[0] * dx + normal[1] * dy + normal[2] * dz
    if constraint.kind == SLIDING:
        T, R = world[mover.tip_joint], np.empty((3, 3))
        for r in range(3):
            for c in range(3):  # T tip rotation^T
                value = 0.0
                for k in range(3):
                    row = T[r, 0] * mover.tip[0, k] + T[r, 1] * mover.tip[1, k] + T[r, 2] * mover.tip[2, k]
                    value += row * constraint.rotation[c, k]
                R[r, c] = value
        x, y, z = 0.5 * (R[2, 1] - R[1, 2]), 0.5 * (R[0, 2] - R[2, 0]), 0.5 * (R[1, 0] - R[0, 1])
        sine = math.sqrt(x * x + y * y + z * z)
        cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
        scale = math.atan2(sine, cosine) / sine if sine > 1e-12 else 1.0
        error_out[1], error_out[2], error_out[3] = scale * x, scale * y, scale * z


@inlined
def constraint_rows(
    constraint: TipConstraint, mover: Mover, world: Floats, subspaces: Floats, jacobian: Floats, rows_out: Floats
) -> None:
    """Derivative of a constraint's numbers by the group's tangent.

    Args:
        constraint: The constraint.
        mover: The joints that move.
        world: Placements of joints, shape (n, 3, 4) [m].
        subspaces: Motion subspaces of the model's tangents about the same origin, shape (m, 6).
        jacobian: Scratch, shape (6, nv).
        rows_out: Shape (kind, nv).
    """
    tip_jacobian(mover, subspaces, tip_position(mover, world), jacobian)
    normal = constraint.normal
    for k in range(jacobian.shape[1]):
        if constraint.kind == HELD:
            rows_out[0, k], rows_out[1, k], rows_out[2, k] = jacobian[0, k], jacobian[1, k], jacobian[2, k]
            continue
        rows_out[0, k] = normal[0] * jacobian[0, k] + normal[1] * jacobian[1, k] + normal[2] * jacobian[2, k]
        if constraint.kind == SLIDING:
            rows_out[1, k], rows_out[2, k], rows_out[3, k] = jacobian[3, k], jacobian[4, k], jacobian[5, k]


@compiled(void(CONSTRAINT, MOVER, VECTOR, VECTOR_OUT, MATRIX_OUT))
def constraint_at(constraint: TipConstraint, mover: Mover, q: Floats, error_out: Floats, rows_out: Floats) -> None:
    """A constraint's numbers and rows at a configuration.

    Args:
        constraint: The constraint.
        mover: The joints that move.
        q: Configuration of the model, shape (nq,).
        error_out: Shape (kind,) [m or rad].
        rows_out: Shape (kind, nv).
    """
    joints, n = mover.joints, mover.joints.parents.shape[0]
    world, subspaces = np.empty((n, 3, 4)), np.empty((mover.leaders.shape[0], 6))
    joint_placements(joints, q, world)
    motion_subspaces(joints, world, subspaces)
    constraint_error(constraint, mover, world, np.zeros(3), error_out)
    constraint_rows(constraint, mover, world, subspaces, np.empty((6, rows_out.shape[1])), rows_out)
