"""Exact decisions if bodies of the robot touch each other, with a cache of verdicts on cells of joint coordinates.

Hulls come first, then nearly convex pieces, and where two of these aren't apart, the bodies themselves. Pairs of joints
whose bodies' distance depends on at most three coordinates have a grid (`collision/batch/cell_grids.py`): a cell is
judged when first met, once for all threads. `never_touching` finds pairs that can't collide at all.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import boolean, int64, types
from numba.extending import intrinsic

from guidefield.kernels.collide.gjk import AXIS, bodies_apart, parts_apart, write_axis
from guidefield.kernels.collide.layout import (
    ALONE,
    AXIS_AND_REACH,
    BAND,
    BODIES,
    CHILDREN,
    COUNT,
    DECISION_BAND,
    DIVIDED,
    GRID_NUMBERS,
    GRID_PLACES,
    GRID_SIDES,
    LEAST,
    LEVELS,
    MOVED,
    PAIR,
    PAIR_AXES,
    PER_LENGTH,
    REACH,
    SIDE,
    SOURCE,
    START,
    STEP,
    TOGETHER,
    WRAPS,
    BatchBodies,
    BatchRobotTables,
    alone_of,
    links_of,
    pair_of,
    pairs_of,
)
from guidefield.kernels.collide.obstacle_narrowphase import keep_axis, lowest_ball, lowest_vertex, no_axis
from guidefield.kernels.collide.parts import ball_radius, balls_meet, part_of, placed_ball, polytope_of
from guidefield.kernels.jit.arrays import (
    DOUBLE_POINTER,
    FLOAT_POINTER,
    INTEGER_POINTER,
    Floats,
    Floats32,
    Indices,
    IndicesOut,
    Integers,
    TruthsOut,
)
from guidefield.kernels.jit.decorators import vector_kernel, vector_part, vector_step
from guidefield.kernels.kinematics.batch_forward_kinematics import batch_placements
from guidefield.kernels.kinematics.poses import (
    POSE,
    column_along,
    one_pose,
    turned,
    turned_axis,
    write_product,
    write_turned,
)
from guidefield.kernels.simd.packing import pointers
from guidefield.kernels.simd.vector import LANES, below, first_lane, largest_of, load, rint, smallest_of, splat, store

UNJUDGED, APART, UNKNOWN, TOUCHING = range(4)
"""Verdicts on a cell: none yet, bodies keep apart wherever in it, neither is known, they touch wherever in it.

`UNJUDGED` is what fresh memory holds, 0. A larger number than these says that neither is known of the cell as a whole,
and where its children are.
"""


@vector_part
def _between(
    balls: Floats32, a: int, pose_a: Floats, others: Floats32, b: int, pose_b: Floats
) -> tuple[float, float, float]:
    """From the middle of a ball of the second body to that of one of the first, which are placed so (12) [m]."""
    x, y, z = placed_ball(pose_a, balls, a)
    u, v, w = placed_ball(pose_b, others, b)
    return x - u, y - v, z - w


@vector_part
def _balls_apart(
    balls: Floats32, a: int, pose_a: Floats, others: Floats32, b: int, pose_b: Floats, margin: float
) -> bool:
    """Tell if two balls of bodies that are placed so (12) are farther apart than a margin."""
    x, y, z = _between(balls, a, pose_a, others, b, pose_b)
    reach = ball_radius(balls, a) + ball_radius(others, b) + margin
    return bool(x * x + y * y + z * z > reach * reach)


@vector_part
def _begin_between(balls: Floats32, a: int, pose_a: Floats, b: int, pose_b: Floats, work: Floats) -> None:
    """Let GJK begin with the axis between the middles of two balls of bodies that are placed so (12)."""
    x, y, z = _between(balls, a, pose_a, balls, b, pose_b)
    write_axis(work, x, y, z)


@vector_step(boolean(BODIES, int64, DOUBLE_POINTER, int64, DOUBLE_POINTER, types.float64))
def _reaches_out(bodies: BatchBodies, a: int, pose_a: Floats, b: int, pose_b: Floats, margin: float) -> bool:
    """Tell if a ball inside a body has its middle farther than a margin from another body, by that one's cover."""
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


