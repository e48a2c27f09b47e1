"""Exact decisions if bodies touch obstacles or clouds: each lane's separating axis is tried on all others.

Before GJK each lane has an axis of its own, away from the obstacle's point nearest to the middle of the body. The last
axis of body and obstacle stays in the scratch, where the next question begins, with one body's reach along it: what is
beyond counts as apart, so that a reach may be too large, not too small. Axes of the robot's own pairs are kept alike
(`self_narrowphase`).

Which axes are tried and kept is a matter of speed, but within `BAND` of contact of the answer, too: a search begins
with none (`batch_collision.forget`), so that it repeats to the bit. What they separate by, `BAND` in float32 and
`DECISION_BAND` in GJK, is what `collision/batch/batch_collision.py` promises, so that neither may shrink.
"""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, float64, int64, types

from guidefield.kernels.collide.gjk import (
    AXIS,
    KEPT,
    axis_in,
    axis_length,
    bodies_apart,
    divide_axis,
    reach_along,
    write_axis,
)
from guidefield.kernels.collide.layout import (
    AXIS_AND_REACH,
    BAND,
    BODIES,
    DECISION_BAND,
    OBSTACLES,
    REACH,
    WORLD,
    BatchBodies,
    BatchObstacles,
    BatchWorld,
    axis_place,
)
from guidefield.kernels.collide.parts import (
    BLOCKS,
    FIRST_BLOCK,
    POINTED_PARTS,
    SHAPE,
    SURFACE,
    Parts,
    X,
    Y,
    Z,
    ball_centre,
    ball_radius,
    kind_of,
    lowest_of_ball,
    part_of,
    placed_ball,
    polytope_of,
)
from guidefield.kernels.collide.primitive import PRIMITIVE, away_from_primitive, near_primitive
from guidefield.kernels.distance.point_tree import (
    CLOUD_TABLES,
    RADIUS,
    BatchCloud,
    cloud_of,
    next_block,
    point_gaps,
    words_at,
)
from guidefield.kernels.jit.arrays import DOUBLE_POINTER, Floats, Floats32, Integers
from guidefield.kernels.jit.decorators import vector_part, vector_step
from guidefield.kernels.kinematics.poses import (
    apply_pose,
    one_pose,
    turned_axis,
    turned_back,
    write_identity,
    write_product,
)
from guidefield.kernels.simd.packing import BLOCK, point_at, points_at
from guidefield.kernels.simd.vector import LANES, Vector, below, f32x16, first_lane, lane, root, smallest_of, splat


@vector_step(f32x16(POINTED_PARTS, int64, f32x16, f32x16, f32x16))
def lowest_vertex(parts: Parts, part: int, x: Vector, y: Vector, z: Vector) -> Vector:
    """The least n.v over the vertices v of a polytope, for an axis n = (x, y, z) in its frame."""
    vertices, first, lowest = parts.vertices, parts.shapes[SHAPE * part + FIRST_BLOCK], splat(1e30)
    for block in range(first, first + parts.shapes[SHAPE * part + BLOCKS]):
        for corner in range(block * BLOCK, block * BLOCK + LANES):
            along = x * vertices[corner] + y * vertices[corner + LANES] + z * vertices[corner + 2 * LANES]
            lowest = smallest_of(lowest, along)
    return lowest


@vector_part
def kept_beyond(
    parts: Parts, part: int, poses: Floats32, joint: int, u: Vector, v: Vector, w: Vector, reach: Vector, margin: float
) -> int:
    """Return the lanes where not all of a polytope is farther along axes than something reaches, by a margin [m].

    `poses` (joints * POSE,) place it; the world axes (u, v, w) have any length, `reach` is times that; where they are
    0, nothing is farther.
    """
    enough = reach + root(u * u + v * v + w * w) * margin + 1e-30  # more than 0, so that no axis separates nothing
    x, y, z, origin = turned_axis(poses, joint, u, v, w)
    return int(below(lowest_vertex(parts, part, x, y, z) + origin, enough))


