"""What the tip has to keep while the robot descends: its plane, its plane and orientation, its place."""

from __future__ import annotations

import numpy as np

from guidefield.kernels.field_tables import frozen
from guidefield.kernels.tip_constraint import HELD, ON_PLANE, SLIDING, TipConstraint, constraint_at
from guidefield.robot.group import PlanningGroup
from guidefield.robot.mover import mover_of

_NONE = frozen(np.eye(3))


def on_plane(point: np.ndarray, normal: np.ndarray) -> TipConstraint:
    """The tip stays on a plane through a point (3,) with a unit normal (3,): slide and reorient at once."""
    return TipConstraint(ON_PLANE, _held(point), _held(normal), _NONE)


def sliding(point: np.ndarray, normal: np.ndarray, rotation: np.ndarray) -> TipConstraint:
    """The tip stays on a plane and keeps its orientation (3, 3): the seed's slide."""
    return TipConstraint(SLIDING, _held(point), _held(normal), _held(rotation))


def reorienting(point: np.ndarray) -> TipConstraint:
    """The tip stays where it is, at a point (3,): the seed's reorient."""
    return TipConstraint(HELD, _held(point), _held(np.zeros(3)), _NONE)


def evaluated(constraint: TipConstraint, group: PlanningGroup, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A constraint's numbers [m or rad], shape (rows,), and their derivative by the tangent, shape (rows, nv)."""
    error, rows = np.empty(constraint.kind), np.empty((constraint.kind, group.nv))
    constraint_at(constraint, mover_of(group), group.expand(q), error, rows)
    return error, rows


def _held(values: np.ndarray) -> np.ndarray:
    return frozen(np.array(values, dtype=np.float64))
