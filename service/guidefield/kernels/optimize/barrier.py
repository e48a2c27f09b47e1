"""The barrier as a function of a distance, and what it is between: a robot as points, obstacles that move, each placed.

`planner/optimize/clearance_samples.py` fills `SampledRobot`, whose columns kernels read by place, and
`scene/distance_tables.py` `MovingBodies`. Such an obstacle is on a screw from each placement to the next, at rest
before the first and after the last, as proofs have it (`kernels/prove/placement.py`).

The optimizer alone reads what stands here, and no proof relies on it: with another `SOFT` (above 0, also in
service/docs/algorithm.md) or `STEEPNESS` it finds other motions.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from guidefield.kernels.distance.distance import DistanceTables
from guidefield.kernels.distance.points_distance import ROWS
from guidefield.kernels.jit.arrays import Blocks, Flags, Floats, IndexRows, Indices, Row, Rows, numba_type
from guidefield.kernels.jit.decorators import counted, inlined, uncounted
from guidefield.kernels.kinematics.forward_kinematics import (
    GroupJoints,
    JointPlaces,
    joint_places,
    place_group,
    write_twists,
)
from guidefield.kernels.kinematics.poses import moved_by, turned_by
from guidefield.kernels.simd.vector import LANES_64, select

SOFT = 0.01  # below this distance the barrier is its parabola [m], at size 1; below half the range where that is less
STEEPNESS = 100.0  # cost of a point in contact, besides the barrier's: a larger one keeps the floor more strictly

SMALL = 1e-3  # below this angle the factors of a screw are series [rad], exact to 1e-14 there; far less loses digits


@inlined
def barrier(distance: Any, reach: float, size: float) -> tuple[Any, Any, Any]:
    """The barrier of range `reach` at a distance, or at one in each lane: value and two derivatives by the distance.

    The size is that of the robot.
    """
    soft = min(SOFT * size, 0.5 * reach)
    within = distance < reach
    x = select(distance > soft, distance, soft) * (1.0 / reach)
    over = 1.0 / x
    cube = over * over * over
    gap = 1.0 - x
    value = gap * gap * cube
    slope = -(2.0 * gap + 3.0 * gap * gap * over) * cube / reach
    curvature = (2.0 + 12.0 * gap * over + 12.0 * gap * gap * over * over) * cube / (reach * reach)
    deeper = select(distance < soft, distance - soft, 0.0)
    return (
        select(within, value + deeper * (slope + 0.5 * deeper * curvature), 0.0),
        select(within, slope + deeper * curvature, 0.0),
        select(within, curvature, 0.0),
    )


@inlined
def deficit(distance: Any, floor: float) -> tuple[Any, Any, Any]:
    """Return what a distance below a floor, positive, costs, or one in each lane: value and two derivatives by it."""
    wanting = select(distance < floor, 1.0 - distance * (1.0 / floor), 0.0)
    curvature = select(distance < floor, 0.0 * distance + 2.0 * STEEPNESS / (floor * floor), 0.0)
    return STEEPNESS * wanting * wanting, -2.0 * STEEPNESS * wanting / floor, curvature


JOINT, FIRST, PAST, PAST_FEW = range(4)
"""Columns of a group of points: their joint, the first point, the one past the last, and the one past the few that
stand for all against links."""

RADIUS = 3  # row of the balls about blocks, after those of their centres

SUMS = 28
"""Numbers summed over a group's points: their barrier, their force (6), and their inertia's upper triangle (21)."""


class SampledRobot(NamedTuple):
    """A robot as points on the surface of its links, and as the links themselves."""

    joints: GroupJoints  # joints of the robot's model, and the coordinates that move them
    # (3, p) on moving links, in the frame of their joint [m]; those of a group stand together, and `LANES_64` after one
    # another from a group's first on, a block, near each other
    points: Rows
    weights: Row  # (p,) how much each counts
    groups: IndexRows  # (g, 4) `JOINT` and the columns after it
    balls: Rows  # (g, 4) centre and radius of a ball about a group's points, in the frame of the joint [m]
    blocks: Rows  # (4, n) the same about each block of points, by rows
    first_blocks: Indices  # (g,) the first block of each group
    ignored: Flags  # (g, obstacles) whether a group's distance to an obstacle doesn't count
    links: DistanceTables  # bodies of all collision shapes, in the frame of their joint
    link_joints: Indices  # (b,) joint of each of them; 0 is the world
    link_balls: Rows  # (b, 4) centre and radius of a ball about each, in the frame of its joint [m]
    pairs: IndexRows  # (k, 2) group and body of links that are kept apart
    pair_ranges: Row  # (k,) range of the barrier between them [m], positive
    size: float  # the robot's


ROBOT = numba_type(SampledRobot)


class Workspace(NamedTuple):
    """Scratch of `robot_barrier`, overwritten by every call; n joints, nv local coordinates of the model."""

    joints: JointPlaces  # placements of the joints, and how they move
    row: Floats  # gradient of one distance by them, shape (nv,)
    gradient: Floats  # sums by them, shapes (nv,) and (nv, nv)
    hessian: Floats
    links: Floats  # placements of the bodies of the links, shape (b, 3, 4) [m], filled where they are examined
    centres: Floats  # centres of the balls about groups and bodies, shapes (g, 3) and (b, 3) [m]
    link_centres: Floats
    columns: Floats  # twists by local coordinates of the model, by columns, shape (6, nv)
    forces: Floats  # what has gathered at each joint, shapes (n, 6) and (n, 6, 6), its upper triangle
    inertias: Floats
    candidates: np.ndarray  # bodies near a group
    gaps: Floats  # square of the distance from a group's points to the nearest box about a body [m^2]
    block_gaps: Floats  # the same of the centres of blocks [m^2]
    block: Floats  # one of which some lanes are empty: coordinates and weights, shape (4 times lanes,)
    lanes: Floats  # for distances lane by lane
    sums: Floats  # of a group, in vectors, shape (`SUMS` times lanes,)


@counted
def workspace(robot: SampledRobot, tables: DistanceTables) -> Workspace:
    """Scratch for a robot among some bodies."""
    n, nv = robot.joints.table.parents.shape[0], robot.joints.offsets.shape[0]
    return Workspace(
        joint_places(robot.joints),
        np.empty(nv),
        np.empty(nv),
        np.empty((nv, nv)),
        np.empty((robot.link_joints.shape[0], 3, 4)),
        np.empty((robot.groups.shape[0], 3)),
        np.empty((robot.link_joints.shape[0], 3)),
        np.empty((6, nv)),
        np.empty((n, 6)),
        np.empty((n, 6, 6)),
        np.empty(tables.kinds.shape[0], np.int64),
        np.empty(robot.points.shape[1]),
        np.empty(robot.blocks.shape[1]),
        np.empty(4 * LANES_64),
        np.empty(ROWS * LANES_64),
        np.empty(SUMS * LANES_64),
    )


@uncounted
def place(robot: SampledRobot, z: Floats, work: Workspace) -> None:
    """Write placements of joints, motion subspaces by local coordinates of the model, and centres of balls.

    Args:
        z: Local coordinates of the group, shape (nv,) [rad or m].
    """
    place_group(robot.joints, z, work.joints)
    write_twists(robot.joints, work.joints)
    for b in range(robot.link_joints.shape[0]):
        _centre(work.joints.poses[robot.link_joints[b]], robot.link_balls[b], work.link_centres[b])
    for g in range(robot.groups.shape[0]):
        _centre(work.joints.poses[robot.groups[g, JOINT]], robot.balls[g], work.centres[g])


@uncounted
def _centre(T: Floats, ball: Floats, centre_out: Floats) -> None:
    centre_out[0], centre_out[1], centre_out[2] = moved_by(T, ball[0], ball[1], ball[2])


@uncounted
def place_link(robot: SampledRobot, b: int, work: Workspace) -> None:
    """Fill in the placement of a link's body."""
    outer, inner, placement_out = work.joints.poses[robot.link_joints[b]], robot.links.placements[b], work.links[b]
    for r in range(3):
        for c in range(4):
            value = outer[r, 3] if c == 3 else 0.0
            placement_out[r, c] = (
                value + outer[r, 0] * inner[0, c] + outer[r, 1] * inner[1, c] + outer[r, 2] * inner[2, c]
            )


