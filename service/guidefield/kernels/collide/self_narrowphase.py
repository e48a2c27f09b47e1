"""The exact decision for bodies of the robot that may touch each other.

Hulls come first, then nearly convex pieces, and where two of these aren't apart, the bodies themselves.
"""

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
from guidefield.kernels.collide.parts import part_of, polytope_of
from guidefield.kernels.collide.separating_axes import keep_axis, lowest_ball, lowest_vertex, no_axis
from guidefield.kernels.jit.signatures import lane_step
from guidefield.kernels.kinematics.poses import (
    POSE,
    column_along,
    one_pose,
    turned,
    turned_axis,
    write_product,
    write_turned,
)
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


@lane_step(boolean(ALONE, int64, int64))
def _surfaces_meet(robot: LaneAlone, first: int, second: int) -> bool:
    """Tell if two bodies touch where the scratch's poses have their joints."""
    bodies, surfaces, scratch = robot.bodies, robot.surfaces, robot.scratch
    surface_a, surface_b, roots = scratch.surface_a, scratch.surface_b, bodies.surface_roots
    write_product(scratch.pose_a, bodies.surface_frames, 12 * first, surface_a, 0)
    write_product(scratch.pose_b, bodies.surface_frames, 12 * second, surface_b, 0)
    return not bodies_apart(
        surfaces, roots[first], surface_a, surfaces, roots[second], surface_b, DECISION_BAND, scratch.work
    )


@lane_step(int64(ALONE, int64, int64, int64, int64, boolean, int64, int64))
def _pieces_meet(
    robot: LaneAlone, first: int, second: int, root_a: int, root_b: int, whole: bool, at: int, mask: int
) -> int:
    """The lanes of a mask where two bodies are apart although two of their pieces aren't; -1 if they touch in any.

    Each lane that is judged leaves an axis behind, as in `meets_obstacle`.
    """
    bodies, parts, scratch = robot.bodies, robot.parts, robot.scratch
    work, pose_a, pose_b, axes = scratch.work, scratch.pose_a, scratch.pose_b, scratch.pair_axes
    joint_a, joint_b, cleared, covered = bodies.joints[first], bodies.joints[second], 0, second if whole else -1
    part_a, part_b = part_of(parts, root_a), part_of(parts, root_b)
    while True:
        mask = _left_of_axis(robot, joint_a, joint_b, covered, polytope_of(parts, root_b), at, mask)
        if mask == 0:
            return cleared
        chosen = first_lane(mask)
        mask &= mask - 1
        one_pose(scratch.poses, joint_a, chosen, pose_a)
        one_pose(scratch.poses, joint_b, chosen, pose_b)
        write_turned(pose_a, axes, at, work, AXIS)
        if whole or not parts_apart(parts, part_a, pose_a, parts, part_b, pose_b, DECISION_BAND, work):
            if _surfaces_meet(robot, first, second):
                return -1
            cleared |= 1 << chosen
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
    """Tell if the bodies of a pair touch in any lane of a mask."""
    bodies, scratch = robot.bodies, robot.scratch
    poses, bounds, pieces, roots = scratch.poses, bodies.piece_bounds, bodies.pieces, bodies.piece_roots
    first, second = pair_of(bodies, pair)
    joint_a, joint_b = bodies.joints[first], bodies.joints[second]
    at = AXIS_AND_REACH * bodies.pairs[PAIR * pair + PAIR_AXES]
    if pieces[first + 1] - pieces[first] == 1 and pieces[second + 1] - pieces[second] == 1:
        root_a, root_b = bodies.roots[first], bodies.roots[second]
        return bool(_pieces_meet(robot, first, second, root_a, root_b, True, at, mask) < 0)
    mask = _left_of_hulls(robot, first, second, at, mask)
    for a in range(pieces[first], pieces[first + 1]):
        for b in range(pieces[second], pieces[second + 1]):
            at += AXIS_AND_REACH
            near = mask & balls_meet(poses, joint_a, a, joint_b, b, bounds, BAND)
            if near:
                cleared = _pieces_meet(robot, first, second, roots[a], roots[b], False, at, near)
                if cleared < 0:
                    return True
                mask &= ~cleared
    return False
