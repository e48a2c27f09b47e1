"""The memory of a scene or a world for lanes: one piece, in which each array begins where a line of the cache does."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np

from guidefield.collision.lanes.robot_tables import LaneRobot
from guidefield.kept import kept_with
from guidefield.kernels.collide.arena import LINE
from guidefield.kernels.collide.gjk import PART, WORK, Parts
from guidefield.kernels.collide.layout import AXIS_AND_REACH, BALL, GRID_SIDES, HITS, LaneObstacles, Scratch
from guidefield.kernels.collide.primitive import PRIMITIVE
from guidefield.kernels.kinematics.batch_forward_kinematics import POSE
from guidefield.kernels.simd.blocks import AROUND, BLOCK
from guidefield.kernels.simd.packing import Words
from guidefield.kernels.simd.vector_model import LANES


class LaneMemory(NamedTuple):
    """Where what is in such a memory.

    Attributes:
        size: Whole numbers of 64 bits that it takes.
        offsets: As `lay_out` or `primitive_tables` take them.
        arrays: Of each array, by its name in the tuple that it is of: offset [bytes], type, length.
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
        "obstacle_axes": (np.float64, AXIS_AND_REACH * met),
        "pair_axes": (np.float64, AXIS_AND_REACH * robot.pieces_paired),
        "obstacle_places": (np.int64, 1 + met),
        "pair_places": (np.int64, 1 + robot.pieces_paired),
    }
    arrays, size = _one_after_another(wanted)
    offsets = [arrays[name][0] for name in ("tested", *Scratch._fields, "block")]
    return LaneMemory(size, np.array(offsets, np.int64), arrays)


@functools.lru_cache(maxsize=256)
def scene_memory(primitives: int, obstacles: int) -> LaneMemory:
    """Lay out the memory for the tables of so many primitives, with boxes for so many obstacles."""
    arrays, size = _one_after_another(
        {
            "kinds": (np.int64, primitives),
            "whole": (np.int64, primitives),
            "roots": (np.int64, primitives),
            "tested": (np.int64, 0),
            "primitives": (np.float32, PRIMITIVE * primitives),
            "boxes": (np.float32, -(-obstacles // LANES) * AROUND),
            "clouds": (np.int64, primitives),
            "balls": (np.float64, 4 * primitives),
            "links": (np.int64, 3 * primitives),
            "shapes": (np.int64, 3 * primitives),
            "numbers": (np.float64, PART * primitives),
            "vertices": (np.float32, BLOCK * primitives),
        }
    )
    offsets = [arrays[name][0] for name in (*LaneObstacles._fields[1:], *Parts._fields)]
    return LaneMemory(size, np.array([obstacles, *offsets], np.int64), arrays)


Arrays = dict[str, tuple[int, Any, int]]


def _one_after_another(wanted: dict[str, tuple[Any, int]]) -> tuple[Arrays, int]:
    """Offsets [bytes] of arrays of types and lengths, and how many numbers of 64 bits they take."""
    arrays, end = {}, 0
    for name, (kind, length) in wanted.items():
        arrays[name] = (end, kind, length)
        end += -(-np.dtype(kind).itemsize * length // LINE) * LINE
    return arrays, (end + LINE) // 8
