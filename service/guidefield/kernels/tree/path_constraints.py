"""Path constraints in local coordinates: their numbers and derivatives, and the way back onto them by Newton's method.

A constraint is one number about a frame that must not exceed a limit; a chain of joints, of one coordinate each, moves
the frame. The number and its derivative are those of robot/group/path_constraints.py, which makes the tables: kinds and
columns have to be the same there. Trees, the optimizer and certificates rely on the same numbers.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import Floats, Indices, Row, RowOut, Rows, Vector3, numba_type
from guidefield.kernels.jit.decorators import inlined, kernel
from guidefield.kernels.kinematics.tip_chain import COLUMN, LANES, TipChain, tip_pose
from guidefield.kernels.linalg.small_systems import cross, dot, invert
from guidefield.kernels.simd.vector import store

CONE, NEAR, EVEN_TURN = range(3)
"""Kinds of constraints: an axis of a frame within a cone; a frame's origin near a plane, line or point; a frame that
turns evenly on its way."""

AXIS, TARGET, POINT, ACROSS, SHARE, TURN, BEGIN, VECTORS = 0, 3, 0, 3, 3, 6, 9, 18
"""Columns of vectors: of a cone the axis in the frame and the target in the world; of what is near a point in the world
and three directions across, the last 0 for a line, the last two for a plane; of an even turn a point in the world, the
share of the way by the origin's place, the whole turn, and the rotation at first, row by row; then how many columns
there are."""

_RIDGE = 1e-12
"""Added to the diagonal of the system of a step [1, for numbers in rad and m]: constraints may depend on each other."""

_REACHED = 1e-6  # share of an aimed number by which it may be exceeded at the end


class KeptFrames(NamedTuple):
    """Path constraints, k of them, on a group of nv coordinates."""

    kinds: Indices  # CONE, NEAR or EVEN_TURN, shape (k,)
    vectors: Rows  # shape (k, VECTORS)
    limits: Row  # shape (k,) [rad or m]
    begins: Indices  # where the parts of each one's chain begin in `chain`, shape (k + 1,)
    firsts: Rows  # what is fixed before the first part of each, shape (k, 12) [m]
    sames: Indices  # the first constraint about the same frame as each, shape (k,)
    chain: TipChain  # the parts of all chains, one chain after the other; its own first placement says nothing


FRAMES = numba_type(KeptFrames)


class Measured(NamedTuple):
    """Buffers in which constraints are measured."""

    zs: Floats  # (nv * LANES,) local coordinates of a SIMD batch
    columns: Floats  # what `tip_pose` writes, for the parts of all chains
    poses: Floats  # (k, 12 * LANES) the frames' placements in a batch, in the row of the first constraint about each


@inlined
def allocate_measured(frames: KeptFrames) -> Measured:
    """Allocate the buffers for these constraints."""
    nv, k = frames.chain.lower.shape[0], frames.kinds.shape[0]
    columns = np.empty(COLUMN * max(frames.chain.kinds.shape[0], 1))
    return Measured(np.empty(nv * LANES), columns, np.empty((k, 12 * LANES)))


@inlined
def _chain_of(frames: KeptFrames, c: int) -> TipChain:
    first, past, chain = frames.begins[c], frames.begins[c + 1], frames.chain
    return TipChain(
        chain.kinds[first:past], chain.sources[first:past], chain.scales[first:past], chain.placements[first:past],
        frames.firsts[c], chain.lower, chain.upper,
    )  # fmt: skip


@inlined
def _triple(row: Floats, at: int) -> Vector3:
    return row[at], row[at + 1], row[at + 2]


@inlined
def _origin(pose: Floats, lane: int) -> Vector3:
    return pose[3 * LANES + lane], pose[7 * LANES + lane], pose[11 * LANES + lane]


@inlined
def _even_turn(vectors: Floats, pose: Floats, lane: int) -> tuple[float, Vector3, Vector3]:
    """The angle of a frame away from an even turn, and its derivatives, as in `_number`.

    The rotation away is E = R B^T W^T, with B the rotation at first and W that of the turn so far; W^T is its cosine's,
    sine's and axis' (Rodrigues).
    """
    point, along, whole = _triple(vectors, POINT), _triple(vectors, SHARE), _triple(vectors, TURN)
    origin = _origin(pose, lane)
    share = dot(along, (origin[0] - point[0], origin[1] - point[1], origin[2] - point[2]))
    angle = math.sqrt(dot(whole, whole))
    over = 1.0 / angle if angle > 0.0 else 0.0
    axis = (over * whole[0], over * whole[1], over * whole[2])
    cosine, sine = (math.cos(share * angle), math.sin(share * angle)) if angle > 0.0 else (1.0, 0.0)
    rows = (
        _away(_turned_row(vectors, pose, 0, lane), axis, cosine, sine),
        _away(_turned_row(vectors, pose, 4, lane), axis, cosine, sine),
        _away(_turned_row(vectors, pose, 8, lane), axis, cosine, sine),
    )
    twice = (rows[2][1] - rows[1][2], rows[0][2] - rows[2][0], rows[1][0] - rows[0][1])
    size = math.sqrt(dot(twice, twice))
    over = 1.0 / size if size > 0.0 else 0.0
    normal = (over * twice[0], over * twice[1], over * twice[2])
    by_share = -dot(normal, whole)
    moves = (by_share * along[0], by_share * along[1], by_share * along[2])
    return math.atan2(size, rows[0][0] + rows[1][1] + rows[2][2] - 1.0), moves, normal


@inlined
def _turned_row(vectors: Floats, pose: Floats, row: int, lane: int) -> Vector3:
    """A row of R B^T."""
    here = (pose[row * LANES + lane], pose[(row + 1) * LANES + lane], pose[(row + 2) * LANES + lane])
    return (
        dot(here, _triple(vectors, BEGIN)),
        dot(here, _triple(vectors, BEGIN + 3)),
        dot(here, _triple(vectors, BEGIN + 6)),
    )


@inlined
def _away(row: Vector3, axis: Vector3, cosine: float, sine: float) -> Vector3:
    """A row of a matrix times W^T: the row turned by W."""
    across, along = cross(axis, row), (1.0 - cosine) * dot(axis, row)
    return (
        cosine * row[0] + sine * across[0] + along * axis[0],
        cosine * row[1] + sine * across[1] + along * axis[1],
        cosine * row[2] + sine * across[2] + along * axis[2],
    )


@inlined
def _number(kind: int, vectors: Floats, pose: Floats, lane: int) -> tuple[float, Vector3, Vector3]:
    """A constraint's number, and its derivatives by how the frame's origin moves and by how the frame turns."""
    zero = (0.0, 0.0, 0.0)
    if kind == CONE:
        axis, target = _triple(vectors, AXIS), _triple(vectors, TARGET)
        pointing = (
            pose[lane] * axis[0] + pose[LANES + lane] * axis[1] + pose[2 * LANES + lane] * axis[2],
            pose[4 * LANES + lane] * axis[0] + pose[5 * LANES + lane] * axis[1] + pose[6 * LANES + lane] * axis[2],
            pose[8 * LANES + lane] * axis[0] + pose[9 * LANES + lane] * axis[1] + pose[10 * LANES + lane] * axis[2],
        )
        normal = cross(target, pointing)
        sine = math.sqrt(dot(normal, normal))
        over = 1.0 / sine if sine > 0.0 else 0.0
        return math.atan2(sine, dot(target, pointing)), zero, (over * normal[0], over * normal[1], over * normal[2])
    if kind == EVEN_TURN:
        return _even_turn(vectors, pose, lane)
    point, origin = _triple(vectors, POINT), _origin(pose, lane)
    one, other, third = _triple(vectors, ACROSS), _triple(vectors, ACROSS + 3), _triple(vectors, ACROSS + 6)
    away = (origin[0] - point[0], origin[1] - point[1], origin[2] - point[2])
    a, b, c = dot(one, away), dot(other, away), dot(third, away)
    distance = math.sqrt(a * a + b * b + c * c)
    over = 1.0 / distance if distance > 0.0 else 0.0
    a, b, c = over * a, over * b, over * c
    moves = (
        a * one[0] + b * other[0] + c * third[0],
        a * one[1] + b * other[1] + c * third[1],
        a * one[2] + b * other[2] + c * third[2],
    )
    return distance, moves, zero


@inlined
def place(frames: KeptFrames, measured: Measured) -> None:
    """Place all frames at the local coordinates of a SIMD batch."""
    for c in range(frames.kinds.shape[0]):
        if frames.sames[c] == c:
            columns = measured.columns[frames.begins[c] * COLUMN :]
            for entry, value in enumerate(tip_pose(_chain_of(frames, c), measured.zs, columns)):
                store(measured.poses[c], entry * LANES, value)


@inlined
def place_one(frames: KeptFrames, z: Floats, measured: Measured) -> None:
    """Place all frames at local coordinates (nv,), in every lane."""
    for j in range(z.shape[0]):
        measured.zs[j * LANES : (j + 1) * LANES] = z[j]
    place(frames, measured)


@inlined
def number(frames: KeptFrames, c: int, measured: Measured, lane: int) -> float:
    """A constraint's number at the local coordinates in a lane [rad or m]."""
    return _number(frames.kinds[c], frames.vectors[c], measured.poses[frames.sames[c]], lane)[0]


