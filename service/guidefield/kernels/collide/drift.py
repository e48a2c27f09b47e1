"""Distances of a robot's bounding spheres from drifting rounded boxes, at sixteen configurations at once.

For search trees of streams among moving obstacles: a tree tests a configuration once, not at each time, so that a box
stands where it will be when the robot could be there at the soonest. This guides a search and proves nothing; pieces of
motion are proven by `kernels/prove`.
"""

from __future__ import annotations

import math

from numba import boolean, int64

from guidefield.kernels.collide.broadphase import carrier_centre, place_carriers
from guidefield.kernels.collide.layout import (
    BODIES,
    DRIFTING_BOX,
    HALF_SIDES,
    HORIZON,
    KEPT,
    KEPT_AT_GOAL,
    KEPT_AT_START,
    ROUNDED_BOX,
    ROUNDING,
    SCRATCH_MEMORY,
    VELOCITY,
    WIDENING,
    WORLD,
    LaneBodies,
    LaneWorld,
    Scratch,
    world_of,
)
from guidefield.kernels.collide.parts import ball_centre, ball_radius
from guidefield.kernels.jit.arrays import FLOAT_POINTER, Floats32, Indices, SingleRows
from guidefield.kernels.jit.decorators import lane_kernel, lane_part, lane_step
from guidefield.kernels.kinematics.batch_forward_kinematics import lane_placements
from guidefield.kernels.simd.packing import pointers
from guidefield.kernels.simd.vector import (
    LANES,
    Vector,
    below,
    f32x16,
    lane,
    largest_of,
    load,
    magnitude,
    rint,
    root,
    smallest_of,
    splat,
)


@lane_part
def _gap(boxes: Floats32, at: int, x: Vector, y: Vector, z: Vector) -> Vector:
    """Signed distance of points, as seen from its centre, from a rounded box whose numbers begin there [m]."""
    u = magnitude(boxes[at] * x + boxes[at + 4] * y + boxes[at + 8] * z) - boxes[at + HALF_SIDES]
    v = magnitude(boxes[at + 1] * x + boxes[at + 5] * y + boxes[at + 9] * z) - boxes[at + HALF_SIDES + 1]
    w = magnitude(boxes[at + 2] * x + boxes[at + 6] * y + boxes[at + 10] * z) - boxes[at + HALF_SIDES + 2]
    zero = splat(0.0)
    a, b, c = largest_of(u, zero), largest_of(v, zero), largest_of(w, zero)
    inside = smallest_of(largest_of(largest_of(u, v), w), zero)
    return root(a * a + b * b + c * c) + inside - boxes[at + ROUNDING]


@lane_step(f32x16(BODIES, SCRATCH_MEMORY, FLOAT_POINTER, int64, f32x16, f32x16, f32x16, f32x16))
def _gap_of_robot(
    bodies: LaneBodies, scratch: Scratch, boxes: Floats32, at: int, x: Vector, y: Vector, z: Vector, most: Vector
) -> Vector:
    """Signed distance of the robot, as it is placed, from a rounded box with centres (x, y, z), `most` at most [m]."""
    poses, least = scratch.poses, most
    h, i, j = boxes[at + HALF_SIDES], boxes[at + HALF_SIDES + 1], boxes[at + HALF_SIDES + 2]
    size = math.sqrt(h * h + i * i + j * j) + boxes[at + ROUNDING]
    for c in range(bodies.moving):
        u, v, w = carrier_centre(scratch.centres, c)
        u, v, w = u - x, v - y, w - z
        reach = largest_of(least + (size + ball_radius(bodies.around, c)), splat(0.0))
        if below(u * u + v * v + w * w, reach * reach) == 0:
            continue
        for k in range(bodies.members[c], bodies.members[c + 1]):
            body = bodies.order[k]
            joint = bodies.joints[body]
            u, v, w = ball_centre(poses, joint, bodies.bounds, body)
            if below(_gap(boxes, at, u - x, v - y, w - z) - ball_radius(bodies.bounds, body), least) == 0:
                continue
            for group in range(bodies.groups[body], bodies.groups[body + 1]):
                u, v, w = ball_centre(poses, joint, bodies.grouped, group)
                if below(_gap(boxes, at, u - x, v - y, w - z) - ball_radius(bodies.grouped, group), least) == 0:
                    continue
                for ball in range(bodies.covers[group], bodies.covers[group + 1]):
                    u, v, w = ball_centre(poses, joint, bodies.cover, ball)
                    gap = _gap(boxes, at, u - x, v - y, w - z) - ball_radius(bodies.cover, ball)
                    least = smallest_of(least, gap)
    return least


@lane_step(boolean(WORLD))
def meets_drifting(world: LaneWorld) -> bool:
    """Tell if the robot, placed at the sixteen configurations of a world's block, is too close to a drifting box."""
    drifting, boxes, first, last = world.drifting, world.drifting.boxes, splat(0.0), splat(0.0)
    for j in range(world.nv):
        z, period = load(world.block, j * LANES), drifting.periods[j]
        since, left = z - drifting.ends[j], z - drifting.ends[world.nv + j]
        if period != 0.0:
            since, left = since - rint(since / period) * period, left - rint(left / period) * period
        first = largest_of(first, magnitude(since) * drifting.rates[j])
        last = largest_of(last, magnitude(left) * drifting.rates[j])
    # the same rule as `later` in `_among` of stream/path_planner.py, which measures `KEPT_AT_GOAL` by it
    then = smallest_of(first, splat(drifting.numbers[HORIZON]))
    first, last = first * drifting.numbers[WIDENING], last * drifting.numbers[WIDENING]
    for k in range(drifting.size):
        at = k * DRIFTING_BOX
        kept = smallest_of(first + boxes[at + KEPT_AT_START], last + boxes[at + KEPT_AT_GOAL])
        kept = smallest_of(kept, splat(boxes[at + KEPT]))
        x = then * boxes[at + VELOCITY] + boxes[at + 3]
        y = then * boxes[at + VELOCITY + 1] + boxes[at + 7]
        z = then * boxes[at + VELOCITY + 2] + boxes[at + 11]
        if below(_gap_of_robot(world.bodies, world.scratch, boxes, at, x, y, z, kept), kept):
            return True
    return False


@lane_kernel
def write_gaps(
    words: Indices, boxes: SingleRows, most: float, configurations: SingleRows, gaps_out: SingleRows
) -> None:
    """Write how far the robot is from boxes (k, `ROUNDED_BOX`) at coordinates (n, nv), at most `most`, (n, k) [m].

    It may be nearer by what its bounding spheres reach beyond its links. `words` are a packed `LaneWorld`.
    """
    world, count, numbers = world_of(pointers(words)), configurations.shape[0], pointers(boxes.reshape(-1))
    for begin in range(0, count, LANES):
        for j in range(world.nv):
            for k in range(LANES):
                world.block[j * LANES + k] = configurations[min(begin + k, count - 1), j]
        lane_placements(world.joints, world.block, world.scratch.poses)
        place_carriers(world.bodies, world.scratch)
        for box in range(boxes.shape[0]):
            at = box * ROUNDED_BOX
            x, y, z = splat(boxes[box, 3]), splat(boxes[box, 7]), splat(boxes[box, 11])
            gaps = _gap_of_robot(world.bodies, world.scratch, numbers, at, x, y, z, splat(most))
            for k in range(min(LANES, count - begin)):
                gaps_out[begin + k, box] = lane(gaps, k)
