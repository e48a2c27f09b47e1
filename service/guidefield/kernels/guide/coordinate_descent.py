"""One round of the minimizer Univariate: a slide, then every link in turn, each by a search for one number.

service/docs/algorithm.md, "Univariate". A search follows the sign of a projected force or torque: steps of one size as
long as it stays, reversed and halved where it changes, halved where a trial isn't free. Only the links whose forces a
search needs are evaluated: those that it moves, of a chain that nothing holds the one that turns.
`planner/guide/guide.py` calls it, for robots that are chains of ball or universal joints; settings are its own. Another
rule leads to other motions: each is tested here, and certified like any.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.collide.swept_bounds import SWEPT, motion_apart
from guidefield.kernels.distance.distance import TABLES as BODIES
from guidefield.kernels.field.energy import ROBOT, link_wrenches, place_points
from guidefield.kernels.field.field import LANES, TABLES_32
from guidefield.kernels.guide.tip_constraint import COUNTS_OUT, EVALUATIONS, GUARD, JUDGED, allows
from guidefield.kernels.jit.arrays import INDICES, MATRIX_OUT, VECTOR, Floats, Vector3, numba_type
from guidefield.kernels.jit.decorators import compiled, inlined
from guidefield.kernels.kinematics.forward_kinematics import JOINTS, joint_placements, local_values
from guidefield.kernels.kinematics.link_chain import (
    CHAIN,
    chain_configuration,
    close_chain,
    end_force,
    turn_from,
    turn_towards,
)

SLIDE_END, SLIDE_WHOLE, TURN_TOWARDS, TURN_PAIR, TURN_FROM = range(5)
"""Searches: the last link slides; the chain slides; a link turns about its far end; two about a line; one about its
joint."""


class Strung(NamedTuple):
    """A chain of links at a configuration."""

    q: Floats  # configuration, shape (nq,)
    places: Floats  # of the joints and the end, shape (n + 1, 3) [m, world]
    rotations: Floats  # of the links in the world, shape (n, 3, 3)


class SweepBuffers(NamedTuple):
    """Buffers of one round; n joints."""

    world: Floats  # placements of joints about the tables' origin, shape (n, 3, 4) [m]
    wrenches: Floats  # on what each joint carries, shape (n, 6)
    points: Floats  # charged points, shape (3, lanes) [m]
    weights: Floats  # their areas, shape (lanes,) [m^2]
    forces: Floats  # on each link [1], and torques about the joint before it [m], shapes (links, 3)
    torques: Floats
    end: Floats  # `end_force`, shape (3,)
    counting: Any  # 0, 1, 2 .. in a vector


@inlined
def strung(nq: int, n: int) -> Any:
    """Buffers for a chain: length of a configuration, count of links."""
    return Strung(np.empty(nq), np.empty((n + 1, 3)), np.empty((n, 3, 3)))


@inlined
def put_at(chain: Any, joints: Any, parent_joints: Any, world: Floats, at: Any) -> None:
    """Write places of joints and rotations of links from the configuration `at.q`, and placements (joints, 3, 4) [m].

    `parent_joints` (n,) has the joint that carries each link.
    """
    n = parent_joints.shape[0]
    joint_placements(joints, at.q, world)
    for k in range(n):
        for r in range(3):
            at.places[k, r] = world[parent_joints[k], r, 3]
            for c in range(3):
                at.rotations[k, r, c] = world[parent_joints[k], r, c]
    R, link = at.rotations[n - 1], chain.links[n - 1]
    for r in range(3):
        at.places[n, r] = at.places[n - 1, r] + R[r, 0] * link[0] + R[r, 1] * link[1] + R[r, 2] * link[2]


@inlined
def _feel(joints: Any, parent_joints: Any, robot: Any, tables: Any, at: Any, low: int, high: int, buffers: Any) -> None:
    """Forces and torques (about the joint before) on links `low` to `high`, from 0, into the buffers."""
    world, origin = buffers.world, tables.origin
    joint_placements(joints, at.q, world)
    for i in range(world.shape[0]):
        for r in range(3):
            world[i, r, 3] -= origin[r]
    place_points(robot, world, buffers.points)
    link_wrenches(
        robot,
        tables,
        world,
        buffers.points,
        buffers.weights,
        parent_joints[low],
        parent_joints[high],
        buffers.counting,
        buffers.wrenches,
    )
    for k in range(low, high + 1):
        f = buffers.wrenches[parent_joints[k]]
        x, y, z = at.places[k, 0] - origin[0], at.places[k, 1] - origin[1], at.places[k, 2] - origin[2]
        buffers.forces[k, 0], buffers.forces[k, 1], buffers.forces[k, 2] = f[0], f[1], f[2]
        buffers.torques[k, 0] = f[3] - (y * f[2] - z * f[1])
        buffers.torques[k, 1] = f[4] - (z * f[0] - x * f[2])
        buffers.torques[k, 2] = f[5] - (x * f[1] - y * f[0])


@inlined
def push(joints: Any, parent_joints: Any, robot: Any, tables: Any, at: Any, kind: int, k: int, buffers: Any) -> Vector3:
    """The force or torque that a search follows."""
    n = parent_joints.shape[0]
    low, high = 0, n - 1
    if kind in (TURN_TOWARDS, TURN_PAIR):
        high = k - 1
    elif kind == TURN_FROM:
        low, high = k - 1, k - 1
    _feel(joints, parent_joints, robot, tables, at, low, high, buffers)
    F, T, end, J = buffers.forces, buffers.torques, buffers.end, at.places
    if kind == TURN_FROM:  # tau_k alone: of a chain that nothing holds
        return T[k - 1, 0], T[k - 1, 1], T[k - 1, 2]
    x, y, z = 0.0, 0.0, 0.0
    if kind == SLIDE_WHOLE:
        for i in range(n):
            x, y, z = x + F[i, 0], y + F[i, 1], z + F[i, 2]
        return x, y, z
    if kind == SLIDE_END:  # F_n + f, f as `end_force` has it
        end_force(J, F, T, n - 1, end)
        return F[n - 1, 0] + end[0], F[n - 1, 1] + end[1], F[n - 1, 2] + end[2]
    if kind == TURN_PAIR:  # links 1 and 2 together, about J_0
        lx, ly, lz = J[1, 0] - J[0, 0], J[1, 1] - J[0, 1], J[1, 2] - J[0, 2]
        x, y, z = T[0, 0] + T[1, 0], T[0, 1] + T[1, 1], T[0, 2] + T[1, 2]
        fx, fy, fz = F[1, 0], F[1, 1], F[1, 2]
        return x + ly * fz - lz * fy, y + lz * fx - lx * fz, z + lx * fy - ly * fx
    # tau_k - l_k x (F_k + f)
    end_force(J, F, T, k - 1, end)
    lx, ly, lz = J[k, 0] - J[k - 1, 0], J[k, 1] - J[k - 1, 1], J[k, 2] - J[k - 1, 2]
    fx, fy, fz = F[k - 1, 0] + end[0], F[k - 1, 1] + end[1], F[k - 1, 2] + end[2]
    x, y, z = T[k - 1, 0], T[k - 1, 1], T[k - 1, 2]
    return x - (ly * fz - lz * fy), y - (lz * fx - lx * fz), z - (lx * fy - ly * fx)


@inlined
def move_places(kind: int, k: int, axis: Floats, step: float, here: Any, places_out: Floats, target: Floats) -> bool:
    """Write places of joints (n + 1, 3) after a step of a search [m, world]; False where the chain can't be closed.

    Along or about `axis` (3,), by `step` [m or rad], of link k, from 1; scratch (3,).
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
    """Write one of two unit vectors (3,) across link k, from 1, and each other, carried with the link."""
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


