"""Rounds towards a guide plane: the tip advances, the arm descends by Projected, the path is straightened.

One call makes at most `ROUNDS_PER_CHECK` of rounds.py, between two checks of the deadline: its record has no more room.
service/docs/algorithm.md, "Crossing a guide plane". rounds.py (`approach`) and guided_path.py of planner/guide do the
same step by step for other minimizers, and for robots whose motions capsules can't judge alone: a rule changed here
is to be changed there. rounds.py also reads `Record`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.collide.swept_bounds import SWEPT, SweptRobot, motion_apart
from guidefield.kernels.distance.distance import TABLES as BODIES, DistanceTables
from guidefield.kernels.field.energy import ROBOT
from guidefield.kernels.field.field import TABLES_32
from guidefield.kernels.guide.descent import SETTINGS, TRIAL, Settings, descend
from guidefield.kernels.guide.tip_constraint import (
    COUNTS,
    EVALUATIONS,
    GUARD,
    JUDGED,
    ON_PLANE,
    REFUSED,
    ROUNDS,
    STEPS,
    TipConstraint,
    TipGuard,
    closest,
)
from guidefield.kernels.jit.arrays import VECTOR, Floats, IndicesOut, Row, RowOut, RowsOut, Vector3, numba_type
from guidefield.kernels.jit.decorators import compiled, inlined, inner_kernel
from guidefield.kernels.kinematics.forward_kinematics import joint_placements, local_values
from guidefield.kernels.kinematics.integrate import MOVER, reach, tip_position

NEARER, ARRIVED, BLOCKED = range(3)  # ends of the last round
ADVANCED, DESCENDED = range(2)  # kinds of steps

BEFORE, AFTER, GAPS = range(3)
"""The tip's distances to the inset polygon of a round: where it begins and where it ends; then how many."""

_STRAIGHT, _ALL, _NONE = -1, -2, -3  # paths without steps, with all, none; a number from 0 on is the only step of one


class Rounds(NamedTuple):
    """Settings of rounds; lengths in m."""

    step: float  # of an advance, at most
    smallest: float  # an advance below this is given up
    guard: float  # share of an advance's gain that a descent keeps
    on_plane: float  # how near the plane counts as on it
    depth: float  # how far inside the plane's edges the tip stays once it is on the plane
    comfortable: float  # a straight path that keeps this distance is taken without comparing
    middle: Row  # a point of the plane, shape (3,)
    normal: Row  # its unit normal, shape (3,)
    margins: Row  # distances by which paths are compared, the widest first, shape (k,)


class Record(NamedTuple):
    """Results of rounds; rows of steps in the order in which they were taken."""

    steps: RowsOut  # configurations of the model, shape (rows, nq)
    values: RowOut  # length of an advance [m] or potential after a descent's step [m], shape (rows,)
    kinds: IndicesOut  # ADVANCED or DESCENDED, shape (rows,)
    kept: IndicesOut  # 1 where a step stays in the path, shape (rows,)
    gaps: RowsOut  # for each round: distance before and after it [m], shape (rounds, GAPS)
    ends: IndicesOut  # for each round: its row past the last, shape (rounds,)
    refused: RowsOut  # ends of the last motion that was not free, shape (2, nq)
    counts: IndicesOut  # of all rounds together, shape (COUNTS,)


ROUND_SETTINGS = numba_type(Rounds)
RECORD_OUT = numba_type(Record)


@inlined
def _tip(mover: Any, q: Floats, world: Floats) -> Vector3:
    joints = mover.joints
    joint_placements(joints, q, world)
    return tip_position(mover, world)


@inlined
def _gap(aim: Any, tip: Vector3) -> tuple[float, Vector3]:
    """Distance to the inset polygon, and its point that is closest."""
    c = closest(aim, tip)
    return math.sqrt((c[0] - tip[0]) ** 2 + (c[1] - tip[1]) ** 2 + (c[2] - tip[2]) ** 2), c


@inner_kernel
def _keeps(
    swept: SweptRobot, bodies: DistanceTables, q0: Row, q1: Row, margin: float, settings: Settings, counts: IndicesOut
) -> bool:
    """Tell if the straight joint motion between two configurations keeps a margin."""
    m = 0
    for i in range(swept.joints.parents.shape[0]):
        m = max(m, swept.joints.idx_v[i] + swept.joints.nv[i])
    z0, z1 = np.zeros(m), np.empty(m)
    local_values(swept.joints, q0, swept.origin, np.zeros(m), z0)
    local_values(swept.joints, q1, swept.origin, z0, z1)
    counts[JUDGED] += 1
    return bool(motion_apart(swept, bodies, z0, z1, margin, settings.self_margin, settings.floor))


@inlined
def _refuse(record: Any, q0: Floats, q1: Floats) -> None:
    record.counts[REFUSED] = 2
    for k in range(q0.shape[0]):
        record.refused[0, k], record.refused[1, k] = q0[k], q1[k]


@inlined
def _advance(
    mover: Any, swept: Any, bodies: Any, settings: Any, rounds: Any, q: Floats, tip: Vector3, to: Vector3,
    distance: float, row: int, record: Any,
) -> float:  # fmt: skip
    """Take the largest of step, step/2, step/4 .. that is feasible and free; return its length, 0 if there is none."""
    tried, smallest = min(rounds.step, distance), min(rounds.smallest, 0.5 * distance)
    longest, point, there = tried, np.empty(3), record.steps[row]
    while tried >= smallest or tried == longest:
        for r in range(3):
            point[r] = tip[r] + tried / distance * (to[r] - tip[r])
        if reach(mover, q, point, there):
            if _keeps(swept, bodies, q, there, settings.margin, settings, record.counts):
                record.kinds[row], record.values[row], record.kept[row] = ADVANCED, tried, 1
                return float(tried)
            _refuse(record, q, there)
        tried *= 0.5
    return 0.0


