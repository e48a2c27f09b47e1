"""The smallest distances along a whole motion, exact to a tolerance, by branch and bound over its time.

The smallest distance at some places is known first. Where the rules of intervals.py don't say that more than that less
the tolerance is kept from one place to the next, the interval is divided; every new place may have a smaller distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.prove.intervals import Entries, Intervals
from guidefield.prove.places import EXACT, HULLS, Places, Surveyor
from guidefield.prove.settings import CERTIFICATE
from guidefield.read_only import ReadOnly

TOLERANCE = 1e-4
"""How much smaller than what is told the smallest distance may be [m]."""

MOST_ENTRIES = 30_000
"""Pairs of so many intervals are judged at once that they are not more than this."""

AT_ONCE = 8
"""So many distances are asked for together while the smallest at some places is looked for."""


@dataclass(frozen=True, eq=False)
class Question(ReadOnly):
    """Of which pairs, and when, the smallest distance is asked for.

    Attributes:
        pairs: Which pairs count, shape (n,).
        since: From when [s].
        until: Until when [s].
    """

    pairs: np.ndarray
    since: float
    until: float


@dataclass(frozen=True)
class Smallest:
    """The smallest distance that was found: another may be smaller, but none is below the bound.

    Attributes:
        distance: At `time` between the bodies of `pair` [m]; infinite without a pair.
        bound: What all keep at least, certified [m].
        time: When [s].
        pair: Index of the world's pair; -1 without one.
    """

    distance: float = np.inf
    bound: float = np.inf
    time: float = np.nan
    pair: int = -1


def smallest(
    surveyor: Surveyor,
    places: Places,
    questions: Sequence[Question],
    known: Sequence[Smallest] = (),
    tolerance: float = TOLERANCE,
    deadline: Deadline = UNLIMITED,
) -> list[Smallest]:
    """Answer questions about the smallest distance along a motion.

    Args:
        surveyor: Who places the robot along it.
        places: In order of time, among them its ends, the ends of every question, and the times at which a rate jumps;
            what becomes known there is written.
        questions: What is asked.
        known: The smallest distance of other pairs, for each question: an answer is the smaller one. None unless given.
        tolerance: Positive; see Returns [m].
        deadline: Ends the search.

    Returns:
        An answer to each question. Its bound is its distance less the tolerance, or smaller if a search was stopped.
    """
    search = _Search(surveyor, questions, known or [Smallest() for _ in questions], tolerance)
    search.look_at(places)
    size = max(1, MOST_ENTRIES // max(1, places.distances.shape[1]))
    asked = np.flatnonzero(np.any([question.pairs for question in questions], axis=0))
    waiting = Intervals.between(places, asked).batches(size) if len(asked) and len(places.times) > 1 else []
    while waiting and not deadline.expired():
        finer = search.divided(waiting.pop())
        if finer is not None:
            waiting += finer.batches(size)
    return search.answers(waiting)


class _Search:
    """The best that is known of each question."""

    def __init__(
        self, surveyor: Surveyor, questions: Sequence[Question], known: Sequence[Smallest], tolerance: float
    ) -> None:
        self.surveyor = surveyor
        self.questions = questions
        self.tolerance = tolerance
        self.best, self._known = list(known), known

    def look_at(self, places: Places) -> None:
        """Find the smallest distance at some places, for every question."""
        self._keep(places, *np.nonzero(places.stages == EXACT))
        for index, question in enumerate(self.questions):
            rows = np.flatnonzero((places.times >= question.since) & (places.times <= question.until))
            pairs = np.flatnonzero(question.pairs)
            there = np.ix_(rows, pairs)
            while len(rows) and len(pairs):
                known = np.where(places.stages[there] == EXACT, np.inf, places.distances[there]).ravel()
                few = np.argpartition(known, min(AT_ONCE, known.size) - 1)[:AT_ONCE]
                few = few[np.argsort(known[few])]
                few = few[known[few] < self.best[index].distance]
                if not len(few):
                    break
                row, pair = rows[few // len(pairs)], pairs[few % len(pairs)]
                soon = places.stages[row, pair] < HULLS
                soon[0] = True
                self._ask(places, row[soon], pair[soon])

    def divided(self, intervals: Intervals) -> Intervals | None:
        """Judge intervals; the parts of those in which a pair is left, or None."""
        places, entries = intervals.places, intervals.entries(self.surveyor)
        while True:
            least = self._asked(places, entries)
            done = entries.never_below >= least + self.tolerance  # none of these is less than what is known already
            left = ~(done | entries.kept(places, least))
            if not left.any():
                return None
            entries = entries.those(left)
            if not self._ask_more(places, entries, least[left]):
                return intervals.divided(entries, self.surveyor)

    def _ask_more(self, places: Places, entries: Entries, least: np.ndarray) -> bool:
        """Take the distances at the ends of what is left to their next stage; whether there was any to be taken.

        A mesh is asked where hulls come too close, or where little is left to come closer.
        """
        rows, pairs = np.concatenate([entries.first, entries.last]), np.concatenate([entries.pair, entries.pair])
        stage, least = places.stages[rows, pairs], np.tile(least, 2)
        near = np.tile(entries.speed * entries.span, 2) <= CERTIFICATE.mesh_from
        asked = (stage < HULLS) | ((stage == HULLS) & (near | (places.distances[rows, pairs] < least)))
        if not asked.any():
            return False
        chosen = np.unique(rows[asked] * len(places.distances[0]) + pairs[asked])
        self._ask(places, *np.divmod(chosen, len(places.distances[0])))
        return True

    def answers(self, waiting: Sequence[Intervals]) -> list[Smallest]:
        """The answers, as some intervals are left undecided."""
        known = zip(self.best, self._known, strict=True)
        bounds = [min(best.distance - self.tolerance, other.bound) for best, other in known]
        for intervals in waiting:
            entries = intervals.entries(self.surveyor)
            kept = np.maximum(entries.first_order(intervals.places), entries.never_below)
            for index, there in enumerate(self._about(intervals.places, entries)):
                bounds[index] = min(bounds[index], float(kept[there].min(initial=np.inf)))
        return [replace(best, bound=bound) for best, bound in zip(self.best, bounds, strict=True)]

    def _about(self, places: Places, entries: Entries) -> list[np.ndarray]:
        """Which entries each question is about, of shape (e,)."""
        since, until = places.times[entries.first], places.times[entries.last]
        return [(since >= one.since) & (until <= one.until) & one.pairs[entries.pair] for one in self.questions]

    def _asked(self, places: Places, entries: Entries) -> np.ndarray:
        """What each entry has to keep, so that no answer is more than the tolerance too large, shape (e,) [m]."""
        least = np.full(len(entries.owner), -np.inf)
        for best, there in zip(self.best, self._about(places, entries), strict=True):
            least[there] = np.maximum(least[there], best.distance - self.tolerance)
        return least

    def _ask(self, places: Places, rows: np.ndarray, pairs: np.ndarray) -> None:
        """Take distances to their next stage, and keep what is smaller than all before."""
        self.surveyor.come_closer(places, rows, pairs)
        exact = places.stages[rows, pairs] == EXACT
        self._keep(places, rows[exact], pairs[exact])

    def _keep(self, places: Places, rows: np.ndarray, pairs: np.ndarray) -> None:
        """Keep those of some exact distances that are smaller than all before."""
        found, times = places.distances[rows, pairs], places.times[rows]
        for index, question in enumerate(self.questions):
            there = np.flatnonzero((times >= question.since) & (times <= question.until) & question.pairs[pairs])
            if len(there):
                least = there[np.argmin(found[there])]
                if found[least] < self.best[index].distance:
                    distance, time, pair = float(found[least]), float(times[least]), int(pairs[least])
                    self.best[index] = Smallest(distance, time=time, pair=pair)
