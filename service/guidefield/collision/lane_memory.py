"""The memory that a world for lanes works in: one piece, in which each array begins where a line of the cache does."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from guidefield.collision.lane_robot import LaneRobot
from guidefield.kept import kept_with
from guidefield.kernels.lane_kinematics import POSE
from guidefield.kernels.lane_tables import AXIS_AND_REACH, BALL, GRID_SIDES, HITS, Scratch
from guidefield.kernels.lane_words import LINE
from guidefield.kernels.lanes import LANES
from guidefield.kernels.packing import Words
from guidefield.kernels.separation import WORK


class LaneMemory(NamedTuple):
    """Where what is in such a memory.

    Attributes:
        size: Whole numbers of 64 bits that it takes.
        offsets: As `lay_out` takes them.
        arrays: Of each array, by its name in `Scratch`, `LaneObstacles` or `LaneWorld`: offset [bytes], type, length.
    """

    size: int
    offsets: Words
    arrays: dict[str, tuple[int, Any, int]]

    def views(self, memory: np.ndarray, begins: int) -> dict[str, np.ndarray]:
        """The arrays by their names.

        Args:
            memory: The memory, shape (size,).
            begins: Where in it the first one is [bytes].
        """
        return {
            name: np.frombuffer(memory, kind, length, begins + offset)
            for name, (offset, kind, length) in self.arrays.items()
        }


@kept_with
def lane_memory(robot: LaneRobot, nv: int, own_pairs: int, obstacles: int) -> LaneMemory:
    """Lay out the memory for a robot among some obstacles.

    Args:
        robot: The robot.
        nv: Its coordinates.
        own_pairs: How many pairs of its bodies must not touch.
        obstacles: How many there are.
    """
    n_poses, met = robot.joints.size * POSE, robot.bodies.size * obstacles
    wanted = {
        "poses": (np.float32, n_poses),
        "block": (np.float32, nv * LANES),
        "centres": (np.float32, robot.bodies.carriers * BALL),
        "places": (np.float32, (GRID_SIDES + 1) * LANES),
        "hits": (np.int64, 3 * HITS),
        "tested": (np.int64, met),
        "found": (np.int64, 3 * (met + own_pairs + 1)),
        "pose_a": (np.float64, 12),
        "pose_b": (np.float64, 12),
        "work": (np.float64, WORK),
        "middle": (np.float32, nv * LANES),
        "middle_poses": (np.float32, n_poses),
        # the axes are one piece
        "obstacle_axes": (np.float64, AXIS_AND_REACH * met),
        "pair_axes": (np.float64, AXIS_AND_REACH * robot.pieces_paired),
    }
    arrays, end = {}, 0
    for name, (kind, length) in wanted.items():
        arrays[name] = (end, kind, length)
        end += -(-np.dtype(kind).itemsize * length // LINE) * LINE
    offsets = [arrays[name][0] for name in ("tested", *Scratch._fields, "block")]
    axes = (arrays["pair_axes"][0] - arrays["obstacle_axes"][0]) // 8 + arrays["pair_axes"][2]
    return LaneMemory((end + LINE) // 8, np.array([*offsets, axes], np.int64), arrays)
