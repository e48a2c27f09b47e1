"""Following a way: where to aim so that the robot, which could stand at one place at the soonest, stays near it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoint, ChartPoints


@dataclass(frozen=True, eq=False)
class Aim(ReadOnly):
    """Where to aim.

    Attributes:
        direction: From where the robot could stand, shape (nv,).
        place: How far along the way that is, in time at full speed [s].
        last: What is aimed at, if it is not to be passed: the way's end, or where to wait, shape (nv,); else None.
        left: What is left of the way, in time at full speed [s].
    """

    direction: np.ndarray
    place: float
    last: ChartPoint | None
    left: float


class Way:
    """A way, measured by the time that the slowest coordinate takes at full speed.

    Args:
        points: Shape (m, nv), m > 1.
        speeds: Velocity limits, shape (nv,).
        times: When to be at each point [s], shape (m,); None: as soon as one likes.

    Attributes:
        begins: How far along each is [s], shape (m,).
    """

    def __init__(self, points: ChartPoints, speeds: np.ndarray, times: np.ndarray | None = None) -> None:
        self.points, self.speeds = points, speeds
        self.times = np.full(len(points), -np.inf) if times is None else times
        lengths = np.abs(np.diff(points, axis=0) / speeds).max(axis=1)
        self.begins = np.concatenate([[0.0], np.cumsum(lengths)])

    @property
    def goal(self) -> ChartPoint:
        """Where it ends, shape (nv,)."""
        end: ChartPoint = self.points[-1]
        return end

    @property
    def length(self) -> float:
        """How long it is [s]."""
        return float(self.begins[-1])

    def at(self, place: float) -> ChartPoint:
        """The point (nv,) at a place [s]; the goal itself, to the last bit, at the end."""
        if place >= self.length:
            return self.goal
        index = int(np.clip(np.searchsorted(self.begins, place, side="right") - 1, 0, len(self.points) - 2))
        span = self.begins[index + 1] - self.begins[index]
        share = min(1.0, (place - self.begins[index]) / span) if span > 0.0 else 1.0
        point: ChartPoint = self.points[index] + share * (self.points[index + 1] - self.points[index])
        return point

    def due(self, time: float) -> float:
        """How far along it one may be at a time [s]; infinite once all of it is due."""
        k = int(np.searchsorted(self.times, time, side="right"))
        if k >= len(self.times):
            return np.inf
        if k == 0:
            return 0.0
        share = (time - self.times[k - 1]) / (self.times[k] - self.times[k - 1])
        return float(self.begins[k - 1] + share * (self.begins[k] - self.begins[k - 1]))

    def aim(self, stand: ChartPoint, since: float, ahead: float, due: float = np.inf) -> Aim:
        """Where to aim.

        Args:
            stand: Where the robot could stand at the soonest, shape (nv,).
            since: The place [s] from which on the nearest one is looked for; 0: on all of the way.
            ahead: How far ahead of that to aim [s].
            due: How far along one may be [s].
        """
        place = self.nearest(stand, since, min(due, since + 2.0 * ahead if since > 0.0 else np.inf))
        beyond = place + ahead
        if due < min(beyond, self.length):
            target = self.at(max(due, place))
            return Aim(target - stand, place, target, self.length - place)
        last = beyond >= self.length
        target = self.goal if last else self.at(beyond)
        return Aim(target - stand, place, self.goal if last else None, self.length - place)

    def rest(self, stand: ChartPoint, place: float, until: float = np.inf) -> ChartPoints:
        """From where the robot could stand, shape (nv,), along the way after a place until another one [s], (k, nv)."""
        inner = self.points[(self.begins > place) & (self.begins < until)]
        return np.concatenate([stand[None], inner, self.at(min(until, self.length))[None]])

    def nearest(self, z: ChartPoint, since: float, until: float) -> float:
        """The place [s] of a stretch of the way that is nearest to a point (nv,)."""
        first = int(np.clip(np.searchsorted(self.begins, since, side="right") - 1, 0, len(self.points) - 2))
        last = max(first + 1, int(np.searchsorted(self.begins, min(until, self.length), side="left")))
        shares = self.speeds.min() / self.speeds  # at most 1: however slow joints are, nothing overflows
        a = self.points[first:last] * shares
        d = self.points[first + 1 : last + 1] * shares - a
        squares = np.maximum((d * d).sum(axis=1), 1e-300)
        share = np.clip((d * (z * shares - a)).sum(axis=1) / squares, 0.0, 1.0)
        away = ((a + share[:, None] * d - z * shares) ** 2).sum(axis=1)
        spans = self.begins[first + 1 : last + 1] - self.begins[first:last]
        places = self.begins[first:last] + share * spans
        return max(since, float(places[np.argmin(away)]))
