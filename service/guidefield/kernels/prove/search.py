"""One search over a motion: a certificate, the first violation, and the smallest distances, by interval bounds.

Continuous collision detection by bounds on motion and distance (Quinlan 1994; Schwarzer, Saha and Latombe 2005), depth
first along the motion, after samples have given first answers. A segment is judged with the robot placed in its middle;
a pair is done with if bounding spheres and boxes are farther apart than both bodies can move within half of it, or if
each two nodes of its bodies' trees are separated by their spheres or by a slab (`kept_distance`, `motion_bounds`). A
segment is halved for the pairs that are left.

What has to be kept is the larger one of the margin and of the smallest distance found so far less the tolerance. As
segments are judged in their order, the search ends at the first violation, to the resolution. `prove/search.py` and
`stream/commit.py` call it, with a limit of segments; questions and verdict are rows of `tables`. `ALL_AT_ONCE` and
`longest` change time and the count of segments, `FINE` smallest distances by at most itself, `DEEPEST` where it gives
up. `LIST` and it are memory; if more pairs than `LIST` stay near in segments however short, nothing is found in time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.arrays import Floats, Integers, Row, RowOut, RowsOut
from guidefield.kernels.jit.decorators import counted, kernel, uncounted
from guidefield.kernels.prove.kept_distance import LOG_COUNT, LOG_PATIENT, LOG_SEGMENT
from guidefield.kernels.prove.motion_bounds import (
    BENT,
    IN_TUBE,
    TRAVEL,
    bound_body,
    bound_pair,
    find_moves,
    mover_reach,
)
from guidefield.kernels.prove.pair_distance import (
    kept_in_addition,
    least_distance,
    list_near,
    pair_distance,
    pair_keeps,
    squared_gap,
)
from guidefield.kernels.prove.placement import NOW, find_twists, kept_from_mover, place_at
from guidefield.kernels.prove.samples import (
    ALL_AT_ONCE,
    APART,
    LIST,
    WHEN,
    Search,
    new_search,
    sample_about,
    sample_motion,
)
from guidefield.kernels.prove.tables import (
    BOUND,
    CULPRIT,
    END,
    ERROR,
    FREE,
    OWN,
    OWN_PAIRS,
    PLACE,
    REASON,
    RESOLUTION,
    SEGMENTS,
    SINCE,
    STAND_OFF,
    UNDECIDED,
    UNTIL,
    MovingRobot,
    first_body,
    is_judged,
    is_own,
    keep,
    largest_answer_above,
    margin_of,
    obstacle_of,
    refuse,
    required_distance,
)

DEEPEST = 48  # most halvings of a segment in a call: it may only grow, as callers have 3 times as many rows, unchecked
BEGINS, ENDS, INTERVAL = range(3)  # columns of a segment that waits: its begin and end; then their number

SINCE_LEVEL, UNTIL_LEVEL, START, COUNT, LEVEL = range(5)
"""Columns of a segment on the stack: begin, end, where its pairs begin and their number, -1 where they are to be
listed; then the number of columns."""

TO_LIST = -1.0  # the number of pairs of a segment whose pairs are to be listed

FINE = 1e-5  # no distance of a pair that moves less than this in a segment differs by more from that in its middle [m]
LOG_ENDS = 3  # columns of a segment in a log: begin, end, and the parameter of the placement


class _Left(NamedTuple):
    """The segments on the stack, and the remaining pairs of each."""

    stack: Floats  # shape (DEEPEST + 3, LEVEL)
    pairs: Integers  # those of each, one behind the other


@counted
def _new_stack() -> _Left:
    levels = DEEPEST + 3
    return _Left(np.empty((levels, LEVEL)), np.empty(levels * LIST, np.int64))


@uncounted
def _list_pairs(
    moving: MovingRobot,
    search: Search,
    left: _Left,
    segment: int,
    share: float,
    start: int,
    of_own: float,
    asked: float,
    verdict: Floats,
) -> int:
    """List the pairs that spheres and boxes can't tell apart in a segment from `start` on.

    -1 where too many, else the count. The robot is in the segment's middle, `share` is L of it; own pairs have to keep
    `of_own`, others `asked` [m].
    """
    robot, pairs, movers, bounds = moving.robot, moving.pairs, moving.movers, search.bounds
    count, capacity = 0, min(LIST, left.pairs.shape[0] - start)
    if of_own > -np.inf and is_judged(verdict, OWN_PAIRS):
        for pair in range(pairs.own.shape[0]):
            if not _are_far(moving, search, pair, segment, share, of_own + verdict[ERROR]):
                if count < capacity:
                    left.pairs[start + count] = pair
                count += 1
    if asked > -np.inf:
        for mover in range(movers.begins.shape[0] - 1):
            more = kept_from_mover(movers, mover, search.place.moment[NOW])
            search.mover_reach[mover] = mover_reach(movers, mover, search.place, bounds) + more
        for row in range(pairs.moving.shape[0]):
            b = pairs.moving[row]
            travel = bounds.known[bound_body(robot, b, segment, share, search.place, bounds), TRAVEL]
            reach = asked + verdict[ERROR] + robot.radii[b] + travel
            if count <= capacity:
                count = list_near(
                    moving, verdict, row, reach, search.mover_reach, search.place, search.boxes,
                    left.pairs, start, capacity, count,
                )  # fmt: skip
    return count if count <= capacity else -1


@uncounted
def _are_far(moving: MovingRobot, search: Search, pair: int, segment: int, share: float, asked: float) -> bool:
    """Return whether a pair keeps a distance by its spheres, or sphere and box, each seen from the world."""
    place, bounds, robot, pairs = search.place, search.bounds, moving.robot, moving.pairs
    a = first_body(pairs, moving.obstacles, pair)
    reach = asked + robot.radii[a] + bounds.known[bound_body(robot, a, segment, share, place, bounds), TRAVEL]
    if is_own(pairs, pair) == 1:
        b = pairs.own[pair, 1]
        reach += robot.radii[b] + bounds.known[bound_body(robot, b, segment, share, place, bounds), TRAVEL]
    else:
        mover = moving.obstacles.movers[obstacle_of(pairs, moving.obstacles, pair)]
        if mover >= 0:
            reach += mover_reach(moving.movers, mover, place, bounds) + kept_in_addition(moving, pair, place)
    return bool(squared_gap(moving, pair, place) >= reach * reach)


@uncounted
def _is_done(
    moving: MovingRobot,
    search: Search,
    pair: int,
    segment: int,
    share: float,
    level: Floats,
    least: float,
    longest: float,
    tolerance: float,
    questions: Floats,
    verdict: Floats,
) -> bool:
    """Return whether a pair keeps a distance in a segment, in whose middle the robot is; note what is found there."""
    since, until, error = level[SINCE_LEVEL], level[UNTIL_LEVEL], verdict[ERROR]
    if _are_far(moving, search, pair, segment, share, least + error):
        return True
    if until - since > longest:
        return False
    apart, middle = least_distance(moving, pair, search.place), 0.5 * (since + until)
    known = search.bounds.known[bound_pair(moving, pair, segment, share, search.place, search.bounds)]
    if apart - known[TRAVEL] - error >= least:
        return True
    asked, last, moved = least + known[BENT] + error, search.latest[pair], known[TRAVEL] - known[IN_TUBE]
    own = is_own(moving.pairs, pair)
    was_told = since <= last[WHEN] <= until and last[APART] > 0.0
    if was_told and moved > verdict[RESOLUTION] and asked > last[APART] + known[TRAVEL]:
        return _is_fine(verdict, since, moved, tolerance)  # it isn't as far apart in the middle either
    kept = pair_keeps(moving, pair, search.place, known, share, asked, known[BENT], search.query)
    if kept == np.inf:
        return True
    last[APART], last[WHEN] = kept, middle
    margin = verdict[RESOLUTION] >= 0.0 and kept <= margin_of(verdict, own)
    most = largest_answer_above(questions, own, middle, kept)
    if margin or most > -np.inf:
        found = pair_distance(moving, pair, search.place, max(most, kept + 1e-9), search.query)
        found = min(found, kept)
        last[APART] = found
        keep(questions, own, middle, found, pair)
        refuse(verdict, own, middle, found, pair)
    if verdict[RESOLUTION] >= 0.0 and since < verdict[END] and moved <= verdict[RESOLUTION]:
        asked = margin_of(verdict, own) + verdict[STAND_OFF] + known[BENT] + error
        log = search.query.log
        log[LOG_PATIENT], begun = 1.0, log[LOG_COUNT]
        kept = pair_keeps(moving, pair, search.place, known, share, asked, known[BENT], search.query)
        log[LOG_PATIENT], log[LOG_COUNT] = 0.0, begun  # it is judged again, in halves
        if kept < np.inf:
            _leave_undecided(verdict, since, until, pair)
    return _is_fine(verdict, since, moved, tolerance)


@uncounted
def _is_fine(verdict: Floats, since: float, travel: float, tolerance: float) -> bool:
    """Return whether a pair needs no shorter segments: no verdict is asked for there, and it moves at most `FINE`.

    Of a small robot at most the tolerance of what is asked for.
    """
    return bool(travel <= min(FINE, tolerance) and not (verdict[RESOLUTION] >= 0.0 and since < verdict[END]))


@uncounted
def _leave_undecided(verdict: Floats, since: float, until: float, pair: int) -> None:
    """End the free part of the motion at the begin of an undecided segment; a violation in the segment is kept."""
    if verdict[REASON] == FREE or verdict[PLACE] > until:
        verdict[REASON], verdict[PLACE], verdict[CULPRIT] = UNDECIDED, 0.5 * (since + until), pair
    verdict[END] = since


@uncounted
def _close(
    moving: MovingRobot, search: Search, pair: int, segment: int, share: float, level: Floats, questions: Floats,
    verdict: Floats,
) -> None:  # fmt: skip
    """Lower the answers' bounds to what a pair keeps at least in a segment, in whose middle the robot is."""
    travel = search.bounds.known[bound_pair(moving, pair, segment, share, search.place, search.bounds), TRAVEL]
    apart = pair_distance(moving, pair, search.place, np.inf, search.query)
    since, until = level[SINCE_LEVEL], level[UNTIL_LEVEL]
    own = is_own(moving.pairs, pair)
    keep(questions, own, 0.5 * (since + until), apart, pair)
    for q in range(questions.shape[0]):
        if since < questions[q, UNTIL] and until > questions[q, SINCE] and questions[q, OWN] == own:
            questions[q, BOUND] = min(questions[q, BOUND], apart - travel - verdict[ERROR])


