"""Convert positions and quaternions (x, y, z, w) of the wire to Pinocchio's placements and rows, and back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin


def se3(position: Sequence[float], quaternion_xyzw: Sequence[float]) -> Any:
    """Return the pinocchio.SE3 of a position (3,) [m] and a quaternion (x, y, z, w), shape (4,), near unit length."""
    return pin.XYZQUATToSE3([*position, *unit(quaternion_xyzw)])


def wire_pose(placement: Any) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    """Return the position [m] and the quaternion (x, y, z, w) of a placement, pinocchio.SE3."""
    x, y, z, a, b, c, d = pin.SE3ToXYZQUAT(placement).tolist()
    return (x, y, z), (a, b, c, d)


def unit(quaternion_xyzw: Sequence[float]) -> tuple[float, float, float, float]:
    """Normalize a quaternion (x, y, z, w)."""
    x, y, z, w = quaternion_xyzw
    norm = math.hypot(x, y, z, w)
    return x / norm, y / norm, z / norm, w / norm


def frames(positions: np.ndarray, quaternions_xyzw: np.ndarray) -> np.ndarray:
    """Return rotation and translation as flat 3 x 4 matrices, (n, 12), of positions (n, 3) and quaternions (n, 4)."""
    x, y, z, w = (quaternions_xyzw / np.linalg.norm(quaternions_xyzw, axis=1, keepdims=True)).T
    columns = (
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w), positions[:, 0],
        2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w), positions[:, 1],
        2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y), positions[:, 2],
    )  # fmt: skip
    return np.column_stack(columns)


def transform_points(placement: Any, points: np.ndarray) -> np.ndarray:
    """Return points (n, 3) of a body in the world [m], where a pinocchio.SE3 places the body."""
    # by this sum, not by `@`: for three columns BLAS takes ten times as long
    there: np.ndarray = np.einsum("nj,ij->ni", points, placement.rotation) + placement.translation
    return there
