"""Which pairs of bodies a slab tells apart: two parallel planes with one body on the far side of each.

Whatever direction a slab has across, it proves that the bodies are as far apart as it is thick: how the direction was
found needs no trust. It is found as GJK does. The differences of a point of one body and a point of the other are a
convex set; its point nearest to the origin is looked for in the hull of the few found so far and the one that is
farthest against the nearest of these (`certificate.simplex`).
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.certificate.discs import unit_across
from guidefield.kernels.certificate.simplex import POINTS, nearest_in
from guidefield.kernels.certificate.tables import CertifiedObstacles, CertifiedRobot
from guidefield.kernels.jit.no_refcount import lane_uncounted
from guidefield.kernels.jit.signatures import Floats

SLACK = 1e-9
"""What slabs have to be thicker by, for rounding, of a metre and of each metre that they are from the origin [m]."""

STEPS = 10
"""So many directions are tried: after these, 12 of 1400 pairs about a Panda's motions are neither told apart nor told
to be within their margin."""

CLOSE = 0.1
"""Where two bodies are known to be within their margin, how far they are apart is told to this share of it: it decides
only how finely a motion is divided. Unrecorded."""

UNKNOWN = 1e300
"""How far bodies are apart of which nothing is told: farther than any margin [m]."""

ACROSS, NEAR, FAR, SIMPLEX, SLAB = 0, 1, 2, 3, 3 + POINTS
"""Rows of what a slab is found in: the direction across, a point of each core on its planes, and where the simplex of
differences begins; then how many there are."""


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
    disc = robot.discs[b]
    if disc > 0.0:
        axis = robot.disc_axes[b]
        x, y, z = unit_across(x, y, z, axis[0], axis[1], axis[2])
        cx, cy, cz = cx + disc * x, cy + disc * y, cz + disc * z
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
    disc = obstacles.discs[o]
    if disc > 0.0:
        x, y, _ = unit_across(x, y, z, 0.0, 0.0, 1.0)
        cx, cy = cx + disc * x, cy + disc * y
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
    """Find the slab across the first row of the room, and points of both cores on its planes, the next two rows.

    Returns:
        How thick it certainly is, whatever numbers are rounded [m].
    """
    count = robot.carriers.shape[0]
    _farthest_of_body(robot, a, placements[robot.carriers[a]], room[ACROSS], 1.0, room[NEAR])
    if b < count:
        _farthest_of_body(robot, b, placements[robot.carriers[b]], room[ACROSS], -1.0, room[FAR])
    else:
        _farthest_of_obstacle(obstacles, b - count, room[ACROSS], room[FAR])
    thick, scale = 0.0, 1.0
    for i in range(3):
        thick += room[ACROSS, i] * (room[FAR, i] - room[NEAR, i])
        scale += abs(room[NEAR, i]) + abs(room[FAR, i])
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
) -> float:
    """How far two bodies are apart, as far as slabs tell: infinite where one is thicker than a margin.

    Args:
        robot: The robot.
        obstacles: The obstacles.
        a: A body of the robot.
        b: Another one, or an obstacle, whose numbers follow those of the bodies.
        margin: At least 0 [m].
        placements: ``T_world_joint`` of every joint, shape (joints, 12) [m].
        room: The direction from a to b across which the first slab is, of any length, then room; shape (SLAB, 3).

    Returns:
        Infinite, or how far two points of the bodies' cores are apart, less what rounds both [m]: bodies that fill
        their cores are no farther apart. `UNKNOWN` where a body has no core.
    """
    needed, across, simplex = _needed(robot, obstacles, a, b, margin), room[ACROSS], room[SIMPLEX:]
    if needed == np.inf:
        return UNKNOWN
    nearest, thickest, count = UNKNOWN, 0.0, 0
    for _ in range(STEPS):
        x, y, z = across[0], across[1], across[2]
        apart = math.sqrt(x * x + y * y + z * z)
        if count > 0:
            nearest = apart  # it is between two points of the cores
        if apart < SLACK or count == POINTS:
            break  # they touch
        across[0], across[1], across[2] = x / apart, y / apart, z / apart
        thick = _find_slab(robot, obstacles, a, b, placements, room)
        if thick > needed:
            return np.inf
        thickest = max(thickest, thick)
        if nearest <= needed and nearest - thickest <= CLOSE * margin:
            break
        for i in range(3):
            simplex[count, i] = room[FAR, i] - room[NEAR, i]
        if count > 0 and nearest - _along(simplex[count], across) <= SLACK * (1.0 + nearest):
            break  # no point is nearer
        count = nearest_in(simplex, count + 1, across)
    return float(nearest - (needed - margin))


@lane_uncounted
def _along(point: Floats, across: Floats) -> float:
    """How far a point (3,) is along a direction (3,) [m]."""
    return float(point[0] * across[0] + point[1] * across[1] + point[2] * across[2])
