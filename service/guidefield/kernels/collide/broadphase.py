# ruff: noqa: ARG001  numba calls typing and code generation with arguments that most have no use for
"""The broad phase at sixteen configurations: a robot's balls near obstacles and clouds, their gap to drifting boxes.

For a cloud, a grid of distances answers first, then the cloud's tree. A cell of the grid holds the distance from its
middle to the nearest point; it is filled when first read (0 before), and stays, for all threads. A place that is `off`
from the middle is that distance away from a point, give or take `off`: this decides for most balls. Masks
are right but for rounding, which is less than `BAND`: callers widen `reach` by it where no contact may be missed, and
shrink it where a ball inside a body shall prove one.

Drifting rounded boxes are for search trees of streams among moving obstacles: a tree tests a configuration once, not at
each time, so that a box stands where it will be when the robot could be there at the soonest. Schedules
(`stream/dodge.py`) are ranked by gaps to them. Both prove nothing, but kept journals replay by them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import boolean, float64, int64, types, void
from numba.extending import intrinsic

from guidefield.kernels.collide.layout import (
    BODIES,
    CLOUD,
    DRIFTING_BOX,
    HALF_SIDES,
    HORIZON,
    KEPT,
    KEPT_AT_GOAL,
    KEPT_AT_START,
    OBSTACLES,
    ROUNDED_BOX,
    ROUNDING,
    SCRATCH_MEMORY,
    VELOCITY,
    WIDENING,
    WORLD,
    BatchBodies,
    BatchObstacles,
    BatchWorld,
    Scratch,
    world_of,
)
from guidefield.kernels.collide.parts import ball_centre, ball_radius
from guidefield.kernels.collide.primitive import PRIMITIVE, near_primitive
from guidefield.kernels.distance.point_tree import (
    CELL,
    CLOUD_TABLES,
    HIGH,
    LOW,
    PER_LENGTH,
    RADIUS,
    BatchCloud,
    cloud_of,
    nearest_distance,
    next_block,
    words_at,
)
from guidefield.kernels.jit.arrays import FLOAT_POINTER, Floats32, Indices, SingleRows
from guidefield.kernels.jit.decorators import vector_kernel, vector_part, vector_step
from guidefield.kernels.kinematics.batch_forward_kinematics import batch_placements
from guidefield.kernels.simd.packing import AROUND, BLOCK, pointers, points_at
from guidefield.kernels.simd.vector import (
    LANES,
    Vector,
    below,
    f32x16,
    first_lane,
    lane,
    largest_lane,
    largest_of,
    load,
    magnitude,
    rint,
    root,
    smallest_lane,
    smallest_of,
    splat,
    store,
)


@intrinsic
def _gather(typing: Any, pointer: Any, places: Any) -> Any:
    """The sixteen floats at places, which are whole numbers held as floats."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        whole = builder.fptosi(args[1], ir.VectorType(ir.IntType(32), LANES))
        found = ir.Constant(ir.VectorType(ir.FloatType(), LANES), ir.Undefined)
        for index in range(LANES):
            at = ir.Constant(ir.IntType(32), index)
            value = builder.load(builder.gep(args[0], [builder.extract_element(whole, at)]))
            found = builder.insert_element(found, value, at)
        return found

    return f32x16(FLOAT_POINTER, f32x16), generate


@vector_step(boolean(CLOUD_TABLES, f32x16, f32x16, f32x16, f32x16, int64))
def _fill_cells(cloud: BatchCloud, places: Vector, x: Vector, y: Vector, z: Vector, lanes: int) -> bool:
    """Fill the cells of a mask's lanes, by their places and middles; none gets 0, which says that a cell is empty."""
    while lanes:
        k = first_lane(lanes)
        lanes &= lanes - 1
        distance = nearest_distance(cloud, float(lane(x, k)), float(lane(y, k)), float(lane(z, k)))
        cloud.cells[int(lane(places, k))] = np.float32(max(distance, 1e-20))
    return True


