"""Forces and torques on a chain that the seed's searches follow, and the places of its joints after their steps.

service/docs/algorithm.md, "Univariate". Only the links whose forces a search needs are evaluated: those that it moves,
of a chain that nothing holds the one that turns.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from guidefield.kernels.field.energy import link_wrenches, place_points
from guidefield.kernels.jit.signatures import Floats, Vector3, inlined
from guidefield.kernels.kinematics.forward_kinematics import joint_placements
from guidefield.kernels.kinematics.link_chain import close_chain, end_force, turn_from, turn_towards

SLIDE_END, SLIDE_WHOLE, TURN_TOWARDS, TURN_PAIR, TURN_FROM = range(5)
"""Searches: the last link slides; the chain slides; a link turns about its far end; two about a line; one about its
joint."""


class Strung(NamedTuple):
    """The chain at a configuration.

    Attributes:
        q: Configuration, shape (nq,).
        places: Of the joints and the end, shape (n + 1, 3) [m, world].
        rotations: Of the links in the world, shape (n, 3, 3).
    """

    q: Floats
    places: Floats
    rotations: Floats


class SweepRoom(NamedTuple):
    """Scratch: placements, wrenches, charged points, forces and torques on links, and what counts lanes."""

    world: Floats
    wrenches: Floats
    points: Floats
    weights: Floats
    forces: Floats
    torques: Floats
    end: Floats
    counting: Any


@inlined
def strung(nq: int, n: int) -> Any:
    """Room for a chain: length of a configuration, count of links."""
    return Strung(np.empty(nq), np.empty((n + 1, 3)), np.empty((n, 3, 3)))


@inlined
def put_at(chain: Any, joints: Any, carriers: Any, world: Floats, at: Any) -> None:
    """Places of joints and rotations of links from the configuration `at.q`.

    Args:
        chain: The chain.
        joints: The joints of its model.
        carriers: The joint that carries each link, shape (n,).
        world: Gets placements of joints, shape (joints, 3, 4) [m].
        at: Gets places and rotations.
    """
    n = carriers.shape[0]
    joint_placements(joints, at.q, world)
    for k in range(n):
        for r in range(3):
            at.places[k, r] = world[carriers[k], r, 3]
            for c in range(3):
                at.rotations[k, r, c] = world[carriers[k], r, c]
    R, link = at.rotations[n - 1], chain.links[n - 1]
    for r in range(3):
        at.places[n, r] = at.places[n - 1, r] + R[r, 0] * link[0] + R[r, 1] * link[1] + R[r, 2] * link[2]


@inlined
def _feel(joints: Any, carriers: Any, robot: Any, tables: Any, at: Any, low: int, high: int, room: Any) -> None:
    """Forces and torques (about the joint before) on links `low` to `high`, from 0, into the room."""
    world, origin = room.world, tables.origin
    joint_placements(joints, at.q, world)
    for i in range(world.shape[0]):
        for r in range(3):
            world[i, r, 3] -= origin[r]
    place_points(robot, world, room.points)
    link_wrenches(
        robot, tables, world, room.points, room.weights, carriers[low], carriers[high], room.counting, room.wrenches
    )
    for k in range(low, high + 1):
        f = room.wrenches[carriers[k]]
        x, y, z = at.places[k, 0] - origin[0], at.places[k, 1] - origin[1], at.places[k, 2] - origin[2]
        room.forces[k, 0], room.forces[k, 1], room.forces[k, 2] = f[0], f[1], f[2]
        room.torques[k, 0] = f[3] - (y * f[2] - z * f[1])
        room.torques[k, 1] = f[4] - (z * f[0] - x * f[2])
        room.torques[k, 2] = f[5] - (x * f[1] - y * f[0])


@inlined
def push(joints: Any, carriers: Any, robot: Any, tables: Any, at: Any, kind: int, k: int, room: Any) -> Vector3:
    """The force or torque that a search follows."""
    n = carriers.shape[0]
    low, high = 0, n - 1
    if kind in (TURN_TOWARDS, TURN_PAIR):
        high = k - 1
    elif kind == TURN_FROM:
        low, high = k - 1, k - 1
    _feel(joints, carriers, robot, tables, at, low, high, room)
    F, T, end, J = room.forces, room.torques, room.end, at.places
    if kind == TURN_FROM:  # tau_k alone: the seed's sequential strategy for a moving base
        return T[k - 1, 0], T[k - 1, 1], T[k - 1, 2]
    x, y, z = 0.0, 0.0, 0.0
    if kind == SLIDE_WHOLE:
        for i in range(n):
            x, y, z = x + F[i, 0], y + F[i, 1], z + F[i, 2]
        return x, y, z
    if kind == SLIDE_END:  # F_n + f2
        end_force(J, F, T, n - 1, end)
        return F[n - 1, 0] + end[0], F[n - 1, 1] + end[1], F[n - 1, 2] + end[2]
    if kind == TURN_PAIR:  # links 1 and 2 together, about J_0
        lx, ly, lz = J[1, 0] - J[0, 0], J[1, 1] - J[0, 1], J[1, 2] - J[0, 2]
        x, y, z = T[0, 0] + T[1, 0], T[0, 1] + T[1, 1], T[0, 2] + T[1, 2]
        fx, fy, fz = F[1, 0], F[1, 1], F[1, 2]
        return x + ly * fz - lz * fy, y + lz * fx - lx * fz, z + lx * fy - ly * fx
    # tau_k - l_k x (F_k + f2)
    end_force(J, F, T, k - 1, end)
    lx, ly, lz = J[k, 0] - J[k - 1, 0], J[k, 1] - J[k - 1, 1], J[k, 2] - J[k - 1, 2]
    fx, fy, fz = F[k - 1, 0] + end[0], F[k - 1, 1] + end[1], F[k - 1, 2] + end[2]
    x, y, z = T[k - 1, 0], T[k - 1, 1], T[k - 1, 2]
    return x - (ly * fz - lz * fy), y - (lz * fx - lx * fz), z - (lx * fy - ly * fx)


@inlined
def moved(kind: int, k: int, axis: Floats, step: float, here: Any, places_out: Floats, target: Floats) -> bool:
    """Places of joints after a step; False where the chain can't be closed.

    Args:
        kind: Which search.
        k: Which link, from 1.
        axis: Unit vector to slide along or turn about, shape (3,), in the world.
        step: How far [m or rad].
        here: The chain before it.
        places_out: Shape (n + 1, 3) [m, world].
        target: Scratch, shape (3,).
    """
    n = here.rotations.shape[0]
    if kind == TURN_FROM:
        turn_from(here.places, k, axis, step, places_out)
        return True
    if kind in (TURN_TOWARDS, TURN_PAIR):
        return turn_towards(here.places, k, axis, step, places_out)
    for i in range(n + 1):
        for c in range(3):
            places_out[i, c] = here.places[i, c] + (step * axis[c] if kind == SLIDE_WHOLE or i == n else 0.0)
    if kind == SLIDE_WHOLE:
        return True
    for c in range(3):
        target[c] = here.places[n - 1, c] + step * axis[c]
    return close_chain(places_out, n - 1, target)


@inlined
def across(at: Any, k: int, which: int, axis_out: Floats) -> None:
    """One of two unit vectors across link k and each other, carried with the link.

    Args:
        at: The chain.
        k: Which link, from 1.
        which: 0 or 1.
        axis_out: Shape (3,), in the world.
    """
    lx = at.places[k, 0] - at.places[k - 1, 0]
    ly = at.places[k, 1] - at.places[k - 1, 1]
    lz = at.places[k, 2] - at.places[k - 1, 2]
    length = math.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx / length, ly / length, lz / length
    R = at.rotations[k - 1]
    least, column = math.inf, 0
    for c in range(3):
        along = abs(R[0, c] * lx + R[1, c] * ly + R[2, c] * lz)
        if along < least:
            least, column = along, c
    x, y, z = R[0, column], R[1, column], R[2, column]
    along = x * lx + y * ly + z * lz
    x, y, z = x - along * lx, y - along * ly, z - along * lz
    over = 1.0 / math.sqrt(x * x + y * y + z * z)
    x, y, z = over * x, over * y, over * z
    if which == 1:
        x, y, z = ly * z - lz * y, lz * x - lx * z, lx * y - ly * x
    axis_out[0], axis_out[1], axis_out[2] = x, y, z
