"""Path constraints of chart points: their numbers and derivatives, and the way back onto them by Newton's method.

A constraint is one number about a frame that must not exceed a limit; a chain of joints, of one coordinate each, moves
the frame. The number and its derivative are those of robot/group/path_constraints.py.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import boolean, int64

from guidefield.kernels.jit.fields import Indices, Row, Rows, numba_type
from guidefield.kernels.jit.signatures import SCALAR, VECTOR, VECTOR_OUT, Floats, Vector3, compiled, inlined
from guidefield.kernels.kinematics.tip_chain import COLUMN, LANES, TipChain, tip_pose
from guidefield.kernels.linalg.small_systems import invert
from guidefield.kernels.linalg.vectors import cross, dot
from guidefield.kernels.simd.vector import store

CONE, NEAR = range(2)
"""Kinds of constraints: an axis of a frame within a cone; a frame's origin near a plane or a line."""

AXIS, TARGET, POINT, ACROSS, SECOND_ACROSS, VECTORS = 0, 3, 0, 3, 6, 9
"""Columns of vectors: of a cone the axis in the frame and the target in the world; of what is near a point in the world
and two directions across, the second 0 for a plane; then how many columns there are."""

_RIDGE = 1e-12
"""Added to the diagonal of the system of a step [1, for numbers in rad and m]: constraints may depend on each other."""

_REACHED = 1e-6
"""A number that is beyond what is aimed at by less than this share of it has got there."""


class KeptFrames(NamedTuple):
    """Path constraints, k of them, on a group of nv coordinates.

    Attributes:
        kinds: CONE or NEAR, shape (k,).
        vectors: Shape (k, VECTORS).
        limits: Shape (k,) [rad or m].
        begins: Where the parts of each one's chain begin in `chain`, shape (k + 1,).
        firsts: What is fixed before the first part of each, shape (k, 12) [m].
        chain: The parts of all chains, one chain after the other; its own first placement says nothing.
    """

    kinds: Indices
    vectors: Rows
    limits: Row
    begins: Indices
    firsts: Rows
    chain: TipChain


FRAMES = numba_type(KeptFrames)


class Measured(NamedTuple):
    """Memory in which constraints are measured.

    Attributes:
        zs: (nv * LANES,) a chart point in lanes.
        columns: What `tip_pose` writes.
        pose: (12 * LANES,) the frame's placement in lanes.
        values: (k,) the numbers [rad or m].
        rows: (k, nv) their derivatives by the chart.
    """

    zs: Floats
    columns: Floats
    pose: Floats
    values: Floats
    rows: Floats


@inlined
def room_to_measure(frames: KeptFrames) -> Measured:
    """Memory for these constraints."""
    nv, k = frames.chain.lower.shape[0], frames.kinds.shape[0]
    columns = np.empty(COLUMN * max(frames.chain.kinds.shape[0], 1))
    return Measured(np.empty(nv * LANES), columns, np.empty(12 * LANES), np.empty(k), np.empty((k, nv)))


@inlined
def _chain_of(frames: KeptFrames, c: int) -> TipChain:
    """The chain of joints that moves the frame of a constraint."""
    first, past, chain = frames.begins[c], frames.begins[c + 1], frames.chain
    return TipChain(
        chain.kinds[first:past], chain.drivers[first:past], chain.scales[first:past], chain.placements[first:past],
        frames.firsts[c], chain.lower, chain.upper,
    )  # fmt: skip


@inlined
def _triple(row: Floats, at: int) -> Vector3:
    return row[at], row[at + 1], row[at + 2]


@inlined
def _number(kind: int, vectors: Floats, pose: Floats) -> tuple[float, Vector3, Vector3]:
    """A constraint's number, and its derivatives by how the frame's origin moves and by how the frame turns."""
    zero = (0.0, 0.0, 0.0)
    if kind == CONE:
        axis, target = _triple(vectors, AXIS), _triple(vectors, TARGET)
        pointing = (
            pose[0] * axis[0] + pose[LANES] * axis[1] + pose[2 * LANES] * axis[2],
            pose[4 * LANES] * axis[0] + pose[5 * LANES] * axis[1] + pose[6 * LANES] * axis[2],
            pose[8 * LANES] * axis[0] + pose[9 * LANES] * axis[1] + pose[10 * LANES] * axis[2],
        )
        normal = cross(target, pointing)
        sine = math.sqrt(dot(normal, normal))
        over = 1.0 / sine if sine > 0.0 else 0.0
        return math.atan2(sine, dot(target, pointing)), zero, (over * normal[0], over * normal[1], over * normal[2])
    point, one, other = _triple(vectors, POINT), _triple(vectors, ACROSS), _triple(vectors, SECOND_ACROSS)
    away = (pose[3 * LANES] - point[0], pose[7 * LANES] - point[1], pose[11 * LANES] - point[2])
    a, b = dot(one, away), dot(other, away)
    distance = math.sqrt(a * a + b * b)
    a, b = (a / distance, b / distance) if distance > 0.0 else (0.0, 0.0)
    return distance, (a * one[0] + b * other[0], a * one[1] + b * other[1], a * one[2] + b * other[2]), zero


