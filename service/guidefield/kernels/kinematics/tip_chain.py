"""A chain of joints from the world to a tip at several configurations at once: how far the tip is from a pose."""

from __future__ import annotations

from typing import Any, NamedTuple

from guidefield.kernels.jit.fields import Indices, Row, Rows, numba_type
from guidefield.kernels.jit.signatures import Floats, inlined
from guidefield.kernels.simd.rotations import (
    cosine_and_sine,
    quaternion_of_matrix,
    quaternion_of_vector,
    vector_of_quaternion,
)
from guidefield.kernels.simd.vector import LANES_64, load, store

TURN, SLIDE, BALL = range(3)
"""Kinds of parts: about z, along z, any rotation. Joints with several degrees of freedom are several parts."""

LANES = LANES_64
COLUMN = 6 * LANES
"""Numbers of a column: how its coordinate turns what comes after it, and the velocity of that at the origin."""


class TipChain(NamedTuple):
    """The parts of a chain, from the world to the tip.

    Attributes:
        kinds: Of each part, shape (n,).
        drivers: Which chart coordinate moves it, of a ball the first of three, shape (n,).
        scales: What the value is by that coordinate: multiplier and offset, shape (n, 2).
        placements: What is fixed after each part, as rows of rotation and translation, shape (n, 12) [m].
        first: What is fixed before the first, shape (12,) [m].
        lower: Of the chart coordinates, shape (nv,).
        upper: Shape (nv,).
    """

    kinds: Indices
    drivers: Indices
    scales: Rows
    placements: Rows
    first: Row
    lower: Row
    upper: Row


CHAIN = numba_type(TipChain)


@inlined
def _fixed_after(pose: Any, fixed: Floats) -> Any:
    """A placement, row by row, with a fixed one after it."""
    a, b, c, x, d, e, f, y, g, h, i, z = pose
    return (
        a * fixed[0] + b * fixed[4] + c * fixed[8],
        a * fixed[1] + b * fixed[5] + c * fixed[9],
        a * fixed[2] + b * fixed[6] + c * fixed[10],
        a * fixed[3] + b * fixed[7] + c * fixed[11] + x,
        d * fixed[0] + e * fixed[4] + f * fixed[8],
        d * fixed[1] + e * fixed[5] + f * fixed[9],
        d * fixed[2] + e * fixed[6] + f * fixed[10],
        d * fixed[3] + e * fixed[7] + f * fixed[11] + y,
        g * fixed[0] + h * fixed[4] + i * fixed[8],
        g * fixed[1] + h * fixed[5] + i * fixed[9],
        g * fixed[2] + h * fixed[6] + i * fixed[10],
        g * fixed[3] + h * fixed[7] + i * fixed[11] + z,
    )


@inlined
def _turned(pose: Any, x: Any, y: Any, z: Any, w: Any) -> Any:
    """A placement turned by a unit quaternion in its own frame."""
    a, b, c, t0, d, e, f, t1, g, h, i, t2 = pose
    xx, yy, zz = 2.0 * x * x, 2.0 * y * y, 2.0 * z * z
    xy, xz, yz, wx, wy, wz = 2.0 * x * y, 2.0 * x * z, 2.0 * y * z, 2.0 * w * x, 2.0 * w * y, 2.0 * w * z
    r0, r1, r2 = 1.0 - yy - zz, xy - wz, xz + wy
    r3, r4, r5 = xy + wz, 1.0 - xx - zz, yz - wx
    r6, r7, r8 = xz - wy, yz + wx, 1.0 - xx - yy
    return (
        a * r0 + b * r3 + c * r6, a * r1 + b * r4 + c * r7, a * r2 + b * r5 + c * r8, t0,
        d * r0 + e * r3 + f * r6, d * r1 + e * r4 + f * r7, d * r2 + e * r5 + f * r8, t1,
        g * r0 + h * r3 + i * r6, g * r1 + h * r4 + i * r7, g * r2 + h * r5 + i * r8, t2,
    )  # fmt: skip


@inlined
def _store_turn(columns: Floats, at: int, ax: Any, ay: Any, az: Any, x: Any, y: Any, z: Any) -> None:
    """The column of a turn about an axis through a point."""
    store(columns, at, ax)
    store(columns, at + LANES, ay)
    store(columns, at + 2 * LANES, az)
    store(columns, at + 3 * LANES, y * az - z * ay)
    store(columns, at + 4 * LANES, z * ax - x * az)
    store(columns, at + 5 * LANES, x * ay - y * ax)