@vector_step(boolean(ALONE, int64, int64, types.float64))
def _inner_meet(robot: BatchRobotTables, first: int, second: int, depth: float) -> bool:
    """Tell if a ball inside each of two bodies, placed by the scratch's poses, lie that deep in each other.

    Neither body may be inside the other: a mesh that swallows another doesn't touch it.
    """
    bodies, scratch = robot.bodies, robot.scratch
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


@vector_step(boolean(ALONE, int64, int64, types.float64))
def _pair_apart(robot: BatchRobotTables, first: int, second: int, margin: float) -> bool:
    """Tell if two bodies, placed by the scratch's poses, are farther apart than a margin, by what contains them.

    GJK begins with the axis that the scratch's `work` holds, unless that is 0.
    """
    bodies, parts, scratch = robot.bodies, robot.parts, robot.scratch
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


@vector_step(int64(ALONE, int64, int64, int64, int64, int64, types.float64))
def judge_cell(robot: BatchRobotTables, link_pair: int, a: int, b: int, c: int, shift: int, besides: float) -> int:
    """Return the verdict on the bodies of a link pair wherever in a cell of its grid the coordinates are.

    a, b, c are indices of one of the smallest cells in it, its sides are 2^shift as long; `besides` is what bodies have
    to keep besides, or to lie in each other [m], at least `BAND`.
    """
    joints, bodies, scratch = robot.joints, robot.bodies, robot.scratch
    grids, numbers, place, at = bodies.grids, bodies.grid_numbers, GRID_PLACES * link_pair, GRID_NUMBERS * link_pair
    for side in range(GRID_SIDES):
        n, index = at + SIDE * side, a if side == 0 else b if side == 1 else c
        if numbers[n + PER_LENGTH] > 0.0:
            middle = numbers[n + LEAST] + ((index >> shift) + 0.5) * (1 << shift) / numbers[n + PER_LENGTH]
            store(scratch.middle, grids[place + SIDE * side + SOURCE] * LANES, splat(middle))
    batch_placements(joints, scratch.middle, scratch.middle_poses)
    first_link, second_link = links_of(bodies, link_pair)
    one_pose(scratch.middle_poses, bodies.link_joints[first_link], 0, scratch.pose_a)
    one_pose(scratch.middle_poses, bodies.link_joints[second_link], 0, scratch.pose_b)
    divisions = grids[place + LEVELS] * grids[place + DIVIDED]
    verdict, moved = APART, numbers[at + MOVED] * (1 << shift) / (1 << divisions) + besides
    write_axis(scratch.work, 0.0, 0.0, 0.0)  # the axis between the last bodies that were apart may do for the next
    first_pair, past_pair = pairs_of(bodies, link_pair)
    for pair in range(first_pair, past_pair):
        first, second = pair_of(bodies, pair)
        if verdict == APART and _pair_apart(robot, first, second, moved):
            continue
        if _inner_meet(robot, first, second, moved + 2.0 * BAND):
            return TOUCHING
        verdict = UNKNOWN
    return verdict


_TURN = 6.283185307179586


@vector_step(int64(ALONE, int64, int64, int64, int64, int64))
def _judge_largest(robot: BatchRobotTables, link_pair: int, a: int, b: int, c: int, shift: int) -> int:
    """Judge one of a grid's largest cells when it is met first: as many of them together, or by itself."""
    bodies = robot.bodies
    grids, cells, place = bodies.grids, bodies.cells, GRID_PLACES * link_pair
    larger, at = shift + grids[place + DIVIDED], 0
    for side in range(GRID_SIDES):
        index = a if side == 0 else b if side == 1 else c
        at = at * ((grids[place + SIDE * side + COUNT] - 1 >> larger) + 1) + (index >> larger)
    at += grids[place + TOGETHER]
    if cells[at] == UNJUDGED:
        cells[at] = judge_cell(robot, link_pair, a, b, c, larger, BAND)
    known = int(cells[at])
    return known if known != UNKNOWN else judge_cell(robot, link_pair, a, b, c, shift, BAND)


