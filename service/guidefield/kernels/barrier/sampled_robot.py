"""A robot as points on its surface, their placements, and the barrier as a function of a distance.

`planner/optimize/clearance_samples.py` fills `SampledRobot`; kernels read its columns by place. `SOFT` (also stated in
service/docs/algorithm.md) and `STEEPNESS` may be changed: the optimizer then finds other motions, and no proof relies
on them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from guidefield.kernels.distance.distance import DistanceTables
from guidefield.kernels.distance.points_distance import ROWS
from guidefield.kernels.jit.arrays import Flags, Floats, IndexRows, Indices, Row, Rows, numba_type
from guidefield.kernels.jit.decorators import counted, inlined, uncounted
from guidefield.kernels.kinematics.forward_kinematics import (
    GroupJoints,
    JointPlaces,
    joint_places,
    place_group,
    write_twists,
)
from guidefield.kernels.kinematics.poses import moved_by
from guidefield.kernels.simd.vector import LANES_64, select

SOFT = 0.01  # below this distance the barrier is its parabola [m], at size 1; below half the range where that is less
STEEPNESS = 100.0  # cost of a point in contact, besides the barrier's: a larger one keeps the floor more strictly


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
    sums: Floats  # of a group, in lanes, shape (`SUMS` times lanes,)


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
