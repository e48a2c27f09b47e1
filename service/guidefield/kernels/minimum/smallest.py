"""The smallest distances of some pairs along a motion, exact to a tolerance, by branch and bound over its time.

The rules that say that a pair keeps a distance from one place to the next are those of `collision.minimum.intervals`,
of first and second order. First the smallest distance at some places is found; then the intervals between them are
judged, those with the smallest ends first. An interval is halved for the pairs that the rules leave.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types, void

from guidefield.kernels.jit.no_refcount import counted, uncounted
from guidefield.kernels.jit.signatures import SCALAR, VECTOR, Floats, Integers, compiled
from guidefield.kernels.minimum.closing import ACCELERATION, BOUNDS, SPEED, Rates, closing_of, find_rates
from guidefield.kernels.minimum.curve_rates import MOST_ORDER
from guidefield.kernels.minimum.pair_distance import Ask, least_distance, new_ask, pair_distance
from guidefield.kernels.minimum.places import TWIST, Places, Room, place
from guidefield.kernels.minimum.tables import MOVING_ROBOT, BodyPairs, MovingRobot, RobotBodies

DEEPEST = 48
"""How often an interval is halved at most: no number is between its ends after that."""

ERROR = 8e-6
"""How much smaller a distance may be than it was found, vertices in single precision counted [m]."""

SINCE, UNTIL, DISTANCE, TIME, PAIR, BOUND, ANSWER = range(7)
"""Numbers of a question, from when until when [s], and its answer: the smallest distance [m], when [s], which pair, and
what all keep at least [m]; then how many numbers there are."""

BEGINS, ENDS, JUMPS_FIRST, JUMPS_LAST, INTERVAL = range(5)
"""Numbers of an interval that waits: from when until when [s], whether a rate jumps there; then how many there are."""

LOW, HIGH, START, COUNT, LEVEL = range(5)
"""Numbers of an interval on the way down: its first and its last slot, where its columns begin and how many there are;
then how many numbers there are."""

MOST_LEFT = 20_000
"""An interval in which more pairs are left is halved before it is looked at closely."""

TOUCHING = -1
"""What is returned where two bodies touch, or nearly: how deep isn't known here."""

NEARLY = 1e-5
"""What is nearly touching [m]."""


class _Left(NamedTuple):
    """Intervals on the way down, and what is left in them; slots hold places.

    Attributes:
        pairs: The pair of each column, shape (most,).
        distances: Of each pair at each slot, at least, shape (slots, most) [m].
        exact: Whether that is the distance itself, shape (slots, most).
        jumps: Whether a rate jumps at a slot, shape (slots,).
        stack: Shape (slots, LEVEL).
        columns: Shape (slots * most,).
    """

    pairs: Integers
    distances: Floats
    exact: np.ndarray
    jumps: np.ndarray
    stack: Integers
    columns: Integers


class _Search(NamedTuple):
    """What a search holds: the robot at some times, rates between two of them, what is left, what was asked last."""

    places: Places
    room: Room
    rates: Rates
    left: _Left
    ask: Ask


@counted
def _places(robot: RobotBodies, pairs: BodyPairs, slots: int) -> Places:
    r, n, movers = robot.carriers.shape[0], robot.offset.shape[0], robot.carriers.shape[0] + pairs.first_by.shape[0]
    return Places(
        np.empty(slots),
        np.empty((slots, robot.joints.parents.shape[0], 3, 4)),
        np.empty((slots, r, 3)),
        np.empty((slots, r, n)),
        np.empty((slots, movers)),
    )


@counted
def _room(robot: RobotBodies) -> Room:
    n, nv = robot.offset.shape[0], robot.expand.shape[1]
    return Room(
        np.empty(MOST_ORDER),
        np.empty(nv),
        np.empty(nv),
        np.empty(n),
        np.empty(n),
        np.empty(robot.origin.shape[0]),
        np.empty((n, TWIST)),
        np.empty((n, TWIST)),
        np.empty(n),
    )


