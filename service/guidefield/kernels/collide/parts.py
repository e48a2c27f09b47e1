"""Convex parts of bodies and trees of balls about them: the tables that GJK, batches and proofs read, and placing.

`collision/part_tables.py`, `batch/surface_tables.py`, `primitive.py`, `stream/shapes.py` write them: columns and kinds
have to be the same there, and in `prove/proof.py`. A node's ball and part contain all that is below it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import (
    Blocks,
    Floats,
    Floats32,
    IndexRows,
    Indices,
    Row,
    Singles,
    SinglesOut,
    numba_type,
)
from guidefield.kernels.jit.decorators import kernel, vector_part
from guidefield.kernels.kinematics.poses import apply_pose, apply_poses, write_product
from guidefield.kernels.simd.packing import BLOCK, pointed
from guidefield.kernels.simd.vector import LANES, Vector, below, splat

BALL_ROW = 4  # numbers of a ball: its centre's x, y, z and its radius [m]
RADIUS = 3  # place of the radius among them


@vector_part
def ball_radius(balls: Any, ball: int) -> Any:
    """Radius of one of some balls, shape (BALL_ROW * n,) [m]."""
    return balls[BALL_ROW * ball + RADIUS]


@vector_part
def ball_centre(poses: Floats32, joint: int, balls: Floats32, ball: int) -> tuple[Vector, Vector, Vector]:
    """Centre of a ball that a joint carries: of `poses`, shape (joints * POSE,), and `balls`, shape (BALL_ROW * n,)."""
    at = BALL_ROW * ball
    return apply_poses(poses, joint, balls[at], balls[at + 1], balls[at + 2])


@vector_part
def placed_ball(pose: Floats, balls: Any, ball: int) -> tuple[float, float, float]:
    """Return the centre of one of balls (BALL_ROW * n,) of a body placed at (12,) [m]."""
    at = BALL_ROW * ball
    return apply_pose(pose, balls[at], balls[at + 1], balls[at + 2])


@vector_part
def balls_meet(poses: Floats32, joint_a: int, a: int, joint_b: int, b: int, balls: Floats32, margin: float) -> int:
    """Mask of the lanes where two balls that two joints carry are closer than a margin; shapes as for `ball_centre`."""
    x, y, z = ball_centre(poses, joint_a, balls, a)
    u, v, w = ball_centre(poses, joint_b, balls, b)
    x, y, z, reach = x - u, y - v, z - w, ball_radius(balls, a) + ball_radius(balls, b) + margin
    return int(below(x * x + y * y + z * z, splat(reach * reach)))


@vector_part
def lowest_of_ball(balls: Floats32, ball: int, x: Any, y: Any, z: Any) -> Any:
    """The least n.p over the points p of one of some balls, shape (BALL_ROW * n,), for unit axes n = (x, y, z) [m]."""
    at = BALL_ROW * ball
    return x * balls[at] + y * balls[at + 1] + z * balls[at + 2] - balls[at + RADIUS]


POLYTOPE = 4  # the kind of a part that is the hull of vertices; the others are a primitive's, but no boxes

TRIANGLE, SURFACE = 5, 6
"""A triangle of a mesh: its corners are its first nine numbers, in the body's frame. Vertices that are points of the
surface within the polytope before this part: never compared."""

LEFT, RIGHT, OWN, LINK = range(4)  # columns of a node: its children, and its part; then how many columns there are

KIND, FIRST_BLOCK, BLOCKS, SHAPE = range(4)
"""Columns of a part: its kind, its first block of vertices, how many blocks; then how many columns there are."""

DISC, HALF_LENGTH, ROUND, PART = 12, 14, 15, 16
"""Numbers of a part: behind its placement in the body's frame (12, row by row) a cylinder's radius, half of a
cylinder's or capsule's length, and the radius of what rounds it; then how many numbers there are."""

PLANE_OFFSET = 3  # place among them of a half-space's offset along its normal, which is the first three


class Parts(NamedTuple):
    """Convex parts of bodies, and trees of balls about them; lengths [m] in the frame of the body."""

    balls: Row  # (BALL_ROW * nodes,) each node's ball; float64
    # (LINK * nodes,) left child, right child, part; a leaf is its part and has no children (-1), of another node the
    # part contains all that is below it, if it has one (else -1)
    links: Indices
    shapes: Indices  # (SHAPE * parts,) kind, first block of vertices, how many blocks
    numbers: Row  # (PART * parts,) float64
    vertices: Singles  # (BLOCK * blocks,) float32; unused places repeat a vertex


PARTS = numba_type(Parts)
POINTED_PARTS = pointed(PARTS)


@vector_part
def part_of(parts: Parts, node: int) -> int:
    """The part of a node; -1 if it has none."""
    return int(parts.links[LINK * node + OWN])


@vector_part
def child_of(parts: Parts, node: int, side: int) -> int:
    """The child of a node at a side, LEFT or RIGHT; -1 if it is a leaf."""
    return int(parts.links[LINK * node + side])


@vector_part
def is_leaf(parts: Parts, node: int) -> bool:
    """Tell if a node has no children."""
    return child_of(parts, node, LEFT) < 0


@vector_part
def kind_of(parts: Parts, part: int) -> int:
    """The kind of a part."""
    return int(parts.shapes[SHAPE * part + KIND])


@vector_part
def is_flat_sided(parts: Parts, part: int) -> bool:
    """Tell if a part is given by corners in its body's frame, so that it has no placement of its own."""
    return kind_of(parts, part) in (POLYTOPE, TRIANGLE)