@vector_part
def lowest_ball(bodies: BatchBodies, body: int, x: Vector, y: Vector, z: Vector) -> Vector:
    """The least n.x over the points x of a body's cover, for an axis n = (x, y, z) in its joint's frame."""
    cover, lowest = bodies.cover, splat(1e30)
    for ball in range(bodies.covers[bodies.groups[body]], bodies.covers[bodies.groups[body + 1]]):
        along = lowest_of_ball(cover, ball, x, y, z)
        lowest = smallest_of(lowest, along)
    return lowest


@vector_part
def no_axis(axes: Floats, at: int) -> bool:
    """Tell if there is no axis at a place among numbers, shape (n,): all three are 0."""
    return bool(axes[at] == 0.0 and axes[at + 1] == 0.0 and axes[at + 2] == 0.0)


@vector_part
def _note(axes: Floats, at: int, places: Integers) -> None:
    """Note the place of an axis that will be kept, if there was none; the first of `places` says how many follow it."""
    if no_axis(axes, at):
        places[0] += 1
        places[places[0]] = at


@vector_part
def keep_direction(work: Floats, axes: Floats, at: int, places: Integers) -> None:
    """Keep the axis in the scratch space, shape (WORK,), if there is one, as it is; the rest as for `keep_axis`."""
    if not no_axis(work, AXIS):
        _note(axes, at, places)
        for k in range(3):
            axes[at + k] = work[AXIS + k]


@vector_part
def forget_axes(axes: Floats, places: Integers) -> None:
    """Forget all of some axes (AXIS_AND_REACH * n,), by their places (1 + n,): a search mostly keeps few of many."""
    for k in range(1, places[0] + 1):
        for number in range(AXIS_AND_REACH):
            axes[places[k] + number] = 0.0
    places[0] = 0


@vector_part
def write_separating(parts: Parts, root: int, work: Floats, pose: Floats, way: float, axes: Floats, at: int) -> None:
    """Write the axis that separated, of length 1 and in the frame of a pose (12,), and a body's reach along it [m].

    The world axis stands in `work` (WORK,); `way` is 1 for how far the body of `root` reaches along it, -1 for how far
    against it. `axes` (n,) gets axis and reach, from `at` on; where the root has no part, the reach is infinite.
    """
    divide_axis(work, max(axis_length(work), 1e-30))
    x, y, z = axis_in(work)
    axes[at], axes[at + 1], axes[at + 2] = turned_back(pose, x, y, z)
    part = part_of(parts, root)
    axes[at + REACH] = np.inf
    if part >= 0:
        axes[at + REACH] = reach_along(parts, part, work, way * axes[at], way * axes[at + 1], way * axes[at + 2])


@vector_part
def keep_axis(
    parts: Parts, root: int, work: Floats, pose: Floats, way: float, axes: Floats, at: int, places: Integers
) -> None:
    """`write_separating` into the store, (AXIS_AND_REACH * n,), if there is an axis, and note where: (1 + n,)."""
    if not no_axis(work, AXIS):
        _note(axes, at, places)
        write_separating(parts, root, work, pose, way, axes, at)


@vector_part
def _near_piece(
    world: BatchWorld, piece: int, joint: int, o: int, clearance: float
) -> tuple[int, Vector, Vector, Vector]:
    """Mask of the lanes where the ball about a piece meets the obstacle's primitive; the ball's middle."""
    bodies, obstacles, scratch = world.bodies, world.obstacles, world.scratch
    x, y, z = ball_centre(scratch.poses, joint, bodies.piece_bounds, piece)
    reach = ball_radius(bodies.piece_bounds, piece) + clearance + BAND
    return near_primitive(obstacles.kinds[o], obstacles.primitives, o * PRIMITIVE, x, y, z, reach), x, y, z


@vector_step(boolean(POINTED_PARTS, int64, DOUBLE_POINTER, OBSTACLES, int64, types.float64))
def _surface_meets(parts: Parts, part: int, pose: Floats, obstacles: BatchObstacles, o: int, reach: float) -> bool:
    """Tell if any of the points of a part, of a body that is placed so (12), are nearer to a primitive than `reach`."""
    vertices, first = parts.vertices, parts.shapes[SHAPE * part + FIRST_BLOCK]
    for block in range(first, first + parts.shapes[SHAPE * part + BLOCKS]):
        x, y, z = points_at(vertices, block * BLOCK)
        u, v, w = apply_pose(pose, x, y, z)
        if near_primitive(obstacles.kinds[o], obstacles.primitives, o * PRIMITIVE, u, v, w, reach):
            return True
    return False


