"""The earliest arrival along a path among what moves: a search over place, speed and time in steps.

With s the time of a motion along the path, a schedule s(t) has one of the rates 0, 1/J, .., 1 at each step of time, and
a constant acceleration in between. In units of half a step of time at the lowest rate, s moves on by j + j' from rate j
to rate j': places are whole numbers, and none is rounded. States that can be reached are followed step by step, and
the first step in which the end is reached is the earliest; of several schedules the smoothest is kept. The idea of a
search in the plane of path and time: K. Kant and S. W. Zucker, "Toward efficient trajectory planning: the path-velocity
decomposition", International Journal of Robotics Research 5(3), 1986.
"""

from __future__ import annotations

import numpy as np
from numba import types, void
from numpy.typing import NDArray

from guidefield.kernels.jit.signatures import INDEX_MATRIX, INDICES, INDICES_OUT, SCALAR, Integers, compiled, inlined

FREE = types.Array(types.uint8, 2, "C", readonly=True)
COSTS = types.Array(types.int64, 2, "C")
PARENTS = types.Array(types.int8, 3, "C")

UNREACHED = 1 << 40
"""Cost of a state that can't be reached."""

CHANGING = 4
"""Cost of a step in which the rate changes."""

SLOW = 1
"""Cost of a step on the way at less than the whole rate."""


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


@compiled(
    void(
        INDICES, INDEX_MATRIX, INDEX_MATRIX, FREE, types.int64, SCALAR, SCALAR, types.int64, COSTS, COSTS, PARENTS,
        INDICES_OUT,
    )
)  # fmt: skip
def earliest_schedule(
    cells: Integers,
    lowest: Integers,
    highest: Integers,
    free: NDArray[np.uint8],
    per_step: int,
    length: float,
    earliest: float,
    first: int,
    costs: Integers,
    next_costs: Integers,
    parents_out: NDArray[np.int8],
    arrival_out: Integers,
) -> None:
    """Follow all states through some steps, or up to the first in which the end is reached.

    At place 0 the robot rests: it may wait there, and leave at any rate. It may arrive at any rate. A rate doesn't
    change in the first step of the way, nor in the last.

    Args:
        cells: Of each place, which column of `free` it is in, not decreasing, shape (n,).
        lowest: By how much the rate may change at a place at a rate, at least, shape (n, J + 1); never above 0.
        highest: The same, at most; never below 0.
        free: Whether a cell is free in a part of a step, shape (steps * per_step, cells).
        per_step: Into how many parts a step is divided.
        length: Place of the end, above n - 1 at least by rounding, at most n.
        earliest: Steps since the very beginning before which the end is not to be reached.
        first: How many steps were followed before.
        costs: Of the states before the first step, shape (n, J + 1); after the last one when it ends.
        next_costs: Room for the same.
        parents_out: After each step, by how much the rate changed in it, shape (steps, n, J + 1).
        arrival_out: In which step the end is reached, from which place and at which rate, -1 if it isn't; the farthest
            place that was reached so far, shape (4,).
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