@counted
def _rates(robot: RobotBodies, pairs: BodyPairs) -> Rates:
    n, movers = robot.offset.shape[0], robot.carriers.shape[0] + pairs.first_by.shape[0]
    return Rates(
        np.empty(MOST_ORDER),
        np.empty(robot.expand.shape[1]),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty((movers, BOUNDS)),
        np.zeros(movers),
    )


@counted
def _left(slots: int, most: int) -> _Left:
    return _Left(
        np.empty(most, np.int64),
        np.empty((slots, most)),
        np.empty((slots, most), np.bool_),
        np.empty(slots, np.bool_),
        np.empty((slots, LEVEL), np.int64),
        np.empty(slots * most, np.int64),
    )


@counted
def _search(moving: MovingRobot, slots: int, most: int) -> _Search:
    """A search with room for so many times, and for so many pairs that are left of an interval."""
    robot, pairs = moving.robot, moving.pairs
    return _Search(
        _places(robot, pairs, slots), _room(robot), _rates(robot, pairs), _left(slots, most), new_ask(moving)
    )


@uncounted
def _keeps(a: float, b: float, speed: float, acceleration: float, span: float, least: float) -> bool:
    """Whether a pair that is so far apart at two times keeps a distance between them, by one of the rules."""
    if _first_order(a, b, speed, span) >= least:
        return True
    if least <= 0.0:
        return False
    a, b, travel = max(a - ERROR, 0.0), max(b - ERROR, 0.0), speed * span
    low, high = min(a, b) * min(a, b), max(a, b) * max(a, b)
    sag = (speed * speed + (least + travel) * acceleration) * span * span
    rise, lowest = high - low, low
    if rise < sag:
        drop = rise / sag
        lowest = 0.5 * (low + high) - 0.25 * sag * (1.0 + drop * drop)
    return lowest >= least * least


@uncounted
def _first_order(a: float, b: float, speed: float, span: float) -> float:
    travel = speed * span
    return max(0.5 * (a + b - travel), max(a, b) - travel) - ERROR


@uncounted
def _least_asked(answers: Floats, since: float, until: float, tolerance: float) -> float:
    """What has to be kept between two times, so that no answer is more than the tolerance too large."""
    least = -np.inf
    for q in range(answers.shape[0]):
        if since >= answers[q, SINCE] and until <= answers[q, UNTIL]:
            least = max(least, answers[q, DISTANCE] - tolerance)
    return least


@uncounted
def _keep(answers: Floats, time: float, distance: float, pair: int) -> None:
    """Keep a distance where it is smaller than all before."""
    for q in range(answers.shape[0]):
        if answers[q, SINCE] <= time <= answers[q, UNTIL] and distance < answers[q, DISTANCE]:
            answers[q, DISTANCE], answers[q, TIME], answers[q, PAIR] = distance, time, pair


ANSWERS = types.Array(types.float64, 2, "C")


@compiled(void(MOVING_ROBOT, types.int64, types.int64, VECTOR, ANSWERS, types.Array(types.float64, 1, "C")))
def smallest_at(
    moving: MovingRobot,
    first: int,
    past: int,
    times: Floats,
    answers: Floats,
    distances_out: Floats,
) -> None:
    """The smallest distance of some pairs at times.

    Args:
        moving: The robot, all its pairs and its motion.
        first: The first pair that counts.
        past: The one past the last.
        times: Shape (p,) [s].
        answers: Questions, shape (q, ANSWER): what is smaller than the answers is written there.
        distances_out: Smallest distance at each time, shape (p,) [m]; infinite without a pair.
    """
    search = _search(moving, 1, 0)
    places, least, nearest = search.places, np.empty(past - first), first
    for p in range(times.shape[0]):
        place(moving, times[p], False, 0, places, search.room)
        for k in range(past - first):
            least[k] = least_distance(moving, first + k, 0, places)
        found = np.inf
        for k in range(-1, past - first):  # the closest of the last time is asked before all others
            pair = nearest if k < 0 else first + k
            if past == first or least[pair - first] >= found or (k >= 0 and pair == nearest):
                continue
            apart = pair_distance(moving, pair, 0, places, found, search.ask)
            if apart < found:
                found = apart
                nearest = pair
        distances_out[p] = found
        _keep(answers, times[p], found, nearest)


