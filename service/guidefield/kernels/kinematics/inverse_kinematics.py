"""Inverse kinematics in SIMD batches: descents from many starts to a pose of the tip, and the choice among solutions.

Damped least squares whose damping follows the squared error (T. Sugihara, "Solvability-unconcerned inverse kinematics
by the Levenberg-Marquardt method", IEEE T-RO 27(5), 2011). The error is what exceeds the tolerances; coordinates rest
on their limits while the error pushes them outward. A lane whose descent has ended takes the next start; where a
descent ends doesn't depend on its neighbours. Constants change the solutions found, so plans, and what refusals state.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import Floats, Indices, IndicesOut, Row, RowOut, Rows, RowsOut, TruthsOut
from guidefield.kernels.jit.decorators import inlined, kernel
from guidefield.kernels.kinematics.tip_chain import BALL, COLUMN, LANES, TipChain, offset_rates, tip_offset, tip_pose
from guidefield.kernels.simd.rotations import quaternion_of_vector, quaternion_product, vector_of_quaternion
from guidefield.kernels.simd.vector import load, magnitude, root, select, store

MAX_ITERATIONS = 60  # of one start
PATIENCE = 5  # a start is given up if this many iterations in a row haven't halved the squared error
LEVER = 0.3  # a rotation error of one radian counts as much as a position error of this [m], at size 1
DAMPING = 0.05
"""Damping per squared error. Of 0.005 to 0.5, with levers of 0.15 to 1 m, these take the fewest iterations on Panda,
UR5, xArm7 and Kinova."""
# least damping [m^2], at size 1: keeps the equations solvable where fewer coordinates than rows move
DAMPING_FLOOR = 1e-10

IDLE = -1  # the start of a lane that has none


class Tolerances(NamedTuple):
    """Tolerances of the tip's offset from its target, translation and rotation vector, and how these count."""

    allowed: Row  # shape (6,) [m, rad], maybe infinite
    aimed: Row  # the part of it that a search aims at, shape (6,) [m, rad]
    size: float  # the robot's
    sizes: Row  # how far each local coordinate goes for one step: 1 for angles, the size for what slides, (nv,)


@inlined
def _store_excess(offset: Any, tolerances: Tolerances, excess_out: Floats, there_out: Floats) -> Any:
    """Excess of each of six errors, whether all are allowed (1 or 0), and the weighted sum of their squares."""
    zero = 0.0 * offset[0]
    squared, within = zero, zero + 1.0
    for row in range(6):
        value, aimed = offset[row], tolerances.aimed[row]
        excess = select(value > aimed, value - aimed, select(value < -aimed, value + aimed, zero))
        store(excess_out, row * LANES, excess)
        weighted = excess if row < 3 else LEVER * tolerances.size * excess
        squared = squared + weighted * weighted
        within = select(magnitude(value) <= tolerances.allowed[row], within, zero)
    store(there_out, 0, within)
    return squared


@inlined
def _store_step(
    chain: TipChain, tolerances: Tolerances, zs: Floats, excess: Floats, squared: Any, rates: Floats, step_out: Floats
) -> None:
    """Write a damped step of every coordinate: -J^T (J J^T + damping)^-1 r; J becomes its weighted, free part."""
    nv, floor = chain.lower.shape[0], DAMPING_FLOOR * tolerances.size * tolerances.size
    lever = LEVER * tolerances.size
    factor = np.empty(36 * LANES)
    for row in range(6):
        for column in range(row + 1):
            store(factor, (6 * row + column) * LANES, floor + DAMPING * squared if row == column else 0.0 * squared)
    for d in range(nv):
        z, slope, size = load(zs, d * LANES), 0.0 * squared, tolerances.sizes[d]
        for row in range(6):
            residual = load(excess, row * LANES)
            weight = 1.0 if row < 3 else lever
            rate = select(residual == 0.0, 0.0 * squared, weight * size * load(rates, d * COLUMN + row * LANES))
            store(rates, d * COLUMN + row * LANES, rate)
            slope = slope + weight * residual * rate
        zero = 0.0 * squared
        free = select(((z > chain.lower[d]) | (slope < 0.0)) & ((z < chain.upper[d]) | (slope > 0.0)), zero + 1.0, zero)
        for row in range(6):
            rate = free * load(rates, d * COLUMN + row * LANES)
            store(rates, d * COLUMN + row * LANES, rate)
            for column in range(row + 1):
                at = (6 * row + column) * LANES
                store(factor, at, load(factor, at) + rate * load(rates, d * COLUMN + column * LANES))
    _solve(factor, lever, excess)
    for d in range(nv):
        step = 0.0 * squared
        for row in range(6):
            step = step - load(factor, row * LANES) * load(rates, d * COLUMN + row * LANES)
        store(step_out, d * LANES, tolerances.sizes[d] * step)


