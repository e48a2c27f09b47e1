"""The smallest distances of some pairs along a motion, exact to a tolerance, by branch and bound over its time.

First the smallest distance at some places is found, and then, about the smallest of them, where it is smaller still.
Then stretches of the motion are judged, all of it first. Of a stretch only the place in its middle is looked at. A pair
is done with there

- if balls and boxes tell that it is farther apart than it can move in half of the stretch, or
- by `kept_distance`, which looks at where each part of its bodies is going, and how that may change.

A stretch is halved for the pairs that are left: what is far apart all along is done with in long ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.jit.no_refcount import counted, uncounted
from guidefield.kernels.jit.signatures import SCALAR, VECTOR, Floats, Integers, compiled
from guidefield.kernels.prove.answers import (
    BOUND,
    OWN,
    SINCE,
    UNTIL,
    is_own,
    keep,
    least_asked,
    may_improve,
    nearly_touch,
)
from guidefield.kernels.prove.closing import BENT, TRAVEL, body_closing, closing_of, find_moves
from guidefield.kernels.prove.looks import APART, WHEN, Search, look_about, look_at, new_search
from guidefield.kernels.prove.pair_distance import least_distance, pair_distance, pair_keeps, squared_gap
from guidefield.kernels.prove.places import find_twists, place_at
from guidefield.kernels.prove.tables import MOVING_ROBOT, MovingRobot

DEEPEST = 48
"""How often a stretch is halved at most: no number is between its ends after that."""

ERROR = 8e-6
"""How much smaller a distance may be than it was found, vertices in single precision counted [m]."""

BEGINS, ENDS, INTERVAL = range(3)
"""Numbers of a stretch that waits: from when until when [s]; then how many there are."""

SINCE_LEVEL, UNTIL_LEVEL, START, COUNT, LEVEL = range(5)
"""Numbers of a stretch on the way down: from when until when [s], where its pairs begin and how many there are; then
how many numbers there are."""

MOST_LEFT = 20_000
"""A stretch in which more pairs are left is halved before it is looked at closely."""

TOUCHING = -1
"""What is returned where two bodies touch, or nearly: how deep isn't known here."""


class _Left(NamedTuple):
    """Stretches on the way down, and what is left in them.

    Attributes:
        stack: Shape (DEEPEST + 3, LEVEL).
        pairs: Those of each, one behind the other; first of all those that are looked at in a new one.
    """

    stack: Floats
    pairs: Integers


@counted
def _left(count: int) -> _Left:
    """Nothing is on the way down; all of so many pairs are looked at in a new stretch."""
    levels = DEEPEST + 3
    pairs = np.empty(count + levels * min(count, MOST_LEFT), np.int64)
    for k in range(count):
        pairs[k] = k
    return _Left(np.empty((levels, LEVEL)), pairs)


@uncounted
def _are_far(moving: MovingRobot, search: Search, pair: int, stretch: int, share: float, least: float) -> bool:
    """Whether a pair keeps a distance by its balls, or ball and box, as both bodies are seen from the world."""
    place, ways, robot, pairs = search.place, search.ways, moving.robot, moving.pairs
    a, b = pairs.first[pair], pairs.second[pair]
    reach = least + ERROR + robot.radii[a] + ways.known[body_closing(robot, a, stretch, share, place, ways), TRAVEL]
    if pair < pairs.first_by.shape[0]:
        reach += robot.radii[b] + ways.known[body_closing(robot, b, stretch, share, place, ways), TRAVEL]
    return bool(squared_gap(moving, pair, place) >= reach * reach)


@uncounted
def _is_done(
    moving: MovingRobot,
    search: Search,
    pair: int,
    stretch: int,
    share: float,
    level: Floats,
    least: float,
    longest: float,
    answers: Floats,
) -> bool:
    """Whether a pair needn't be looked at closer in a stretch, in whose middle the robot is: it keeps what is asked."""
    since, until = level[SINCE_LEVEL], level[UNTIL_LEVEL]
    if _are_far(moving, search, pair, stretch, share, least):
        return True
    if until - since > longest:
        return False
    apart, middle = least_distance(moving, pair, search.place), 0.5 * (since + until)
    known = search.ways.known[closing_of(moving, pair, stretch, share, search.place, search.ways)]
    if apart - known[TRAVEL] - ERROR >= least:
        return True
    asked, last = least + known[BENT] + ERROR, search.told[pair]
    if since <= last[WHEN] <= until and asked > last[APART] + known[TRAVEL]:
        return False  # it isn't as far apart in the middle either
    kept = pair_keeps(moving, pair, search.place, known, share, asked, known[BENT], search.ask)
    if kept == np.inf:
        return True
    last[APART], last[WHEN] = kept, middle
    own = is_own(moving, pair)
    most = may_improve(answers, own, middle, kept)
    if most > -np.inf:
        found = pair_distance(moving, pair, search.place, most, search.ask)
        if found < most:
            last[APART] = found
            keep(answers, own, middle, found, pair)
    return False


