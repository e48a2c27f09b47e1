"""Balls of bodies as rows of numbers, and where they are when a joint moves them."""

from __future__ import annotations

from typing import Any

from guidefield.kernels.jit.signatures import Floats, Floats32, lane_part
from guidefield.kernels.kinematics.poses import moved, placed
from guidefield.kernels.simd.vector import Vector, below, splat

BALL_ROW = 4
"""Numbers of a ball: its centre's x, y, z and its radius [m]."""

RADIUS = 3
"""Place of the radius among them."""


@lane_part
def ball_radius(balls: Any, ball: int) -> Any:
    """Radius of one of some balls, shape (BALL_ROW * n,) [m]."""
    return balls[BALL_ROW * ball + RADIUS]


@lane_part
def ball_centre(poses: Floats32, joint: int, balls: Floats32, ball: int) -> tuple[Vector, Vector, Vector]:
    """Centre of a ball that a joint carries: of `poses`, shape (joints * POSE,), and `balls`, shape (BALL_ROW * n,)."""
    at = BALL_ROW * ball
    return moved(poses, joint, balls[at], balls[at + 1], balls[at + 2])


@lane_part
def placed_ball(pose: Floats, balls: Any, ball: int) -> tuple[float, float, float]:
    """Centre of one of some balls, shape (BALL_ROW * n,), of a body that is placed by a pose (12,) [m]."""
    at = BALL_ROW * ball
    return placed(pose, balls[at], balls[at + 1], balls[at + 2])


@lane_part
def balls_meet(poses: Floats32, joint_a: int, a: int, joint_b: int, b: int, balls: Floats32, margin: float) -> int:
    """Mask of the lanes where two balls that two joints carry are closer than a margin; shapes as for `ball_centre`."""
    x, y, z = ball_centre(poses, joint_a, balls, a)
    u, v, w = ball_centre(poses, joint_b, balls, b)
    x, y, z, reach = x - u, y - v, z - w, ball_radius(balls, a) + ball_radius(balls, b) + margin
    return int(below(x * x + y * y + z * z, splat(reach * reach)))


@lane_part
def lowest_of_ball(balls: Floats32, ball: int, x: Any, y: Any, z: Any) -> Any:
    """The least n.p over the points p of one of some balls, shape (BALL_ROW * n,), for unit axes n = (x, y, z) [m]."""
    at = BALL_ROW * ball
    return x * balls[at] + y * balls[at + 1] + z * balls[at + 2] - balls[at + RADIUS]