@inlined
def _solve(factor: Floats, lever: float, excess: Floats) -> None:
    """Solve for the weighted errors by Cholesky; the lower triangle is overwritten, its first six by the solution."""
    y = np.empty(6 * LANES)
    for row in range(6):
        value = (1.0 if row < 3 else lever) * load(excess, row * LANES)
        for column in range(row + 1):
            entry = load(factor, (6 * row + column) * LANES)
            for k in range(column):
                entry = entry - load(factor, (6 * row + k) * LANES) * load(factor, (6 * column + k) * LANES)
            if column == row:
                entry = 1.0 / root(entry)
                value = value * entry
            else:
                entry = entry * load(factor, 7 * column * LANES)
                value = value - entry * load(y, column * LANES)
            store(factor, (6 * row + column) * LANES, entry)
        store(y, row * LANES, value)
    for row in range(5, -1, -1):
        value = load(y, row * LANES)
        for k in range(row + 1, 6):
            value = value - load(factor, (6 * k + row) * LANES) * load(y, k * LANES)
        store(y, row * LANES, value * load(factor, 7 * row * LANES))
    for row in range(6):
        store(factor, row * LANES, load(y, row * LANES))


@inlined
def _move(chain: TipChain, step: Floats, going: Floats, zs: Floats) -> None:
    """Go a step, in the lanes that are going, and stay within the limits."""
    moves = load(going, 0)
    for d in range(chain.lower.shape[0]):
        z = load(zs, d * LANES) + moves * load(step, d * LANES)
        z = select(z < chain.lower[d], 0.0 * z + chain.lower[d], z)
        store(step, d * LANES, select(z > chain.upper[d], 0.0 * z + chain.upper[d], z))
    for k in range(chain.kinds.shape[0]):
        if chain.kinds[k] == BALL:
            at = chain.sources[k] * LANES
            x, y, z = load(zs, at), load(zs, at + LANES), load(zs, at + 2 * LANES)
            dx, dy, dz = load(step, at) - x, load(step, at + LANES) - y, load(step, at + 2 * LANES) - z
            turned = quaternion_product(quaternion_of_vector(x, y, z), quaternion_of_vector(dx, dy, dz))
            vector = vector_of_quaternion(turned[0], turned[1], turned[2], turned[3])
            for j in range(3):
                store(step, at + j * LANES, vector[j])
    for d in range(chain.lower.shape[0]):
        store(zs, d * LANES, load(step, d * LANES))


@inlined
def _begin(starts: Floats, start: int, chain: TipChain, lane: int, zs: Floats) -> None:
    for d in range(starts.shape[1]):
        zs[d * LANES + lane] = min(max(starts[start, d], chain.lower[d]), chain.upper[d])


@kernel
def descend(
    chain: TipChain,
    tolerances: Tolerances,
    starts: Rows,
    ends_out: RowsOut,
    reached_out: TruthsOut,
    closest_out: RowOut,
) -> int:
    """Descend from `starts` (n, nv) to configurations whose tip is within tolerances of the target.

    The chain is in the target's frame. Writes where the descents ended (n, nv), whether each reached it (n,), and of
    the closest the weighted squared error, then its six excesses (7,), improved from what they are. Returns the number
    of iterations.
    """
    n, nv = starts.shape
    zs, step, rates = np.zeros(nv * LANES), np.empty(nv * LANES), np.empty(nv * COLUMN)
    columns = np.empty((3 * chain.kinds.shape[0] + 1) * COLUMN)
    excess, there, squares, going = np.empty(6 * LANES), np.empty(LANES), np.empty(LANES), np.zeros(LANES)
    start_of, patience, spent = np.full(LANES, IDLE), np.zeros(LANES, np.int64), np.zeros(LANES, np.int64)
    halved = np.zeros(LANES)
    taken, running, iterations = 0, 0, 0
    for lane in range(min(LANES, n)):
        _begin(starts, taken, chain, lane, zs)
        start_of[lane], patience[lane], spent[lane], halved[lane] = taken, PATIENCE, 0, np.inf
        taken, running = taken + 1, running + 1
    while running > 0:
        offset = tip_offset(tip_pose(chain, zs, columns))
        squared = _store_excess(offset, tolerances, excess, there)
        store(squares, 0, squared)
        for lane in range(LANES):
            start = start_of[lane]
            going[lane] = 0.0
            if start == IDLE:
                continue
            iterations += 1
            if squares[lane] < closest_out[0]:
                closest_out[0] = squares[lane]
                for row in range(6):
                    closest_out[1 + row] = excess[row * LANES + lane]
            if squares[lane] < 0.5 * halved[lane]:
                halved[lane], patience[lane] = squares[lane], PATIENCE
            else:
                patience[lane] -= 1
            spent[lane] += 1
            if there[lane] == 0.0 and patience[lane] > 0 and spent[lane] < MAX_ITERATIONS:
                going[lane] = 1.0
                continue
            reached_out[start] = there[lane] != 0.0
            for d in range(nv):
                ends_out[start, d] = zs[d * LANES + lane]
            if taken < n:
                _begin(starts, taken, chain, lane, zs)
                start_of[lane], patience[lane], spent[lane], halved[lane] = taken, PATIENCE, 0, np.inf
                taken += 1
            else:
                start_of[lane], running = IDLE, running - 1
        offset_rates(chain, offset, columns, rates)
        _store_step(chain, tolerances, zs, excess, squared, rates, step)
        _move(chain, step, going, zs)
    return iterations


