"""Giving way: velocities that lead away from what comes close, the most promising first."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from guidefield.kernels.stream.room import RoomRobot, pressure
from guidefield.robot.model.spaces import ChartPoint
from guidefield.stream.settings import STREAM


def pressure_at(
    robot: RoomRobot, boxes: np.ndarray, z: ChartPoint, near: float = STREAM.near
) -> tuple[float, np.ndarray]:
    """How closely boxes surround a robot, and the gradient of that, shape (nv,).

    Args:
        robot: The robot.
        boxes: Shape (k, 16) [m].
        z: Where it is, shape (nv,).
        near: From where on a box counts [m].
    """
    gradient = np.empty(len(z))
    return float(pressure(robot, boxes, np.ascontiguousarray(z, float), near, gradient)), gradient


def flights(gradient: np.ndarray, speeds: np.ndarray, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Velocities (nv,) down the gradient (nv,) first, then in random directions that lead down as well.

    Args:
        gradient: Of the pressure.
        speeds: Velocity limits, shape (nv,).
        rng: For the directions.
    """
    down = -gradient * speeds
    largest = float(np.abs(down).max())
    directions = [down / largest] if largest > 0.0 else []
    for drawn in rng.normal(size=(STREAM.flights - 1, len(speeds))):
        side = drawn if float(drawn @ gradient) <= 0.0 else -drawn
        directions.append(side / float(np.abs(side).max()))
    for share in STREAM.flight_speeds:
        for direction in directions:
            yield share * direction * speeds
