"""What is known of a robot's own bodies all over a cell of the coordinates that they depend on: one verdict a cell."""

from __future__ import annotations

from numba import boolean, int64, types

from guidefield.kernels.collide.balls import ball_radius, placed_ball
from guidefield.kernels.collide.gjk import parts_apart
from guidefield.kernels.collide.gjk_scratch import AXIS, write_axis
from guidefield.kernels.collide.layout import (
    BAND,
    BODIES,
    DIVIDED,
    DRIVER,
    GRID_NUMBERS,
    GRID_PLACES,
    GRID_SIDES,
    LEAST,
    LEVELS,
    MOVED,
    PER_LENGTH,
    SCRATCH_MEMORY,
    SIDE,
    LaneBodies,
    Scratch,
    carriers_of,
    pair_of,
    pairs_of,
)
from guidefield.kernels.collide.parts import POINTED_PARTS, Parts, part_of
from guidefield.kernels.collide.separating_axes import no_axis
from guidefield.kernels.jit.signatures import DOUBLE_POINTER, Floats, Floats32, lane_part, lane_step
from guidefield.kernels.kinematics.batch_forward_kinematics import JOINTS, LaneJoints, lane_placements
from guidefield.kernels.kinematics.poses import one_pose
from guidefield.kernels.simd.vector import LANES, splat, store

UNJUDGED, APART, UNKNOWN, TOUCHING = range(4)
"""What is known of a cell: bodies keep apart wherever in it, they touch wherever in it, or neither is known.

A larger number says that neither is known of the cell as a whole, and where its children are.
"""


@lane_part
def _between(
    balls: Floats32, a: int, pose_a: Floats, others: Floats32, b: int, pose_b: Floats
) -> tuple[float, float, float]:
    """From the middle of a ball of the second body to that of one of the first, which are placed so (12) [m]."""
    x, y, z = placed_ball(pose_a, balls, a)
    u, v, w = placed_ball(pose_b, others, b)
    return x - u, y - v, z - w


@lane_part
def _balls_apart(
    balls: Floats32, a: int, pose_a: Floats, others: Floats32, b: int, pose_b: Floats, margin: float
) -> bool:
    """Whether two balls of bodies that are placed so (12) are farther apart than a margin."""
    x, y, z = _between(balls, a, pose_a, others, b, pose_b)
    reach = ball_radius(balls, a) + ball_radius(others, b) + margin
    return bool(x * x + y * y + z * z > reach * reach)


@lane_part
def _begin_between(balls: Floats32, a: int, pose_a: Floats, b: int, pose_b: Floats, work: Floats) -> None:
    """Let GJK begin with the axis between the middles of two balls of bodies that are placed so (12)."""
    x, y, z = _between(balls, a, pose_a, balls, b, pose_b)
    write_axis(work, x, y, z)


@lane_step(boolean(BODIES, int64, DOUBLE_POINTER, int64, DOUBLE_POINTER, types.float64))
def _reaches_out(bodies: LaneBodies, a: int, pose_a: Floats, b: int, pose_b: Floats, margin: float) -> bool:
    """Whether a ball inside a body has its middle farther than a margin from another body, by that one's cover."""
    first, last = bodies.covers[bodies.groups[b]], bodies.covers[bodies.groups[b + 1]]
    for ball in range(bodies.inners[a], bodies.inners[a + 1]):
        outside = True
        for other in range(first, last):
            reach = margin - ball_radius(bodies.inner, ball)
            if not _balls_apart(bodies.inner, ball, pose_a, bodies.cover, other, pose_b, reach):
                outside = False
                break
        if outside:
            return True
    return False


@lane_step(boolean(BODIES, int64, int64, types.float64, SCRATCH_MEMORY))
def _inner_meet(bodies: LaneBodies, first: int, second: int, depth: float, scratch: Scratch) -> bool:
    """Whether a ball inside each of two bodies, placed by the scratch's poses, lie that deep in each other.

    Neither body may be inside the other: a mesh that swallows another doesn't touch it.
    """
    pose_a, pose_b, inner = scratch.pose_a, scratch.pose_b, bodies.inner
    if _balls_apart(bodies.bounds, first, pose_a, bodies.bounds, second, pose_b, -depth):
        return False
    for a in range(bodies.inners[first], bodies.inners[first + 1]):
        for b in range(bodies.inners[second], bodies.inners[second + 1]):
            if ball_radius(inner, a) + ball_radius(inner, b) <= depth:
                continue
            if not _balls_apart(inner, a, pose_a, inner, b, pose_b, -depth):
                out = _reaches_out(bodies, first, pose_a, second, pose_b, depth)
                return bool(out and _reaches_out(bodies, second, pose_b, first, pose_a, depth))
    return False