@kernel
def squared_errors(chain: TipChain, tolerances: Tolerances, points: Rows, squared_out: RowOut) -> None:
    """Write weighted squared errors (n,) of local coordinates (n, nv), as descents count them [m^2]."""
    nv = points.shape[1]
    zs, columns = np.zeros(nv * LANES), np.empty((3 * chain.kinds.shape[0] + 1) * COLUMN)
    excess, there, row = np.empty(6 * LANES), np.empty(LANES), np.empty(LANES)
    for begin in range(0, points.shape[0], LANES):
        count = min(LANES, points.shape[0] - begin)
        for d in range(nv):
            for lane in range(count):
                zs[d * LANES + lane] = points[begin + lane, d]
        store(row, 0, _store_excess(tip_offset(tip_pose(chain, zs, columns)), tolerances, excess, there))
        for lane in range(count):
            squared_out[begin + lane] = row[lane]


class Measure(NamedTuple):
    """A measure of the distance of two points in local coordinates."""

    periods: Row  # by how much a coordinate may differ without any difference, 0 for none, shape (nv,) [rad or m]
    units: Row  # the difference that counts as one, shape (nv,) [rad or m]
    rotations: Indices  # where rotation vectors begin, of which the angle between the two counts, shape (b,)


@inlined
def _turn_between(a: Floats, b: Floats, at: int) -> float:
    va, vb = (
        math.sqrt(a[at] ** 2 + a[at + 1] ** 2 + a[at + 2] ** 2),
        math.sqrt(b[at] ** 2 + b[at + 1] ** 2 + b[at + 2] ** 2),
    )
    sa = math.sin(0.5 * va) / va if va > 1e-9 else 0.5
    sb = math.sin(0.5 * vb) / vb if vb > 1e-9 else 0.5
    dot = sa * sb * (a[at] * b[at] + a[at + 1] * b[at + 1] + a[at + 2] * b[at + 2])
    return 2.0 * math.acos(min(abs(dot + math.cos(0.5 * va) * math.cos(0.5 * vb)), 1.0))


@inlined
def _apart(measure: Measure, a: Floats, b: Floats) -> tuple[float, float]:
    """The largest of the differences between two points, and the sum of their squares."""
    largest, squared, rotation = 0.0, 0.0, 0
    for d in range(a.shape[0]):
        if rotation < measure.rotations.shape[0] and d >= measure.rotations[rotation]:
            difference = _turn_between(a, b, d) if d == measure.rotations[rotation] else 0.0
            if d == measure.rotations[rotation] + 2:
                rotation += 1
        else:
            difference = abs(a[d] - b[d])
            if measure.periods[d] > 0.0:
                difference = abs(difference - measure.periods[d] * np.rint(difference / measure.periods[d]))
        difference /= measure.units[d]
        largest, squared = max(largest, difference), squared + difference * difference
    return largest, squared


@kernel
def distinct(measure: Measure, points: Rows, known: int, kept_out: IndicesOut) -> int:
    """Write the indices (n,) of points (n, nv) that differ from all before by over one unit in some coordinate.

    The first `known` are distinct; returns the count.
    """
    count = known
    for i in range(known):
        kept_out[i] = i
    for i in range(known, points.shape[0]):
        alone = True
        for k in range(count):
            if _apart(measure, points[i], points[kept_out[k]])[0] <= 1.0:
                alone = False
                break
        if alone:
            kept_out[count] = i
            count += 1
    return count


@kernel
def farthest_apart(measure: Measure, points: Rows, given: int, chosen_out: IndicesOut) -> None:
    """Choose points (n, nv), each the farthest from those chosen before it, indices (m,); ties go to the first.

    The first `given`, at least one, are chosen; the distance is the root of the sum of squares.
    """
    nearest = np.full(points.shape[0], np.inf)
    for place in range(chosen_out.shape[0]):
        best = place
        if place >= given:
            best = 0
            for i in range(points.shape[0]):
                if nearest[i] > nearest[best]:
                    best = i
        chosen_out[place] = best
        for i in range(points.shape[0]):
            nearest[i] = min(nearest[i], _apart(measure, points[i], points[best])[1])
