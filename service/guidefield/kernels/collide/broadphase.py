"""Which obstacles sixteen balls of a robot are near, each in one lane."""

from __future__ import annotations

from numba import int64, types, void

from guidefield.kernels.collide.balls import ball_centre
from guidefield.kernels.collide.cloud_broadphase import cloud_near
from guidefield.kernels.collide.layout import (
    BODIES,
    CLOUD,
    OBSTACLES,
    SCRATCH_MEMORY,
    LaneBodies,
    LaneObstacles,
    Scratch,
)
from guidefield.kernels.collide.primitive import PRIMITIVE, near_primitive
from guidefield.kernels.distance.point_tree import cloud_of, words_at
from guidefield.kernels.jit.signatures import Floats32, lane_part, lane_step
from guidefield.kernels.simd.blocks import AROUND, BLOCK, points_at
from guidefield.kernels.simd.vector import LANES, Vector, below, f32x16, largest_lane, smallest_lane, splat, store


@lane_step(int64(OBSTACLES, int64, f32x16, f32x16, f32x16, types.float64, int64))
def _near_cloud(obstacles: LaneObstacles, o: int, x: Vector, y: Vector, z: Vector, reach: float, lanes: int) -> int:
    """`near_obstacle` of a cloud: a call of its own, as the others are but a few instructions in their place."""
    return int(cloud_near(cloud_of(words_at(obstacles.clouds[o])), x, y, z, reach, lanes))


@lane_part
def near_obstacle_of(
    cloudy: bool, obstacles: LaneObstacles, o: int, x: Vector, y: Vector, z: Vector, reach: float, lanes: int
) -> int:
    """`near_obstacle` where it is known whether the obstacle is a cloud: a loop that can't meet one needs no call."""
    if cloudy:
        return int(_near_cloud(obstacles, o, x, y, z, reach, lanes))
    return int(near_primitive(obstacles.kinds[o], obstacles.primitives, o * PRIMITIVE, x, y, z, reach))


@lane_part
def near_obstacle(obstacles: LaneObstacles, o: int, x: Vector, y: Vector, z: Vector, reach: float, lanes: int) -> int:
    """Mask of the points, of those in some lanes at least, closer to an obstacle's primitive than `reach`."""
    return int(near_obstacle_of(obstacles.kinds[o] == CLOUD, obstacles, o, x, y, z, reach, lanes))


@lane_step(void(BODIES, SCRATCH_MEMORY))
def place_carriers(bodies: LaneBodies, scratch: Scratch) -> None:
    """Write the centres of the balls about carriers."""
    poses, around, carrying, centres = scratch.poses, bodies.around, bodies.carrying, scratch.centres
    for c in range(bodies.carriers):
        x, y, z = ball_centre(poses, carrying[c], around, c)
        store(centres, c * BLOCK, x)
        store(centres, c * BLOCK + LANES, y)
        store(centres, c * BLOCK + 2 * LANES, z)


@lane_part
def carrier_centre(centres: Floats32, c: int) -> tuple[Vector, Vector, Vector]:
    """The centre of the ball about a carrier, of those that `place_carriers` wrote, shape (m * BLOCK,)."""
    return points_at(centres, c * BLOCK)


@lane_part
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
