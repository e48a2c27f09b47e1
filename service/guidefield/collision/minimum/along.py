"""The smallest distances along a motion and at some of its times: by kernels, or by Coal where those can't tell.

Kernels know obstacles that rest, within some hundred metres of the origin, and don't know how deep bodies are in each
other. Coal answers all else, and takes longer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

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
    NEARLY,
    PAIR,
    SINCE,
    TIME,
    TOUCHING,
    UNTIL,
    smallest_at,
    smallest_between,
)
from guidefield.kernels.minimum.tables import MovingRobot
from guidefield.read_only import ReadOnly

AT_ONCE = 2000
"""So many intervals are judged before it is asked whether to stop: a few milliseconds."""

FEWER = 2
"""The smallest distance of the robot to itself is looked for from every so manieth of the times."""


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
    breaks = surveyor.breaks[(surveyor.breaks > times[0]) & (surveyor.breaks < times[-1])]
    every = np.unique(np.concatenate([times, breaks, *spans[1:]]))
    few = np.unique(np.concatenate([times[::FEWER], times[-1:], breaks]))
    if is_served(surveyor.worlds.moving):
        search = _Search(surveyor, stopped)
        first = search.found(every, spans, of_obstacles=True)
        if first is not None:
            own = search.found(few, spans[:1], of_obstacles=False)
            if own is not None:
                return Along(first[0], own[0][0], first[1][np.searchsorted(every, times)])
    return _by_coal(surveyor, times, every, few, spans, stopped)


class _Search:
    """The kernels with a world and a motion.

    Args:
        surveyor: The robot among obstacles that kernels know, and the motion.
        stopped: See `smallest_along`.
    """

    def __init__(self, surveyor: Surveyor, stopped: Callable[[], object]) -> None:
        self._surveyor, self._stopped = surveyor, stopped

    @cached_property
    def _moving(self) -> MovingRobot:
        world = self._surveyor.worlds.moving
        curve = bezier_curve(self._surveyor.curve)
        return MovingRobot(robot_bodies(world), resting_obstacles(world), body_pairs(world), curve)

    def found(
        self, times: np.ndarray, spans: Sequence[tuple[float, float]], *, of_obstacles: bool
    ) -> tuple[list[Smallest], np.ndarray] | None:
        """The smallest distances within spans, and at times (p,), shape (p,) [m]; None where bodies touch, or nearly.

        Args:
            times: From one to the next of which is looked: ends of spans and where rates jump are among them [s].
            spans: The spans [s].
            of_obstacles: Whether from obstacles, else of the robot to itself.
        """
        world = self._surveyor.worlds.moving
        own, every = world.pairs.n_self, len(world.pairs)
        pairs = (own, every) if of_obstacles else (0, own)
        answers, distances = np.full((len(spans), ANSWER), np.inf), np.full(len(times), np.inf)
        answers[:, [SINCE, UNTIL]], answers[:, PAIR], answers[:, TIME] = spans, -1.0, np.nan
        if pairs[0] < pairs[1]:
            smallest_at(self._moving, pairs[0], pairs[1], times, answers, distances)
            if (answers[:, DISTANCE] <= NEARLY).any() or not self._between(times, distances, pairs, answers):
                return None
        answers[:, BOUND] = np.minimum(answers[:, BOUND], answers[:, DISTANCE] - TOLERANCE)
        return [_answer(row) for row in answers], distances

    def _between(self, times: np.ndarray, distances: np.ndarray, pairs: tuple[int, int], answers: np.ndarray) -> bool:
        """Write the answers of a whole motion; whether nothing touches, nor nearly."""
        order = np.argsort(-np.minimum(distances[:-1], distances[1:]), kind="stable")
        waiting = np.zeros((len(order) + 3 * DEEPEST, INTERVAL))
        waiting[: len(order), BEGINS], waiting[: len(order), ENDS] = times[order], times[order + 1]
        count, (first, past) = len(order), pairs
        while count > 0:
            closing = bool(self._stopped())
            count = smallest_between(self._moving, first, past, TOLERANCE, AT_ONCE, closing, answers, waiting, count)
        return count != TOUCHING


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