@vector_step(int64(CLOUD_TABLES, f32x16, f32x16, f32x16, float64, int64))
def cloud_near(cloud: BatchCloud, x: Vector, y: Vector, z: Vector, reach: float, lanes: int) -> int:
    """Return the lanes of a mask whose points are closer than `reach` to a ball of the cloud [m]."""
    numbers, cells, zero = cloud.numbers, cloud.cells, splat(0.0)
    reach += numbers[RADIUS]
    dx = largest_of(largest_of(numbers[LOW] - x, x - numbers[HIGH]), zero)
    dy = largest_of(largest_of(numbers[LOW + 1] - y, y - numbers[HIGH + 1]), zero)
    dz = largest_of(largest_of(numbers[LOW + 2] - z, z - numbers[HIGH + 2]), zero)
    near = lanes & below(dx * dx + dy * dy + dz * dz, splat(reach * reach))
    if near == 0:
        return 0
    size, per = numbers[CELL], numbers[PER_LENGTH]
    i = smallest_of(largest_of(rint((x - numbers[0]) * per), zero), splat(float(cloud.columns - 1)))
    j = smallest_of(largest_of(rint((y - numbers[1]) * per), zero), splat(float(cloud.rows - 1)))
    k = smallest_of(largest_of(rint((z - numbers[2]) * per), zero), splat(float(cloud.layers - 1)))
    places = (i * float(cloud.rows) + j) * float(cloud.layers) + k
    u, v, w = i * size + numbers[0], j * size + numbers[1], k * size + numbers[2]
    known = _gather(cells, places)
    unknown = near & below(known, splat(1e-30))
    if unknown and _fill_cells(cloud, places, u, v, w, unknown):
        known = _gather(cells, places)
    dx, dy, dz = x - u, y - v, z - w
    off = root(dx * dx + dy * dy + dz * dz)
    near &= below(known - off, splat(reach))
    left = near & ~below(known + off, splat(reach))
    while left:
        at = first_lane(left)
        left &= left - 1
        if next_block(cloud, -1, float(lane(x, at)), float(lane(y, at)), float(lane(z, at)), reach) < 0:
            near &= ~(1 << at)
    return int(near)


@vector_step(int64(OBSTACLES, int64, f32x16, f32x16, f32x16, types.float64, int64))
def _near_cloud(obstacles: BatchObstacles, o: int, x: Vector, y: Vector, z: Vector, reach: float, lanes: int) -> int:
    """`near_obstacle` of a cloud: a function of its own, while the others are inlined as a few instructions."""
    return int(cloud_near(cloud_of(words_at(obstacles.clouds[o])), x, y, z, reach, lanes))


@vector_part
def near_obstacle_of(
    cloudy: bool, obstacles: BatchObstacles, o: int, x: Vector, y: Vector, z: Vector, reach: float, lanes: int
) -> int:
    """`near_obstacle` where it is known whether the obstacle is a cloud: a loop that can't meet one needs no call."""
    if cloudy:
        return int(_near_cloud(obstacles, o, x, y, z, reach, lanes))
    return int(near_primitive(obstacles.kinds[o], obstacles.primitives, o * PRIMITIVE, x, y, z, reach))


@vector_part
def near_obstacle(obstacles: BatchObstacles, o: int, x: Vector, y: Vector, z: Vector, reach: float, lanes: int) -> int:
    """Return the lanes, at least those of a mask, whose points are closer to an obstacle's primitive than `reach`."""
    return int(near_obstacle_of(obstacles.kinds[o] == CLOUD, obstacles, o, x, y, z, reach, lanes))


@vector_step(void(BODIES, SCRATCH_MEMORY))
def place_links(bodies: BatchBodies, scratch: Scratch) -> None:
    """Write the centres of the balls about links (`BatchBodies`) where the scratch's poses place them."""
    poses, around, link_joints, centres = scratch.poses, bodies.around, bodies.link_joints, scratch.centres
    for c in range(bodies.n_links):
        x, y, z = ball_centre(poses, link_joints[c], around, c)
        store(centres, c * BLOCK, x)
        store(centres, c * BLOCK + LANES, y)
        store(centres, c * BLOCK + 2 * LANES, z)