@uncounted
def _closer(moving: MovingRobot, search: _Search, slot: int, column: int, most: float, answers: Floats) -> None:
    """Take the distance of a pair at a slot to what it is, up to `most`, unless that is known."""
    left = search.left
    if left.exact[slot, column] or left.distances[slot, column] >= most:
        return
    pair = left.pairs[column]
    found = pair_distance(moving, pair, slot, search.places, most, search.ask)
    left.distances[slot, column] = max(left.distances[slot, column], found) if found >= most else found
    if found < most:
        left.exact[slot, column] = True
        _keep(answers, search.places.times[slot], found, pair)


@uncounted
def _judged(
    moving: MovingRobot, search: _Search, interval: int, level: int, tolerance: float, closing: bool, answers: Floats
) -> int:
    """Judge the interval on a level of the stack: the columns left are written behind its own; how many there are.

    Where it is the end (`closing`), what those keep at least is written to the answers' bounds.
    """
    places, rates, left = search.places, search.rates, search.left
    low, high = int(left.stack[level, LOW]), int(left.stack[level, HIGH])
    start, count = int(left.stack[level, START]), int(left.stack[level, COUNT])
    since, until = places.times[low], places.times[high]
    find_rates(moving, since, until, rates)
    span, behind = until - since, start + count
    for index in range(start, start + count):
        column = left.columns[index]
        mover = closing_of(moving, left.pairs[column], interval, low, high, places, rates)
        speed, acceleration = rates.known[mover, SPEED], rates.known[mover, ACCELERATION]
        least = _least_asked(answers, since, until, tolerance)
        a, b = left.distances[low, column], left.distances[high, column]
        if _keeps(a, b, speed, acceleration, span, least):
            continue
        most = least + 0.5 * speed * span + 4.0 * ERROR
        _closer(moving, search, low, column, most, answers)
        _closer(moving, search, high, column, most, answers)
        least = _least_asked(answers, since, until, tolerance)
        a, b = left.distances[low, column], left.distances[high, column]
        if _keeps(a, b, speed, acceleration, span, least):
            continue
        if closing:
            for q in range(answers.shape[0]):
                if since >= answers[q, SINCE] and until <= answers[q, UNTIL]:
                    answers[q, BOUND] = min(answers[q, BOUND], _first_order(a, b, speed, span))
            continue
        left.columns[behind] = column
        behind += 1
    return behind - start - count


@uncounted
def _begun(
    moving: MovingRobot, search: _Search, first: int, past: int, interval: int, tolerance: float, answers: Floats
) -> int:
    """The pairs that balls and boxes leave between slots 0 and 1, as columns; how many there are, or -1: too many."""
    places, rates, left = search.places, search.rates, search.left
    count, since, until = 0, places.times[0], places.times[1]
    find_rates(moving, since, until, rates)
    least = _least_asked(answers, since, until, tolerance)
    for pair in range(first, past):
        a = least_distance(moving, pair, 0, places)
        b = least_distance(moving, pair, 1, places)
        mover = closing_of(moving, pair, interval, 0, 1, places, rates)
        if _keeps(a, b, rates.known[mover, SPEED], rates.known[mover, ACCELERATION], until - since, least):
            continue
        if count == left.pairs.shape[0]:
            return -1
        left.pairs[count], left.columns[count] = pair, count
        left.distances[0, count], left.distances[1, count] = a, b
        left.exact[0, count] = left.exact[1, count] = False
        count += 1
    return count