_MOST_TRIALS = 80  # trials of one search


class Searching(NamedTuple):
    """Settings of searches."""

    # first_turn, last_turn: A search for an angle begins with the one and ends below the other [rad]
    first_turn: float
    last_turn: float
    # first_slide, last_slide: The same for a slide [m]
    first_slide: float
    last_slide: float
    margin: float  # distance kept from obstacles [m]
    self_margin: float  # what capsules of the robot keep from each other [m]
    floor: float  # motions are halved down to this [m]


SEARCHING = numba_type(Searching)


@inlined
def _within(limits: Any, q: Floats) -> bool:
    """Tell if no value is beyond its limits: where values stand, the lower limits, the upper ones."""
    values, lower, upper = limits
    for k in range(values.shape[0]):
        at = values[k]
        if at >= 0 and (q[at] < lower[k] or q[at] > upper[k]):
            return False
    return True


@inlined
def _kind_of(leads: int, task: int, n: int) -> tuple[int, int, int]:
    """Kind, link, and which axis across it, of a round's task, by its number."""
    if task == 0:
        return (SLIDE_WHOLE if leads == 1 else SLIDE_END), n, 0
    if leads == 1:
        return TURN_FROM, 1 + (task - 1) // 2, (task - 1) % 2
    k = n - (task - 1) // 2
    if k > 2:
        return TURN_TOWARDS, k, (task - 1) % 2
    return TURN_PAIR, 2, 0


@inlined
def _axis_of(kind: int, k: int, which: int, at: Any, felt: Vector3, normal: Floats, axis_out: Floats) -> bool:
    """Write the axis along or about which a search goes; False where there is none."""
    if kind in (TURN_FROM, TURN_TOWARDS):
        across(at, k, which, axis_out)
        return True
    x, y, z = felt
    if kind == TURN_PAIR:
        x, y, z = (
            at.places[2, 0] - at.places[0, 0], at.places[2, 1] - at.places[0, 1], at.places[2, 2] - at.places[0, 2],
        )  # fmt: skip
    else:
        along = x * normal[0] + y * normal[1] + z * normal[2]
        x, y, z = x - along * normal[0], y - along * normal[1], z - along * normal[2]
    length = math.sqrt(x * x + y * y + z * z)
    if length <= (1e-9 if kind == TURN_PAIR else 0.0):
        return False
    axis_out[0], axis_out[1], axis_out[2] = x / length, y / length, z / length
    return True


