"""Axes of planar joints: Pinocchio's planar joint moves in its own xy plane, whatever axis the URDF gives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

NEARLY_ALONG_X = 0.9
"""If the axis has a larger share of x, its plane is spanned from the joint frame's y axis."""


def plane_rotation(axis: np.ndarray) -> np.ndarray:
    """Rotation, shape (3, 3), from a planar joint's own axes (first, second, normal) to the joint's frame.

    The normal is the joint's axis. The first axis is the frame's x axis projected into the plane, or its y axis where
    the normal is nearly along x; the second completes a right-handed frame.

    Args:
        axis: Shape (3,), of any length but zero.
    """
    normal = axis / np.abs(axis).max()
    normal = normal / np.linalg.norm(normal)
    start = np.eye(3)[0 if abs(normal[0]) <= NEARLY_ALONG_X else 1]
    first = start - (start @ normal) * normal
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(normal, first), normal]) + 0.0


def set_planar_axes(model: Any, geometry: Any | None, axes: Mapping[int, np.ndarray]) -> None:
    """Let planar joints move in the plane normal to their axis and turn about it, in place.

    The joint's own frame is turned so that its z axis is the joint's axis. What the joint carries is turned back, so
    that links, frames and shapes stay where the URDF has them.

    Args:
        model: Pinocchio model.
        geometry: Its collision geometry, if there is any.
        axes: Axis, shape (3,), of each planar joint, by Pinocchio's index.
    """
    for index, axis in axes.items():
        turn = pin.SE3(plane_rotation(axis), np.zeros(3))
        if turn.isIdentity(0.0):
            continue
        back = turn.inverse()
        model.jointPlacements[index] = model.jointPlacements[index] * turn
        model.inertias[index] = back.act(model.inertias[index])
        for child in range(1, model.njoints):
            if model.parents[child] == index:
                model.jointPlacements[child] = back * model.jointPlacements[child]
        for carried in (*model.frames, *(geometry.geometryObjects if geometry is not None else ())):
            if carried.parentJoint == index:
                carried.placement = back * carried.placement
