"""Separating axes of bodies at sixteen configurations: bodies' reach along them, and the stored form of an axis.

A stored axis has one body's reach along it: what is beyond counts as apart, so that a reach may be too large, not too
small. Which axes are kept is a matter of speed, but within `BAND` of contact of the answer, too: a search begins with
none (`batch_collision.forget`), so that it repeats to the bit.
"""

from __future__ import annotations

import numpy as np
from numba import int64

from guidefield.kernels.collide.gjk import AXIS, axis_in, axis_length, divide_axis, reach_along
from guidefield.kernels.collide.layout import AXIS_AND_REACH, REACH, LaneBodies
from guidefield.kernels.collide.parts import BLOCKS, FIRST_BLOCK, POINTED_PARTS, SHAPE, Parts, lowest_of_ball, part_of
from guidefield.kernels.jit.arrays import Floats, Floats32, Integers
from guidefield.kernels.jit.decorators import lane_part, lane_step
from guidefield.kernels.kinematics.poses import turned_axis, turned_back
from guidefield.kernels.simd.packing import BLOCK
from guidefield.kernels.simd.vector import LANES, Vector, below, f32x16, root, smallest_of, splat


@lane_step(f32x16(POINTED_PARTS, int64, f32x16, f32x16, f32x16))
def lowest_vertex(parts: Parts, part: int, x: Vector, y: Vector, z: Vector) -> Vector:
    """The least n.v over the vertices v of a polytope, for an axis n = (x, y, z) in its frame."""
    vertices, first, lowest = parts.vertices, parts.shapes[SHAPE * part + FIRST_BLOCK], splat(1e30)
    for block in range(first, first + parts.shapes[SHAPE * part + BLOCKS]):
        for corner in range(block * BLOCK, block * BLOCK + LANES):
            along = x * vertices[corner] + y * vertices[corner + LANES] + z * vertices[corner + 2 * LANES]
            lowest = smallest_of(lowest, along)
    return lowest


@lane_part
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


@lane_part
def lowest_ball(bodies: LaneBodies, body: int, x: Vector, y: Vector, z: Vector) -> Vector:
    """The least n.x over the points x of a body's cover, for an axis n = (x, y, z) in its joint's frame."""
    cover, lowest = bodies.cover, splat(1e30)
    for ball in range(bodies.covers[bodies.groups[body]], bodies.covers[bodies.groups[body + 1]]):
        along = lowest_of_ball(cover, ball, x, y, z)
        lowest = smallest_of(lowest, along)
    return lowest


@lane_part
def no_axis(axes: Floats, at: int) -> bool:
    """Tell if there is no axis at a place among numbers, shape (n,): all three are 0."""
    return bool(axes[at] == 0.0 and axes[at + 1] == 0.0 and axes[at + 2] == 0.0)


@lane_part
def _note(axes: Floats, at: int, places: Integers) -> None:
    """Note the place of an axis that will be kept, if there was none; the first of `places` says how many follow it."""
    if no_axis(axes, at):
        places[0] += 1
        places[places[0]] = at


@lane_part
def keep_direction(work: Floats, axes: Floats, at: int, places: Integers) -> None:
    """Keep the axis in the scratch space, shape (WORK,), if there is one, as it is; the rest as for `keep_axis`."""
    if not no_axis(work, AXIS):
        _note(axes, at, places)
        for k in range(3):
            axes[at + k] = work[AXIS + k]


@lane_part
def forget_axes(axes: Floats, places: Integers) -> None:
    """Forget all of some axes (AXIS_AND_REACH * n,), by their places (1 + n,): a search mostly keeps few of many."""
    for k in range(1, places[0] + 1):
        for number in range(AXIS_AND_REACH):
            axes[places[k] + number] = 0.0
    places[0] = 0


@lane_part
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


@lane_part
def keep_axis(
    parts: Parts, root: int, work: Floats, pose: Floats, way: float, axes: Floats, at: int, places: Integers
) -> None:
    """`write_separating` into the store, (AXIS_AND_REACH * n,), if there is an axis, and note where: (1 + n,)."""
    if not no_axis(work, AXIS):
        _note(axes, at, places)
        write_separating(parts, root, work, pose, way, axes, at)
