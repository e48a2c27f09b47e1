"""A chain of joints from the world to a tip in SIMD batches of local coordinates: the tip's offset from a pose, rates.

Inverse kinematics, path constraints of trees and of the optimizer share it; `robot/group/kinematics.py` makes the
table, by these kinds of parts.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from guidefield.kernels.jit.arrays import Floats, Indices, Row, Rows
from guidefield.kernels.jit.decorators import inlined
from guidefield.kernels.kinematics.batch_forward_kinematics import rotation_of, row_after, row_times, row_turned
from guidefield.kernels.simd.rotations import (
    cosine_and_sine,
    quaternion_of_matrix,
    quaternion_of_vector,
    vector_of_quaternion,
)
from guidefield.kernels.simd.vector import LANES_64, load, store

TURN, SLIDE, BALL = range(3)
"""Kinds of parts: about z, along z, any rotation. Joints with several degrees of freedom are several parts."""

LANES = LANES_64  # configurations at once, in float64
COLUMN = 6 * LANES
"""Numbers of a column: how its coordinate turns what comes after it, and the velocity of that at the origin."""


class TipChain(NamedTuple):
    """The parts of a chain, from the world to the tip."""

    kinds: Indices  # of each part, shape (n,)
    sources: Indices  # the local coordinate that moves it, of a ball the first of three, shape (n,)
    scales: Rows  # what the value is by that coordinate: multiplier and offset, shape (n, 2)
    placements: Rows  # what is fixed after each part, as rows of rotation and translation, shape (n, 12) [m]
    first: Row  # what is fixed before the first, shape (12,) [m]
    lower: Row  # of the local coordinates, shape (nv,)
    upper: Row  # shape (nv,)


@inlined
def _append_fixed(pose: Any, fixed: Floats) -> Any:
    """A placement, row by row, with a fixed one after it."""
    a, b, c, x, d, e, f, y, g, h, i, z = pose
    a, b, c, x = row_after(a, b, c, x, fixed, 0)
    d, e, f, y = row_after(d, e, f, y, fixed, 0)
    g, h, i, z = row_after(g, h, i, z, fixed, 0)
    return a, b, c, x, d, e, f, y, g, h, i, z


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
    """Return the tip's rotation and translation, row by row in vectors [m], at local coordinates (nv * LANES,).

    `columns_out` (columns * COLUMN,) gets how each part moves the tip, three columns of a ball.
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
        here = chain.sources[k] * LANES
        a, b, c, x, d, e, f, y, g, h, i, z = pose
        if chain.kinds[k] == BALL:
            turn = quaternion_of_vector(load(zs, here), load(zs, here + LANES), load(zs, here + 2 * LANES))
            R = rotation_of(turn[0], turn[1], turn[2], turn[3])
            a, b, c = row_times(a, b, c, R)
            d, e, f = row_times(d, e, f, R)
            g, h, i = row_times(g, h, i, R)
            pose = (a, b, c, x, d, e, f, y, g, h, i, z)
            _store_turn(columns_out, at, a, d, g, x, y, z)
            _store_turn(columns_out, at + COLUMN, b, e, h, x, y, z)
            _store_turn(columns_out, at + 2 * COLUMN, c, f, i, x, y, z)
            at += 3 * COLUMN
        else:
            value = chain.scales[k, 0] * load(zs, here) + chain.scales[k, 1]
            if chain.kinds[k] == TURN:
                _store_turn(columns_out, at, c, f, i, x, y, z)
                cosine, sine = cosine_and_sine(value)
                a, b = row_turned(a, b, cosine, sine)
                d, e = row_turned(d, e, cosine, sine)
                g, h = row_turned(g, h, cosine, sine)
                pose = (a, b, c, x, d, e, f, y, g, h, i, z)
            else:
                for row in range(3):
                    store(columns_out, at + row * LANES, zero)
                store(columns_out, at + 3 * LANES, c)
                store(columns_out, at + 4 * LANES, f)
                store(columns_out, at + 5 * LANES, i)
                pose = (a, b, c, x + c * value, d, e, f, y + f * value, g, h, i, z + i * value)
            at += COLUMN
        pose = _append_fixed(pose, chain.placements[k])
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
    """Write how an offset of `tip_offset` changes by each local coordinate, by columns of `tip_pose`; (nv * COLUMN,).

    Rows of the translation, then of the rotation vector v, which changes by J_l(v)^-1 w, J_l^-1 = 1 - [v]/2 + rate
    [v]^2; rotation vectors of balls change by turns in the moved frame.
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
            to = (chain.sources[k] + j) * COLUMN
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
