"""Which pairs of bodies a slab tells apart: two parallel planes with one body on the far side of each.

Whatever direction a slab has across, it proves that the bodies are as far apart as it is thick: how the direction was
found needs no trust. Gilbert's algorithm finds it. The differences of a point of one body and a point of the other are
a convex set; its point nearest to the origin is looked for between the nearest one so far and the one that is farthest
against that.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.certificate.tables import CertifiedObstacles, CertifiedRobot
from guidefield.kernels.jit.no_refcount import lane_uncounted
from guidefield.kernels.jit.signatures import Floats

SLACK = 1e-9
"""What slabs have to be thicker by, for rounding, of a metre and of each metre that they are from the origin [m]."""

STEPS = 8
"""So many directions are tried: with 16 a tenth less is left for Coal, which takes as long as the search for it."""

TINY = 1e-300
"""Squares of lengths that are no less are divided by [m^2]."""


@lane_uncounted
def _farthest_of_body(robot: CertifiedRobot, b: int, place: Floats, across: Floats, sign: float, found: Floats) -> None:
    """The point of the core about a body that is farthest along a direction, times a sign, shape (3,) [m, world].

    Args:
        robot: The robot.
        b: The body.
        place: ``T_world_joint`` of the joint that carries it, shape (12,) [m].
        across: The direction, shape (3,).
        sign: 1 or -1.
        found: Out.
    """
    x = sign * (place[0] * across[0] + place[4] * across[1] + place[8] * across[2])
    y = sign * (place[1] * across[0] + place[5] * across[1] + place[9] * across[2])
    z = sign * (place[2] * across[0] + place[6] * across[1] + place[10] * across[2])
    corners, at, farthest = robot.corners, 0, -np.inf
    for k in range(robot.corners_from[b], robot.corners_from[b + 1]):
        along = x * corners[k, 0] + y * corners[k, 1] + z * corners[k, 2]
        if along > farthest:
            at, farthest = k, along
    cx, cy, cz = corners[at, 0], corners[at, 1], corners[at, 2]
    axis = robot.disc_axes[b]
    along = x * axis[0] + y * axis[1] + z * axis[2]
    x, y, z = x - along * axis[0], y - along * axis[1], z - along * axis[2]
    out = math.sqrt(x * x + y * y + z * z)
    if robot.discs[b] > 0.0 and out > 0.0:
        out = robot.discs[b] / out
        cx, cy, cz = cx + out * x, cy + out * y, cz + out * z
    for i in range(3):
        found[i] = place[4 * i] * cx + place[4 * i + 1] * cy + place[4 * i + 2] * cz + place[4 * i + 3]


@lane_uncounted
def _farthest_of_obstacle(obstacles: CertifiedObstacles, o: int, across: Floats, found: Floats) -> None:
    """The point of the core about an obstacle that is farthest against a direction (3,), shape (3,) [m, world]."""
    axes, cores, middles = obstacles.axes[o], obstacles.cores[o], obstacles.middles[o]
    x = -(across[0] * axes[0] + across[1] * axes[3] + across[2] * axes[6])
    y = -(across[0] * axes[1] + across[1] * axes[4] + across[2] * axes[7])
    z = -(across[0] * axes[2] + across[1] * axes[5] + across[2] * axes[8])
    cx = middles[0] + math.copysign(cores[0], x)
    cy = middles[1] + math.copysign(cores[1], y)
    cz = middles[2] + math.copysign(cores[2], z)
    out = math.sqrt(x * x + y * y)
    if obstacles.discs[o] > 0.0 and out > 0.0:
        cx, cy = cx + obstacles.discs[o] / out * x, cy + obstacles.discs[o] / out * y
    for i in range(3):
        found[i] = axes[3 * i] * cx + axes[3 * i + 1] * cy + axes[3 * i + 2] * cz


@lane_uncounted
def _needed(robot: CertifiedRobot, obstacles: CertifiedObstacles, a: int, b: int, margin: float) -> float:
    """How far apart the cores of two bodies are where these are a margin apart [m]; infinite where one has none."""
    count = robot.carriers.shape[0]
    if robot.corners_from[a] == robot.corners_from[a + 1]:
        return np.inf
    if b >= count:
        return float(margin + robot.rounded[a] + obstacles.rounded[b - count])
    if robot.corners_from[b] == robot.corners_from[b + 1]:
        return np.inf
    return float(margin + robot.rounded[a] + robot.rounded[b])


@lane_uncounted
def _find_slab(
    robot: CertifiedRobot, obstacles: CertifiedObstacles, a: int, b: int, placements: Floats, room: Floats
) -> float:
    """Find the slab across the first row of the room, and points of both cores on its planes, the other two rows.

    Returns:
        How thick it certainly is, whatever numbers are rounded [m].
    """
    count = robot.carriers.shape[0]
    _farthest_of_body(robot, a, placements[robot.carriers[a]], room[0], 1.0, room[1])
    if b < count:
        _farthest_of_body(robot, b, placements[robot.carriers[b]], room[0], -1.0, room[2])
    else:
        _farthest_of_obstacle(obstacles, b - count, room[0], room[2])
    thick, scale = 0.0, 1.0
    for i in range(3):
        thick += room[0, i] * (room[2, i] - room[1, i])
        scale += abs(room[1, i]) + abs(room[2, i])
    return thick - SLACK * scale


@lane_uncounted
def slab_between(
    robot: CertifiedRobot,
    obstacles: CertifiedObstacles,
    a: int,
    b: int,
    margin: float,
    placements: Floats,
    room: Floats,
) -> bool:
    """Whether a slab that is thicker than a margin is found between two bodies.

    Args:
        robot: The robot.
        obstacles: The obstacles.
        a: A body of the robot.
        b: Another one, or an obstacle, whose numbers follow those of the bodies.
        margin: At least 0 [m].
        placements: ``T_world_joint`` of every joint, shape (joints, 12) [m].
        room: The direction from a to b across which the first slab is, of any length, then room; shape (3, 3).
    """
    needed, across = _needed(robot, obstacles, a, b, margin), room[0]
    if needed == np.inf:
        return False
    for step in range(STEPS):
        x, y, z = across[0], across[1], across[2]
        apart = math.sqrt(x * x + y * y + z * z)
        if apart <= (needed if step > 0 else 0.0):
            return False  # two points of the cores are no farther apart
        across[0], across[1], across[2] = x / apart, y / apart, z / apart
        if _find_slab(robot, obstacles, a, b, placements, room) > needed:
            return True
        dx, dy, dz = room[2, 0] - room[1, 0] - x, room[2, 1] - room[1, 1] - y, room[2, 2] - room[1, 2] - z
        share = 1.0
        if step > 0:
            share = -(x * dx + y * dy + z * dz) / max(dx * dx + dy * dy + dz * dz, TINY)
        if share <= 0.0:
            return False
        share = min(1.0, share)
        across[0], across[1], across[2] = x + share * dx, y + share * dy, z + share * dz
    return False
