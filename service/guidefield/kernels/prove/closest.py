"""The closest pairs of bodies at many configurations, and pairs in contact, by spheres, boxes and GJK over trees.

`prove/closest.py` calls it: -1 and -2 in its results mean "no more pairs" and "more than `CANDIDATES`".
"""

from __future__ import annotations

import numpy as np

from guidefield.kernels.collide.near_pairs import is_left_out
from guidefield.kernels.jit.arrays import Floats, IndexBlocksOut, IndicesOut, Integers, Row, Rows, RowsOut
from guidefield.kernels.jit.decorators import kernel, uncounted
from guidefield.kernels.kinematics.forward_kinematics import place_joints
from guidefield.kernels.prove.kept_distance import LOG_ROWS
from guidefield.kernels.prove.pair_distance import least_distance, pair_distance
from guidefield.kernels.prove.placement import LOOK, NOW, place_centres
from guidefield.kernels.prove.samples import Search, new_search
from guidefield.kernels.prove.tables import MovingRobot

CANDIDATES = 12  # pairs returned for each configuration and kind of pair, at most


@uncounted
def _place_configuration(moving: MovingRobot, q: Floats, time: float, search: Search) -> None:
    """Place the robot at a configuration of its model, shape (nq,), and obstacles that move at a time [s]."""
    scratch = search.scratch
    place_joints(moving.robot.joints, q, scratch.rotation, scratch.translation, search.place.poses)
    place_centres(moving.robot, search.place)
    search.place.moment[NOW] = time
    search.place.moment[LOOK] += 1.0


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