_INDEX = types.int64


@compiled(_INDEX(MOVING_ROBOT, _INDEX, _INDEX, SCALAR, _INDEX, types.boolean, ANSWERS, ANSWERS, _INDEX))
def smallest_between(
    moving: MovingRobot,
    first: int,
    past: int,
    tolerance: float,
    most: int,
    closing: bool,
    answers: Floats,
    waiting: Floats,
    count: int,
) -> int:
    """Judge intervals of a motion until none waits: then no answer is more than the tolerance too large.

    Args:
        moving: The robot, all its pairs and its motion.
        first: The first pair that counts.
        past: The one past the last.
        tolerance: Positive [m].
        most: How many intervals are judged before it is left at that; at least one that waits is.
        closing: Whether none is halved any more: what is left is kept at least is written to the answers' bounds.
        answers: Questions with what is known of their answers, shape (q, ANSWER); written.
        waiting: Intervals that wait, shape (w, INTERVAL), with room for 2 + `DEEPEST` more; the last comes first.
        count: How many there are.

    Returns:
        How many wait now; `TOUCHING` where bodies touch, or nearly.
    """
    search, interval = _search(moving, DEEPEST + 3, min(past - first, MOST_LEFT)), 0
    places, room, left = search.places, search.room, search.left
    while count > 0 and (interval < most or closing):
        count -= 1
        row = waiting[count]
        for slot in range(2):
            place(moving, row[slot], row[JUMPS_FIRST + slot] != 0.0, slot, places, room)
            left.jumps[slot] = row[JUMPS_FIRST + slot] != 0.0
        interval += 1
        began = _begun(moving, search, first, past, interval, tolerance, answers)
        if began < 0:
            middle = 0.5 * (row[BEGINS] + row[ENDS])
            until, jumps = row[ENDS], row[JUMPS_LAST]
            row[ENDS], row[JUMPS_LAST] = middle, 0.0
            after = waiting[count + 1]
            after[BEGINS], after[ENDS], after[JUMPS_FIRST], after[JUMPS_LAST] = middle, until, 0.0, jumps
            count += 2
            continue
        first_level = left.stack[0]
        first_level[LOW], first_level[HIGH], first_level[START], first_level[COUNT] = 0, 1, 0, began
        top = 1
        while top > 0:
            if interval >= most and not closing:  # what is on the stack waits again
                for level in range(top):
                    a, b = left.stack[level, LOW], left.stack[level, HIGH]
                    again = waiting[count]
                    again[BEGINS], again[ENDS] = places.times[a], places.times[b]
                    again[JUMPS_FIRST], again[JUMPS_LAST] = left.jumps[a], left.jumps[b]
                    count += 1
                break
            top -= 1
            interval += 1
            more = _judged(moving, search, interval, top, tolerance, closing, answers)
            for q in range(answers.shape[0]):
                if answers[q, DISTANCE] <= NEARLY:
                    return TOUCHING
            low, high = left.stack[top, LOW], left.stack[top, HIGH]
            middle = 0.5 * (places.times[low] + places.times[high])
            slot = max(low, high) + 1
            if more == 0 or slot >= left.jumps.shape[0] or not places.times[low] < middle < places.times[high]:
                continue
            begins = left.stack[top, START] + left.stack[top, COUNT]
            place(moving, middle, False, slot, places, room)
            left.jumps[slot] = False
            for index in range(begins, begins + more):
                column = left.columns[index]
                left.distances[slot, column] = least_distance(moving, left.pairs[column], slot, places)
                left.exact[slot, column] = False
            for level in range(2):
                half = left.stack[top + level]
                half[LOW], half[HIGH] = (slot, high) if level == 0 else (low, slot)
                half[START], half[COUNT] = begins, more
            top += 2
    return count
