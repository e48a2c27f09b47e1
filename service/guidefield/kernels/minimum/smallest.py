"""The smallest distances of some pairs along a motion, exact to a tolerance, by branch and bound over its time.

First the smallest distance at some places is found; then the intervals between them are judged, those with the smallest
ends first. Of an interval only the place in its middle is looked at. A pair is done with there

- if balls and boxes tell that it is farther apart than it can move in half of the interval, or
- by `kept_distance`, which looks at where each part of its bodies is going, and how that may change.

An interval is halved for the pairs that are left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types, void

from guidefield.kernels.jit.no_refcount import counted, uncounted
from guidefield.kernels.jit.signatures import SCALAR, VECTOR, Floats, Integers, compiled
from guidefield.kernels.minimum.closing import ACCELERATION, BOUNDS, TRAVEL, Rates, closing_of, find_rates
from guidefield.kernels.minimum.curve_rates import MOST_ORDER
from guidefield.kernels.minimum.pair_distance import Ask, least_distance, new_ask, pair_distance, pair_keeps
from guidefield.kernels.minimum.places import TWIST, Place, Room, find_twists, place_at
from guidefield.kernels.minimum.tables import MOVING_ROBOT, BodyPairs, MovingRobot, RobotBodies

DEEPEST = 48
"""How often an interval is halved at most: no number is between its ends after that."""

ERROR = 8e-6
"""How much smaller a distance may be than it was found, vertices in single precision counted [m]."""

SINCE, UNTIL, DISTANCE, TIME, PAIR, BOUND, ANSWER = range(7)
"""Numbers of a question, from when until when [s], and its answer: the smallest distance [m], when [s], which pair, and
what all keep at least [m]; then how many numbers there are."""

BEGINS, ENDS, INTERVAL = range(3)
"""Numbers of an interval that waits: from when until when [s]; then how many there are."""

SINCE_LEVEL, UNTIL_LEVEL, START, COUNT, LEVEL = range(5)
"""Numbers of an interval on the way down: from when until when [s], where its pairs begin and how many there are; then
how many numbers there are."""

MOST_LEFT = 20_000
"""An interval in which more pairs are left is halved before it is looked at closely."""

TOUCHING = -1
"""What is returned where two bodies touch, or nearly: how deep isn't known here."""

NEARLY = 1e-5
"""What is nearly touching [m]."""


class _Left(NamedTuple):
    """Intervals on the way down, and what is left in them.

    Attributes:
        stack: Shape (DEEPEST + 3, LEVEL).
        pairs: Those of each, one behind the other; first of all those that are looked at in a new one.
    """

    stack: Floats
    pairs: Integers


class _Search(NamedTuple):
    """What a search holds: the robot at a time, rates about it, and what was asked last."""

    place: Place
    room: Room
    rates: Rates
    ask: Ask