@vector_step(boolean(WORLD, int64, int64, int64, types.float64))
def _points_meet(world: BatchWorld, body: int, o: int, mask: int, clearance: float) -> bool:
    """Tell if a point of a body's surface is in an obstacle, which is a primitive, in any lane of a mask."""
    bodies, parts, obstacles, scratch = world.bodies, world.parts, world.obstacles, world.scratch
    joint = bodies.joints[body]
    for piece in range(bodies.pieces[body], bodies.pieces[body + 1]):
        points = polytope_of(parts, bodies.piece_roots[piece]) + 1
        if points == 0 or kind_of(parts, points) != SURFACE:
            continue
        near, _, _, _ = _near_piece(world, piece, joint, o, clearance)
        near &= mask
        while near:
            one_pose(scratch.poses, joint, first_lane(near), scratch.pose_a)
            near &= near - 1
            if _surface_meets(parts, points, scratch.pose_a, obstacles, o, clearance + DECISION_BAND):
                return True
    return False


@vector_step(boolean(WORLD, int64, DOUBLE_POINTER, int64, DOUBLE_POINTER, types.float64))
def _surface_apart(world: BatchWorld, body: int, pose: Floats, root: int, there: Floats, margin: float) -> bool:
    """Tell if a body whose joint is placed so (12) is farther than a margin from what is below a node of the scene."""
    bodies, scratch = world.bodies, world.scratch
    write_product(pose, bodies.surface_frames, 12 * body, scratch.surface_a, 0)
    return bool(
        bodies_apart(
            world.surfaces, bodies.surface_roots[body], scratch.surface_a, world.scene, root, there, margin,
            scratch.work,
        )
    )  # fmt: skip


@vector_step(boolean(WORLD, int64, int64, int64, types.float64))
def pieces_meet(world: BatchWorld, body: int, o: int, mask: int, clearance: float) -> bool:
    """Tell if any piece of a body touches an obstacle, no cloud, in any lane of a mask.

    The scratch's `pose_b` has to be the identity.
    """
    bodies, parts, obstacles, scene, scratch = world.bodies, world.parts, world.obstacles, world.scene, world.scratch
    if obstacles.whole[o] and _points_meet(world, body, o, mask, clearance):
        return True
    work, pose, pose_b, poses = scratch.work, scratch.pose_a, scratch.pose_b, scratch.poses
    joint, root, margin = bodies.joints[body], obstacles.roots[o], clearance + DECISION_BAND
    for piece in range(bodies.pieces[body], bodies.pieces[body + 1]):
        near, x, y, z = _near_piece(world, piece, joint, o, clearance)
        near &= mask
        if near == 0:
            continue
        u, v, w, reach = away_from_primitive(obstacles.kinds[o], obstacles.primitives, o * PRIMITIVE, x, y, z)
        own = bodies.piece_roots[piece]
        part = polytope_of(parts, own)
        if part >= 0:
            near &= kept_beyond(parts, part, poses, joint, u, v, w, reach, clearance + BAND)
        while near:
            chosen = first_lane(near)
            near &= near - 1
            one_pose(poses, joint, chosen, pose)
            write_axis(work, lane(u, chosen), lane(v, chosen), lane(w, chosen))
            if not bodies_apart(parts, own, pose, scene, root, pose_b, margin, work):
                if not _surface_apart(world, body, pose, root, pose_b, margin):
                    return True
                mask &= ~(1 << chosen)
            if near and part >= 0:  # the axis that it left behind
                write_separating(scene, root, work, pose_b, 1.0, work, KEPT)
                a, b, c = splat(work[KEPT]), splat(work[KEPT + 1]), splat(work[KEPT + 2])
                far = splat(work[KEPT + REACH])
                near &= kept_beyond(parts, part, poses, joint, a, b, c, far, clearance + BAND)
    return False


