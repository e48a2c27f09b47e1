"""The exact decision between an obstacle and a body that isn't convex: by its pieces, in lanes as far as that goes.

A piece far from the obstacle falls out by the ball about it. Points of a body's surface that lie in an obstacle are a
certain contact. Else each lane has an axis of its own, away from the point of the obstacle's primitive that is nearest
to the middle of the piece; where that doesn't separate the two, GJK begins with it.
"""

from __future__ import annotations

from numba import boolean, int64, types

from guidefield.kernels.collide.balls import ball_centre, ball_radius, placed_ball
from guidefield.kernels.collide.gjk import bodies_apart, parts_apart
from guidefield.kernels.collide.gjk_scratch import KEPT, STACK, write_axis
from guidefield.kernels.collide.layout import (
    BAND,
    BODIES,
    DECISION_BAND,
    OBSTACLES,
    REACH,
    SCRATCH_MEMORY,
    LaneBodies,
    LaneObstacles,
    Scratch,
)
from guidefield.kernels.collide.parts import (
    BLOCKS,
    FIRST_BLOCK,
    LEFT,
    POINTED_PARTS,
    POLYTOPE,
    RIGHT,
    SHAPE,
    SURFACE,
    Parts,
    child_of,
    is_leaf,
    kind_of,
    part_of,
    polytope_of,
)
from guidefield.kernels.collide.primitive import PRIMITIVE, away_from_primitive, near_primitive
from guidefield.kernels.collide.separating_axes import kept_beyond, write_separating
from guidefield.kernels.jit.signatures import DOUBLE_POINTER, Floats, lane_part, lane_step
from guidefield.kernels.kinematics.poses import one_pose, placed
from guidefield.kernels.simd.blocks import BLOCK, points_at
from guidefield.kernels.simd.vector import Vector, first_lane, lane, splat


@lane_part
def _near_piece(
    bodies: LaneBodies, piece: int, joint: int, obstacles: LaneObstacles, o: int, clearance: float, scratch: Scratch
) -> tuple[int, Vector, Vector, Vector]:
    """Mask of the lanes where the ball about a piece meets the obstacle's primitive; the ball's middle."""
    x, y, z = ball_centre(scratch.poses, joint, bodies.piece_bounds, piece)
    reach = ball_radius(bodies.piece_bounds, piece) + clearance + BAND
    return near_primitive(obstacles.kinds[o], obstacles.primitives, o * PRIMITIVE, x, y, z, reach), x, y, z


@lane_step(boolean(POINTED_PARTS, int64, DOUBLE_POINTER, OBSTACLES, int64, types.float64))
def _surface_meets(parts: Parts, part: int, pose: Floats, obstacles: LaneObstacles, o: int, reach: float) -> bool:
    """Whether any of the points of a part, of a body that is placed so (12), are nearer to a primitive than `reach`."""
    vertices, first = parts.vertices, parts.shapes[SHAPE * part + FIRST_BLOCK]
    for block in range(first, first + parts.shapes[SHAPE * part + BLOCKS]):
        x, y, z = points_at(vertices, block * BLOCK)
        u, v, w = placed(pose, x, y, z)
        if near_primitive(obstacles.kinds[o], obstacles.primitives, o * PRIMITIVE, u, v, w, reach):
            return True
    return False


@lane_step(boolean(BODIES, POINTED_PARTS, int64, OBSTACLES, int64, int64, types.float64, SCRATCH_MEMORY))
def _points_meet(
    bodies: LaneBodies,
    parts: Parts,
    body: int,
    obstacles: LaneObstacles,
    o: int,
    mask: int,
    clearance: float,
    scratch: Scratch,
) -> bool:
    """Whether a point of a body's surface is in an obstacle, which is a primitive, in any lane of a mask."""
    joint = bodies.joints[body]
    for piece in range(bodies.pieces[body], bodies.pieces[body + 1]):
        points = polytope_of(parts, bodies.piece_roots[piece]) + 1
        if points == 0 or kind_of(parts, points) != SURFACE:
            continue
        near, _, _, _ = _near_piece(bodies, piece, joint, obstacles, o, clearance, scratch)
        near &= mask
        while near:
            one_pose(scratch.poses, joint, first_lane(near), scratch.pose_a)
            near &= near - 1
            if _surface_meets(parts, points, scratch.pose_a, obstacles, o, clearance + DECISION_BAND):
                return True
    return False