@uncounted
def lower_gaps(
    T: Floats, points: Floats, first: int, last: int, tables: DistanceTables, body: int, gaps_out: Floats
) -> None:
    """Lower the gaps of points to those to the box about a body; a vector loop.

    Args:
        T: Placement of the points' frame, shape (3, 4) [m].
        points: By rows, at least (3, p) [m].
        gaps_out: Squares of distances, shape (p,) [m²].
    """
    B, bounds = tables.placements[body], tables.bounds[body]
    r00 = B[0, 0] * T[0, 0] + B[1, 0] * T[1, 0] + B[2, 0] * T[2, 0]
    r01 = B[0, 0] * T[0, 1] + B[1, 0] * T[1, 1] + B[2, 0] * T[2, 1]
    r02 = B[0, 0] * T[0, 2] + B[1, 0] * T[1, 2] + B[2, 0] * T[2, 2]
    r10 = B[0, 1] * T[0, 0] + B[1, 1] * T[1, 0] + B[2, 1] * T[2, 0]
    r11 = B[0, 1] * T[0, 1] + B[1, 1] * T[1, 1] + B[2, 1] * T[2, 1]
    r12 = B[0, 1] * T[0, 2] + B[1, 1] * T[1, 2] + B[2, 1] * T[2, 2]
    r20 = B[0, 2] * T[0, 0] + B[1, 2] * T[1, 0] + B[2, 2] * T[2, 0]
    r21 = B[0, 2] * T[0, 1] + B[1, 2] * T[1, 1] + B[2, 2] * T[2, 1]
    r22 = B[0, 2] * T[0, 2] + B[1, 2] * T[1, 2] + B[2, 2] * T[2, 2]
    dx, dy, dz = T[0, 3] - B[0, 3], T[1, 3] - B[1, 3], T[2, 3] - B[2, 3]
    tx = B[0, 0] * dx + B[1, 0] * dy + B[2, 0] * dz
    ty = B[0, 1] * dx + B[1, 1] * dy + B[2, 1] * dz
    tz = B[0, 2] * dx + B[1, 2] * dy + B[2, 2] * dz
    lx, ly, lz, hx, hy, hz = bounds[0], bounds[1], bounds[2], bounds[3], bounds[4], bounds[5]
    # slices: an index that might be negative keeps the loop from becoming a vector loop
    px, py, pz, gaps = points[0, first:last], points[1, first:last], points[2, first:last], gaps_out[first:last]
    for i in range(gaps.shape[0]):
        x = r00 * px[i] + r01 * py[i] + r02 * pz[i] + tx
        y = r10 * px[i] + r11 * py[i] + r12 * pz[i] + ty
        z = r20 * px[i] + r21 * py[i] + r22 * pz[i] + tz
        ex = max(lx - x, x - hx, 0.0)
        ey = max(ly - y, y - hy, 0.0)
        ez = max(lz - z, z - hz, 0.0)
        gaps[i] = min(gaps[i], ex * ex + ey * ey + ez * ez)


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
    sums: Floats  # of a group, in vectors: derivatives by time of its barrier (2) and its force, shape (8 times lanes,)


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
