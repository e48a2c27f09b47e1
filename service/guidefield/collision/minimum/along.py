"""The smallest distances along a motion and at some of its times: by kernels, or by Coal where those can't tell.

Kernels know obstacles that rest, within some hundred metres of the origin, and don't know how deep bodies are in each
other. Coal answers all else, and takes longer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from guidefield.collision.minimum.places import Surveyor
from guidefield.collision.minimum.smallest import TOLERANCE, Question, Smallest, smallest
from guidefield.collision.minimum.tables import bezier_curve, body_pairs, is_served, resting_obstacles, robot_bodies
from guidefield.kernels.minimum.smallest import (
    ANSWER,
    BEGINS,
    BOUND,
    DEEPEST,
    DISTANCE,
    ENDS,
    INTERVAL,
    OWN,
    PAIR,
    SINCE,
    TIME,
    TOUCHING,
    UNTIL,
    search_along,
)
from guidefield.kernels.minimum.tables import MovingRobot
from guidefield.read_only import ReadOnly

AT_ONCE = 2000
"""So many stretches are judged before it is asked whether to stop: a few milliseconds."""

FEWER = 2
"""Coal looks for the smallest distance of the robot to itself from every so manieth of the times."""

FEW = 8
"""Kernels do from every so manieth: with more it takes longer to look there than it saves. Unrecorded."""

LOOKED = 1 / 15
"""In stretches longer than this share of the motion balls and boxes alone tell, as other looks mostly fail there: twice
or half of it takes a UR5 and a Baxter longer. Unrecorded."""

STOPPED = 1 / 32
"""A search that is stopped tells what is kept in stretches no longer than this share of the motion."""


_UNKNOWN = np.full(ANSWER, np.inf)
_UNKNOWN[TIME], _UNKNOWN[PAIR] = np.nan, -1.0


@dataclass(frozen=True, eq=False)
class Along(ReadOnly):
    """What was found along a motion.

    Attributes:
        obstacle: The smallest distance from obstacles within each of the spans that were asked for.
        own: The smallest distance of the robot to itself, all along.
        distances: The smallest distance from obstacles at each of the times, shape (k,) [m]; infinite without one.
    """

    obstacle: list[Smallest]
    own: Smallest
    distances: np.ndarray


def smallest_along(
    surveyor: Surveyor,
    times: np.ndarray,
    spans: Sequence[tuple[float, float]],
    stopped: Callable[[], object] = lambda: None,
) -> Along:
    """Find the smallest distances along a motion, at most `TOLERANCE` too large.

    Args:
        surveyor: The robot among obstacles, and the motion.
        times: At which the distance from obstacles is asked for as well, in order, the first and the last of the motion
            among them, shape (k,) [s].
        spans: Within which the smallest distance from obstacles is asked for, the whole motion first [s].
        stopped: Asked now and then; anything true ends the search.
    """
    if is_served(surveyor.worlds.moving):
        found = _Search(surveyor, stopped).found(times, spans)
        if found is not None:
            return found
    breaks = surveyor.breaks[(surveyor.breaks > times[0]) & (surveyor.breaks < times[-1])]
    every = np.unique(np.concatenate([times, breaks, *spans[1:]]))
    few = np.unique(np.concatenate([times[::FEWER], times[-1:], breaks]))
    return _by_coal(surveyor, times, every, few, spans, stopped)


class _Search:
    """The kernels with a world and a motion.

    Args:
        surveyor: The robot among obstacles that kernels know, and the motion.
        stopped: See `smallest_along`.
    """

    def __init__(self, surveyor: Surveyor, stopped: Callable[[], object]) -> None:
        self._stopped = stopped
        world = surveyor.worlds.moving
        curve = bezier_curve(surveyor.curve)
        self._moving = MovingRobot(robot_bodies(world), resting_obstacles(world), body_pairs(world), curve)

    def found(self, times: np.ndarray, spans: Sequence[tuple[float, float]]) -> Along | None:
        """What `smallest_along` finds; None where bodies touch, or nearly.

        Args:
            times: See there [s].
            spans: See `smallest_along` [s].
        """
        asked = [(*span, 0.0) for span in spans] + [(*spans[0], 1.0)]
        answers, distances = np.empty((len(asked), ANSWER)), np.empty(len(times))
        answers[:] = _UNKNOWN
        answers[:, [SINCE, UNTIL, OWN]] = asked
        if not self._judge(times, answers, distances):
            return None
        answers[:, BOUND] = np.minimum(answers[:, BOUND], answers[:, DISTANCE] - TOLERANCE)
        *obstacle, own = map(_answer, answers)
        return Along(obstacle, own, distances)

    def _judge(self, times: np.ndarray, answers: np.ndarray, distances_out: np.ndarray) -> bool:
        """Write the answers of a whole motion, and distances at times; whether nothing touches, nor nearly."""
        whole, waiting = float(times[-1] - times[0]), np.zeros((1 + 3 * DEEPEST, INTERVAL))
        waiting[0, BEGINS], waiting[0, ENDS] = times[0], times[-1]
        count, looked = int(len(times) > 1), times
        while True:
            shortest = STOPPED * whole if self._stopped() else 0.0
            count = search_along(
                self._moving, TOLERANCE, looked, FEW, AT_ONCE, LOOKED * whole, shortest, answers, waiting, count,
                distances_out,
            )  # fmt: skip
            if count <= 0:
                return count != TOUCHING
            looked = times[:0]


def _answer(row: np.ndarray) -> Smallest:
    return Smallest(float(row[DISTANCE]), float(row[BOUND]), float(row[TIME]), int(row[PAIR]))


def _by_coal(
    surveyor: Surveyor,
    times: np.ndarray,
    every: np.ndarray,
    few: np.ndarray,
    spans: Sequence[tuple[float, float]],
    stopped: Callable[[], object],
) -> Along:
    world, places = surveyor.worlds.moving, surveyor.places(every)
    is_mixed, distances = np.arange(len(world.pairs)) >= world.pairs.n_self, np.full(len(times), np.inf)
    if is_mixed.any():
        rows = np.searchsorted(every, times)
        distances = places.distances[rows, surveyor.closest(places, rows, np.flatnonzero(is_mixed))]
    questions = [Question(is_mixed, *span) for span in spans]
    obstacle = smallest(surveyor, places, questions, stopped=stopped)
    fewer = places.rows(np.searchsorted(every, few))
    (own,) = smallest(surveyor, fewer, [Question(~is_mixed, *spans[0])], stopped=stopped)
    return Along(obstacle, own, distances)
