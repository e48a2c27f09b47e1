"""What a way costs among what drifts: when a robot arrives that goes on or waits, and how close it comes."""

from __future__ import annotations

import numpy as np
from numba import float64

from guidefield.kernels.jit.signatures import MATRIX, SCALAR, VECTOR, Floats, compiled
from guidefield.kernels.stream.room import ROOM_ROBOT, RoomRobot, distances

FADING = 1.0
"""What is foreseen for this time from now on counts half [s]: what drifts may turn."""


@compiled(float64(ROOM_ROBOT, MATRIX, MATRIX, VECTOR, VECTOR, MATRIX, SCALAR, SCALAR, SCALAR))
def arrival(
    robot: RoomRobot,
    boxes: Floats,
    drifts: Floats,
    going: Floats,
    waiting: Floats,
    places: Floats,
    step: float,
    horizon: float,
    dear: float,
) -> float:
    """The least cost of going along a way step by step, or waiting, by dynamic programming over places and times.

    Args:
        robot: The robot.
        boxes: What moves, now, shape (k, 16) [m, world].
        drifts: How fast each goes straight on, shape (k, 3) [m/s].
        going: What to keep from each on the move, shape (k,) [m].
        waiting: The same where the robot waits, shape (k,) [m].
        places: The way's points, a time `step` at full speed apart, shape (m, nv).
        step: That time [s].
        horizon: So far obstacles are foreseen [s]; then the rest of the way costs its time.
        dear: What a lack of 1 m for 1 s costs [s].

    Returns:
        Time of arrival and what lacks on the way, together [s].
    """
    count, times = places.shape[0], int(horizon / step) + 1
    costs = np.full(count, np.inf)
    costs[0] = 0.0
    moved, least = boxes.copy(), np.empty(boxes.shape[0])
    cut = 0.0
    for k in range(boxes.shape[0]):
        cut = max(cut, going[k], waiting[k])
    best = np.inf
    for i in range(1, times):
        now = i * step
        for k in range(boxes.shape[0]):
            for r in range(3):
                moved[k, 4 * r + 3] = boxes[k, 4 * r + 3] + now * drifts[k, r]
        price = dear * step / (1.0 + now / FADING)
        for place in range(min(i, count - 1), -1, -1):
            before = costs[place - 1] if place > 0 else np.inf
            if not (before < best or costs[place] < best):
                costs[place] = np.inf
                continue
            distances(robot, moved, places[place], cut, least)
            lacks_going, lacks_waiting = 0.0, 0.0
            for k in range(boxes.shape[0]):
                lacks_going = max(lacks_going, going[k] - least[k])
                lacks_waiting = max(lacks_waiting, waiting[k] - least[k])
            costs[place] = step + min(before + price * lacks_going, costs[place] + price * lacks_waiting)
        best = min(best, costs[count - 1])
    for place in range(count):
        best = min(best, costs[place] + (count - 1 - place) * step)
    return best
