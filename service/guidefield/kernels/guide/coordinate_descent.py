"""One round of the seed's minimizer: a slide, then every link in turn, each by a search for one number.

service/docs/algorithm.md, "Univariate". A search follows the sign of a projected force or torque: steps of one size as
long as it stays, reversed and halved where it changes, halved where a trial isn't free. Only the links whose forces a
search needs are evaluated: those that it moves, of a chain that nothing holds the one that turns.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.distance.distance import TABLES as BODIES
from guidefield.kernels.field.energy import ROBOT
from guidefield.kernels.field.field import LANES
from guidefield.kernels.field.field_tables import TABLES_32
from guidefield.kernels.guide.tip_constraint import COUNTS_OUT, EVALUATIONS, GUARD, JUDGED, allows
from guidefield.kernels.guide.univariate_search import (
    SLIDE_END,
    SLIDE_WHOLE,
    TURN_FROM,
    TURN_PAIR,
    TURN_TOWARDS,
    SweepRoom,
    across,
    moved,
    push,
    put_at,
    strung,
)
from guidefield.kernels.jit.fields import numba_type
from guidefield.kernels.jit.signatures import INDICES, MATRIX_OUT, VECTOR, Floats, Vector3, compiled, inlined
from guidefield.kernels.kinematics.forward_kinematics import JOINTS
from guidefield.kernels.kinematics.link_chain import CHAIN, chain_configuration
from guidefield.kernels.kinematics.local_coordinates import chart_values
from guidefield.kernels.sweep.swept import motion_apart
from guidefield.kernels.sweep.swept_bounds import SWEPT

_MOST_TRIALS = 80
"""Trials of one search."""


class Searching(NamedTuple):
    """Settings of searches.

    Attributes:
        first_turn, last_turn: A search for an angle begins with the one and ends below the other [rad].
        first_slide, last_slide: The same for a slide [m].
        margin: Distance kept from obstacles [m].
        self_margin: What capsules of the robot keep from each other [m].
        floor: Motions are halved down to this [m].
    """

    first_turn: float
    last_turn: float
    first_slide: float
    last_slide: float
    margin: float
    self_margin: float
    floor: float


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
    """Of a round's tasks in order: kind, link, and which axis across it."""
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
    """Along or about what a search goes; False where there is nothing to follow."""
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
    """Tell if a step may be taken: the guard allows the tip, the joints can stand there, and the way is free."""
    tip = there.places[0 if leads == 1 else there.rotations.shape[0]]
    if not allows(guard, (tip[0], tip[1], tip[2])):
        return False
    if not chain_configuration(chain, there.places, here.q, here.rotations, there.q, there.rotations):
        return False
    if not _within(limits, there.q):
        return False
    z1[:] = 0.0
    chart_values(joints, here.q, swept.origin, z1, z0)
    chart_values(joints, there.q, swept.origin, z0, z1)
    counts_out[JUDGED] += 1
    return bool(motion_apart(swept, bodies, z0, z1, searching.margin, searching.self_margin, searching.floor))


@compiled(
    types.int64(
        *(CHAIN, JOINTS, INDICES, types.int64, ROBOT, TABLES_32, SWEPT, BODIES, GUARD, SEARCHING),
        *(INDICES, VECTOR, VECTOR, VECTOR, VECTOR, MATRIX_OUT, COUNTS_OUT),
    )
)
def sweep(
    chain: Any, joints: Any, carriers: Any, leads: int, robot: Any, tables: Any, swept: Any, bodies: Any, guard: Any,
    searching: Any, values: Any, lower: Floats, upper: Floats, normal: Floats, q: Floats, path_out: Floats,
    counts_out: Any,
) -> int:  # fmt: skip
    """One round: slide, then reorient every link.

    Args:
        chain: The chain.
        joints: The joints of its model.
        carriers: The joint that carries each link, shape (n,).
        leads: 1 where the first joint is the tip and nothing holds it.
        robot: What is charged.
        tables: What repels it, in single precision.
        swept: The robot's capsules; a motion that they can't tell is free is not taken.
        bodies: The obstacles.
        guard: Where the tip may be.
        searching: How searches go.
        values: Where values with limits stand in a configuration, -1 where there are none, shape (nv,).
        lower: Their limits, shape (nv,).
        upper: Shape (nv,).
        normal: Unit normal of the plane in which the tip slides, shape (3,).
        q: Configuration, shape (nq,).
        path_out: Configurations accepted, shape (most, nq); where it is full the round ends.
        counts_out: Evaluations of forces and motions judged are added, shape (COUNTS,).

    Returns:
        How many were accepted.
    """
    n, kind_of_lane = carriers.shape[0], tables.boxes.dtype
    lanes = robot.points.shape[0] + 2 * LANES
    counting, weights = np.empty(LANES, kind_of_lane), np.zeros(lanes, kind_of_lane)
    for i in range(LANES):
        counting[i] = i
    for i in range(robot.points.shape[0]):
        weights[i] = robot.weights[i]
    count = joints.parents.shape[0]
    room = SweepRoom(
        np.empty((count, 3, 4)), np.empty((count, 6)), np.empty((3, lanes), kind_of_lane), weights, np.zeros((n, 3)),
        np.zeros((n, 3)), np.empty(3), counting,
    )  # fmt: skip
    here, there = strung(q.shape[0], n), strung(q.shape[0], n)
    axis, target = np.empty(3), np.empty(3)
    z0, z1 = np.empty(lower.shape[0]), np.empty(lower.shape[0])
    here.q[:] = q
    put_at(chain, joints, carriers, room.world, here)
    taken = 0
    for task in range(1 + 2 * n if leads == 1 else 2 * n - 2):
        kind, k, which = _kind_of(leads, task, n)
        felt = push(joints, carriers, robot, tables, here, kind, k, room)
        counts_out[EVALUATIONS] += 1
        if not _axis_of(kind, k, which, here, felt, normal, axis):
            continue
        slope = felt[0] * axis[0] + felt[1] * axis[1] + felt[2] * axis[2]
        step, last = _steps(searching, kind, slope)
        trials = 0 if slope != 0.0 else _MOST_TRIALS
        while trials < _MOST_TRIALS and abs(step) >= last and taken < path_out.shape[0]:
            trials += 1
            free = moved(kind, k, axis, step, here, there.places, target) and _free(
                chain, joints, leads, swept, bodies, guard, searching, (values, lower, upper), here, there, z0, z1,
                counts_out,
            )  # fmt: skip
            if not free:
                step *= 0.5
                continue
            here, there = there, here
            path_out[taken] = here.q
            taken += 1
            felt = push(joints, carriers, robot, tables, here, kind, k, room)
            counts_out[EVALUATIONS] += 1
            if (felt[0] * axis[0] + felt[1] * axis[1] + felt[2] * axis[2]) * step < 0.0:
                step *= -0.5
    return taken
