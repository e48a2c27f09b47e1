"""Bodies of obstacles that move, placed where they are at a time, with the velocities of what carries them.

`scene/distance_tables.py` makes the tables. A motion is on a screw from each placement to the next, at rest before the
first and after the last, as proofs have it (`kernels/prove/placement.py`). The optimizer alone reads what stands here.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.distance.distance import DistanceTables
from guidefield.kernels.jit.arrays import Blocks, Floats, IndexRows, Indices, Row, Rows, numba_type
from guidefield.kernels.jit.decorators import counted, uncounted
from guidefield.kernels.kinematics.poses import turned_by
from guidefield.kernels.simd.vector import LANES_64

SMALL = 1e-3  # below this angle the factors of a screw are series [rad], exact to 1e-14 there; far less loses digits


class MovingBodies(NamedTuple):
    """Bodies of obstacles that move: n of m motions."""

    bodies: DistanceTables  # each placed in the frame of its motion, without a tree
    motions: Indices  # which motion is each one's, shape (n,)
    spans: IndexRows  # first row of each motion, and the one past its last, shape (m, 2)
    times: Row  # when a motion is on its placements, shape (r,) [s]
    placements: Blocks  # these, rotation and translation of the frame in the world, shape (r, 3, 4) [m]
    # velocity of the frame in itself from there to the next, linear part first, 0 from the last one on; shape (r, 6)
    # [m/s and rad/s]
    twists: Rows


MOVING = numba_type(MovingBodies)

BY_TIME = 8  # numbers summed over a group's points: two derivatives of their barrier by time, and those of their force


class MovedBodies(NamedTuple):
    """Scratch: bodies where they are at a time, and what gathers of how the barrier changes with it."""

    bodies: DistanceTables  # placed in the world
    frames: Floats  # placements of the motions' frames, shape (m, 3, 4) [m]
    velocities: Floats  # of what each frame carries at the world's origin, then angular, shape (m, 6) [m/s and rad/s]
    placed: Floats  # what the bodies are placed by, shape (n, 3, 4) [m]
    candidates: np.ndarray  # bodies near a group of points
    forces: Floats  # derivatives by time of what has gathered at each joint, shape (joints, 6) [1/s]
    row: Floats  # the same by the local coordinates of the model, shape (nv,)
    by_time: Floats  # first and second derivative of the barrier by time [1/s and 1/s²]
    sums: Floats  # of a group, in lanes: derivatives by time of its barrier (2) and its force, shape (8 times lanes,)


@counted
def moved_bodies(moving: MovingBodies, joints: int, nv: int) -> MovedBodies:
    """Scratch for a robot of a given number of joints and local coordinates."""
    t = moving.bodies
    placed = np.empty((t.kinds.shape[0], 3, 4))
    bodies = DistanceTables(
        t.kinds, t.obstacles, placed, t.sizes, t.bounds, t.boxes, t.spans, t.anchors, t.nodes, t.surfaces, t.clouds
    )
    motions = moving.spans.shape[0]
    return MovedBodies(
        bodies,
        np.empty((motions, 3, 4)),
        np.empty((motions, 6)),
        placed,
        np.empty(t.kinds.shape[0], np.int64),
        np.empty((joints, 6)),
        np.empty(nv),
        np.empty(2),
        np.empty(BY_TIME * LANES_64),
    )


@uncounted
def place_moved(moving: MovingBodies, time: float, moved: MovedBodies) -> None:
    """Place all bodies where they are at a time [s]."""
    for k in range(moving.spans.shape[0]):
        first, past = moving.spans[k, 0], moving.spans[k, 1]
        row = first
        while row + 1 < past and moving.times[row + 1] <= time:
            row += 1
        _on_screw(moving.placements[row], moving.twists[row], max(time - moving.times[row], 0.0), moved.frames[k])
        _velocity(moved.frames[k], moving.twists[row], time >= moving.times[first], moved.velocities[k])
    for b in range(moving.motions.shape[0]):
        frame, own, placed = moved.frames[moving.motions[b]], moving.bodies.placements[b], moved.placed[b]
        for r in range(3):
            for c in range(4):
                value = frame[r, 3] if c == 3 else 0.0
                placed[r, c] = value + frame[r, 0] * own[0, c] + frame[r, 1] * own[1, c] + frame[r, 2] * own[2, c]


@uncounted
def _on_screw(start: Floats, twist: Floats, time: float, placement_out: Floats) -> None:
    """Write where a frame is that has been on a screw for a time, from a placement (3, 4) on."""
    x, y, z = time * twist[0], time * twist[1], time * twist[2]
    u, v, w = time * twist[3], time * twist[4], time * twist[5]
    square = u * u + v * v + w * w
    if square < SMALL * SMALL:
        a, b, c = 1.0 - square / 6.0, 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        angle = math.sqrt(square)
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
        c = (1.0 - a) / square
    uv, uw, vw = b * u * v, b * u * w, b * v * w
    r00, r01, r02 = 1.0 - b * (v * v + w * w), uv - a * w, uw + a * v
    r10, r11, r12 = uv + a * w, 1.0 - b * (u * u + w * w), vw - a * u
    r20, r21, r22 = uw - a * v, vw + a * u, 1.0 - b * (u * u + v * v)
    across = (v * z - w * y, w * x - u * z, u * y - v * x)
    px = x + b * across[0] + c * (v * across[2] - w * across[1])
    py = y + b * across[1] + c * (w * across[0] - u * across[2])
    pz = z + b * across[2] + c * (u * across[1] - v * across[0])
    for r in range(3):
        s0, s1, s2 = start[r, 0], start[r, 1], start[r, 2]
        placement_out[r, 0] = s0 * r00 + s1 * r10 + s2 * r20
        placement_out[r, 1] = s0 * r01 + s1 * r11 + s2 * r21
        placement_out[r, 2] = s0 * r02 + s1 * r12 + s2 * r22
        placement_out[r, 3] = start[r, 3] + s0 * px + s1 * py + s2 * pz


@uncounted
def _velocity(frame: Floats, twist: Floats, begun: bool, velocity_out: Floats) -> None:
    """The velocity (6,) of what a placed frame carries, by its twist in itself; 0 if it has not begun."""
    velocity_out[:] = 0.0
    if not begun:
        return
    lx, ly, lz = turned_by(frame, twist[0], twist[1], twist[2])
    wx, wy, wz = turned_by(frame, twist[3], twist[4], twist[5])
    velocity_out[0] = lx + frame[1, 3] * wz - frame[2, 3] * wy
    velocity_out[1] = ly + frame[2, 3] * wx - frame[0, 3] * wz
    velocity_out[2] = lz + frame[0, 3] * wy - frame[1, 3] * wx
    velocity_out[3], velocity_out[4], velocity_out[5] = wx, wy, wz