@inlined
def tip_pose(chain: TipChain, zs: Floats, columns_out: Floats) -> Any:
    """Where the tip is, and how each part moves it.

    Args:
        chain: The chain.
        zs: Chart coordinates in lanes, shape (nv * LANES,).
        columns_out: Column by column, three of a ball, shape (columns * COLUMN,).

    Returns:
        Rotation and translation row by row, 12 values in lanes [m].
    """
    zero = 0.0 * load(zs, 0)
    first = chain.first
    pose = (
        first[0] + zero, first[1] + zero, first[2] + zero, first[3] + zero,
        first[4] + zero, first[5] + zero, first[6] + zero, first[7] + zero,
        first[8] + zero, first[9] + zero, first[10] + zero, first[11] + zero,
    )  # fmt: skip
    at = 0
    for k in range(chain.kinds.shape[0]):
        here = chain.drivers[k] * LANES
        a, b, c, x, d, e, f, y, g, h, i, z = pose
        if chain.kinds[k] == BALL:
            turn = quaternion_of_vector(load(zs, here), load(zs, here + LANES), load(zs, here + 2 * LANES))
            pose = _turned(pose, turn[0], turn[1], turn[2], turn[3])
            a, b, c, x, d, e, f, y, g, h, i, z = pose
            _store_turn(columns_out, at, a, d, g, x, y, z)
            _store_turn(columns_out, at + COLUMN, b, e, h, x, y, z)
            _store_turn(columns_out, at + 2 * COLUMN, c, f, i, x, y, z)
            at += 3 * COLUMN
        else:
            value = chain.scales[k, 0] * load(zs, here) + chain.scales[k, 1]
            if chain.kinds[k] == TURN:
                _store_turn(columns_out, at, c, f, i, x, y, z)
                cosine, sine = cosine_and_sine(value)
                pose = (
                    a * cosine + b * sine, b * cosine - a * sine, c, x,
                    d * cosine + e * sine, e * cosine - d * sine, f, y,
                    g * cosine + h * sine, h * cosine - g * sine, i, z,
                )  # fmt: skip
            else:
                for row in range(3):
                    store(columns_out, at + row * LANES, zero)
                store(columns_out, at + 3 * LANES, c)
                store(columns_out, at + 4 * LANES, f)
                store(columns_out, at + 5 * LANES, i)
                pose = (a, b, c, x + c * value, d, e, f, y + f * value, g, h, i, z + i * value)
            at += COLUMN
        pose = _fixed_after(pose, chain.placements[k])
    return pose


@inlined
def tip_offset(pose: Any) -> Any:
    """Translation and rotation vector of a placement, then what `vector_of_quaternion` says of that vector's rate."""
    a, b, c, x, d, e, f, y, g, h, i, z = pose
    turn = quaternion_of_matrix((a, b, c, d, e, f, g, h, i))
    rx, ry, rz, square, rate = vector_of_quaternion(turn[0], turn[1], turn[2], turn[3])
    return x, y, z, rx, ry, rz, square, rate


@inlined
def offset_rates(chain: TipChain, offset: Any, columns: Floats, rates_out: Floats) -> None:
    """How an offset changes by each chart coordinate, rotation vectors of balls by turns in the moved frame.

    The rotation vector v changes by J_l(v)^-1 w, J_l^-1 = 1 - [v]/2 + rate [v]^2.

    Args:
        chain: The chain.
        offset: As `tip_offset` has it.
        columns: As `tip_pose` wrote them.
        rates_out: Translation's three rows, then the rotation's, of each coordinate, shape (nv * COLUMN,).
    """
    x, y, z, rx, ry, rz, square, rate = offset
    zero = 0.0 * x
    for entry in range(6 * chain.lower.shape[0]):
        store(rates_out, entry * LANES, zero)
    straight, at = 1.0 - rate * square, 0
    for k in range(chain.kinds.shape[0]):
        for j in range(3 if chain.kinds[k] == BALL else 1):
            scale = chain.scales[k, 0]
            ax, ay, az = load(columns, at), load(columns, at + LANES), load(columns, at + 2 * LANES)
            along = rate * (rx * ax + ry * ay + rz * az)
            to = (chain.drivers[k] + j) * COLUMN
            rows = (
                load(columns, at + 3 * LANES) + ay * z - az * y,
                load(columns, at + 4 * LANES) + az * x - ax * z,
                load(columns, at + 5 * LANES) + ax * y - ay * x,
                straight * ax - 0.5 * (ry * az - rz * ay) + along * rx,
                straight * ay - 0.5 * (rz * ax - rx * az) + along * ry,
                straight * az - 0.5 * (rx * ay - ry * ax) + along * rz,
            )
            for row in range(6):
                store(rates_out, to + row * LANES, load(rates_out, to + row * LANES) + scale * rows[row])
            at += COLUMN