@inlined
def write_row(frames: KeptFrames, c: int, measured: Measured, lane: int, row_out: Floats) -> None:
    """The derivative of a constraint's number by coordinates (nv,), from those by how its frame moves and turns."""
    same = frames.sames[c]
    chain, columns, pose = _chain_of(frames, same), measured.columns, measured.poses[same]
    _, moves, turns = _number(frames.kinds[c], frames.vectors[c], pose, lane)
    origin = _origin(pose, lane)
    row_out[:] = 0.0
    for k in range(chain.kinds.shape[0]):
        at = (frames.begins[same] + k) * COLUMN + lane
        turn = (columns[at], columns[at + LANES], columns[at + 2 * LANES])
        carried = cross(turn, origin)
        slide = (
            columns[at + 3 * LANES] + carried[0],
            columns[at + 4 * LANES] + carried[1],
            columns[at + 5 * LANES] + carried[2],
        )
        row_out[chain.sources[k]] += chain.scales[k, 0] * (dot(moves, slide) + dot(turns, turn))


@kernel
def largest_share(frames: KeptFrames, z: Row) -> float:
    """The largest share of its limit that a constraint's number is, at local coordinates (nv,)."""
    measured, largest = allocate_measured(frames), 0.0
    place_one(frames, z, measured)
    for c in range(frames.kinds.shape[0]):
        largest = max(largest, number(frames, c, measured, 0) / frames.limits[c])
    return largest