@vector_part
def rounding(parts: Parts, part: int) -> float:
    """Radius of what rounds a part [m]."""
    return float(parts.numbers[PART * part + ROUND])


@vector_part
def polytope_of(parts: Parts, root: int) -> int:
    """The polytope that a body is or is contained in, as a part; -1 if there is none."""
    part = part_of(parts, root)
    return part if part >= 0 and kind_of(parts, part) == POLYTOPE else -1


@kernel
def write_cluster_vertices(corners: Blocks, members: IndexRows, vertices_out: SinglesOut) -> None:
    """Write the vertices of clusters of triangles (n, k), cluster by cluster, as `Parts.vertices` has them.

    `corners` (t, 3, 3) are those of all triangles [m]; the first vertex fills the rest of (BLOCK * blocks of all,).
    """
    each = members.shape[1]
    blocks = (3 * each + LANES - 1) // LANES
    for cluster in range(members.shape[0]):
        for place in range(LANES * blocks):
            which = place if place < 3 * each else 0
            triangle, corner = members[cluster, which // 3], which % 3
            at = BLOCK * (blocks * cluster + place // LANES) + place % LANES
            for k in range(3):
                vertices_out[at + LANES * k] = np.float32(corners[triangle, corner, k])


X, Y, Z = 3, 7, 11  # places of its origin in a pose


@vector_part
def place_ball(parts: Parts, node: int, body: Floats, work: Floats, pose: int) -> None:
    """Write the rotation of a body placed at (12,), and the centre of a node's ball, to a pose in scratch (WORK,)."""
    for r in range(3):
        for c in range(3):
            work[pose + 4 * r + c] = body[4 * r + c]
    work[pose + X], work[pose + Y], work[pose + Z] = placed_ball(body, parts.balls, node)


@vector_part
def place_part(parts: Parts, part: int, body: Floats, work: Floats, pose: int) -> None:
    """Write the placement of a part; shapes as for `place_ball`."""
    if is_flat_sided(parts, part):
        for k in range(12):
            work[pose + k] = body[k]
        return
    write_product(body, parts.numbers, part * PART, work, pose)


@vector_part
def place_part_of(parts: Parts, node: int, body: Floats, work: Floats, pose: int) -> float:
    """Place the part of a node instead of its ball, if it has one; return the radius of what rounds it [m].

    Shapes are those of `place_ball`.
    """
    part = part_of(parts, node)
    if part < 0:
        return float(ball_radius(parts.balls, node))
    place_part(parts, part, body, work, pose)
    return rounding(parts, part)
