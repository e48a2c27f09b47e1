"""Forces and torques on some links of a chain: the field of the scene on their points, and what other links add."""

from __future__ import annotations

from typing import Any

import numpy as np

from guidefield.kernels.field.energy import ends_at
from guidefield.kernels.field.field import LANES, add_field
from guidefield.kernels.field.field_tables import CAPSULE_RADIUS
from guidefield.kernels.field.primitives import capsule_at
from guidefield.kernels.jit.signatures import Floats, inlined
from guidefield.kernels.simd.vector import lanes_of, load, select, total


@inlined
def _add(wrench: Floats, sign: float, f: Any) -> None:
    for c in range(6):
        wrench[c] += sign * f[c]


@inlined
def _from_scene(robot: Any, tables: Any, points: Floats, low: int, high: int, wrenches: Floats) -> None:
    """Forces of the scene on points whose joints are from `low` to `high`, which stand together."""
    first, past = 0, robot.points.shape[0]
    while first < past and robot.point_joints[first] < low:
        first += 1
    while past > first and robot.point_joints[past - 1] > high:
        past -= 1
    if first == past:
        return
    width = past - first + (first - past) % LANES
    some, field = np.empty((3, width), points.dtype), np.zeros((6, width), points.dtype)
    for r in range(3):
        for i in range(width):
            some[r, i] = points[r, min(first + i, past - 1)]
    add_field(tables, some, 0, field)
    for i in range(past - first):
        w, joint = robot.weights[first + i], robot.point_joints[first + i]
        x, y, z = some[0, i], some[1, i], some[2, i]
        fx, fy, fz = -w * field[1, i], -w * field[2, i], -w * field[3, i]
        wrench = wrenches[joint]
        wrench[0] += fx
        wrench[1] += fy
        wrench[2] += fz
        wrench[3] += y * fz - z * fy
        wrench[4] += z * fx - x * fz
        wrench[5] += x * fy - y * fx


@inlined
def _between(
    robot: Any, k: int, world: Floats, points: Floats, weights: Floats, counting: Any, wrenches: Floats
) -> None:
    """Repulsion of a pair, on both links."""
    first, past, c = robot.pairs[k, 0], robot.pairs[k, 1], robot.pairs[k, 2]
    other = robot.capsule_joints[c]
    ax, ay, az, bx, by, bz = ends_at(robot.capsules[c], world[other])
    x, y, z = points[0], points[1], points[2]
    lane = load(counting, 0)
    zero = 0.0 * lane
    fx, fy, fz, mx, my, mz = zero, zero, zero, zero, zero, zero
    for i in range(first, past, lanes_of(counting)):
        X, Y, Z = load(x, i), load(y, i), load(z, i)
        w = select(lane < past - i, load(weights, i), 0.0)
        _, gx, gy, gz = capsule_at(X, Y, Z, ax, ay, az, bx, by, bz, robot.capsules[c, CAPSULE_RADIUS])
        gx, gy, gz = w * gx, w * gy, w * gz
        fx, fy, fz = fx - gx, fy - gy, fz - gz
        mx, my, mz = mx - (Y * gz - Z * gy), my - (Z * gx - X * gz), mz - (X * gy - Y * gx)
    wrench = (total(fx), total(fy), total(fz), total(mx), total(my), total(mz))
    _add(wrenches[robot.point_joints[first]], 1.0, wrench)
    _add(wrenches[other], -1.0, wrench)


@inlined
def link_wrenches(
    robot: Any, tables: Any, world: Floats, points: Floats, weights: Floats, low: int, high: int, counting: Any,
    wrenches_out: Floats,
) -> None:  # fmt: skip
    """Force and moment about the tables' origin on what joints from `low` to `high` carry.

    Points of a joint stand together, in the order of joints.

    Args:
        robot: What the joints carry.
        tables: What is charged.
        world: Placements of joints about the tables' origin, shape (n, 3, 4) [m].
        points: Charged points there, shape (3, lanes) [m].
        weights: Area that each stands for, shape (lanes,) [m^2].
        low: First joint.
        high: Last joint, one of them.
        counting: 0, 1, 2 .. in the precision of the tables, shape (LANES,).
        wrenches_out: Force [1] and moment [m], shape (n, 6); rows of other joints have no meaning.
    """
    wrenches_out[:, :] = 0.0
    _from_scene(robot, tables, points, low, high, wrenches_out)
    for k in range(robot.pairs.shape[0]):
        own, other = robot.point_joints[robot.pairs[k, 0]], robot.capsule_joints[robot.pairs[k, 2]]
        if low <= own <= high or low <= other <= high:
            _between(robot, k, world, points, weights, counting, wrenches_out)