@intrinsic
def _add_atomically(typing: Any, numbers: Any, amount: Any) -> Any:  # noqa: ARG001 - numba's
    """Add to the first of some int32 at once for all threads; what it was before."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:  # noqa: ARG001 - numba's
        more = builder.trunc(args[1], ir.IntType(32))
        return builder.sext(builder.atomic_rmw("add", args[0], more, "seq_cst"), ir.IntType(64))

    return types.int64(types.CPointer(types.int32), types.int64), generate


@vector_part
def _claim(cells: Any, amount: int, size: int) -> int:
    """Return the first of `amount` numbers of cells (size,) that no thread has; -1 if there aren't that many left.

    The first number of `cells` says from where on they are free.
    """
    if cells[0] + amount > size:
        return -1
    first = _add_atomically(cells, amount)
    return first if first + amount <= size else -1


@vector_part
def _find_verdict(robot: BatchRobotTables, link_pair: int, chosen: int) -> int:
    """Return the verdict on a link pair's bodies at a lane's configuration, by the smallest cell that is needed."""
    bodies, scratch = robot.bodies, robot.scratch
    grids, cells, places, place = bodies.grids, bodies.cells, scratch.places, GRID_PLACES * link_pair
    a, b, c = int(places[chosen]), int(places[LANES + chosen]), int(places[2 * LANES + chosen])
    divided, largest = grids[place + DIVIDED], grids[place + START] + int(places[GRID_SIDES * LANES + chosen])
    shift, last, at = divided * grids[place + LEVELS], (1 << divided) - 1, largest
    while True:
        known = int(cells[at])
        if known == UNJUDGED:
            if at == largest:
                known = _judge_largest(robot, link_pair, a, b, c, shift)
            else:
                known = judge_cell(robot, link_pair, a, b, c, shift, BAND)
            if known == UNKNOWN and shift > 0:
                known = max(UNKNOWN, _claim(cells, CHILDREN, bodies.n_cells))
            cells[at] = known
        if known <= TOUCHING:
            if known == APART and at == largest:
                # a bit that another thread sets at the same time may be lost: it is set when the cell is asked again
                bodies.apart[at >> 5] |= np.uint32(1) << np.uint32(at & 31)
            return known
        shift -= divided
        at = known + grids[place + STEP] * (a >> shift & last)
        at += grids[place + SIDE + STEP] * (b >> shift & last) + grids[place + 2 * SIDE + STEP] * (c >> shift & last)


@vector_part
def _apart_by_largest(apart: Any, start: int, places: Floats32) -> int:
    """The lanes whose largest cell keeps the bodies apart; without a branch, as most of the time is spent on memory."""
    mask = 0
    for k in range(LANES):
        cell = start + int(places[GRID_SIDES * LANES + k])
        mask |= (int(apart[cell >> 5]) >> (cell & 31) & 1) << k
    return mask


@vector_step(int64(ALONE, int64, int64, FLOAT_POINTER))
def left_of_cells(robot: BatchRobotTables, link_pair: int, mask: int, coordinates: Floats32) -> int:
    """The lanes of a mask where nothing is known of a link pair's bodies by their cells, -1 if they touch in any.

    `coordinates` are a world's block.
    """
    bodies, scratch = robot.bodies, robot.scratch
    grids, numbers, places = bodies.grids, bodies.grid_numbers, scratch.places
    place, at, cells, inside = GRID_PLACES * link_pair, GRID_NUMBERS * link_pair, splat(0.0), mask
    if grids[place + COUNT] == 0:
        return mask
    divisions = 1 << grids[place + LEVELS] * grids[place + DIVIDED]
    share, down = 1.0 / divisions, 0.5 / divisions - 0.5
    for side in range(GRID_SIDES):
        count, n = float(grids[place + SIDE * side + COUNT]), at + SIDE * side
        value = load(coordinates, grids[place + SIDE * side + SOURCE] * LANES)
        along = (value - rint(value * numbers[n + WRAPS]) * _TURN - numbers[n + LEAST]) * numbers[n + PER_LENGTH]
        inside &= below(along, splat(count)) & ~below(along, splat(0.0))
        index = smallest_of(largest_of(rint(along - 0.5), splat(0.0)), splat(count - 1.0))
        store(places, side * LANES, index)
        cells = cells * (count * share) + rint(index * share + down)
    store(places, GRID_SIDES * LANES, cells)
    left, mask = mask & ~inside, inside & ~_apart_by_largest(bodies.apart, grids[place + START], places)
    while mask:
        chosen = first_lane(mask)
        mask &= mask - 1
        known = _find_verdict(robot, link_pair, chosen)
        if known == TOUCHING:
            return -1
        if known != APART:
            left |= 1 << chosen
    return left


BEYOND = 1e-3  # bodies that keep this aren't tested again [m]: joints may be a little beyond limits; it may only grow

CELL = GRID_SIDES + 1
"""Numbers of a cell that waits to be judged: the indices of its first smallest cell, the logarithm of its sides."""


@vector_step(boolean(ALONE, int64, int64, INTEGER_POINTER))
def _is_always_apart(robot: BatchRobotTables, link_pair: int, most: int, stack: Integers) -> bool:
    """Tell if a link pair's bodies keep apart in all of its grid, as far as its cells tell; others are halved."""
    grids, place = robot.bodies.grids, GRID_PLACES * link_pair
    largest, longest = grids[place + LEVELS] * grids[place + DIVIDED], 0
    for side in range(GRID_SIDES):
        while 1 << longest < grids[place + SIDE * side + COUNT]:
            longest += 1
    stack[0], stack[1], stack[2], stack[3] = 0, 0, 0, longest
    top = 1
    while top > 0:
        top -= 1
        a, b, c, shift = stack[CELL * top], stack[CELL * top + 1], stack[CELL * top + 2], stack[CELL * top + 3]
        most -= 1
        known = judge_cell(robot, link_pair, a, b, c, shift, BEYOND)
        if known == APART:
            continue
        if known == TOUCHING or most <= 0 or shift <= largest:
            return False
        half = 1 << shift - 1
        for child in range(1 << GRID_SIDES):
            u, v, w = a + half * (child & 1), b + half * (child >> 1 & 1), c + half * (child >> 2)
            inside = u < grids[place + COUNT] and v < grids[place + SIDE + COUNT]
            if inside and w < grids[place + 2 * SIDE + COUNT]:
                at = CELL * top
                stack[at], stack[at + 1], stack[at + 2], stack[at + 3] = u, v, w, shift - 1
                top += 1
    return True


