"""The smallest distances along a motion and at some of its times: by kernels, or by Coal where those can't tell.

Kernels know obstacles that rest, within some hundred metres of the origin, and don't know how deep bodies are in each
other. Coal answers all else, and takes longer: also about obstacles that move, of which only those matter then that
come closer than what rests.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from guidefield.collision.certify.timed_certificate import TimedWorld
from guidefield.collision.minimum.curve import Curve
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
    world = surveyor.worlds.moving
    resting = _resting(surveyor.worlds) if world.scene.moves else world
    found = _Search(resting, surveyor.curve, stopped).found(times, spans) if is_served(resting) else None
    if found is None:
        return _by_coal(surveyor, times, spans, stopped)
    return _with_what_moves(surveyor, times, spans, stopped, found) if world.scene.moves else found


def _resting(worlds: TimedWorld) -> World:
    """The robot among those obstacles that rest, in the order in which they are among all."""
    rest = np.flatnonzero([one.motion is None for one in worlds.moving.scene.obstacles])
    same = len(rest) == worlds.resting.pairs.obstacles
    return worlds.resting if same else worlds.moving.among(rest)


class _Search:
    """The kernels with a world and a motion.

    Args:
        world: The robot among obstacles that kernels know.
        curve: The motion.
        stopped: See `smallest_along`.
    """

    def __init__(self, world: World, curve: Curve, stopped: Callable[[], object]) -> None:
        self._stopped = stopped
        tables = robot_bodies(world), resting_obstacles(world), body_pairs(world)
        self._moving = MovingRobot(*tables, bezier_curve(curve))

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


def _with_what_moves(
    surveyor: Surveyor,
    times: np.ndarray,
    spans: Sequence[tuple[float, float]],
    stopped: Callable[[], object],
    found: Along,
) -> Along:
    """The same with obstacles that move, by Coal, given what was found among those that rest."""
    places, rows = _places(surveyor, times, spans)
    moves = surveyor.mover_of_pair > 0
    if not moves.any():
        return found
    distances, pairs = found.distances.copy(), np.flatnonzero(moves)
    closer = np.flatnonzero(places.distances[np.ix_(rows, pairs)].min(axis=1) < distances)
    at = rows[closer]
    distances[closer] = np.minimum(distances[closer], places.distances[at, surveyor.closest(places, at, pairs)])
    known = [_among_all(surveyor.worlds, one) for one in found.obstacle]
    questions = [Question(moves, *span) for span in spans]
    return Along(smallest(surveyor, places, questions, known, stopped=stopped), found.own, distances)


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


def _by_coal(
    surveyor: Surveyor, times: np.ndarray, spans: Sequence[tuple[float, float]], stopped: Callable[[], object]
) -> Along:
    places, rows = _places(surveyor, times, spans)
    world = surveyor.worlds.moving
    is_mixed, distances = np.arange(len(world.pairs)) >= world.pairs.n_self, np.full(len(times), np.inf)
    if is_mixed.any():
        distances = places.distances[rows, surveyor.closest(places, rows, np.flatnonzero(is_mixed))]
    obstacle = smallest(surveyor, places, [Question(is_mixed, *span) for span in spans], stopped=stopped)
    few = np.isin(places.times, np.concatenate([times[::FEWER], times[-1:], surveyor.breaks]))
    (own,) = smallest(surveyor, places.rows(few), [Question(~is_mixed, *spans[0])], stopped=stopped)
    return Along(obstacle, own, distances)


def _places(surveyor: Surveyor, times: np.ndarray, spans: Sequence[tuple[float, float]]) -> tuple[Places, np.ndarray]:
    """Places at some times, at ends of spans and where rates jump; in which rows those at the times are, shape (k,)."""
    breaks = surveyor.breaks[(surveyor.breaks > times[0]) & (surveyor.breaks < times[-1])]
    every = np.unique(np.concatenate([times, breaks, *spans[1:]]))
    return surveyor.places(every), np.searchsorted(every, times)