@lane_step(boolean(BODIES, POINTED_PARTS, int64, int64, types.float64, SCRATCH_MEMORY))
def _pair_apart(bodies: LaneBodies, parts: Parts, first: int, second: int, margin: float, scratch: Scratch) -> bool:
    """Whether two bodies, placed by the scratch's poses, are farther apart than a margin, by what contains them.

    GJK begins with the axis that the scratch's `work` holds, unless that is 0.
    """
    work, pose_a, pose_b = scratch.work, scratch.pose_a, scratch.pose_b
    pieces, roots = bodies.pieces, bodies.piece_roots
    if _balls_apart(bodies.bounds, first, pose_a, bodies.bounds, second, pose_b, margin):
        return True
    hull_a, hull_b = part_of(parts, bodies.roots[first]), part_of(parts, bodies.roots[second])
    if no_axis(work, AXIS):
        _begin_between(bodies.bounds, first, pose_a, second, pose_b, work)
    if hull_a >= 0 and hull_b >= 0 and parts_apart(parts, hull_a, pose_a, parts, hull_b, pose_b, margin, work):
        return True
    for a in range(pieces[first], pieces[first + 1]):
        for b in range(pieces[second], pieces[second + 1]):
            if _balls_apart(bodies.piece_bounds, a, pose_a, bodies.piece_bounds, b, pose_b, margin):
                continue
            part_a, part_b = part_of(parts, roots[a]), part_of(parts, roots[b])
            _begin_between(bodies.piece_bounds, a, pose_a, b, pose_b, work)
            if part_a < 0 or part_b < 0 or not parts_apart(parts, part_a, pose_a, parts, part_b, pose_b, margin, work):
                return False
    return True


@lane_step(int64(JOINTS, BODIES, POINTED_PARTS, int64, int64, int64, int64, int64, types.float64, SCRATCH_MEMORY))
def judged(
    joints: LaneJoints,
    bodies: LaneBodies,
    parts: Parts,
    meeting: int,
    a: int,
    b: int,
    c: int,
    shift: int,
    besides: float,
    scratch: Scratch,
) -> int:
    """What is known of the bodies of a meeting wherever in a cell of its grid the coordinates are.

    Args:
        joints: The robot's joints.
        bodies: Its bodies.
        parts: Their shapes.
        meeting: Which one.
        a: Index of one of the smallest cells in it along the first coordinate.
        b: Along the second.
        c: Along the third.
        shift: The cell's sides are 2^shift as long as those of the smallest.
        besides: What bodies have to keep besides, or to lie in each other [m], at least `BAND`.
        scratch: Memory.
    """
    grids, numbers, place, at = bodies.grids, bodies.grid_numbers, GRID_PLACES * meeting, GRID_NUMBERS * meeting
    for side in range(GRID_SIDES):
        n, index = at + SIDE * side, a if side == 0 else b if side == 1 else c
        if numbers[n + PER_LENGTH] > 0.0:
            middle = numbers[n + LEAST] + ((index >> shift) + 0.5) * (1 << shift) / numbers[n + PER_LENGTH]
            store(scratch.middle, grids[place + SIDE * side + DRIVER] * LANES, splat(middle))
    lane_placements(joints, scratch.middle, scratch.middle_poses)
    first_carrier, second_carrier = carriers_of(bodies, meeting)
    one_pose(scratch.middle_poses, bodies.carrying[first_carrier], 0, scratch.pose_a)
    one_pose(scratch.middle_poses, bodies.carrying[second_carrier], 0, scratch.pose_b)
    divisions = grids[place + LEVELS] * grids[place + DIVIDED]
    verdict, moved = APART, numbers[at + MOVED] * (1 << shift) / (1 << divisions) + besides
    write_axis(scratch.work, 0.0, 0.0, 0.0)  # the axis between the last bodies that were apart may do for the next
    first_pair, past_pair = pairs_of(bodies, meeting)
    for pair in range(first_pair, past_pair):
        first, second = pair_of(bodies, pair)
        if verdict == APART and _pair_apart(bodies, parts, first, second, moved, scratch):
            continue
        if _inner_meet(bodies, first, second, moved + 2.0 * BAND, scratch):
            return TOUCHING
        verdict = UNKNOWN
    return verdict