STACK = CELL * 256  # numbers of the memory for cells that wait: fewer than 8 more of each size


@vector_kernel
def never_touching(words: Indices, most: int, stack: IndicesOut, never_out: TruthsOut) -> None:
    """Write for each link pair if its bodies are known to keep apart wherever their coordinates are within limits.

    Args:
        words: A packed `BatchRobotTables`.
        most: Cells judged for each link pair at most, divided by its number of pairs.
        stack: Memory, shape (STACK,).
        never_out: Shape (n_link_pairs,).
    """
    robot = alone_of(pointers(words))
    for link_pair in range(len(never_out)):
        first, past = pairs_of(robot.bodies, link_pair)
        gridded = robot.bodies.grids[GRID_PLACES * link_pair + COUNT] > 0
        never_out[link_pair] = gridded and _is_always_apart(robot, link_pair, most // (past - first), pointers(stack))


@vector_step(int64(ALONE, int64, int64, int64, int64, int64, int64))
def _left_of_axis(
    robot: BatchRobotTables, joint_a: int, joint_b: int, body_b: int, part_b: int, at: int, mask: int
) -> int:
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


@vector_step(boolean(ALONE, int64, int64))
def _surfaces_meet(robot: BatchRobotTables, first: int, second: int) -> bool:
    """Tell if two bodies touch where the scratch's poses have their joints."""
    bodies, surfaces, scratch = robot.bodies, robot.surfaces, robot.scratch
    surface_a, surface_b, roots = scratch.surface_a, scratch.surface_b, bodies.surface_roots
    write_product(scratch.pose_a, bodies.surface_frames, 12 * first, surface_a, 0)
    write_product(scratch.pose_b, bodies.surface_frames, 12 * second, surface_b, 0)
    return not bodies_apart(
        surfaces, roots[first], surface_a, surfaces, roots[second], surface_b, DECISION_BAND, scratch.work
    )


@vector_step(int64(ALONE, int64, int64, int64, int64, boolean, int64, int64))
def _pieces_meet(
    robot: BatchRobotTables, first: int, second: int, root_a: int, root_b: int, whole: bool, at: int, mask: int
) -> int:
    """The lanes of a mask where two bodies are apart although two of their pieces aren't; -1 if they touch in any.

    Each lane that is judged leaves an axis behind, which mostly separates the others too.
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


@vector_step(int64(ALONE, int64, int64, int64, int64))
def _left_of_hulls(robot: BatchRobotTables, first: int, second: int, at: int, mask: int) -> int:
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


@vector_step(boolean(ALONE, int64, int64))
def pair_meets(robot: BatchRobotTables, pair: int, mask: int) -> bool:
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
