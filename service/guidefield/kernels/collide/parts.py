"""Convex parts of bodies and trees of balls about them, as tables for kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import void

from guidefield.kernels.jit.fields import Indices, Row, Singles, numba_type
from guidefield.kernels.jit.signatures import (
    BLOCKS as CORNERS,
    FLOATS_OUT,
    INDEX_MATRIX,
    Floats,
    Floats32,
    Integers,
    compiled,
    lane_part,
)
from guidefield.kernels.simd.blocks import BLOCK
from guidefield.kernels.simd.packing import pointed
from guidefield.kernels.simd.vector_model import LANES

POLYTOPE = 4
"""The kind of a part that is the hull of vertices; the others are a primitive's, but no boxes."""

TRIANGLE, SURFACE = 5, 6
"""A triangle of a mesh: its corners are its first nine numbers, in the body's frame. Vertices that are points of the
surface within the polytope before this part: never compared."""

LEFT, RIGHT, OWN, LINK = range(4)
"""Columns of a node: its children, and its part; then how many columns there are."""

KIND, FIRST_BLOCK, BLOCKS, SHAPE = range(4)
"""Columns of a part: its kind, its first block of vertices, how many blocks; then how many columns there are."""

DISC, HALF_LENGTH, ROUND, PART = 12, 14, 15, 16
"""Numbers of a part: behind its placement in the body's frame (12, row by row) a cylinder's radius, half of a
cylinder's or capsule's length, and the radius of what rounds it; then how many numbers there are."""

PLANE_OFFSET = 3
"""Place among them of a half-space's offset along its normal, which is the first three."""


class Parts(NamedTuple):
    """Convex parts of bodies, and trees of balls about them; lengths [m] in the frame of the body.

    Attributes:
        balls: (BALL_ROW * nodes,) each node's ball; float64.
        links: (LINK * nodes,) left child, right child, part; a leaf is its part and has no children (-1), of another
            node the part contains all that is below it, if it has one (else -1).
        shapes: (SHAPE * parts,) kind, first block of vertices, how many blocks.
        numbers: (PART * parts,) float64.
        vertices: (BLOCK * blocks,) float32; unused places repeat a vertex.
    """

    balls: Row
    links: Indices
    shapes: Indices
    numbers: Row
    vertices: Singles


PARTS = numba_type(Parts)
POINTED_PARTS = pointed(PARTS)


@lane_part
def part_of(parts: Parts, node: int) -> int:
    """The part of a node; -1 if it has none."""
    return int(parts.links[LINK * node + OWN])


@lane_part
def child_of(parts: Parts, node: int, side: int) -> int:
    """The child of a node at a side, LEFT or RIGHT; -1 if it is a leaf."""
    return int(parts.links[LINK * node + side])


@lane_part
def is_leaf(parts: Parts, node: int) -> bool:
    """Tell if a node has no children."""
    return child_of(parts, node, LEFT) < 0


@lane_part
def kind_of(parts: Parts, part: int) -> int:
    """The kind of a part."""
    return int(parts.shapes[SHAPE * part + KIND])


@lane_part
def is_flat_sided(parts: Parts, part: int) -> bool:
    """Tell if a part is given by corners in its body's frame, so that it has no placement of its own."""
    return kind_of(parts, part) in (POLYTOPE, TRIANGLE)


@lane_part
def rounding(parts: Parts, part: int) -> float:
    """Radius of what rounds a part [m]."""
    return float(parts.numbers[PART * part + ROUND])


@lane_part
def polytope_of(parts: Parts, root: int) -> int:
    """The polytope that a body is or is contained in, as a part; -1 if there is none."""
    part = part_of(parts, root)
    return part if part >= 0 and kind_of(parts, part) == POLYTOPE else -1


@compiled(void(CORNERS, INDEX_MATRIX, FLOATS_OUT))
def write_cluster_vertices(corners: Floats, members: Integers, vertices_out: Floats32) -> None:
    """Write the vertices of clusters, cluster by cluster.

    Args:
        corners: Of all triangles, shape (t, 3, 3) [m].
        members: The triangles of each cluster, shape (n, k).
        vertices_out: Their corners, as `Parts.vertices` has them, and the first one wherever places are left; shape
            (BLOCK * blocks of all,).
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