@vector_step(int64(WORLD, int64, int64, int64, types.float64, boolean))
def left_of_obstacle(world: BatchWorld, body: int, obstacle: int, mask: int, clearance: float, closely: bool) -> int:
    """Return the lanes of a mask where the last axis that separated body and obstacle, fixed in the world, does not.

    By the balls of the body's cover; `closely` also by the vertices of its hull.
    """
    bodies, parts, obstacles, scratch = world.bodies, world.parts, world.obstacles, world.scratch
    axes, at = scratch.obstacle_axes, axis_place(obstacles, body, obstacle)
    if no_axis(axes, at):
        return mask
    x, y, z = axes[at], axes[at + 1], axes[at + 2]
    enough = splat(axes[at + REACH] + clearance + BAND)
    u, v, w, origin = turned_axis(scratch.poses, bodies.joints[body], splat(x), splat(y), splat(z))
    left = mask & below(lowest_ball(bodies, body, u, v, w) + origin, enough)
    part = polytope_of(parts, bodies.roots[body])
    if closely and left and part >= 0:
        left &= below(lowest_vertex(parts, part, u, v, w) + origin, enough)
    return int(left)


@vector_step(boolean(WORLD, int64, int64, int64, types.float64))
def meets_obstacle(world: BatchWorld, body: int, obstacle: int, mask: int, clearance: float) -> bool:
    """Tell if a body touches an obstacle in any lane of a mask.

    Each lane that is judged leaves an axis behind, which mostly separates the others too.
    """
    bodies, parts, obstacles, scene, scratch = world.bodies, world.parts, world.obstacles, world.scene, world.scratch
    work, pose_a, pose_b, axes = scratch.work, scratch.pose_a, scratch.pose_b, scratch.obstacle_axes
    at, margin = axis_place(obstacles, body, obstacle), clearance + DECISION_BAND
    own, root, joint = bodies.roots[body], obstacles.roots[obstacle], bodies.joints[body]
    mask = left_of_obstacle(world, body, obstacle, mask, clearance, True)
    if mask == 0:
        return False
    write_identity(pose_b)
    hull = polytope_of(parts, own)
    if hull >= 0:
        kind, primitives = obstacles.kinds[obstacle], obstacles.primitives
        x, y, z = ball_centre(scratch.poses, joint, bodies.bounds, body)
        u, v, w, reach = away_from_primitive(kind, primitives, obstacle * PRIMITIVE, x, y, z)
        apart = mask & ~kept_beyond(parts, hull, scratch.poses, joint, u, v, w, reach, clearance + BAND)
        if apart:
            chosen = first_lane(apart)
            write_axis(work, lane(u, chosen), lane(v, chosen), lane(w, chosen))
            keep_axis(scene, root, work, pose_b, 1.0, axes, at, scratch.obstacle_places)
            mask &= ~apart
            if mask == 0:
                return False
    if bodies.pieces[body + 1] - bodies.pieces[body] > 1:
        return bool(pieces_meet(world, body, obstacle, mask, clearance))
    while mask:
        one_pose(scratch.poses, joint, first_lane(mask), pose_a)
        mask &= mask - 1
        write_axis(work, axes[at], axes[at + 1], axes[at + 2])
        if not _surface_apart(world, body, pose_a, root, pose_b, margin):
            return True
        keep_axis(scene, root, work, pose_b, 1.0, axes, at, scratch.obstacle_places)
        mask = left_of_obstacle(world, body, obstacle, mask, clearance, True)
    return False


@vector_step(float64(WORLD, int64, DOUBLE_POINTER, DOUBLE_POINTER))
def _lowest(world: BatchWorld, body: int, pose: Floats, work: Floats) -> float:
    """The least n.x over the points x of a body in a pose, for the axis n in the scratch space [m]."""
    bodies, parts = world.bodies, world.parts
    x, y, z = axis_in(work)
    u, v, w = turned_back(pose, x, y, z)
    origin = x * pose[3] + y * pose[7] + z * pose[11]
    part = part_of(parts, bodies.roots[body])
    if part >= 0:
        return float(origin - reach_along(parts, part, work, -u, -v, -w))
    cover, lowest = bodies.cover, math.inf
    for ball in range(bodies.covers[bodies.groups[body]], bodies.covers[bodies.groups[body + 1]]):
        along = lowest_of_ball(cover, ball, u, v, w)
        lowest = min(lowest, along)
    return float(origin + lowest)