@lane_step(
    boolean(
        POINTED_PARTS,
        int64,
        DOUBLE_POINTER,
        OBSTACLES,
        int64,
        POINTED_PARTS,
        DOUBLE_POINTER,
        types.float64,
        DOUBLE_POINTER,
    )
)
def _piece_meets(
    parts: Parts,
    root: int,
    pose: Floats,
    obstacles: LaneObstacles,
    o: int,
    scene: Parts,
    pose_b: Floats,
    margin: float,
    work: Floats,
) -> bool:
    """Whether what is below a node, of a body placed so (12), comes closer to a primitive than a margin.

    A polytope below the root has corners of triangles for its vertices: one in the obstacle is a contact.
    """
    balls, top = parts.balls, 1
    other = part_of(scene, obstacles.roots[o])
    work[STACK] = root
    while top > 0:
        top -= 1
        node = int(work[STACK + top])
        x, y, z = placed_ball(pose, balls, node)
        u, v, w, reach = splat(x), splat(y), splat(z), ball_radius(balls, node) + margin + BAND
        if not near_primitive(obstacles.kinds[o], obstacles.primitives, o * PRIMITIVE, u, v, w, reach):
            continue
        part = part_of(parts, node)
        if part >= 0:
            of_corners = node != root and kind_of(parts, part) == POLYTOPE
            if of_corners and _surface_meets(parts, part, pose, obstacles, o, margin):
                return True
            if parts_apart(parts, part, pose, scene, other, pose_b, margin, work):
                continue
            if is_leaf(parts, node):
                return True
        for side in (LEFT, RIGHT):
            work[STACK + top] = child_of(parts, node, side)
            top += 1
    return False


@lane_step(boolean(BODIES, POINTED_PARTS, int64, OBSTACLES, POINTED_PARTS, int64, int64, types.float64, SCRATCH_MEMORY))
def pieces_meet(
    bodies: LaneBodies,
    parts: Parts,
    body: int,
    obstacles: LaneObstacles,
    scene: Parts,
    o: int,
    mask: int,
    clearance: float,
    scratch: Scratch,
) -> bool:
    """Whether any piece of a body touches an obstacle, no cloud, in any lane of a mask; shapes as in `block_touches`.

    The scratch's `pose_b` has to be the identity.
    """
    if obstacles.whole[o] and _points_meet(bodies, parts, body, obstacles, o, mask, clearance, scratch):
        return True
    work, pose, pose_b, poses = scratch.work, scratch.pose_a, scratch.pose_b, scratch.poses
    joint, root, margin = bodies.joints[body], obstacles.roots[o], clearance + DECISION_BAND
    for piece in range(bodies.pieces[body], bodies.pieces[body + 1]):
        near, x, y, z = _near_piece(bodies, piece, joint, obstacles, o, clearance, scratch)
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
            if obstacles.whole[o]:
                meets = _piece_meets(parts, own, pose, obstacles, o, scene, pose_b, margin, work)
            else:
                meets = not bodies_apart(parts, own, pose, scene, root, pose_b, margin, work)
            if meets:
                return True
            if near and part >= 0:  # the axis that it left behind
                write_separating(scene, root, work, pose_b, 1.0, work, KEPT)
                a, b, c = splat(work[KEPT]), splat(work[KEPT + 1]), splat(work[KEPT + 2])
                far = splat(work[KEPT + REACH])
                near &= kept_beyond(parts, part, poses, joint, a, b, c, far, clearance + BAND)
    return False