@kernel
def bring_back(frames: KeptFrames, room: float, most: int, z: RowOut) -> bool:
    """Move coordinates (nv,) onto path constraints by Newton's steps of least length on numbers that are too large.

    `room` is the share of each limit that is aimed at; at most `most` steps, each within limits. Tells whether it got
    there.
    """
    measured, k, nv = allocate_measured(frames), frames.kinds.shape[0], z.shape[0]
    gram, excess, weights = np.empty((k, k)), np.empty(k), np.empty(k)
    rows = np.empty((k, nv))
    for _ in range(most):
        place_one(frames, z, measured)
        count, there = 0, True
        for c in range(k):
            over = number(frames, c, measured, 0) - room * frames.limits[c]
            there &= over <= _REACHED * room * frames.limits[c]
            if over > 0.0:
                excess[count] = over
                write_row(frames, c, measured, 0, rows[count])
                count += 1
        if there:
            return True
        for a in range(count):
            for b in range(count):
                total = _RIDGE if a == b else 0.0
                for j in range(nv):
                    total += rows[a, j] * rows[b, j]
                gram[a, b] = total
        invert(gram, count)
        for a in range(count):
            weights[a] = 0.0
            for b in range(count):
                weights[a] += gram[a, b] * excess[b]
        for j in range(nv):
            step = 0.0
            for a in range(count):
                step += weights[a] * rows[a, j]
            z[j] = min(max(z[j] - step, frames.chain.lower[j]), frames.chain.upper[j])
    return False