@inner_kernel
def _path_keeps(
    swept: SweptRobot,
    bodies: DistanceTables,
    q: Row,
    steps: RowsOut,
    through: int,
    margin: float,
    settings: Settings,
    counts: IndicesOut,
) -> bool:
    """Tell if the path from q to the last of some steps keeps a margin: straight, by one of them, or by all."""
    last, before = steps.shape[0] - 1, q
    for row in range(steps.shape[0]):
        if row in (last, through) or through == _ALL:
            if not _keeps(swept, bodies, before, steps[row], margin, settings, counts):
                return False
            before = steps[row]
    return True


@inlined
def _straighten(
    swept: Any, bodies: Any, settings: Any, rounds: Any, q: Floats, steps: Floats, kept: Any, record: Any
) -> None:
    """Leave out steps of a round where the path without them keeps as wide a margin: as guided_path.py."""
    last, through, m, counts = steps.shape[0] - 1, _NONE, 0, record.counts
    if last < 1:
        return
    if _path_keeps(swept, bodies, q, steps, _STRAIGHT, max(rounds.comfortable, settings.margin), settings, counts):
        through = _STRAIGHT
    while through == _NONE and m < rounds.margins.shape[0] and rounds.margins[m] > settings.margin:
        margin, choices = rounds.margins[m], last + 2
        if not _keeps(swept, bodies, q, q, margin, settings, counts):  # no path is wider than where it begins
            choices = 0
        for choice in range(choices):
            # straight, by a single step from the last one on, by all
            one = _STRAIGHT if choice == 0 else last - choice if choice <= last else _ALL
            if _path_keeps(swept, bodies, q, steps, one, margin, settings, counts):
                through = one
                break
        m += 1
    if through == _NONE:
        if not _keeps(swept, bodies, q, steps[last], settings.margin, settings, counts):
            _refuse(record, q, steps[last])
            return
        through = _STRAIGHT
    if through != _ALL:
        kept[:last] = 0
        if through >= 0:
            kept[through] = 1


@compiled(
    types.int64(
        MOVER, ROBOT, TABLES_32, SWEPT, BODIES, GUARD, SETTINGS, ROUND_SETTINGS, types.int64, VECTOR, RECORD_OUT
    )
)
def approach(
    mover: Any, robot: Any, tables: Any, swept: Any, bodies: Any, aim: Any, settings: Any, rounds: Any,
    most_steps: int, q: Floats, record_out: Any,
) -> int:  # fmt: skip
    """Make rounds towards a guide plane, until the record is full; return how the last one ended.

    From q (nq,); `aim` is the plane's `TipGuard`; capsules have to be the links themselves, not bounds of them; tables
    are in single precision. A descent has at most `most_steps` steps: there have to be that many rows and one more in
    the record for each round.

    The end is NEARER, ARRIVED or BLOCKED (the tip can't be moved; that round has no steps).
    """
    world = np.empty((mover.joints.parents.shape[0], 3, 4))
    constraint = TipConstraint(ON_PLANE, np.empty(3), np.empty(3), np.eye(3))
    trial, counts, potentials = np.empty(TRIAL), np.zeros(COUNTS, np.int64), np.empty(most_steps + 1)
    here, row, total = q.copy(), 0, record_out.counts
    total[:] = 0
    while total[ROUNDS] < record_out.ends.shape[0]:
        tip = _tip(mover, here, world)
        distance, to = _gap(aim, tip)
        if distance <= rounds.on_plane:
            return ARRIVED
        first = row
        total[REFUSED] = 0
        moved = _advance(mover, swept, bodies, settings, rounds, here, tip, to, distance, row, record_out)
        if moved == 0.0:
            return BLOCKED
        arrived = moved >= distance - rounds.on_plane
        farthest, depth = math.inf, -math.inf
        if arrived:
            constraint.point[:], constraint.normal[:] = rounds.middle, rounds.normal
            depth = rounds.depth
        else:
            now = _tip(mover, record_out.steps[row], world)
            for r in range(3):
                constraint.point[r], constraint.normal[r] = now[r], (to[r] - tip[r]) / distance
            farthest = distance - rounds.guard * (distance - _gap(aim, now)[0])
        guard = TipGuard(aim.origin, aim.axes, aim.inward, aim.offsets, aim.corners, aim.inset, farthest, depth)
        row += 1
        descend(
            mover, robot, tables, swept, bodies, constraint, guard, settings, record_out.steps[row - 1], 1.0,
            record_out.steps[row : row + most_steps], potentials, trial, counts,
        )  # fmt: skip
        for k in range(counts[STEPS]):
            record_out.kinds[row + k], record_out.values[row + k] = DESCENDED, potentials[k + 1]
            record_out.kept[row + k] = 1
        row += counts[STEPS]
        for counted in (EVALUATIONS, JUDGED, STEPS):
            total[counted] += counts[counted]
        _straighten(
            swept, bodies, settings, rounds, here, record_out.steps[first:row], record_out.kept[first:row], record_out
        )
        here[:] = record_out.steps[row - 1]
        made = total[ROUNDS]
        record_out.gaps[made, BEFORE] = distance
        record_out.gaps[made, AFTER] = _gap(aim, _tip(mover, here, world))[0]
        record_out.ends[made] = row
        total[ROUNDS] += 1
        if arrived:
            return ARRIVED
    return NEARER
