"""Intervals of a motion in time, and two rules that say what bodies keep apart all along one.

Between two times a and b, T apart, the points of a pair's bodies move at most at the speed V and with the acceleration
A relative to each other (`Closing`; what an obstacle moves comes on top). Two rules say from the distances d_a and d_b
that they keep at least c between those times:

    of first order    max((d_a + d_b - V T) / 2, d_a - V T, d_b - V T) >= c
    of second order   min over s of d_a^2 + (d_b^2 - d_a^2) s / T - C s (T - s) >= c^2,   C = V^2 + (c + V T) A

The first holds since no distance changes faster than V. The second: let the pair be closest, nearer than c, at time s,
and r(t) the vector between the two points that are closest then. |r|^2 has the second derivative 2 |r'|^2 + 2 r.r'',
which is at most 2 C because |r| stays below c + V T; so at s it is above its chord less C s (T - s), and at a and b it
is at least d_a^2 and d_b^2. It asks nothing of the bodies' shapes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.prove.places import Places, Surveyor
from guidefield.prove.settings import without_coal_error
from guidefield.read_only import ReadOnly

DIVISION = 4
"""Into how many parts an interval is divided that can't be decided."""


@dataclass(frozen=True, eq=False)
class Intervals(ReadOnly):
    """Intervals of time that are not decided, and which pairs are left in each.

    Attributes:
        places: Places where they begin and end, among others.
        first, last: Rows of those, shape (s,).
        owner, pair: An interval and a pair that is left in it, both of shape (e,).
    """

    places: Places
    first: np.ndarray
    last: np.ndarray
    owner: np.ndarray
    pair: np.ndarray

    @classmethod
    def between(cls, places: Places, pairs: np.ndarray) -> Intervals:
        """Those from one to the next of places in order of time, with some pairs (p,) in each."""
        starts = np.arange(len(places.times) - 1)
        return cls(places, starts, starts + 1, np.repeat(starts, len(pairs)), np.tile(pairs, len(starts)))

    def batches(self, size: int) -> list[Intervals]:
        """Parts of at most so many intervals, the first one last."""
        count = len(self.first)
        if count <= size:
            return [self]
        return [self._part(np.arange(k, min(k + size, count))) for k in reversed(range(0, count, size))]

    def _part(self, chosen: np.ndarray) -> Intervals:
        """Some of them (k,), with their own places only."""
        index = np.full(len(self.first), -1)
        index[chosen] = np.arange(len(chosen))
        mine = index[self.owner] >= 0
        rows, ends = np.unique(np.concatenate([self.first[chosen], self.last[chosen]]), return_inverse=True)
        first, last = np.split(ends, 2)
        return Intervals(self.places.rows(rows), first, last, index[self.owner[mine]], self.pair[mine])

    def entries(self, surveyor: Surveyor) -> Entries:
        """What is left in them, with bounds of speed and acceleration."""
        places, first, last = self.places, self.first, self.last
        since, until = places.times[first], places.times[last]
        rates = surveyor.curve.most(since, until)
        reach = np.maximum(places.reach[first], places.reach[last])
        speeds = 0.5 * (places.speeds[first] + places.speeds[last])
        owner, pair = self.owner, self.pair
        movers, mover = np.unique(surveyor.movers[pair], return_inverse=True)
        found = surveyor.worlds.moving.closing.over(movers, reach, speeds, *rates, until - since)
        speed, acceleration = found[0][owner, mover], found[1][owner, mover]
        if len(surveyor.worlds.pairs):
            more = surveyor.rates_of_obstacles(since, until)
            column = surveyor.mover_of_pair[pair]
            speed, acceleration = speed + more[0][owner, column], acceleration + more[1][owner, column]
        never_below = surveyor.never_below[pair]
        return Entries(first[owner], last[owner], owner, pair, (until - since)[owner], speed, acceleration, never_below)

    def divided(self, entries: Entries, surveyor: Surveyor) -> Intervals:
        """The parts of every interval in which an entry is left."""
        chosen, owner = np.unique(entries.owner, return_inverse=True)
        rows, ends = np.unique(np.concatenate([self.first[chosen], self.last[chosen]]), return_inverse=True)
        first, last = np.split(ends, 2)
        places = self.places.rows(rows)
        shares = np.arange(1, DIVISION) / DIVISION
        times = places.times[first, None] + (places.times[last] - places.times[first])[:, None] * shares
        places = places.with_more(surveyor.places(times.ravel()))
        between = (len(rows) + np.arange(times.size)).reshape(times.shape)
        return Intervals(
            places,
            np.column_stack([first, between]).ravel(),
            np.column_stack([between, last]).ravel(),
            (DIVISION * owner[:, None] + np.arange(DIVISION)).ravel(),
            np.repeat(entries.pair, DIVISION),
        )


@dataclass(frozen=True, eq=False)
class Entries(ReadOnly):
    """What is left in intervals, one by one: all arrays of shape (e,).

    Attributes:
        first, last: Rows of the interval's ends.
        owner, pair: As in `Intervals`.
        span: Length of the interval [s].
        speed, acceleration: V and A of the file's formulas [m/s, m/s^2].
        never_below: What the pair's distance never is below, whatever it does [m].
    """

    first: np.ndarray
    last: np.ndarray
    owner: np.ndarray
    pair: np.ndarray
    span: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    never_below: np.ndarray

    def those(self, chosen: np.ndarray) -> Entries:
        """Some of them, as an index or a mask of shape (e,) says."""
        return Entries(*(array[chosen] for array in vars(self).values()))

    def first_order(self, places: Places) -> np.ndarray:
        """What each keeps at least by the rule of first order, shape (e,) [m]."""
        a, b = (without_coal_error(places.distances[row, self.pair]) for row in (self.first, self.last))
        travel = self.speed * self.span
        bound: np.ndarray = np.maximum(0.5 * (a + b - travel), np.maximum(a, b) - travel)
        return bound

    def kept(self, places: Places, least: np.ndarray) -> np.ndarray:
        """Whether each keeps a distance at least, shape (e,), by one of the rules."""
        decided = self.first_order(places) >= least
        rest = np.flatnonzero(~decided & (least > 0.0))
        decided[rest] = self.those(rest)._second_order(places, least[rest])
        return decided

    def _second_order(self, places: Places, least: np.ndarray) -> np.ndarray:
        ends = (without_coal_error(places.distances[row, self.pair]) for row in (self.first, self.last))
        a, b = (np.maximum(end, 0.0) ** 2 for end in ends)
        travel = self.speed * self.span
        bend = self.speed**2 + (least + travel) * self.acceleration
        rise, sag = np.abs(b - a), bend * self.span**2
        inside = rise < sag
        drop = np.divide(rise, sag, out=np.ones_like(rise), where=inside)
        lowest = np.where(inside, 0.5 * (a + b) - 0.25 * sag * (1.0 + drop**2), np.minimum(a, b))
        kept: np.ndarray = lowest >= least**2
        return kept
