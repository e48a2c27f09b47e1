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
    NEARLY,
    OWN,
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
        self._own, self._every = world.pairs.n_self, len(world.pairs)
        curve = bezier_curve(surveyor.curve)
        self._moving = MovingRobot(robot_bodies(world), resting_obstacles(world), body_pairs(world), curve)

    def found(self, times: np.ndarray, spans: Sequence[tuple[float, float]]) -> Along | None:
        """What `smallest_along` finds; None where bodies touch, or nearly.

        Args:
            times: See there [s].
            spans: See `smallest_along` [s].
        """
        answers, distances = np.full((len(spans) + 1, ANSWER), np.inf), np.full(len(times), np.inf)
        answers[:, [SINCE, UNTIL]], answers[:, PAIR], answers[:, TIME] = [*spans, spans[0]], -1.0, np.nan
        answers[:, OWN] = 0.0
        answers[-1, OWN] = 1.0
        ends = np.array([time for span in spans[1:] for time in span])
        smallest_at(self._moving, self._own, self._every, times, answers, distances)
        smallest_at(self._moving, self._own, self._every, ends, answers, np.empty(len(ends)))
        few = np.append(times[:-1:FEW], times[-1])
        smallest_at(self._moving, 0, self._own, few, answers, np.empty(len(few)))
        if (answers[:, DISTANCE] <= NEARLY).any() or not self._between(times, answers):
            return None
        answers[:, BOUND] = np.minimum(answers[:, BOUND], answers[:, DISTANCE] - TOLERANCE)
        *obstacle, own = map(_answer, answers)
        return Along(obstacle, own, distances)

    def _between(self, times: np.ndarray, answers: np.ndarray) -> bool:
        """Write the answers of a whole motion; whether nothing touches, nor nearly."""
        whole, waiting = float(times[-1] - times[0]), np.zeros((1 + 3 * DEEPEST, INTERVAL))
        waiting[0, BEGINS], waiting[0, ENDS] = times[0], times[-1]
        count, stride = int(len(times) > 1), whole / max(len(times) - 1, 1)
        while count > 0:
            shortest = STOPPED * whole if self._stopped() else 0.0
            count = smallest_between(
                self._moving, TOLERANCE, stride, AT_ONCE, LOOKED * whole, shortest, answers, waiting, count
            )
            stride = 0.0
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
