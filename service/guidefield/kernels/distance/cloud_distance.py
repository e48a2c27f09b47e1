"""Distance of single points to a cloud of balls: what the grid of distances can't tell, the tree does."""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, float64, int64, types

from guidefield.kernels.distance.point_tree import (
    CELL,
    CLOUD_TABLES,
    PER_LENGTH,
    RADIUS,
    LaneCloud,
    cloud_of,
    nearest_distance,
    nearest_point,
    words_at,
)
from guidefield.kernels.distance.shape_distance import Signed
from guidefield.kernels.jit.signatures import lane_step


@lane_step(boolean(CLOUD_TABLES, float64, float64, float64, float64))
def _beyond(cloud: LaneCloud, x: float, y: float, z: float, reach: float) -> bool:
    """Whether the grid tells that a point is farther than a reach from all points of a cloud."""
    n = cloud.numbers
    size, per = float(n[CELL]), float(n[PER_LENGTH])
    i = min(max(int((x - n[0]) * per + 0.5), 0), cloud.columns - 1)
    j = min(max(int((y - n[1]) * per + 0.5), 0), cloud.rows - 1)
    k = min(max(int((z - n[2]) * per + 0.5), 0), cloud.layers - 1)
    place = (i * cloud.rows + j) * cloud.layers + k
    u, v, w = i * size + n[0], j * size + n[1], k * size + n[2]
    known = float(cloud.cells[place])
    if known == 0.0:
        known = max(nearest_distance(cloud, u, v, w), 1e-20)
        cloud.cells[place] = np.float32(known)
    off = math.sqrt((x - u) * (x - u) + (y - v) * (y - v) + (z - w) * (z - w))
    return bool(known - off > reach + 1e-6)


@lane_step(boolean(int64, float64, float64, float64, float64))
def cloud_beyond(address: int, x: float, y: float, z: float, reach: float) -> bool:
    """Whether a point is certain to be farther than a reach from all balls of a cloud.

    Args:
        address: Where the words of the cloud are.
        x: Point in the cloud's frame [m], with y and z.
        y: See x.
        z: See x.
        reach: Distance [m].
    """
    cloud = cloud_of(words_at(address))
    return bool(_beyond(cloud, x, y, z, reach + cloud.numbers[RADIUS]))


@lane_step(types.UniTuple(float64, 4)(int64, float64, float64, float64, float64))
def cloud_distance(address: int, x: float, y: float, z: float, cutoff: float) -> Signed:
    """Signed distance of a point to the nearest ball of a cloud, and the unit vector along which it grows.

    Points are in float32, of which the one that is nearest may be missed by another that is as near to a micrometre.

    Args:
        address: Where the words of the cloud are.
        x: Point in the cloud's frame [m], with y and z.
        y: See x.
        z: See x.
        cutoff: Distance from which on the answer doesn't matter [m]; may be infinite or negative.

    Returns:
        Distance [m] and unit vector (3); infinite and zero beyond the cutoff.
    """
    cloud = cloud_of(words_at(address))
    radius = float(cloud.numbers[RADIUS])
    reach = min(max(cutoff + radius, 0.0), 1e15)
    if _beyond(cloud, x, y, z, reach):
        return math.inf, 0.0, 0.0, 0.0
    at = nearest_point(cloud, x, y, z, reach)
    if at < 0:
        return math.inf, 0.0, 0.0, 0.0
    dx, dy, dz = x - cloud.points[at], y - cloud.points[at + 16], z - cloud.points[at + 32]
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    if distance < 1e-12:
        return distance - radius, 0.0, 0.0, 1.0
    over = 1.0 / distance
    return distance - radius, over * dx, over * dy, over * dz
