"""Time-optimal speed along a path within limits of velocity and acceleration, and schedules among moving obstacles.

With s the parameter of a path q(s), x = (ds/dt)² and u = d²s/dt², constant over a step h_i of the grid, every limit is
linear in (x, u):

    |q'_j|² x <= V_j²        |q'_j u + q''_j x| <= A_j        x_{i+1} = x_i + 2 h_i u_i

Backward, the *controllable* x_i is the largest from which some u reaches a controllable x_{i+1}: a linear program in
two variables. The path ends at rest, so x = u = 0 is always allowed and the controllable sets are intervals [0, K_i].
Forward from rest, the greatest u that stays controllable is optimal. Theory: H. Pham and Q.-C. Pham, "A new approach to
time-optimal path parameterization based on reachability analysis", IEEE Transactions on Robotics 34(3), 2018.

A schedule is a search in breadth over places on a path and rates, step by step in time: of those that arrive first, the
cheapest. `planner/schedule.py` follows `parents_out` back; costs decide among schedules, not whether there is
one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guidefield.kernels.jit.arrays import (
    ByteBlocksOut,
    ByteRows,
    Floats,
    IndexRows,
    IndexRowsOut,
    Indices,
    IndicesOut,
    Integers,
    Row,
    RowOut,
    Rows,
)
from guidefield.kernels.jit.decorators import inlined, kernel

UNREACHED = 1 << 40  # cost of a state that can't be reached
CHANGING = 4  # cost of a step in which the rate changes
SLOW = 1  # cost of a step on the way at less than the whole rate


@inlined
def _is_free(
    cells: Integers, free: NDArray[np.uint8], row: int, per_step: int, place: int, rate: int, change: int
) -> bool:
    """Tell if a step from a place at a rate that changes meets nothing; `row` is its first row of `free`."""
    last = cells.shape[0] - 1
    begin = float(place)
    for part in range(per_step):
        share = (part + 1.0) / per_step
        end = place + 2.0 * rate * share + change * share * share
        first_cell = cells[min(max(int(begin), 0), last)]
        last_cell = cells[min(max(int(end) + 1, 0), last)]
        for cell in range(first_cell, last_cell + 1):
            if free[row + part, cell] == 0:
                return False
        begin = end
    return True


@inlined
def _may_be_there(lowest: Integers, highest: Integers, place: int, rate: int, change: int) -> bool:
    """Tell if a step that changes the rate so may end at a place at a rate."""
    places, rates = lowest.shape
    if place >= places or rate < 0 or rate >= rates:
        return False
    return bool(lowest[place, rate] <= change <= highest[place, rate])


@inlined
def _cost_of_step(place: int, rate: int, change: int, rates: int) -> int:
    """Return what a step costs: smooth and quick motions are cheap, and so is waiting at the start."""
    if change != 0:
        return CHANGING
    return SLOW if place > 0 and rate < rates - 1 else 0


@kernel
def earliest_schedule(
    cells: Indices,
    lowest: IndexRows,
    highest: IndexRows,
    free: ByteRows,
    per_step: int,
    length: float,
    earliest: float,
    first: int,
    costs: IndexRowsOut,
    next_costs: IndexRowsOut,
    parents_out: ByteBlocksOut,
    arrival_out: IndicesOut,
) -> None:
    """Follow all states, places and rates, through some steps, or up to the first in which the end is reached.

    At place 0 the robot rests: it may wait there, and leave at any rate. It may arrive at any rate. A rate doesn't
    change in the first step of the path, nor in the last. `cells` (n,) is the column of `free` (steps * per_step,
    cells) of each place, not decreasing; `lowest` and `highest` (n, J + 1) are how much the rate may change at a place
    at a rate, never above and never below 0. `length` is the place of the end, above n - 1 at least by rounding, at
    most n; it is not reached before `earliest` steps since the very beginning, `first` of which were followed before.
    `costs` (n, J + 1) are those of the states before the first step, and after the last one when it ends.

    Writes after each step how much the rate changed in it (steps, n, J + 1), and (4,): in which step the end is
    reached, from which place and at which rate, -1 if it isn't; the farthest place that was reached so far.
    """
    places, rates = costs.shape
    arrival_out[0] = -1
    for step in range(parents_out.shape[0]):
        next_costs[:, :] = UNREACHED
        best = UNREACHED
        row = step * per_step
        for place in range(places):
            for rate in range(rates):
                cost = costs[place, rate]
                if cost >= UNREACHED:
                    continue
                arrival_out[3] = max(arrival_out[3], place)
                if rate > 0 and place + 2 * rate >= length:
                    share = (length - place) / (2.0 * rate)
                    in_time = first + step + share >= earliest
                    if in_time and cost < best and _is_free(cells, free, row, per_step, place, rate, 0):
                        best = cost
                        arrival_out[0], arrival_out[1], arrival_out[2] = step, place, rate
                    continue
                for change in range(lowest[place, rate], highest[place, rate] + 1):
                    new_rate = rate + change
                    new_place = place + rate + new_rate
                    if not _may_be_there(lowest, highest, new_place, new_rate, change):
                        continue
                    new_cost = cost + _cost_of_step(place, rate, change, rates)
                    if new_cost < next_costs[new_place, new_rate] and _is_free(
                        cells, free, row, per_step, place, rate, change
                    ):
                        next_costs[new_place, new_rate] = new_cost
                        parents_out[step, new_place, new_rate] = change
        if best < UNREACHED:
            return
        next_costs[0, 1:] = next_costs[0, 0]
        costs[:, :] = next_costs


# A coefficient of u below this is none: dividing by it could overflow. Derivatives of a path are far above, or zero.
_NONE = 1e-100


@inlined
def _bounds_of_u(
    first: Floats, second: Floats, steps: Floats, limits: Floats, offsets: Floats, i: int, x_next: float, x: float
) -> tuple[float, float, float, float]:
    """The bounds of u over step i that bind at x, as lines: (a, b, c, d) with a x - b <= u <= c x + d.

    The step's far end counts as its near one, with x + 2 h u in the place of x, and 0 <= x + 2 h u <= x_next; b and d
    are never negative.
    """
    width = 2.0 * steps[i]
    low_slope, low_reach, high_slope, high_reach = -1.0 / width, 0.0, -1.0 / width, x_next / width
    low, high = low_slope * x, high_slope * x + high_reach
    for j in range(first.shape[1]):
        for end in range(2):
            on_x = second[i + end, j]
            on_u = first[i + end, j] + end * width * on_x
            if abs(on_u) <= _NONE:
                continue
            slope = -on_x / on_u
            reach = limits[i, j] / abs(on_u)
            offset = offsets[i, j] if on_u > 0.0 else -offsets[i, j]
            below, above = reach * (1.0 + offset), reach * (1.0 - offset)
            if slope * x - below > low:
                low, low_slope, low_reach = slope * x - below, slope, below
            if slope * x + above < high:
                high, high_slope, high_reach = slope * x + above, slope, above
    return low_slope, low_reach, high_slope, high_reach


@inlined
def _bound_without_u(
    first: Floats, second: Floats, steps: Floats, limits: Floats, offsets: Floats, i: int, cap: float
) -> float:
    """The cap on x, lowered by the limits of step i that u has no part in: |q''_j| x <= A_j."""
    for j in range(first.shape[1]):
        for end in range(2):
            on_x = second[i + end, j]
            on_u = first[i + end, j] + end * 2.0 * steps[i] * on_x
            most = limits[i, j] * (1.0 - (offsets[i, j] if on_x > 0.0 else -offsets[i, j]))
            if abs(on_u) <= _NONE and abs(on_x) * cap > most:
                cap = most / abs(on_x)
    return cap


@inlined
def _largest_controllable(
    first: Floats, second: Floats, steps: Floats, limits: Floats, offsets: Floats, i: int, x_next: float, cap: float
) -> float:
    """The largest x <= cap for which some u over step i keeps the limits and leads to at most x_next.

    Where the range of u is empty, the two lines that bind cross at a smaller x, which is tried next. The range's width
    is concave and piecewise linear in x and not negative at 0, so this is Newton's method from the right: it never
    passes the zero and ends after as many rounds as there are lines at most; two or three do.
    """
    x = cap
    for _ in range(4 * first.shape[1] + 2):
        low_slope, low_reach, high_slope, high_reach = _bounds_of_u(first, second, steps, limits, offsets, i, x_next, x)
        if low_slope * x - low_reach <= high_slope * x + high_reach:
            break
        crossing = (low_reach + high_reach) / (low_slope - high_slope)
        if not crossing < x:  # nothing but rounding is left
            break
        x = crossing
    return x


@kernel
def fastest_speeds(
    first: Rows,
    second: Rows,
    steps: Row,
    caps: Row,
    limits: Rows,
    offsets: Rows,
    controllable_out: RowOut,
    squared_speeds_out: RowOut,
) -> None:
    """Largest squared speed x = (ds/dt)² at every grid point of a path that starts and ends at rest.

    Args:
        first: q' at the grid points, shape (g, nv).
        second: q'' at the grid points, shape (g, nv).
        steps: Differences of s between grid points, shape (g - 1,), positive.
        caps: Largest x at each grid point by the velocity limits, shape (g,), positive.
        limits: Acceleration limits over each step, shape (g - 1, nv), positive; kept at both ends of the step. What
            has a limit, q' u + q'' x, may be another quantity of the path's than an acceleration.
        offsets: Shares e of the limits, shape (g - 1, nv), between -1 and 1: from -(1 + e) of a limit to 1 - e of it is
            allowed.
        controllable_out: Largest x from which the end can still be reached at rest, shape (g,).
        squared_speeds_out: The result x, shape (g,); 0 at both ends.
    """
    last = steps.shape[0]
    controllable_out[last] = 0.0
    for i in range(last - 1, -1, -1):
        cap = _bound_without_u(first, second, steps, limits, offsets, i, caps[i])
        x_next = controllable_out[i + 1]
        controllable_out[i] = _largest_controllable(first, second, steps, limits, offsets, i, x_next, cap)
    squared_speeds_out[0] = 0.0
    for i in range(last):
        x = squared_speeds_out[i]
        _, _, slope, reach = _bounds_of_u(first, second, steps, limits, offsets, i, controllable_out[i + 1], x)
        x_next = x + 2.0 * steps[i] * (slope * x + reach)
        # the bounds only cut off what rounding adds
        squared_speeds_out[i + 1] = min(max(x_next, 0.0), controllable_out[i + 1])