@inlined
def _write_row(
    chain: TipChain, columns: Floats, origin: Vector3, moves: Vector3, turns: Vector3, row_out: Floats
) -> None:
    """A number's derivative by the chart, from those by how its frame moves and turns."""
    row_out[:] = 0.0
    for k in range(chain.kinds.shape[0]):
        at = k * COLUMN
        turn = (columns[at], columns[at + LANES], columns[at + 2 * LANES])
        carried = cross(turn, origin)
        slide = (
            columns[at + 3 * LANES] + carried[0],
            columns[at + 4 * LANES] + carried[1],
            columns[at + 5 * LANES] + carried[2],
        )
        row_out[chain.drivers[k]] += chain.scales[k, 0] * (dot(moves, slide) + dot(turns, turn))


@inlined
def measure(frames: KeptFrames, z: Floats, measured: Measured) -> None:
    """Write the numbers of constraints at a chart point, shape (nv,), and their derivatives."""
    for j in range(z.shape[0]):
        measured.zs[j * LANES : (j + 1) * LANES] = z[j]
    for c in range(frames.kinds.shape[0]):
        chain = _chain_of(frames, c)
        for entry, value in enumerate(tip_pose(chain, measured.zs, measured.columns)):
            store(measured.pose, entry * LANES, value)
        pose = measured.pose
        value, moves, turns = _number(frames.kinds[c], frames.vectors[c], pose)
        measured.values[c] = value
        origin = (pose[3 * LANES], pose[7 * LANES], pose[11 * LANES])
        _write_row(chain, measured.columns, origin, moves, turns, measured.rows[c])


@compiled(SCALAR(FRAMES, VECTOR))
def largest_share(frames: KeptFrames, z: Floats) -> float:
    """The largest share of its limit that a constraint's number is, at a chart point, shape (nv,)."""
    measured, largest = room_to_measure(frames), 0.0
    measure(frames, z, measured)
    for c in range(frames.kinds.shape[0]):
        largest = max(largest, measured.values[c] / frames.limits[c])
    return largest


@compiled(boolean(FRAMES, SCALAR, int64, VECTOR_OUT))
def bring_back(frames: KeptFrames, room: float, most: int, z: Floats) -> bool:
    """Move a chart point onto path constraints by Newton's steps of least length on the numbers that are too large.

    Args:
        frames: The constraints.
        room: The share of each limit that is aimed at.
        most: Steps at most.
        z: The point, shape (nv,); changed, and within limits after a step.

    Returns:
        Whether it got there.
    """
    measured, k, nv = room_to_measure(frames), frames.kinds.shape[0], z.shape[0]
    gram, excess, chosen, weights = np.empty((k, k)), np.empty(k), np.empty(k, np.int64), np.empty(k)
    for _ in range(most):
        measure(frames, z, measured)
        count, there = 0, True
        for c in range(k):
            over = measured.values[c] - room * frames.limits[c]
            there &= over <= _REACHED * room * frames.limits[c]
            if over > 0.0:
                chosen[count], excess[count] = c, over
                count += 1
        if there:
            return True
        for a in range(count):
            for b in range(count):
                total = _RIDGE if a == b else 0.0
                for j in range(nv):
                    total += measured.rows[chosen[a], j] * measured.rows[chosen[b], j]
                gram[a, b] = total
        invert(gram, count)
        for a in range(count):
            weights[a] = 0.0
            for b in range(count):
                weights[a] += gram[a, b] * excess[b]
        for j in range(nv):
            step = 0.0
            for a in range(count):
                step += weights[a] * measured.rows[chosen[a], j]
            z[j] = min(max(z[j] - step, frames.chain.lower[j]), frames.chain.upper[j])
    return False