@uncounted
def _leave_open(questions: Floats, since: float, until: float) -> None:
    """Note that nothing bounds the answers to questions about a segment."""
    for q in range(questions.shape[0]):
        if since < questions[q, UNTIL] and until > questions[q, SINCE]:
            questions[q, BOUND] = -np.inf


@uncounted
def _judge(
    moving: MovingRobot,
    search: Search,
    left: _Left,
    segment: int,
    level: int,
    tolerance: float,
    longest: float,
    shortest: float,
    questions: Floats,
    verdict: Floats,
) -> int:
    """Judge a segment on the stack; write its pairs that are left behind its own and return their number.

    It is `TO_LIST` where they weren't listed yet. Where the segment is no longer than `shortest`, what those keep at
    least is written to the answers' bounds: minus infinity if there are too many.
    """
    row = left.stack[level]
    since, until, start, count = row[SINCE_LEVEL], row[UNTIL_LEVEL], int(row[START]), int(row[COUNT])
    asked = required_distance(questions, verdict, 0, since, until, tolerance)
    of_own = required_distance(questions, verdict, 1, since, until, tolerance)
    if asked == -np.inf and of_own == -np.inf:
        return 0
    if count < 0 and moving.obstacles.roots.shape[0] > ALL_AT_ONCE and until - since > longest:
        return -1  # of many obstacles too many are near in it
    place_at(moving, 0.5 * (since + until), search.place, search.scratch)
    share = find_moves(moving, since, until, search.place, search.scratch, search.bounds)
    find_twists(moving, search.place, search.scratch)
    if count < 0:
        count = _list_pairs(moving, search, left, segment, share, start, of_own, asked, verdict)
        if count < 0 and until - since <= shortest:
            _leave_open(questions, since, until)
            return 0
        if count < 0:
            return -1
        row[COUNT] = count
    search.query.log[LOG_SEGMENT] = float(segment)
    behind = start + count
    for index in range(start, start + count):
        pair = left.pairs[index]
        own = is_own(moving.pairs, pair)
        least = of_own if own == 1 else asked
        if least == -np.inf or _is_done(
            moving, search, pair, segment, share, row, least, longest, tolerance, questions, verdict
        ):
            continue
        asked = required_distance(questions, verdict, 0, since, until, tolerance)
        of_own = required_distance(questions, verdict, 1, since, until, tolerance)
        if (of_own if own == 1 else asked) == -np.inf:
            continue
        if until - since <= shortest:
            _close(moving, search, pair, segment, share, row, questions, verdict)
            continue
        left.pairs[behind] = pair
        behind += 1
    return behind - start - count


