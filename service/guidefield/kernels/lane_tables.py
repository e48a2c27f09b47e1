"""What lane kernels know of a robot's bodies and of obstacles, and the memory that they work in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.lanes import FLOATS, FLOATS_OUT, INTEGERS_OUT, LANES, pointed
from guidefield.kernels.signatures import VECTOR_OUT
from guidefield.kernels.tree_kinematics import INDICES

BAND = 1e-5
"""Within this of contact [m] either answer may come."""

DECISION_BAND = 2e-6
"""What the exact decision keeps of it [m]: more than the error of a placement in float32."""

BALL = 3 * LANES
"""Floats of a ball's centre in sixteen lanes."""


class LaneBodies(NamedTuple):
    """The robot's bodies; lengths [m] in the frame of the joint that carries a body.

    Attributes:
        size: n.
        moving: m.
        n_pairs: p.
        joints: (n,) the joint that carries each.
        covers: (n + 1,) where each body's cover begins in `cover`.
        inners: (n + 1,) where its inner balls begin in `inner`.
        roots: (n,) its root in the robot's parts.
        order: (m,) the bodies that move in the world, in the order in which they are tested: those far out first.
        pairs: (2 * p,) bodies that must not touch each other.
        bounds: (4 * n,) a ball about each.
        cover: (4 * c,) balls that contain the bodies.
        inner: (4 * i,) balls that are inside them.
    """

    size: int
    moving: int
    n_pairs: int
    joints: np.ndarray
    covers: np.ndarray
    inners: np.ndarray
    roots: np.ndarray
    order: np.ndarray
    pairs: np.ndarray
    bounds: np.ndarray
    cover: np.ndarray
    inner: np.ndarray


class LaneObstacles(NamedTuple):
    """Obstacles, in the world [m]; one of many triangles stands as several.

    Attributes:
        size: n.
        kinds: (n,) lane_math's kind of the primitive that contains each.
        whole: (n,) 1 where that primitive is the obstacle itself, else 0.
        roots: (n,) its root in the scene's parts.
        tested: (bodies * n,) 1 where the body must not touch it.
        primitives: (PRIMITIVE * n,) float32.
    """

    size: int
    kinds: np.ndarray
    whole: np.ndarray
    roots: np.ndarray
    tested: np.ndarray
    primitives: np.ndarray


class Scratch(NamedTuple):
    """Memory that a search uses again and again; its contents mean nothing between calls.

    Attributes:
        poses: (joints * POSE,) placements; the world's is written once.
        centres: (cover * BALL,) centres of cover balls.
        placed: (bodies,) whether a body's are up to date.
        found: (3 * (bodies * obstacles + pairs),) what is near what: body, obstacle and mask, or -1, pair and mask.
        obstacle_axes: (3 * bodies * obstacles,) the axis that last separated them, in the world; 0 where there is none.
        pair_axes: (3 * pairs,) the axis that last separated each pair, in the first one's frame; 0 where there is none.
        pose_a, pose_b: (12,) each.
        work: (WORK,).
    """

    poses: np.ndarray
    centres: np.ndarray
    placed: np.ndarray
    found: np.ndarray
    obstacle_axes: np.ndarray
    pair_axes: np.ndarray
    pose_a: np.ndarray
    pose_b: np.ndarray
    work: np.ndarray


LANE_BODIES = types.NamedTuple([*[types.int64] * 3, *[INDICES] * 6, *[FLOATS] * 3], LaneBodies)
LANE_OBSTACLES = types.NamedTuple([types.int64, *[INDICES] * 4, FLOATS], LaneObstacles)
SCRATCH = types.NamedTuple([*[FLOATS_OUT] * 2, *[INTEGERS_OUT] * 2, *[VECTOR_OUT] * 5], Scratch)

BODIES, OBSTACLES, SCRATCH_MEMORY = pointed(LANE_BODIES), pointed(LANE_OBSTACLES), pointed(SCRATCH)