@counted
def _place(robot: RobotBodies) -> Place:
    n = robot.offset.shape[0]
    return Place(
        np.empty((robot.joints.parents.shape[0], 3, 4)),
        np.empty((robot.carriers.shape[0], 3)),
        np.empty((n, TWIST)),
        np.empty((n, TWIST)),
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
def _left(first: int, past: int) -> _Left:
    """Nothing is on the way down; some pairs are looked at in a new interval."""
    count, levels = past - first, DEEPEST + 3
    pairs = np.empty(count + levels * min(count, MOST_LEFT), np.int64)
    for k in range(count):
        pairs[k] = first + k
    return _Left(np.empty((levels, LEVEL)), pairs)


@counted
def new_search(moving: MovingRobot) -> _Search:
    """The robot is nowhere yet, and nothing is known."""
    robot, pairs = moving.robot, moving.pairs
    return _Search(_place(robot), _room(robot), _rates(robot, pairs), new_ask(moving))


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
    search = new_search(moving)
    place, least, nearest = search.place, np.empty(past - first), first
    for p in range(times.shape[0]):
        place_at(moving, times[p], place, search.room)
        for k in range(past - first):
            least[k] = least_distance(moving, first + k, place)
        found = np.inf
        for k in range(-1, past - first):  # the closest of the last time is asked before all others
            pair = nearest if k < 0 else first + k
            if past == first or least[pair - first] >= found or (k >= 0 and pair == nearest):
                continue
            apart = pair_distance(moving, pair, place, found, search.ask)
            if apart < found:
                found = apart
                nearest = pair
        distances_out[p] = found
        _keep(answers, times[p], found, nearest)


@uncounted
def _may_improve(answers: Floats, time: float, distance: float) -> float:
    """The largest answer at a time that a distance is smaller than; minus infinity where there is none."""
    most = -np.inf
    for q in range(answers.shape[0]):
        if answers[q, SINCE] <= time <= answers[q, UNTIL] and distance < answers[q, DISTANCE]:
            most = max(most, answers[q, DISTANCE])
    return most


@uncounted
def _is_done(
    moving: MovingRobot, search: _Search, pair: int, mover: int, level: Floats, tolerance: float, answers: Floats
) -> bool:
    """Whether a pair needn't be looked at closer in an interval, in whose middle the robot is."""
    since, until, known = level[SINCE_LEVEL], level[UNTIL_LEVEL], search.rates.known[mover]
    least = _least_asked(answers, since, until, tolerance)
    if least == -np.inf:
        return True
    least = max(least, 0.0)  # what overlaps isn't told from what touches
    if least_distance(moving, pair, search.place) - known[TRAVEL] - ERROR >= least:
        return True
    half, middle = 0.5 * (until - since), 0.5 * (since + until)
    asked = least + 0.5 * known[ACCELERATION] * half * half + ERROR
    kept = pair_keeps(moving, pair, search.place, known, half, asked, search.ask)
    if kept == np.inf:
        return True
    most = _may_improve(answers, middle, kept)
    if most > -np.inf:
        found = pair_distance(moving, pair, search.place, most, search.ask)
        if found < most:
            _keep(answers, middle, found, pair)
    return False


@uncounted
def _close(moving: MovingRobot, search: _Search, pair: int, mover: int, level: Floats, answers: Floats) -> None:
    """Write to the answers' bounds what a pair keeps at least in an interval, in whose middle the robot is."""
    apart = pair_distance(moving, pair, search.place, np.inf, search.ask)
    _keep(answers, 0.5 * (level[SINCE_LEVEL] + level[UNTIL_LEVEL]), apart, pair)
    kept = apart - search.rates.known[mover, TRAVEL] - ERROR
    for q in range(answers.shape[0]):
        if level[SINCE_LEVEL] >= answers[q, SINCE] and level[UNTIL_LEVEL] <= answers[q, UNTIL]:
            answers[q, BOUND] = min(answers[q, BOUND], kept)


@uncounted
def _judged(
    moving: MovingRobot,
    search: _Search,
    left: _Left,
    interval: int,
    level: int,
    tolerance: float,
    closing: bool,
    answers: Floats,
) -> int:
    """Judge an interval on the stack: the pairs left are written behind its own; how many, or -1: too many.

    Where it is the end (`closing`), what those keep at least is written to the answers' bounds.
    """
    row = left.stack[level]
    since, until, start, count = row[SINCE_LEVEL], row[UNTIL_LEVEL], int(row[START]), int(row[COUNT])
    half, behind = 0.5 * (until - since), start + count
    place_at(moving, 0.5 * (since + until), search.place, search.room)
    find_twists(moving, search.place, search.room)
    find_rates(moving, since, until, search.rates)
    for index in range(start, start + count):
        pair = left.pairs[index]
        mover = closing_of(moving, pair, interval, half, search.place, search.rates)
        if _is_done(moving, search, pair, mover, row, tolerance, answers):
            continue
        if closing:
            _close(moving, search, pair, mover, row, answers)
            continue
        if behind == left.pairs.shape[0]:
            return -1
        left.pairs[behind] = pair
        behind += 1
    return behind - start - count


@uncounted
def _halve(left: _Left, level: int, more: int) -> int:
    """Put an interval's halves in its place on the stack, with the pairs behind its own; how many are on it then."""
    row = left.stack[level]
    since, until, start = row[SINCE_LEVEL], row[UNTIL_LEVEL], row[START] + row[COUNT]
    middle = 0.5 * (since + until)
    if more == 0 or level + 2 > left.stack.shape[0] or not since < middle < until:
        return level
    for half in range(2):
        other = left.stack[level + half]
        other[SINCE_LEVEL], other[UNTIL_LEVEL] = (middle, until) if half == 0 else (since, middle)
        other[START], other[COUNT] = start, more
    return level + 2


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
        waiting: Intervals that wait, no rate jumps within one, shape (w, INTERVAL), with room for `DEEPEST` + 3 more;
            the last comes first.
        count: How many there are.

    Returns:
        How many wait now; `TOUCHING` where bodies touch, or nearly.
    """
    search, left, interval = new_search(moving), _left(first, past), 0
    stack = left.stack
    while count > 0 and (interval < most or closing):
        count -= 1
        stack[0, SINCE_LEVEL], stack[0, UNTIL_LEVEL] = waiting[count, BEGINS], waiting[count, ENDS]
        stack[0, START], stack[0, COUNT], top = 0.0, past - first, 1
        while top > 0 and (interval < most or closing):
            interval += 1
            more = _judged(moving, search, left, interval, top - 1, tolerance, closing, answers)
            for q in range(answers.shape[0]):
                if answers[q, DISTANCE] <= NEARLY:
                    return TOUCHING
            if more < 0:
                stack[top - 1, COUNT], more = 0.0, past - first
            top = _halve(left, top - 1, more)
        for level in range(top):  # what is on the stack waits again
            waiting[count, BEGINS], waiting[count, ENDS] = stack[level, SINCE_LEVEL], stack[level, UNTIL_LEVEL]
            count += 1
    return count
