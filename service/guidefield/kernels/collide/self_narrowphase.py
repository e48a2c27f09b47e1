"""The exact decision for bodies of the robot that may touch each other: hulls first, then nearly convex pieces."""

from __future__ import annotations

import numpy as np
from numba import boolean, int64

from guidefield.kernels.collide.balls import balls_meet
from guidefield.kernels.collide.gjk import bodies_apart, parts_apart
from guidefield.kernels.collide.gjk_scratch import AXIS
from guidefield.kernels.collide.layout import (
    ALONE,
    AXIS_AND_REACH,
    BAND,
    DECISION_BAND,
    PAIR,
    PAIR_AXES,
    REACH,
    LaneAlone,
    pair_of,
)
from guidefield.kernels.collide.parts import polytope_of
from guidefield.kernels.collide.separating_axes import keep_axis, lowest_ball, lowest_vertex, no_axis
from guidefield.kernels.jit.signatures import lane_step
from guidefield.kernels.kinematics.poses import POSE, column_along, one_pose, turned, turned_axis, write_turned
from guidefield.kernels.simd.vector import LANES, below, first_lane, splat


@lane_step(int64(ALONE, int64, int64, int64, int64, int64, int64))
def _left_of_axis(robot: LaneAlone, joint_a: int, joint_b: int, body_b: int, part_b: int, at: int, mask: int) -> int:
    """The lanes of a mask where an axis that is fixed in the frame of one joint does not separate.

    `part_b` is a polytope about the second body or a piece of it, whose cover is asked first if `body_b` is not -1.
    """
    bodies, parts, scratch = robot.bodies, robot.parts, robot.scratch
    poses, axes = scratch.poses, scratch.pair_axes
    if no_axis(axes, at):
        return mask
    x, y, z = np.float32(axes[at]), np.float32(axes[at + 1]), np.float32(axes[at + 2])
    u, v, w = turned(poses, joint_a, x, y, z)
    lowest = column_along(poses, joint_a * POSE + 3 * LANES, u, v, w) - axes[at + REACH]
    u, v, w, origin = turned_axis(poses, joint_b, -u, -v, -w)
    lowest, enough = lowest + origin, splat(BAND)
    if body_b >= 0:
        mask &= below(lowest_ball(bodies, body_b, u, v, w) + lowest, enough)
    if mask and part_b >= 0:
        mask &= below(lowest_vertex(parts, part_b, u, v, w) + lowest, enough)
    return int(mask)


@lane_step(boolean(ALONE, int64, int64, int64, int64, int64, int64, int64))
def _nodes_meet(
    robot: LaneAlone, root_a: int, joint_a: int, root_b: int, joint_b: int, body_b: int, at: int, mask: int
) -> bool:
    """Tell if what is below two nodes touches in any lane of a mask; as `meets_obstacle`."""
    parts, scratch = robot.parts, robot.scratch
    work, pose_a, pose_b, axes = scratch.work, scratch.pose_a, scratch.pose_b, scratch.pair_axes
    part_b = polytope_of(parts, root_b)
    while True:
        mask = _left_of_axis(robot, joint_a, joint_b, body_b, part_b, at, mask)
        if mask == 0:
            return False
        chosen = first_lane(mask)
        mask &= mask - 1
        one_pose(scratch.poses, joint_a, chosen, pose_a)
        one_pose(scratch.poses, joint_b, chosen, pose_b)
        write_turned(pose_a, axes, at, work, AXIS)
        if not bodies_apart(parts, root_a, pose_a, parts, root_b, pose_b, DECISION_BAND, work):
            return True
        keep_axis(parts, root_a, work, pose_a, -1.0, axes, at, scratch.pair_places)


@lane_step(int64(ALONE, int64, int64, int64, int64))
def _left_of_hulls(robot: LaneAlone, first: int, second: int, at: int, mask: int) -> int:
    """The lanes of a mask where the hulls about two bodies meet, or nearly."""
    bodies, parts, scratch = robot.bodies, robot.parts, robot.scratch
    work, pose_a, pose_b, axes = scratch.work, scratch.pose_a, scratch.pose_b, scratch.pair_axes
    joint_a, joint_b = bodies.joints[first], bodies.joints[second]
    root_a = bodies.roots[first]
    part_a, part_b = polytope_of(parts, root_a), polytope_of(parts, bodies.roots[second])
    left = 0
    while True:
        mask = _left_of_axis(robot, joint_a, joint_b, second, part_b, at, mask)
        if mask == 0 or part_a < 0 or part_b < 0:
            return left | mask
        chosen = first_lane(mask)
        mask &= mask - 1
        one_pose(scratch.poses, joint_a, chosen, pose_a)
        one_pose(scratch.poses, joint_b, chosen, pose_b)
        write_turned(pose_a, axes, at, work, AXIS)
        if parts_apart(parts, part_a, pose_a, parts, part_b, pose_b, DECISION_BAND, work):
            keep_axis(parts, root_a, work, pose_a, -1.0, axes, at, scratch.pair_places)
        else:
            left |= 1 << chosen


@lane_step(boolean(ALONE, int64, int64))
def pair_meets(robot: LaneAlone, pair: int, mask: int) -> bool:
    """Tell if the bodies of a pair touch in any lane of a mask: the hulls first, then piece by piece."""
    bodies, scratch = robot.bodies, robot.scratch
    poses, bounds, pieces, roots = scratch.poses, bodies.piece_bounds, bodies.pieces, bodies.piece_roots
    first, second = pair_of(bodies, pair)
    joint_a, joint_b = bodies.joints[first], bodies.joints[second]
    at = AXIS_AND_REACH * bodies.pairs[PAIR * pair + PAIR_AXES]
    if pieces[first + 1] - pieces[first] == 1 and pieces[second + 1] - pieces[second] == 1:
        root_a, root_b = bodies.roots[first], bodies.roots[second]
        return bool(_nodes_meet(robot, root_a, joint_a, root_b, joint_b, second, at, mask))
    mask = _left_of_hulls(robot, first, second, at, mask)
    if mask == 0:
        return False
    for a in range(pieces[first], pieces[first + 1]):
        for b in range(pieces[second], pieces[second + 1]):
            at += AXIS_AND_REACH
            near = mask & balls_meet(poses, joint_a, a, joint_b, b, bounds, BAND)
            if near and _nodes_meet(robot, roots[a], joint_a, roots[b], joint_b, -1, at, near):
                return True
    return False
