"""The cheapest schedule of a path among drifting obstacles: going on, waiting, turning back or stepping off the path.

Dynamic programming over time, step by step, in a tube about the path: its places, and some steps beside them to some
sides. On the path alone all states are examined; beside it the most promising ones at each step. `stream/dodging.py`
ranks paths by the cost and leads pieces along the schedule: each is proven by itself, so that constants decide how well
a stream dodges, and to what kept journals replay, not whether it is safe.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.kernels.collide.broadphase import write_gaps
from guidefield.kernels.jit.arrays import Floats, Floats32, IndexRows, Indices, IndicesOut, Integers, Row, Rows, RowsOut
from guidefield.kernels.jit.decorators import inlined, kernel
from guidefield.kernels.linalg.small_systems import write_stable_order

FADING = 1.0  # a prediction this far ahead counts half [s], above 0: what drifts may turn

ASIDE = 0.05
"""Additional cost of a step beside the path, as a share of it: of paths that are as quick the one nearby is taken."""

STRETCHED = 1.25
"""A move on and sideways at once is one step if it is longer than one at full speed by this factor at most."""


class Tube(NamedTuple):
    """A path and what is beside it.

    A state is a place and a column, by number place * columns + column; column 0 is the path itself, then come the
    steps to the first side, and so on.
    """

    places: Rows  # the path's points, a step at full speed apart, then its end some times over, shape (m, nv)
    sides: Rows  # what a step to each side changes, shape (d, nv)
    taken: IndexRows  # not 0 where one can't be, shape (m, 1 + d * levels)
    speeds: Row  # of the coordinates, at most, shape (nv,) [rad/s or m/s]
    step: float  # how long a step lasts [s]
    stays: int  # this many places at the end are the end once more: the robot is to stay there


class KeptClearances(NamedTuple):
    """Requirements on a path among moving obstacles."""

    # what to keep from each on the move, where the robot waits, and at the path's end at least; shape (3, k) [m]
    kept: Rows
    # where the end is closer to an obstacle than the first two ask, its distance then is enough, and this more for each
    # second before it [m/s]
    widening: float
    dear: float  # what a lack of 1 m for 1 s costs [s]


@inlined
def _level(column: int, levels: int) -> int:
    """Return how many steps beside the path a column is."""
    return 0 if column == 0 else (column - 1) % levels + 1


@inlined
def _time_left(tube: Tube, state: int, columns: int, levels: int) -> float:
    """Return how long it is at least from a state to the end [s]."""
    places = tube.places.shape[0] - 1 - state // columns
    return float(tube.step * max(places, _level(state % columns, levels)))


@inlined
def _write_state(tube: Tube, state: int, columns: int, levels: int, z: Floats) -> None:
    place, column = state // columns, state % columns
    for j in range(z.shape[0]):
        z[j] = tube.places[place, j]
        if column > 0:
            z[j] += _level(column, levels) * tube.sides[(column - 1) // levels, j]


@inlined
def _column_beside(column: int, which: int, reach: int, levels: int) -> int:
    """A column that a step may lead to, the first one first, of `reach` columns; -1: there are no more.

    From the path that is itself, and the first step to each side; from beside it one step less, itself, one more.
    """
    if column == 0:
        new = 0 if which == 0 else 1 + (which - 1) * levels
        return new if new < reach else -1
    level = _level(column, levels)
    if which == 0:
        return 0 if level == 1 else column - 1
    return column + which - 1 if which == 1 or (which == 2 and level < levels) else -1


@inlined
def _is_a_step(tube: Tube, old: int, new: int, columns: int, levels: int, z: Floats, y: Floats) -> bool:
    """Tell if one step leads to a column beside and the same place or the next; z, y (nv,) are memory."""
    if old % columns == new % columns or old // columns == new // columns:
        return True
    _write_state(tube, old, columns, levels, z)
    _write_state(tube, new, columns, levels, y)
    longest = 0.0
    for j in range(z.shape[0]):
        longest = max(longest, abs(y[j] - z[j]) / tube.speeds[j])
    return bool(longest <= STRETCHED * tube.step)


@inlined
def _is_wait(tube: Tube, old: int, new: int, columns: int) -> bool:
    """Tell if a step stays where it is: at a state, or at the end."""
    if old == new:
        return True
    end = tube.places.shape[0] - 1 - tube.stays
    return old % columns == 0 and new % columns == 0 and min(old // columns, new // columns) >= end


@inlined
def _all_kept(wanted: KeptClearances) -> float:
    most = 0.0
    for k in range(wanted.kept.shape[1]):
        most = max(most, wanted.kept[0, k], wanted.kept[1, k])
    return most


@inlined
def _place_boxes(boxes: Floats, drifts: Floats, time: float, moved: Floats32) -> None:
    """Write the places of drifting boxes after a time [s] to boxes that are otherwise the same, shape (k, 16)."""
    for k in range(boxes.shape[0]):
        for r in range(3):
            moved[k, 4 * r + 3] = boxes[k, 4 * r + 3] + time * drifts[k, r]


@inlined
def _write_kept_at_end(
    words: Integers, boxes: Floats, drifts: Floats, wanted: KeptClearances, tube: Tube, moved: Floats32, ends: Floats32
) -> None:
    """Write the distance of each obstacle from the robot at the path's end after each step, shape (n, k) [m].

    If it is less than has to be kept, the most that is kept from anything: no schedule ends there then.
    """
    most, end = _all_kept(wanted), np.empty((1, tube.places.shape[1]), np.float32)
    end[0] = tube.places[tube.places.shape[0] - 1]
    for i in range(ends.shape[0]):
        _place_boxes(boxes, drifts, i * tube.step, moved)
        write_gaps(words, moved, most, end, ends[i : i + 1])
        for k in range(boxes.shape[0]):
            if ends[i, k] < wanted.kept[2, k]:
                ends[i, k] = most


@inlined
def _lacks(gaps: Floats32, wanted: KeptClearances, enough: Floats32, more: float) -> tuple[float, float]:
    """Return the distance that lacks at gaps (k,) from obstacles, on the move and where the robot waits [m].

    `enough` (k,) is kept of each at the path's end when the robot can be there, `more` more is enough here [m].
    """
    going, waiting = 0.0, 0.0
    for k in range(gaps.shape[0]):
        going = max(going, min(wanted.kept[0, k], enough[k] + more) - gaps[k])
        waiting = max(waiting, min(wanted.kept[1, k], enough[k] + more) - gaps[k])
    return going, waiting


@inlined
def _most_promising(tube: Tube, coming: Integers, count: int, width: int, values: Floats, columns: int) -> int:
    """Put the states that may cost least first, of `count` that come, and forget those after `width`; how many stay."""
    if count <= width:
        return count
    levels = (columns - 1) // max(1, tube.sides.shape[0])
    promise = np.empty(count)
    for c in range(count):
        state = coming[c]
        promise[c] = min(values[state, 0], values[state, 1]) + _time_left(tube, state, columns, levels)
    ranks = np.empty(count, np.int64)
    write_stable_order(promise, ranks)
    before = coming[:count].copy()
    for c in range(count):
        coming[c] = before[ranks[c]]
        if c >= width:
            values[coming[c]] = np.inf
    return width


@inlined
def _write_path(
    tube: Tube, before: Integers, end: int, steps: int, columns: int, timed: Floats, reached: Integers
) -> None:
    """Write where the robot is at each step, shape (steps + 1, nv), and its states, until the one at the end."""
    levels = (columns - 1) // max(1, tube.sides.shape[0])
    at = end
    for i in range(steps, -1, -1):
        _write_state(tube, at, columns, levels, timed[i])
        reached[i] = at
        at = before[i, at]


@inlined
def _expand(
    tube: Tube, active: Integers, size: int, costs: Floats, reach: int, best: float, values: Floats, origins: Integers,
    coming: Integers, z: Floats, y: Floats,
) -> int:  # fmt: skip
    """Write the states that can be reached a step later, and their least costs; how many they are.

    `values` (n, 2) gets what each costs at least, going there and waiting, infinite before, `origins` (n, 2) from
    where; columns behind `reach`, and what costs `best` all in all, are left out.
    """
    count, columns = tube.places.shape[0], tube.taken.shape[1]
    levels = (columns - 1) // max(1, tube.sides.shape[0])
    arriving = 0
    for a in range(size):
        old = active[a]
        for to in range(max(0, old // columns - 1), min(count, old // columns + 2)):
            which = -1
            while True:
                which += 1
                column = _column_beside(old % columns, which, reach, levels)
                if column < 0:
                    break
                new = to * columns + column
                value = costs[old] + tube.step * (1.0 + (ASIDE if column > 0 else 0.0))
                if value + _time_left(tube, new, columns, levels) >= best or tube.taken[to, column] != 0:
                    continue
                if not _is_a_step(tube, old, new, columns, levels, z, y):
                    continue
                if values[new, 0] == np.inf and values[new, 1] == np.inf:
                    coming[arriving] = new
                    arriving += 1
                kind = 1 if _is_wait(tube, old, new, columns) else 0
                if value < values[new, kind]:
                    values[new, kind], origins[new, kind] = value, old
    return arriving


@kernel
def find_schedule(
    words: Indices,
    boxes: Rows,
    drifts: Rows,
    wanted: KeptClearances,
    tube: Tube,
    width: int,
    timed: RowsOut,
    reached: IndicesOut,
) -> tuple[int, float]:
    """Find where to be at each step so that arriving costs least; return the rows of `timed`, and that cost [s].

    `words` are the robot, a packed `BatchWorld`, `boxes` (k, `ROUNDED_BOX`) what moves, now [m, world], `drifts` (k, 3)
    how fast each goes straight on [m/s]; beside the path at most `width` states are examined for each step, 0: none.
    `timed` (n, nv) gets the coordinates, `reached` (n,) the states; n - 1 steps are foreseen, and from the last state
    on the rest of the path costs its time. The cost is the time of arrival and of what lacks on the way.
    """
    count, columns = tube.places.shape[0], tube.taken.shape[1]
    levels = (columns - 1) // max(1, tube.sides.shape[0])
    states, times = count * columns, timed.shape[0]
    moved, all_kept = boxes.astype(np.float32), _all_kept(wanted)
    most_chosen = max(count, width)
    zs = np.empty((most_chosen, tube.places.shape[1]), np.float32)
    gaps = np.empty((most_chosen, boxes.shape[0]), np.float32)
    z, y = np.empty(tube.places.shape[1]), np.empty(tube.places.shape[1])
    costs, before = np.empty(states), np.full((times, states), -1)
    values, origins = np.full((states, 2), np.inf), np.empty((states, 2), np.int64)
    ends = np.empty((times, boxes.shape[0]), np.float32)
    _write_kept_at_end(words, boxes, drifts, wanted, tube, moved, ends)
    active, coming = np.empty(states, np.int64), np.empty(states, np.int64)
    best, rows = np.inf, 0
    for beside in range(2):
        if beside == 1 and (width == 0 or best <= tube.step * (count - 1) * (1.0 + ASIDE)):
            break
        reach, most = (columns, width) if beside == 1 else (1, states)
        costs[0], active[0], size = 0.0, 0, 1
        end, last = -1, 0
        for i in range(1, times):
            arriving = _expand(tube, active, size, costs, reach, best, values, origins, coming, z, y)
            chosen = _most_promising(tube, coming, arriving, most, values, columns)
            price, size = wanted.dear * tube.step / (1.0 + i * tube.step / FADING), 0
            _place_boxes(boxes, drifts, i * tube.step, moved)
            for c in range(chosen):
                _write_state(tube, coming[c], columns, levels, zs[c])
            write_gaps(words, moved, all_kept, zs[:chosen], gaps)
            for c in range(chosen):
                state = coming[c]
                left = _time_left(tube, state, columns, levels)
                to_end = max(0.0, left - tube.stays * tube.step)
                arrives = min(times - 1, i + round(to_end / tube.step))
                lacks = _lacks(gaps[c], wanted, ends[arrives], wanted.widening * to_end)
                going, waiting = values[state, 0] + price * lacks[0], values[state, 1] + price * lacks[1]
                value = min(going, waiting)
                before[i, state] = origins[state, 1] if waiting < going else origins[state, 0]
                values[state] = np.inf
                if value + left >= best:
                    continue
                if i == times - 1 or left == 0.0:
                    best, end, last = value + left, state, i
                    continue
                costs[state], active[size] = value, state
                size += 1
        if end >= 0:
            _write_path(tube, before, end, last, columns, timed, reached)
            rows = last + 1
    return rows, best
