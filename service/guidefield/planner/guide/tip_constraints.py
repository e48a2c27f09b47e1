"""What the tip has to keep while the robot descends: its plane, its plane and orientation, its place."""

from __future__ import annotations

import numpy as np

from guidefield.kernels.guide.tip_constraint import HELD, ON_PLANE, SLIDING, TipConstraint, constraint_at
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.mover import mover_of
from guidefield.robot.model.spaces import Configuration

_NONE = np.eye(3)


def on_plane(point: np.ndarray, normal: np.ndarray) -> TipConstraint:
    """The tip stays on a plane: slide and reorient at once.

    Args:
        point: On the plane, shape (3,) [m, world].
        normal: Its unit normal, shape (3,), in the world.
    """
    return TipConstraint(ON_PLANE, _held(point), _held(normal), _NONE)


def sliding(point: np.ndarray, normal: np.ndarray, rotation: np.ndarray) -> TipConstraint:
    """The tip stays on a plane and keeps its orientation: the thesis' slide.

    Args:
        point: On the plane, shape (3,) [m, world].
        normal: Its unit normal, shape (3,), in the world.
        rotation: Of the tip in the world, shape (3, 3).
    """
    return TipConstraint(SLIDING, _held(point), _held(normal), _held(rotation))


def reorienting(point: np.ndarray) -> TipConstraint:
    """The tip stays where it is, at a point (3,) [m, world]: the thesis' reorient."""
    return TipConstraint(HELD, _held(point), _held(np.zeros(3)), _NONE)


def evaluated(constraint: TipConstraint, group: PlanningGroup, q: Configuration) -> tuple[np.ndarray, np.ndarray]:
    """A constraint's numbers and their derivative by the tangent.

    Args:
        constraint: The constraint.
        group: The joints.
        q: Configuration, shape (nq,).

    Returns:
        Shape (rows,) [m or rad], and shape (rows, nv).
    """
    error, rows = np.empty(constraint.kind), np.empty((constraint.kind, group.nv))
    constraint_at(constraint, mover_of(group), group.expand(q), error, rows)
    return error, rows


def _held(values: np.ndarray) -> np.ndarray:
    return np.array(values, dtype=np.float64, order="C")
