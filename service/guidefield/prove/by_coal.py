"""The smallest distances along a motion by Coal, which takes longer than kernels and knows all that they don't.

Of obstacles that move only those matter that come closer than what rests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from guidefield.prove.asked import Asked, OfObstacles, among_resting
from guidefield.prove.places import Places
from guidefield.prove.smallest import Question, Smallest, smallest
from guidefield.prove.timed_world import TimedWorld

FEWER = 2
"""The smallest distance of the robot to itself is looked for from every so manieth of the times."""


class ByCoal:
    """Coal's search, among all obstacles."""

    def __init__(self, asked: Asked) -> None:
        self._surveyor, self._times, self._spans, self._deadline = asked
        pairs = self._surveyor.worlds.moving.pairs
        self._are_own = np.arange(len(pairs)) < pairs.n_self

    @cached_property
    def _places(self) -> Places:
        """Places at the times, at ends of spans and where rates jump."""
        breaks, times = self._surveyor.breaks, self._times
        within = breaks[(breaks > times[0]) & (breaks < times[-1])]
        return self._surveyor.places(np.unique(np.concatenate([times, within, *self._spans[1:]])))

    def obstacles(self) -> OfObstacles:
        """What is found of all obstacles."""
        return self._closer(~self._are_own, (), np.full(len(self._times), np.inf))

    def obstacles_that_move(self, resting: OfObstacles) -> OfObstacles:
        """What is found of all obstacles, given what those that rest come to."""
        known = [_among_all(self._surveyor.worlds, one) for one in resting.smallest]
        return self._closer(self._surveyor.mover_of_pair > 0, known, resting.distances.copy())

    def _closer(self, pairs: np.ndarray, known: Sequence[Smallest], distances: np.ndarray) -> OfObstacles:
        """The smaller ones of what is known and the distances of some pairs, a mask of shape (n,)."""
        if not pairs.any():
            return OfObstacles([*known] or [Smallest() for _ in self._spans], distances)
        places, asked = self._places, np.flatnonzero(pairs)
        rows = np.searchsorted(places.times, self._times)
        closer = np.flatnonzero(places.distances[np.ix_(rows, asked)].min(axis=1) < distances)
        at = rows[closer]
        found = places.distances[at, self._surveyor.closest(places, at, asked)]
        distances[closer] = np.minimum(distances[closer], found)
        questions = [Question(pairs, *span) for span in self._spans]
        return OfObstacles(smallest(self._surveyor, places, questions, known, deadline=self._deadline), distances)

    def own(self) -> Smallest:
        """What is found of the robot and itself."""
        chosen = np.concatenate([self._times[::FEWER], self._times[-1:], self._surveyor.breaks])
        places = self._places.rows(np.isin(self._places.times, chosen))
        (found,) = smallest(self._surveyor, places, [Question(self._are_own, *self._spans[0])], deadline=self._deadline)
        return found


def _among_all(worlds: TimedWorld, found: Smallest) -> Smallest:
    """What was found among obstacles that rest, with its pair as it is among all."""
    resting, every = among_resting(worlds), worlds.moving
    if found.pair < resting.pairs.n_self:
        return found
    body, other = resting.pairs.of(found.pair)
    rest = np.flatnonzero([one.motion is None for one in every.scene.obstacles])
    pairs = every.pairs.of_obstacles(rest[[other - resting.pairs.links]])
    (pair,) = pairs[every.pairs.bodies(pairs)[:, 0] == body].tolist()
    return replace(found, pair=pair)
