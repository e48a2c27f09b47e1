"""Looks at a robot at some times of its motion: which pair is the nearest there, and whether it is nearer soon."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.kernels.jit.no_refcount import counted, uncounted
from guidefield.kernels.jit.signatures import Floats
from guidefield.kernels.prove.answers import DISTANCE, PAIR, SINCE, TIME, UNTIL, is_about, is_own, keep
from guidefield.kernels.prove.closing import BOUNDS, Ways
from guidefield.kernels.prove.curve_ways import MOST_ORDER
from guidefield.kernels.prove.pair_distance import Ask, least_distance, new_ask, pair_distance
from guidefield.kernels.prove.places import TWIST, Place, Room, place_at
from guidefield.kernels.prove.tables import BodyPairs, MovingRobot, RobotBodies

APART, WHEN = range(2)
"""Numbers of what was told of a pair last: how far it was apart at most [m], and when [s]."""

STEPS = 3
"""So often it is looked where about the smallest of some places its pair is nearer still, each time half as far away.
Unrecorded."""


class Search(NamedTuple):
    """What a search holds.

    Attributes:
        place, room, ways: The robot at a time, scratch, and how far it goes about it.
        ask: What was asked last.
        told: A distance that each pair had no more than, and when, shape (m, 2) [m, s].
        least: What each pair keeps at least at a place, shape (m,) [m].
    """

    place: Place
    room: Room
    ways: Ways
    ask: Ask
    told: Floats
    least: Floats


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
        np.empty((3, 3)),
        np.empty(3),
    )


@counted
def _ways(robot: RobotBodies, pairs: BodyPairs) -> Ways:
    n, nv, movers = robot.offset.shape[0], robot.expand.shape[1], robot.carriers.shape[0] + pairs.first_by.shape[0]
    return Ways(
        np.empty((2, MOST_ORDER, nv)),
        np.empty(nv),
        np.empty(nv),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty((movers, BOUNDS)),
        np.zeros(movers),
    )


@counted
def new_search(moving: MovingRobot) -> Search:
    """The robot is nowhere yet, and nothing is known."""
    robot, pairs = moving.robot, moving.pairs
    told = np.full((pairs.first.shape[0], 2), np.inf)
    told[:, WHEN] = 0.0
    least = np.empty(pairs.first.shape[0])
    return Search(_place(robot), _room(robot), _ways(robot, pairs), new_ask(moving), told, least)


@uncounted
def _smallest_now(
    moving: MovingRobot, search: Search, first: int, past: int, time: float, likely: int, answers: Floats
) -> tuple[float, int]:
    """Keep the smallest distance of some pairs where the robot is placed, at a time [s]; that [m] and its pair.

    The likely pair, if that isn't -1, is asked first, then what may be closest. Infinite, and -1, without a pair.
    """
    found, nearest, least, closest = np.inf, -1, search.least, first
    for pair in range(first, past):
        least[pair] = least_distance(moving, pair, search.place)
        closest = pair if least[pair] < least[closest] else closest
    for index in range(first - 2 if past > first else past, past):
        pair = index
        if index < first:
            pair = likely if index == first - 2 else closest
        if pair < 0 or least[pair] >= found:
            continue
        least[pair] = np.inf
        apart = pair_distance(moving, pair, search.place, found, search.ask)
        if apart < found:
            found, nearest = apart, pair
    keep(answers, is_own(moving, nearest), time, found, nearest)
    return found, nearest


@uncounted
def look_at(
    moving: MovingRobot, search: Search, times: Floats, few: int, answers: Floats, distances_out: Floats
) -> None:
    """Look at some times and where spans begin or end within the motion: see `search_along`."""
    own, every, count = moving.pairs.first_by.shape[0], moving.pairs.first.shape[0], times.shape[0]
    nearest, nearest_own = -1, -1
    for p in range(count):
        place_at(moving, times[p], search.place, search.room)
        distances_out[p], nearest = _smallest_now(moving, search, own, every, times[p], nearest, answers)
        if p % few == 0 or p == count - 1:
            _, nearest_own = _smallest_now(moving, search, 0, own, times[p], nearest_own, answers)
    for q in range(answers.shape[0]):
        for side in range(2 if own < every else 0):
            time = answers[q, SINCE if side == 0 else UNTIL]
            if times[0] < time < times[count - 1]:
                place_at(moving, time, search.place, search.room)
                _, nearest = _smallest_now(moving, search, own, every, time, nearest, answers)


@uncounted
def look_about(moving: MovingRobot, search: Search, stride: float, answers: Floats) -> None:
    """Look where about the smallest of answers (q, ANSWER), a stride of time apart, the same pairs are nearer still."""
    for q in range(answers.shape[0]):
        step = stride if answers[q, PAIR] >= 0.0 else 0.0
        for _ in range(STEPS if step > 0.0 else 0):
            step *= 0.5
            pair, about = int(answers[q, PAIR]), answers[q, TIME]
            for side in range(2):
                time = about - step if side == 0 else about + step
                own = is_own(moving, pair)
                if is_about(answers, q, own, time):
                    place_at(moving, time, search.place, search.room)
                    most = answers[q, DISTANCE]
                    found = pair_distance(moving, pair, search.place, most, search.ask)
                    if found < most:
                        keep(answers, own, time, found, pair)