@uncounted
def _halve(left: _Left, level: int, more: int, end: float) -> int:
    """Replace a segment on the stack by its halves, cut at `end` if that is within; return the stack's new height."""
    row = left.stack[level]
    since, until, start = row[SINCE_LEVEL], row[UNTIL_LEVEL], row[START] + max(row[COUNT], 0.0)
    middle = end if since < end < until else 0.5 * (since + until)
    if more == 0 or level + 2 > left.stack.shape[0] or not since < middle < until:
        return level
    for half in range(2):
        other = left.stack[level + half]
        other[SINCE_LEVEL], other[UNTIL_LEVEL] = (middle, until) if half == 0 else (since, middle)
        other[START], other[COUNT] = start, more
    return level + 2


@kernel
def prove_along(
    moving: MovingRobot,
    tolerance: float,
    parameters: Row,
    every: int,
    most: int,
    longest: float,
    shortest: float,
    questions: RowsOut,
    verdict: RowOut,
    waiting: RowsOut,
    count: int,
    distances_out: RowOut,
    log: RowOut,
    segments_out: RowsOut,
) -> int:
    """Sample a motion, and judge segments of it until none waits: then each answer is one. Return how many wait.

    `tolerance`: largest error of a smallest distance, positive [m]. `parameters` (p,): samples in order, the motion's
    ends among them; none where they were taken before; own pairs are sampled at every `every`-th, and at the last.
    `most`: segments after which the search is left, with the others waiting. `longest`: in longer segments only spheres
    and boxes are examined. `shortest`: segments no longer than this aren't halved, and the search goes on until none
    waits, with their lower bounds in the answers' bounds; 0 as long as there is time. `questions` (q,
    ANSWER) and `verdict` (VERDICT,) are written. `waiting` (w, INTERVAL) has `count` segments, the last comes first,
    and room for `DEEPEST` + 3 more. `distances_out` (p,) gets the smallest distance from obstacles at each sample,
    `log` (n,) the slabs that close pairs, `segments_out` (s, LOG_ENDS) the segments that were judged.
    """
    search, left, last = new_search(moving, log), _new_stack(), parameters.shape[0] - 1
    segment, begun, stack = int(verdict[SEGMENTS]), int(verdict[SEGMENTS]), left.stack
    if last >= 0:
        sample_motion(moving, search, parameters, every, questions, verdict, distances_out)
        sample_about(moving, search, (parameters[last] - parameters[0]) / max(last, 1), questions, verdict)
    while count > 0 and (segment - begun < most or shortest > 0.0):
        count -= 1
        stack[0, SINCE_LEVEL], stack[0, UNTIL_LEVEL] = waiting[count, BEGINS], waiting[count, ENDS]
        stack[0, START], stack[0, COUNT], top = 0.0, TO_LIST, 1
        while top > 0 and (segment - begun < most or shortest > 0.0):
            segment += 1
            row = stack[top - 1]
            if segment <= segments_out.shape[0]:
                segments_out[segment - 1, 0], segments_out[segment - 1, 1] = row[SINCE_LEVEL], row[UNTIL_LEVEL]
                segments_out[segment - 1, 2] = 0.5 * (row[SINCE_LEVEL] + row[UNTIL_LEVEL])
            more = _judge(moving, search, left, segment, top - 1, tolerance, longest, shortest, questions, verdict)
            height = _halve(left, top - 1, more, verdict[END])
            if more != 0 and height < top and row[SINCE_LEVEL] < verdict[END]:  # there is no number between its ends
                pair = left.pairs[int(row[START] + row[COUNT])] if more > 0 else -1
                _leave_undecided(verdict, row[SINCE_LEVEL], row[UNTIL_LEVEL], pair)
            top = height
        for level in range(top):  # what is on the stack waits again
            waiting[count, BEGINS], waiting[count, ENDS] = stack[level, SINCE_LEVEL], stack[level, UNTIL_LEVEL]
            count += 1
    verdict[SEGMENTS] = float(segment)
    return count
