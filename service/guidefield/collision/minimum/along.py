"""The smallest distances along a motion and at some of its times: by kernels, or by Coal where those can't tell.

Kernels know obstacles that rest, within some hundred metres of the origin, and don't know how deep bodies are in each
other. Coal answers all else, and takes longer: also about obstacles that move, of which only those matter then that
come closer than what rests.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from guidefield.collision.certify.timed_certificate import TimedWorld
from guidefield.collision.minimum.places import Places, Surveyor
from guidefield.collision.minimum.smallest import TOLERANCE, Question, Smallest, smallest
from guidefield.collision.minimum.tables import bezier_curve, body_pairs, is_served, resting_obstacles, robot_bodies
from guidefield.collision.world import World
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
    kernels, coal = _Kernels(surveyor, times, spans, stopped), _Coal(surveyor, times, spans, stopped)
    obstacles, own = kernels.found() if kernels.serve else (None, None)
    if obstacles is None:
        obstacles = coal.obstacles()
    elif surveyor.worlds.moving.scene.moves:
        obstacles = coal.obstacles_that_move(obstacles)
    return Along(obstacles.smallest, coal.own() if own is None else own, obstacles.distances)


class _Obstacles(NamedTuple):
    """The smallest distance from obstacles within each span, and at each time, as in `Along`."""

    smallest: list[Smallest]
    distances: np.ndarray


class _Kernels:
    """The kernels among the obstacles that rest. Args: see `smallest_along`."""

    def __init__(
        self,
        surveyor: Surveyor,
        times: np.ndarray,
        spans: Sequence[tuple[float, float]],
        stopped: Callable[[], object],
    ) -> None:
        self._world, self._curve = _resting(surveyor.worlds), surveyor.curve
        self._times, self._spans, self._stopped = times, spans, stopped

    @property
    def serve(self) -> bool:
        """Whether they know all bodies."""
        return is_served(self._world)

    def found(self) -> tuple[_Obstacles | None, Smallest | None]:
        """What they find of obstacles, and of the robot itself; None where bodies touch, or nearly."""
        tables = robot_bodies(self._world), resting_obstacles(self._world), body_pairs(self._world)
        moving = MovingRobot(*tables, bezier_curve(self._curve))
        of_obstacles, of_itself = [(*span, 0.0) for span in self._spans], [(*self._spans[0], 1.0)]
        if (both := self._answers(moving, of_obstacles + of_itself)) is not None:
            return _Obstacles(both.smallest[:-1], both.distances), both.smallest[-1]
        if (own := self._answers(moving, of_itself)) is not None:
            return None, own.smallest[0]
        return self._answers(moving, of_obstacles), None

    def _answers(self, moving: MovingRobot, asked: list[tuple[float, float, float]]) -> _Obstacles | None:
        """Answers to questions (since, until, whether about own pairs), and distances from obstacles at the times."""
        answers, distances = np.empty((len(asked), ANSWER)), np.empty(len(self._times))
        answers[:] = _UNKNOWN
        answers[:, [SINCE, UNTIL, OWN]] = asked
        if not self._judge(moving, answers, distances):
            return None
        answers[:, BOUND] = np.minimum(answers[:, BOUND], answers[:, DISTANCE] - TOLERANCE)
        return _Obstacles([*map(_answer, answers)], distances)

    def _judge(self, moving: MovingRobot, answers: np.ndarray, distances_out: np.ndarray) -> bool:
        """Write the answers of a whole motion, and distances at times; whether nothing touches, nor nearly."""
        times = self._times
        whole, waiting = float(times[-1] - times[0]), np.zeros((1 + 3 * DEEPEST, INTERVAL))
        waiting[0, BEGINS], waiting[0, ENDS] = times[0], times[-1]
        count, looked = int(len(times) > 1), times
        while True:
            shortest = STOPPED * whole if self._stopped() else 0.0
            count = search_along(
                moving, TOLERANCE, looked, FEW, AT_ONCE, LOOKED * whole, shortest, answers, waiting, count,
                distances_out,
            )  # fmt: skip
            if count <= 0:
                return count != TOUCHING
            looked = times[:0]


def _answer(row: np.ndarray) -> Smallest:
    return Smallest(float(row[DISTANCE]), float(row[BOUND]), float(row[TIME]), int(row[PAIR]))


def _resting(worlds: TimedWorld) -> World:
    """The robot among those obstacles that rest, in the order in which they are among all."""
    if not worlds.moving.scene.moves:
        return worlds.moving
    rest = np.flatnonzero([one.motion is None for one in worlds.moving.scene.obstacles])
    same = len(rest) == worlds.resting.pairs.obstacles
    return worlds.resting if same else worlds.moving.among(rest)


def _among_all(worlds: TimedWorld, found: Smallest) -> Smallest:
    """What was found among obstacles that rest, with its pair as it is among all."""
    resting, every = _resting(worlds), worlds.moving
    if found.pair < resting.pairs.n_self:
        return found
    body, other = resting.pairs.of(found.pair)
    rest = np.flatnonzero([one.motion is None for one in every.scene.obstacles])
    pairs = every.pairs.of_obstacles(rest[[other - resting.pairs.links]])
    (pair,) = pairs[every.pairs.bodies(pairs)[:, 0] == body].tolist()
    return replace(found, pair=pair)


class _Coal:
    """Coal's search. Args: see `smallest_along`."""

    def __init__(
        self,
        surveyor: Surveyor,
        times: np.ndarray,
        spans: Sequence[tuple[float, float]],
        stopped: Callable[[], object],
    ) -> None:
        self._surveyor, self._times, self._spans, self._stopped = surveyor, times, spans, stopped
        pairs = surveyor.worlds.moving.pairs
        self._are_own = np.arange(len(pairs)) < pairs.n_self

    @cached_property
    def _places(self) -> Places:
        """Places at the times, at ends of spans and where rates jump."""
        breaks, times = self._surveyor.breaks, self._times
        within = breaks[(breaks > times[0]) & (breaks < times[-1])]
        return self._surveyor.places(np.unique(np.concatenate([times, within, *self._spans[1:]])))

    def obstacles(self) -> _Obstacles:
        """What is found of all obstacles."""
        return self._closer(~self._are_own, (), np.full(len(self._times), np.inf))

    def obstacles_that_move(self, resting: _Obstacles) -> _Obstacles:
        """What is found of all obstacles, given what those that rest come to."""
        known = [_among_all(self._surveyor.worlds, one) for one in resting.smallest]
        return self._closer(self._surveyor.mover_of_pair > 0, known, resting.distances.copy())

    def _closer(self, pairs: np.ndarray, known: Sequence[Smallest], distances: np.ndarray) -> _Obstacles:
        """The smaller ones of what is known and the distances of some pairs, a mask of shape (n,)."""
        if not pairs.any():
            return _Obstacles([*known] or [Smallest() for _ in self._spans], distances)
        places, asked = self._places, np.flatnonzero(pairs)
        rows = np.searchsorted(places.times, self._times)
        closer = np.flatnonzero(places.distances[np.ix_(rows, asked)].min(axis=1) < distances)
        at = rows[closer]
        found = places.distances[at, self._surveyor.closest(places, at, asked)]
        distances[closer] = np.minimum(distances[closer], found)
        questions = [Question(pairs, *span) for span in self._spans]
        return _Obstacles(smallest(self._surveyor, places, questions, known, stopped=self._stopped), distances)

    def own(self) -> Smallest:
        """What is found of the robot and itself."""
        chosen = np.concatenate([self._times[::FEWER], self._times[-1:], self._surveyor.breaks])
        places = self._places.rows(np.isin(self._places.times, chosen))
        (found,) = smallest(self._surveyor, places, [Question(self._are_own, *self._spans[0])], stopped=self._stopped)
        return found