@vector_part
def link_centre(centres: Floats32, c: int) -> tuple[Vector, Vector, Vector]:
    """The centre of the ball about a link, of those that `place_links` wrote, shape (m * BLOCK,)."""
    return points_at(centres, c * BLOCK)


@vector_part
def boxes_near(boxes: Floats32, block: int, x: Vector, y: Vector, z: Vector, reach: float) -> int:
    """Mask of the sixteen obstacles whose boxes, shape (AROUND * blocks,), come near the box about all lanes' balls."""
    low_x, low_y, low_z = points_at(boxes, block * AROUND)
    high_x, high_y, high_z = points_at(boxes, block * AROUND + BLOCK)
    near = below(low_x, splat(largest_lane(x) + reach))
    near &= below(low_y, splat(largest_lane(y) + reach))
    near &= below(low_z, splat(largest_lane(z) + reach))
    near &= below(splat(smallest_lane(x) - reach), high_x)
    near &= below(splat(smallest_lane(y) - reach), high_y)
    near &= below(splat(smallest_lane(z) - reach), high_z)
    return int(near)


@vector_part
def _gap(boxes: Floats32, at: int, x: Vector, y: Vector, z: Vector) -> Vector:
    """Signed distance of points, as seen from its centre, from a rounded box whose numbers begin there [m]."""
    u = magnitude(boxes[at] * x + boxes[at + 4] * y + boxes[at + 8] * z) - boxes[at + HALF_SIDES]
    v = magnitude(boxes[at + 1] * x + boxes[at + 5] * y + boxes[at + 9] * z) - boxes[at + HALF_SIDES + 1]
    w = magnitude(boxes[at + 2] * x + boxes[at + 6] * y + boxes[at + 10] * z) - boxes[at + HALF_SIDES + 2]
    zero = splat(0.0)
    a, b, c = largest_of(u, zero), largest_of(v, zero), largest_of(w, zero)
    inside = smallest_of(largest_of(largest_of(u, v), w), zero)
    return root(a * a + b * b + c * c) + inside - boxes[at + ROUNDING]


@vector_step(f32x16(BODIES, SCRATCH_MEMORY, FLOAT_POINTER, int64, f32x16, f32x16, f32x16, f32x16))
def _gap_of_robot(
    bodies: BatchBodies, scratch: Scratch, boxes: Floats32, at: int, x: Vector, y: Vector, z: Vector, most: Vector
) -> Vector:
    """Signed distance of the robot, as it is placed, from a rounded box with centres (x, y, z), `most` at most [m]."""
    poses, least = scratch.poses, most
    h, i, j = boxes[at + HALF_SIDES], boxes[at + HALF_SIDES + 1], boxes[at + HALF_SIDES + 2]
    size = math.sqrt(h * h + i * i + j * j) + boxes[at + ROUNDING]
    for c in range(bodies.moving):
        u, v, w = link_centre(scratch.centres, c)
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


@vector_step(boolean(WORLD))
def meets_drifting(world: BatchWorld) -> bool:
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


@vector_kernel
def write_gaps(
    words: Indices, boxes: SingleRows, most: float, configurations: SingleRows, gaps_out: SingleRows
) -> None:
    """Write how far the robot is from boxes (k, `ROUNDED_BOX`) at coordinates (n, nv), at most `most`, (n, k) [m].

    It may be nearer by what its bounding spheres reach beyond its links. `words` are a packed `BatchWorld`.
    """
    world, count, numbers = world_of(pointers(words)), configurations.shape[0], pointers(boxes.reshape(-1))
    for begin in range(0, count, LANES):
        for j in range(world.nv):
            for k in range(LANES):
                world.block[j * LANES + k] = configurations[min(begin + k, count - 1), j]
        batch_placements(world.joints, world.block, world.scratch.poses)
        place_links(world.bodies, world.scratch)
        for box in range(boxes.shape[0]):
            at = box * ROUNDED_BOX
            x, y, z = splat(boxes[box, 3]), splat(boxes[box, 7]), splat(boxes[box, 11])
            gaps = _gap_of_robot(world.bodies, world.scratch, numbers, at, x, y, z, splat(most))
            for k in range(min(LANES, count - begin)):
                gaps_out[begin + k, box] = lane(gaps, k)
