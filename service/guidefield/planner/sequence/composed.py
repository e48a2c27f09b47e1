"""Motions one after the other as one trajectory of all joints: each begins and ends at rest."""

from __future__ import annotations

from collections.abc import Iterable
from typing import cast

import numpy as np

from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.sequence.embedding import Embedding
from guidefield.robot.model.spaces import ChartPoint, ChartRate


class Composition:
    """A trajectory of all joints that grows at its end.

    Args:
        z: Where it begins, a chart point, shape (n,).
    """

    def __init__(self, z: ChartPoint) -> None:
        self._times = [0.0]
        self._positions: list[ChartPoint] = [z]
        self._velocities: list[ChartRate] = [cast(ChartRate, np.zeros(len(z)))]

    @property
    def end(self) -> float:
        """When it ends [s]."""
        return self._times[-1]

    @property
    def z(self) -> ChartPoint:
        """Where it ends, a chart point, shape (n,)."""
        return self._positions[-1]

    def move(self, motion: Trajectory, embedding: Embedding) -> list[float]:
        """Go on along a motion that begins where this ends; returns when it is at each of its knots [s]."""
        first, since = len(self._times) - 1, self.end - float(motion.times[0])
        self._times += (since + motion.times[1:]).tolist()
        self._positions += list(embedding.points(motion.positions)[1:])
        self._velocities += list(embedding.rates(motion.velocities)[1:])
        return self._times[first:]

    def wait(self, seconds: float) -> None:
        """Stay for some time."""
        if seconds > 0.0:
            self._times.append(self.end + seconds)
            self._positions.append(self.z)
            self._velocities.append(cast(ChartRate, np.zeros(len(self.z))))

    def trajectory(self) -> Trajectory:
        """As it is by now."""
        return Trajectory(np.array(self._times), np.array(self._positions), np.array(self._velocities))


def with_knots_at(trajectory: Trajectory, times: Iterable[float]) -> Trajectory:
    """The same curve with knots at some more times [s]."""
    inner = [time for time in times if trajectory.times[0] < time < trajectory.times[-1]]
    more = np.setdiff1d(np.array(inner, float), trajectory.times)
    if not len(more):
        return trajectory
    positions, velocities, _ = trajectory.evaluate(more)
    order = np.argsort(np.concatenate([trajectory.times, more]), kind="stable")
    return Trajectory(
        np.concatenate([trajectory.times, more])[order],
        np.concatenate([trajectory.positions, positions])[order],
        np.concatenate([trajectory.velocities, velocities])[order],
        trajectory.stretch,
    )


def part(trajectory: Trajectory, begin: float, end: float) -> Trajectory:
    """The part of a trajectory between two of its knots [s]; its times stay what they are."""
    first, last = np.searchsorted(trajectory.times, [begin, end])
    rows = slice(first, last + 1)
    return Trajectory(trajectory.times[rows], trajectory.positions[rows], trajectory.velocities[rows])