@uncounted
def _close(moving: MovingRobot, search: Search, pair: int, travel: float, level: Floats, answers: Floats) -> None:
    """Write to the answers' bounds what a pair keeps at least in a stretch, in whose middle the robot is."""
    apart = pair_distance(moving, pair, search.place, np.inf, search.ask)
    since, until = level[SINCE_LEVEL], level[UNTIL_LEVEL]
    own = is_own(moving, pair)
    keep(answers, own, 0.5 * (since + until), apart, pair)
    for q in range(answers.shape[0]):
        if since < answers[q, UNTIL] and until > answers[q, SINCE] and answers[q, OWN] == own:
            answers[q, BOUND] = min(answers[q, BOUND], apart - travel - ERROR)


@uncounted
def _judged(
    moving: MovingRobot,
    search: Search,
    left: _Left,
    stretch: int,
    level: int,
    tolerance: float,
    longest: float,
    shortest: float,
    answers: Floats,
) -> int:
    """Judge a stretch on the stack: the pairs left are written behind its own; how many, or -1: too many.

    Where it is no longer than `shortest`, what those keep at least is written to the answers' bounds.
    """
    row = left.stack[level]
    since, until, start, count = row[SINCE_LEVEL], row[UNTIL_LEVEL], int(row[START]), int(row[COUNT])
    behind = start + count
    place_at(moving, 0.5 * (since + until), search.place, search.room)
    share = find_moves(moving, since, until, search.room, search.ways)
    find_twists(moving, search.place, search.room)
    asked, of_own = least_asked(answers, 0, since, until, tolerance), least_asked(answers, 1, since, until, tolerance)
    for index in range(start, start + count):
        pair = left.pairs[index]
        own = is_own(moving, pair)
        least = of_own if own else asked
        if least == -np.inf or _is_done(moving, search, pair, stretch, share, row, least, longest, answers):
            continue
        if own:  # an answer may be smaller now
            of_own = least_asked(answers, 1, since, until, tolerance)
        else:
            asked = least_asked(answers, 0, since, until, tolerance)
        if until - since <= shortest:
            mover = closing_of(moving, pair, stretch, share, search.place, search.ways)
            _close(moving, search, pair, search.ways.known[mover, TRAVEL], row, answers)
            continue
        if behind == left.pairs.shape[0]:
            return -1
        left.pairs[behind] = pair
        behind += 1
    return behind - start - count


@uncounted
def _halve(left: _Left, level: int, more: int) -> int:
    """Put a stretch's halves in its place on the stack, with the pairs behind its own; how many are on it then."""
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


ANSWERS = types.Array(types.float64, 2, "C")

_INDEX, _OUT = types.int64, types.Array(types.float64, 1, "C")


@compiled(_INDEX(MOVING_ROBOT, SCALAR, VECTOR, _INDEX, _INDEX, SCALAR, SCALAR, ANSWERS, ANSWERS, _INDEX, _OUT))
def search_along(
    moving: MovingRobot,
    tolerance: float,
    times: Floats,
    few: int,
    most: int,
    longest: float,
    shortest: float,
    answers: Floats,
    waiting: Floats,
    count: int,
    distances_out: Floats,
) -> int:
    """Look at some times, and judge stretches of a motion until none waits: then no answer is too large.

    Args:
        moving: The robot, all its pairs and its motion.
        tolerance: By how much an answer may be too large, positive [m].
        times: At which it is looked first, evenly apart, those of the whole motion's ends among them; or none, where
            they were looked at before, shape (p,) [s].
        few: It is looked for own pairs at every so manieth of them, and at the last.
        most: How many stretches are judged before it is left at that; at least one that waits is.
        longest: In longer stretches balls and boxes alone tell [s].
        shortest: Stretches no longer than this aren't halved any more, and it is gone on until none waits: what is kept
            at least there is written to the answers' bounds. 0 as long as there is time [s].
        answers: Questions with what is known of their answers, shape (q, ANSWER); written.
        waiting: Stretches that wait, shape (w, INTERVAL), with room for `DEEPEST` + 3 more;
            the last comes first.
        count: How many there are.
        distances_out: Smallest distance from obstacles at each time, shape (p,) [m]; infinite without one.

    Returns:
        How many wait now; `TOUCHING` where bodies touch, or nearly.
    """
    search, left, stretch = new_search(moving), _left(moving.pairs.first.shape[0]), 0
    stack, last = left.stack, times.shape[0] - 1
    if last >= 0:
        look_at(moving, search, times, few, answers, distances_out)
        if nearly_touch(answers):
            return TOUCHING
        look_about(moving, search, (times[last] - times[0]) / max(last, 1), answers)
    while count > 0 and (stretch < most or shortest > 0.0):
        count -= 1
        stack[0, SINCE_LEVEL], stack[0, UNTIL_LEVEL] = waiting[count, BEGINS], waiting[count, ENDS]
        stack[0, START], stack[0, COUNT], top = 0.0, float(moving.pairs.first.shape[0]), 1
        while top > 0 and (stretch < most or shortest > 0.0):
            stretch += 1
            more = _judged(moving, search, left, stretch, top - 1, tolerance, longest, shortest, answers)
            if nearly_touch(answers):
                return TOUCHING
            if more < 0:  # both halves have all of its own
                more = int(stack[top - 1, COUNT])
                stack[top - 1, COUNT] = 0.0
            top = _halve(left, top - 1, more)
        for level in range(top):  # what is on the stack waits again
            waiting[count, BEGINS], waiting[count, ENDS] = stack[level, SINCE_LEVEL], stack[level, UNTIL_LEVEL]
            count += 1
    return count
