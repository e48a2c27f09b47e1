"""A robot's tables for lanes without what never touches."""

from __future__ import annotations

import dataclasses

import numpy as np

from guidefield.collision.lanes.memory import lane_memory
from guidefield.collision.lanes.robot_tables import LaneRobot
from guidefield.kernels.collide.layout import GRID_NUMBERS, GRID_PLACES, MEETING, PAIR, Scratch
from guidefield.kernels.collide.never_colliding import STACK, LaneAlone, never_touching
from guidefield.kernels.simd.packing import packed

MOST = 2000
"""Cells of a grid that are judged: a millisecond or two."""


def without_never_touching(robot: LaneRobot, nv: int) -> LaneRobot:
    """The same robot without the meetings whose bodies keep apart wherever their coordinates are within their limits.

    A robot's description rarely says of all pairs that can't touch that they can't.

    Args:
        robot: The robot.
        nv: Its coordinates.
    """
    bodies = robot.bodies
    layout = lane_memory(robot, nv, len(bodies.pairs) // PAIR, 0)
    views = layout.views(np.zeros(layout.size, np.int64), 0)
    alone = LaneAlone(robot.joints, bodies, robot.parts, Scratch(**{name: views[name] for name in Scratch._fields}))
    never = np.zeros(bodies.n_meetings, np.bool_)
    never_touching(packed(alone), MOST, np.zeros(STACK, np.int64), never)
    meetings = bodies.meetings.reshape(-1, MEETING)[~never].ravel()
    grids = bodies.grids.reshape(-1, GRID_PLACES)[~never].ravel()
    numbers = bodies.grid_numbers.reshape(-1, GRID_NUMBERS)[~never].ravel()
    for array in (meetings, grids, numbers):
        array.setflags(write=False)
    left = bodies._replace(n_meetings=len(meetings) // MEETING, meetings=meetings, grids=grids, grid_numbers=numbers)
    return dataclasses.replace(robot, bodies=left)
