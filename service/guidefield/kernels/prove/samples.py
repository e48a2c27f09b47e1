"""Smallest distances at samples: of a motion, as first answers of its search, and of single configurations.

They are measured at places, and prove nothing in between. Small first answers let a search leave out more: constants
but `LIST` and `ALL_AT_ONCE` change how soon it ends and where it finds a distance within the tolerance, not its
verdict; in contact `STEPS` changes the depth that replies have. Parts are compiled into `search.py`: long ones are
called once, in a loop.

At configurations `prove/closest.py` asks for the closest pairs, at most `CANDIDATES` of each kind: -1 and -2 among them
mean "no more pairs" and "more than that".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.kernels.collide.near_pairs import is_left_out
from guidefield.kernels.jit.arrays import Floats, IndexBlocksOut, IndicesOut, Integers, Row, Rows, RowsOut
from guidefield.kernels.jit.decorators import counted, kernel, uncounted
from guidefield.kernels.kinematics.forward_kinematics import place_joints
from guidefield.kernels.prove.kept_distance import LOG_ROWS
from guidefield.kernels.prove.motion_bounds import BOUNDS, MotionBounds
from guidefield.kernels.prove.pair_distance import (
    DistanceQuery,
    NearBoxes,
    least_distance,
    list_near,
    nearest_within,
    new_near_boxes,
    new_query,
    pair_distance,
)
from guidefield.kernels.prove.placement import (
    MOMENT,
    MOST_ORDER,
    NOW,
    PLACEMENT,
    TWIST,
    BodyPoses,
    PoseScratch,
    kept_from_mover,
    place_at,
    place_centres,
)
from guidefield.kernels.prove.tables import (
    DISTANCE,
    OWN,
    OWN_PAIRS,
    PAIR,
    SINCE,
    TIME,
    UNTIL,
    BodyPairs,
    MovingRobot,
    RobotBodies,
    is_about,
    is_judged,
    is_own,
    keep,
    refuse,
)

APART, WHEN = range(2)  # columns of `Search.latest`: a pair's last known distance [m], and its parameter

STEPS = 3
"""Number of times that the surroundings of the smallest sample are searched, each time half as far away. Unrecorded."""

FIRST_REACH = 0.2  # obstacles are first listed within this distance of the robot, above 0, then twice as much [m]
FARTHEST = 1e10  # no obstacle with an end is farther away [m], so it may only grow: messages allow places within 1e9 m
ALL_AT_ONCE = 128  # of no more obstacles all are listed at once: of more pairs than `LIST` samples leave some out
LIST = 20_000  # pairs listed at a placement, where more aren't measured, or in a segment, which is halved for more

CANDIDATES = 12  # pairs returned of a configuration and kind, at least 1: with more Coal measures all, ties may change


class Search(NamedTuple):
    """The state of a search."""

    # place, scratch, bounds: The robot at a parameter, scratch, and bounds of its motion about it
    place: BodyPoses
    scratch: PoseScratch
    bounds: MotionBounds
    query: DistanceQuery  # scratch of distance queries
    latest: Floats  # the last distance of each pair and its parameter, shape (m, 2) [m]
    mover_reach: Floats  # travel of each moving obstacle in the segment, shape (v,) [m]
    boxes: NearBoxes  # scratch to find boxes
    near: Integers  # pairs near a placement, shape (LIST,)
    gaps: Floats  # distances of these by spheres and boxes, shape (LIST,) [m]


@counted
def _body_poses(moving: MovingRobot) -> BodyPoses:
    robot, movers = moving.robot, moving.movers.begins.shape[0] - 1
    n = robot.offset.shape[0]
    return BodyPoses(
        np.empty((robot.joints.parents.shape[0], 3, 4)),
        np.empty((robot.parent_joints.shape[0], 3)),
        np.empty((n, TWIST)),
        np.empty((n, TWIST)),
        np.zeros(MOMENT),
        np.empty((movers, 12)),
        np.zeros(movers),
    )


@counted
def _scratch(robot: RobotBodies) -> PoseScratch:
    n, nv = robot.offset.shape[0], robot.expand.shape[1]
    return PoseScratch(
        np.empty(MOST_ORDER),
        np.empty(nv),
        np.empty(nv),
        np.empty(n),
        np.empty(n),
        np.empty(robot.origin.shape[0]),
        np.empty((3, 3)),
        np.empty(3),
    )


@counted
def _motion_bounds(robot: RobotBodies, pairs: BodyPairs) -> MotionBounds:
    n, nv, rows = robot.offset.shape[0], robot.expand.shape[1], robot.parent_joints.shape[0] + pairs.own.shape[0] + 1
    return MotionBounds(
        np.empty((2, MOST_ORDER, nv)),
        np.empty(nv),
        np.empty(nv),
        np.empty(nv),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty((rows, BOUNDS)),
        np.zeros(rows),
        np.empty(2),
    )


@counted
def new_search(moving: MovingRobot, log: Floats) -> Search:
    """Return the state before anything is known, with a log of slabs, shape (n,)."""
    robot, pairs = moving.robot, moving.pairs
    count = pairs.own.shape[0] + pairs.moving.shape[0] * moving.obstacles.roots.shape[0]
    return Search(
        _body_poses(moving),
        _scratch(robot),
        _motion_bounds(robot, pairs),
        new_query(moving, log),
        np.zeros((count, 2)),
        np.zeros(moving.movers.begins.shape[0] - 1),
        new_near_boxes(moving.obstacles.boxes),
        np.empty(LIST, np.int64),
        np.empty(LIST),
    )


@uncounted
def list_obstacles(moving: MovingRobot, search: Search, verdict: Floats, reach: float) -> int:
    """List the pairs with obstacles closer than a distance at the placement [m]; return their number, at most LIST.

    Kinds of pairs are those of a verdict, shape (VERDICT,).
    """
    count = 0
    for row in range(moving.pairs.moving.shape[0]):
        within = reach + moving.robot.radii[moving.pairs.moving[row]]
        count = list_near(
            moving, verdict, row, within, search.mover_reach, search.place, search.boxes, search.near, 0, LIST, count
        )
    return min(count, LIST)


@uncounted
def _find_nearest(moving: MovingRobot, search: Search, count: int, found: float, nearest: int) -> tuple[float, int]:
    """Return the smallest distance of listed pairs, and its pair, where it is less than that of a pair measured before.

    What bounding spheres and boxes have nearest is measured first.
    """
    first = nearest_within(moving, search.near, count, search.place, search.gaps)
    for index in range(-1 if first >= 0 else 0, count):
        at = first if index < 0 else index
        if search.gaps[at] >= found:
            continue
        search.gaps[at] = np.inf
        apart = pair_distance(moving, search.near[at], search.place, found, search.query)
        if apart < found:
            found, nearest = apart, search.near[at]
    return found, nearest


@uncounted
def nearest_obstacle(moving: MovingRobot, search: Search, verdict: Floats, likely: int) -> tuple[float, int]:
    """Return the smallest distance from obstacles at the placement [m], and its pair: infinite and -1 without one.

    The likely pair, where that isn't -1, is measured first. Kinds of pairs are those of a verdict, shape (VERDICT,).
    """
    for mover in range(search.mover_reach.shape[0]):
        search.mover_reach[mover] = kept_from_mover(moving.movers, mover, search.place.moment[NOW])
    found, nearest, is_last = np.inf, -1, False
    reach = np.inf if moving.obstacles.roots.shape[0] <= ALL_AT_ONCE else FIRST_REACH
    while True:
        if likely >= 0:
            search.near[0], count = likely, 1
        else:
            is_last = found < np.inf or reach == np.inf
            count = list_obstacles(moving, search, verdict, max(found, 0.0) if is_last else reach)
        found, nearest = _find_nearest(moving, search, count, found, nearest)
        if is_last or (likely < 0 and reach > FARTHEST):
            return found, nearest
        likely, reach = -1, reach if likely >= 0 else 2.0 * reach


@uncounted
def nearest_own(moving: MovingRobot, search: Search, likely: int) -> tuple[float, int]:
    """Return the smallest distance of the robot from itself at the placement [m], and its pair; see above."""
    found, nearest, count = np.inf, -1, moving.pairs.own.shape[0]
    closest, gaps = 0, search.gaps
    fits = count <= LIST
    for pair in range(count if fits else 0):
        gaps[pair] = least_distance(moving, pair, search.place)
        closest = pair if gaps[pair] < gaps[closest] else closest
    for index in range(-2 if count > 0 else 0, count):
        pair = index
        if index < 0:
            pair = likely if index == -2 else closest
        if pair < 0:
            continue
        gap = gaps[pair] if fits else least_distance(moving, pair, search.place)
        if gap >= found:
            continue
        if fits:
            gaps[pair] = np.inf
        apart = pair_distance(moving, pair, search.place, found, search.query)
        if apart < found:
            found, nearest = apart, pair
    return found, nearest


@uncounted
def _sample(
    moving: MovingRobot, search: Search, own: int, at: float, likely: int, questions: Floats, verdict: Floats
) -> tuple[float, int]:
    """Note the smallest distance of own pairs, or of others, at a parameter; return it and its pair."""
    if own == 1:
        found, nearest = nearest_own(moving, search, likely)
    else:
        found, nearest = nearest_obstacle(moving, search, verdict, likely)
    if nearest >= 0:
        keep(questions, own, at, found, nearest)
        refuse(verdict, own, at, found, nearest)
    return found, nearest


@uncounted
def sample_motion(
    moving: MovingRobot,
    search: Search,
    parameters: Floats,
    every: int,
    questions: Floats,
    verdict: Floats,
    distances_out: Floats,
) -> None:
    """Sample a motion at parameters and at ends of spans within it: see `prove_along`."""
    count, nearest, own_nearest = parameters.shape[0], -1, -1
    has_own = is_judged(verdict, OWN_PAIRS) and moving.pairs.own.shape[0] > 0
    for step in range(2 * (count + questions.shape[0])):
        p, odd, own = step // 2, step % 2, 0
        if p < count:
            own, at = odd, parameters[p]
            if own == 1 and not (has_own and (p % every == 0 or p == count - 1)):
                continue
        else:
            at = questions[p - count, SINCE if odd == 0 else UNTIL]
            within = parameters[0] < at < parameters[count - 1]
            if nearest < 0 or questions[p - count, OWN] != 0.0 or not within:
                continue
        if own == 0:
            place_at(moving, at, search.place, search.scratch)
        likely = own_nearest if own == 1 else nearest
        found, likely = _sample(moving, search, own, at, likely, questions, verdict)
        if own == 1:
            own_nearest = likely
            continue
        nearest = likely
        if p < count:
            distances_out[p] = found


@uncounted
def sample_about(moving: MovingRobot, search: Search, stride: float, questions: Floats, verdict: Floats) -> None:
    """Sample about the smallest answers of questions (q, ANSWER), a stride of the parameter away, the same pairs."""
    for q in range(questions.shape[0]):
        step = stride if questions[q, PAIR] >= 0.0 else 0.0
        for _ in range(STEPS if step > 0.0 else 0):
            step *= 0.5
            pair, about = int(questions[q, PAIR]), questions[q, TIME]
            for side in range(2):
                at = about - step if side == 0 else about + step
                own = is_own(moving.pairs, pair)
                if is_about(questions, q, own, at):
                    place_at(moving, at, search.place, search.scratch)
                    most = questions[q, DISTANCE]
                    found = pair_distance(moving, pair, search.place, most, search.query)
                    if found < most:
                        keep(questions, own, at, found, pair)
                        refuse(verdict, own, at, found, pair)


@uncounted
def _place_configuration(moving: MovingRobot, q: Floats, time: float, search: Search) -> None:
    """Place the robot at a configuration of its model, shape (nq,), and obstacles that move at a time [s]."""
    scratch = search.scratch
    place_joints(moving.robot.joints, q, scratch.rotation, scratch.translation, search.place.poses)
    place_centres(moving.robot, search.place)
    search.place.moment[NOW] = time
    search.place.moment[PLACEMENT] += 1.0


@uncounted
def _find_closest(
    moving: MovingRobot, search: Search, first: int, past: int, within: float, likely: int, pairs_out: Integers
) -> float:
    """Find the pairs in [first, past) within a tolerance of the smallest distance, or in contact; return that distance.

    The likely pair, where that isn't -1, is measured first, then the one of the smallest bound. `pairs_out` gets the
    pairs in ascending order and -1 behind them; where there are more, -2 stands first.
    """
    least, found, most, closest, own = search.latest, np.inf, np.inf, first, moving.pairs.own.shape[0]
    for pair in range(first, past):
        if pair >= own and is_left_out(moving.pairs.left_out, pair - own):
            least[pair, 0] = np.inf
        else:
            least[pair, 0] = least_distance(moving, pair, search.place)
        closest = pair if least[pair, 0] < least[closest, 0] else closest
    for index in range(first - 2 if past > first else past, past):
        pair = index
        if index < first:
            pair = likely if index == first - 2 else closest
        was_measured = index >= first and pair in (likely, closest)
        if pair < 0 or was_measured or least[pair, 0] >= most:
            continue
        least[pair, 0] = pair_distance(moving, pair, search.place, most, search.query)
        found = min(found, least[pair, 0])
        most = max(found, 0.0) + within
    count = 0
    for k in range(pairs_out.shape[0]):
        pairs_out[k] = -1
    for pair in range(first, past):
        if least[pair, 0] < most:  # of what is farther `pair_distance` returns no less
            if count == pairs_out.shape[0]:
                pairs_out[0] = -2
                break
            pairs_out[count] = pair
            count += 1
    return found


@kernel
def closest_pairs(
    moving: MovingRobot,
    configurations: Rows,
    times: Row,
    within: float,
    distances_out: RowsOut,
    pairs_out: IndexBlocksOut,
) -> None:
    """Find the closest pairs at configurations (n, nq) and times (n,) [s], and all farther by at most `within` [m].

    Writes the distances of the closest own pair and of the closest with an obstacle (n, 2) [m], of bodies in contact at
    most 0 but not their depth, and the pairs (n, 2, CANDIDATES) as `_find_closest` does.
    """
    search, own = new_search(moving, np.zeros(LOG_ROWS)), moving.pairs.own.shape[0]
    every = own + moving.pairs.moving.shape[0] * moving.obstacles.roots.shape[0]
    for i in range(configurations.shape[0]):
        _place_configuration(moving, configurations[i], times[i], search)
        for kind in range(2):
            first, past = (0, own) if kind == 0 else (own, every)
            likely = max(pairs_out[i - 1, kind, 0], -1) if i > 0 else -1
            distances_out[i, kind] = _find_closest(moving, search, first, past, within, likely, pairs_out[i, kind])


@kernel
def first_contacts(moving: MovingRobot, configurations: Rows, touching: float, pairs_out: IndicesOut) -> None:
    """Find a pair in contact, within `touching` [m], or -1 at each configuration (n, nq), shape (n,).

    The pair that touched before is examined first, and is the one that is found if it still does.
    """
    search, last, own = new_search(moving, np.zeros(LOG_ROWS)), -1, moving.pairs.own.shape[0]
    count = own + moving.pairs.moving.shape[0] * moving.obstacles.roots.shape[0]
    for i in range(configurations.shape[0]):
        _place_configuration(moving, configurations[i], 0.0, search)
        pairs_out[i] = -1
        for index in range(-1 if last >= 0 else 0, count):
            pair = last if index < 0 else index
            if least_distance(moving, pair, search.place) > touching:
                continue
            # of what is farther `pair_distance` returns no less
            if pair_distance(moving, pair, search.place, touching, search.query) < touching and not (
                pair >= own and is_left_out(moving.pairs.left_out, pair - own)
            ):
                pairs_out[i] = last = pair
                break