@vector_part
def _beyond(cloud: BatchCloud, block: int, work: Floats, lowest: float, grown: float) -> int:
    """Mask of sixteen points that the axis in the scratch space doesn't keep apart from a body."""
    u, v, w = points_at(cloud.points, block * BLOCK)
    x, y, z = axis_in(work)
    along = u * x + v * y + w * z
    return int(below(splat(lowest - grown), along))


@vector_step(int64(BODIES, int64, DOUBLE_POINTER, CLOUD_TABLES, int64, float64, int64))
def _in_cover(
    bodies: BatchBodies, group: int, pose: Floats, cloud: BatchCloud, block: int, grown: float, near: int
) -> int:
    """The points of some of sixteen that are within `grown` of a ball in a group of a body's cover."""
    cover, mask = bodies.cover, 0
    for ball in range(bodies.covers[group], bodies.covers[group + 1]):
        x, y, z = placed_ball(pose, cover, ball)
        reach = ball_radius(cover, ball) + grown
        mask |= below(point_gaps(cloud.points, block, x, y, z), splat(reach * reach))
        if mask & near == near:
            break
    return int(mask & near)


@vector_step(boolean(WORLD, int64, DOUBLE_POINTER, CLOUD_TABLES, int64, float64))
def _pose_meets(world: BatchWorld, body: int, pose: Floats, cloud: BatchCloud, root: int, clearance: float) -> bool:
    """Tell if a body in a pose touches a ball of a cloud; the search begins with the axis in the scratch space."""
    bodies, scratch = world.bodies, world.scratch
    work, there, grouped = scratch.work, scratch.pose_b, bodies.grouped
    grown = cloud.numbers[RADIUS] + clearance + BAND
    known = not no_axis(work, AXIS)
    lowest = _lowest(world, body, pose, work) if known else 0.0
    for group in range(bodies.groups[body], bodies.groups[body + 1]):
        x, y, z = placed_ball(pose, grouped, group)
        reach, block = ball_radius(grouped, group) + grown, -1
        while True:
            block = next_block(cloud, block, x, y, z, reach)
            if block < 0:
                break
            left = below(point_gaps(cloud.points, block, x, y, z), splat(reach * reach))
            if known:
                left &= _beyond(cloud, block, work, lowest, grown)
            if left:
                left = _in_cover(bodies, group, pose, cloud, block, grown, left)
            while left:
                at = block * BLOCK + first_lane(left)
                left &= left - 1
                there[X], there[Y], there[Z] = point_at(cloud.points, at)
                margin = clearance + DECISION_BAND
                if not _surface_apart(world, body, pose, root, there, margin):
                    return True
                length = axis_length(work)
                known = length > 1e-15
                if known:
                    divide_axis(work, length)
                    lowest = _lowest(world, body, pose, work)
                    left &= _beyond(cloud, block, work, lowest, grown)
    return False


@vector_step(boolean(WORLD, int64, int64, int64, types.float64))
def meets_cloud(world: BatchWorld, body: int, obstacle: int, mask: int, clearance: float) -> bool:
    """Tell if a body touches a cloud in any lane of a mask.

    The axis that kept a ball apart last is where the next decision about body and cloud begins.
    """
    bodies, obstacles, scratch = world.bodies, world.obstacles, world.scratch
    work, pose, axes = scratch.work, scratch.pose_a, scratch.obstacle_axes
    at, cloud = axis_place(obstacles, body, obstacle), cloud_of(words_at(obstacles.clouds[obstacle]))
    write_identity(scratch.pose_b)
    write_axis(work, axes[at], axes[at + 1], axes[at + 2])
    while mask:
        one_pose(scratch.poses, bodies.joints[body], first_lane(mask), pose)
        mask &= mask - 1
        if _pose_meets(world, body, pose, cloud, obstacles.roots[obstacle], clearance):
            return True
        keep_direction(work, axes, at, scratch.obstacle_places)
    return False
