"""Placements as Pinocchio has them, from positions and quaternions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pinocchio as pin


def se3(position: Sequence[float], quaternion_xyzw: Sequence[float]) -> Any:
    """A placement, pinocchio.SE3.

    Args:
        position: Of the frame's origin, shape (3,) [m].
        quaternion_xyzw: Its rotation (x, y, z, w), shape (4,), near unit length.
    """
    norm = math.hypot(*quaternion_xyzw)
    return pin.XYZQUATToSE3([*position, *(value / norm for value in quaternion_xyzw)])