@inlined
def _steps(searching: Any, kind: int, slope: float) -> tuple[float, float]:
    """First and last step of a search, the first along its slope."""
    slides = kind in (SLIDE_END, SLIDE_WHOLE)
    first = searching.first_slide if slides else searching.first_turn
    last = searching.last_slide if slides else searching.last_turn
    return first if slope > 0.0 else -first, last


@inlined
def _free(
    chain: Any, joints: Any, leads: int, swept: Any, bodies: Any, guard: Any, searching: Any, limits: Any, here: Any,
    there: Any, z0: Floats, z1: Floats, counts_out: Any,
) -> bool:  # fmt: skip
    """Tell if a step may be taken: the guard allows the tip, the joints can stand there, and the path is free."""
    tip = there.places[0 if leads == 1 else there.rotations.shape[0]]
    if not allows(guard, (tip[0], tip[1], tip[2])):
        return False
    if not chain_configuration(chain, there.places, here.q, here.rotations, there.q, there.rotations):
        return False
    if not _within(limits, there.q):
        return False
    z1[:] = 0.0
    local_values(joints, here.q, swept.origin, z1, z0)
    local_values(joints, there.q, swept.origin, z0, z1)
    counts_out[JUDGED] += 1
    return bool(motion_apart(swept, bodies, z0, z1, searching.margin, searching.self_margin, searching.floor))


@compiled(
    types.int64(
        *(CHAIN, JOINTS, INDICES, types.int64, ROBOT, TABLES_32, SWEPT, BODIES, GUARD, SEARCHING),
        *(INDICES, VECTOR, VECTOR, VECTOR, VECTOR, MATRIX_OUT, COUNTS_OUT),
    )
)
def sweep(
    chain: Any, joints: Any, parent_joints: Any, leads: int, robot: Any, tables: Any, swept: Any, bodies: Any,
    guard: Any, searching: Any, values: Any, lower: Floats, upper: Floats, normal: Floats, q: Floats, path_out: Floats,
    counts_out: Any,
) -> int:  # fmt: skip
    """Make one round: slide, then reorient every link; return how many configurations were accepted.

    `parent_joints` (n,) has the joint of each link; `leads` is 1 where the first joint is the tip and nothing holds it.
    A motion that the capsules can't tell is free is not taken. `values` (nv,) is where values with limits `lower` and
    `upper` (nv,) stand, -1 where there are none, `normal` (3,) that of the plane in which the tip slides, `path_out`
    (most, nq) gets the configurations accepted, where it is full the round ends; `counts_out` (COUNTS,) is added to.
    """
    n, kind_of_lane = parent_joints.shape[0], tables.boxes.dtype
    lanes = robot.points.shape[0] + 2 * LANES
    counting, weights = np.empty(LANES, kind_of_lane), np.zeros(lanes, kind_of_lane)
    for i in range(LANES):
        counting[i] = i
    for i in range(robot.points.shape[0]):
        weights[i] = robot.weights[i]
    count = joints.parents.shape[0]
    buffers = SweepBuffers(
        np.empty((count, 3, 4)), np.empty((count, 6)), np.empty((3, lanes), kind_of_lane), weights, np.zeros((n, 3)),
        np.zeros((n, 3)), np.empty(3), counting,
    )  # fmt: skip
    here, there = strung(q.shape[0], n), strung(q.shape[0], n)
    axis, target = np.empty(3), np.empty(3)
    z0, z1 = np.empty(lower.shape[0]), np.empty(lower.shape[0])
    here.q[:] = q
    put_at(chain, joints, parent_joints, buffers.world, here)
    taken = 0
    for task in range(1 + 2 * n if leads == 1 else 2 * n - 2):
        kind, k, which = _kind_of(leads, task, n)
        felt = push(joints, parent_joints, robot, tables, here, kind, k, buffers)
        counts_out[EVALUATIONS] += 1
        if not _axis_of(kind, k, which, here, felt, normal, axis):
            continue
        slope = felt[0] * axis[0] + felt[1] * axis[1] + felt[2] * axis[2]
        step, last = _steps(searching, kind, slope)
        trials = 0 if slope != 0.0 else _MOST_TRIALS
        while trials < _MOST_TRIALS and abs(step) >= last and taken < path_out.shape[0]:
            trials += 1
            free = move_places(kind, k, axis, step, here, there.places, target) and _free(
                chain, joints, leads, swept, bodies, guard, searching, (values, lower, upper), here, there, z0, z1,
                counts_out,
            )  # fmt: skip
            if not free:
                step *= 0.5
                continue
            here, there = there, here
            path_out[taken] = here.q
            taken += 1
            felt = push(joints, parent_joints, robot, tables, here, kind, k, buffers)
            counts_out[EVALUATIONS] += 1
            if (felt[0] * axis[0] + felt[1] * axis[1] + felt[2] * axis[2]) * step < 0.0:
                step *= -0.5
    return taken
