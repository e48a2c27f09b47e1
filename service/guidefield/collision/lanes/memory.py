"""Lay out the memory of a world's scratch and of a scene's primitives in one buffer, arrays on lines of the cache.

Names, order and types of the arrays are those of the kernels' tuples (kernels/collide/layout.py), lengths are set here.
The offsets are in the order in which `lay_out` and `primitive_tables` read them.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np

from guidefield.collision.lanes.robot_tables import LaneRobot
from guidefield.kernels.collide.gjk import WORK
from guidefield.kernels.collide.layout import (
    AXIS_AND_REACH,
    FOUND,
    GRID_SIDES,
    HIT,
    HITS,
    LaneObstacles,
    LaneWorld,
    Scratch,
)
from guidefield.kernels.collide.parts import BALL_ROW, LINK, PART, SHAPE, Parts
from guidefield.kernels.collide.primitive import PRIMITIVE
from guidefield.kernels.collide.primitives_layout import LINE
from guidefield.kernels.jit.arrays import array_types
from guidefield.kernels.kinematics.poses import POSE
from guidefield.kernels.simd.packing import AROUND, BLOCK, Words
from guidefield.kernels.simd.vector_model import LANES
from guidefield.memo import memoized


class BufferLayout(NamedTuple):
    """Offset, type and length of each array in one buffer."""

    size: int  # of the buffer, in words of 64 bits
    offsets: Words  # as kernels take them: `lay_out` those of a world, `primitive_tables` those of a scene
    arrays: dict[str, tuple[int, Any, int]]  # by name: offset [bytes], type, length

    def views(self, memory: np.ndarray, begins: int) -> dict[str, np.ndarray]:
        """The arrays by their names, in a memory (size,) from where the first one begins [bytes]."""
        return {
            name: np.frombuffer(memory, kind, length, begins + offset)
            for name, (offset, kind, length) in self.arrays.items()
        }


@memoized
def scratch_layout(robot: LaneRobot, nv: int, own_pairs: int, obstacles: int) -> BufferLayout:
    """Lay out a world's scratch, configuration block and ignored pairs, for nv coordinates.

    The obstacles themselves are in `obstacle_tables_layout`.
    """
    poses, met = robot.joints.size * POSE, robot.bodies.size * obstacles
    lengths = {
        "poses": poses,
        "block": nv * LANES,
        "centres": robot.bodies.carriers * BLOCK,
        "places": (GRID_SIDES + 1) * LANES,
        "hits": HIT * HITS,
        "ignored": met,
        "found": FOUND * (met + own_pairs),  # each body near each obstacle, and each own pair, once
        "pose_a": 12,
        "pose_b": 12,
        "surface_a": 12,
        "surface_b": 12,
        "work": WORK,
        "middle": nv * LANES,
        "middle_poses": poses,
        "obstacle_axes": AXIS_AND_REACH * met,
        "pair_axes": AXIS_AND_REACH * robot.pieces_paired,
        "obstacle_places": 1 + met,
        "pair_places": 1 + robot.pieces_paired,
    }
    arrays, size = _one_after_another(lengths, LaneObstacles, Scratch, LaneWorld)
    offsets = [arrays[name][0] for name in ("ignored", *Scratch._fields, "block")]
    return BufferLayout(size, np.array(offsets, np.int64), arrays)


def obstacle_tables_layout(primitives: int, obstacles: int) -> BufferLayout:
    """Lay out the memory for the tables of a given number of primitives, with boxes for a given number of obstacles."""
    lengths = {
        "kinds": primitives,
        "whole": primitives,
        "roots": primitives,
        "ignored": 0,
        "primitives": PRIMITIVE * primitives,
        "boxes": -(-obstacles // LANES) * AROUND,
        "clouds": primitives,
        "balls": BALL_ROW * primitives,
        "links": LINK * primitives,
        "shapes": SHAPE * primitives,
        "numbers": PART * primitives,
        "vertices": BLOCK * primitives,
    }
    arrays, size = _one_after_another(lengths, LaneObstacles, Parts)
    offsets = [arrays[name][0] for name in (*LaneObstacles._fields[1:], *Parts._fields)]
    return BufferLayout(size, np.array([obstacles, *offsets], np.int64), arrays)


Arrays = dict[str, tuple[int, Any, int]]


@functools.cache
def _types_in(*layouts: type) -> dict[str, Any]:
    return {name: kind for layout in layouts for name, kind in array_types(layout).items()}


def _one_after_another(lengths: dict[str, int], *layouts: type) -> tuple[Arrays, int]:
    """Lay arrays one behind the other: offset [bytes], type and length of each, and the words of 64 bits of all."""
    kinds, arrays, end = _types_in(*layouts), {}, 0
    for name, length in lengths.items():
        arrays[name] = (end, kinds[name], length)
        end += -(-kinds[name].itemsize * length // LINE) * LINE
    return arrays, (end + LINE) // 8
