"""The smallest distances along a motion by kernels.

They know obstacles that rest, within some hundred metres of the origin, and don't know how deep bodies are in each
other.
"""

from __future__ import annotations

import numpy as np

from guidefield.kernels.prove.answers import ANSWER, BOUND, DISTANCE, OWN, PAIR, SINCE, TIME, UNTIL
from guidefield.kernels.prove.smallest import BEGINS, DEEPEST, ENDS, INTERVAL, TOUCHING, search_along
from guidefield.kernels.prove.tables import MovingRobot
from guidefield.prove.asked import Asked, OfObstacles, among_resting
from guidefield.prove.smallest import TOLERANCE, Smallest
from guidefield.prove.tables import bezier_curve, body_pairs, is_served, resting_obstacles, robot_bodies

AT_ONCE = 2000
"""So many stretches are judged before it is asked whether to stop: a few milliseconds."""

FEW = 34
"""It is looked for own pairs at every so manieth time, and at the last: with 8 a UR5, whose own pairs are near each
other all along, takes a tenth longer, and a Baxter a fiftieth less."""

LOOKED = 1 / 15
"""In stretches longer than this share of the motion balls and boxes alone tell, as other looks mostly fail there: twice
or half of it takes a UR5 and a Baxter longer. Unrecorded."""

STOPPED = 1 / 32
"""A search that is stopped tells what is kept in stretches no longer than this share of the motion."""

_UNKNOWN = np.full(ANSWER, np.inf)
_UNKNOWN[TIME], _UNKNOWN[PAIR] = np.nan, -1.0


class ByKernels:
    """The kernels, among the obstacles that rest."""

    def __init__(self, asked: Asked) -> None:
        self._asked, self._world = asked, among_resting(asked.surveyor.worlds)

    @property
    def serve(self) -> bool:
        """Whether they know all bodies."""
        return is_served(self._world)

    def found(self) -> tuple[OfObstacles | None, Smallest | None]:
        """What they find of obstacles, and of the robot itself; None where bodies touch, or nearly."""
        tables = robot_bodies(self._world), resting_obstacles(self._world), body_pairs(self._world)
        moving = MovingRobot(*tables, bezier_curve(self._asked.surveyor.curve))
        of_obstacles, of_itself = [(*span, 0.0) for span in self._asked.spans], [(*self._asked.spans[0], 1.0)]
        if (both := self._answers(moving, of_obstacles + of_itself)) is not None:
            return OfObstacles(both.smallest[:-1], both.distances), both.smallest[-1]
        if (own := self._answers(moving, of_itself)) is not None:
            return None, own.smallest[0]
        return self._answers(moving, of_obstacles), None

    def _answers(self, moving: MovingRobot, asked: list[tuple[float, float, float]]) -> OfObstacles | None:
        """Answers to questions (since, until, whether about own pairs), and distances from obstacles at the times."""
        answers, distances = np.empty((len(asked), ANSWER)), np.empty(len(self._asked.times))
        answers[:] = _UNKNOWN
        answers[:, [SINCE, UNTIL, OWN]] = asked
        if not self._judge(moving, answers, distances):
            return None
        answers[:, BOUND] = np.minimum(answers[:, BOUND], answers[:, DISTANCE] - TOLERANCE)
        return OfObstacles([*map(_answer, answers)], distances)

    def _judge(self, moving: MovingRobot, answers: np.ndarray, distances_out: np.ndarray) -> bool:
        """Write the answers of a whole motion, and distances at times; whether nothing touches, nor nearly."""
        times = self._asked.times
        whole, waiting = float(times[-1] - times[0]), np.zeros((1 + 3 * DEEPEST, INTERVAL))
        waiting[0, BEGINS], waiting[0, ENDS] = times[0], times[-1]
        count, looked = int(len(times) > 1), times
        while True:
            shortest = STOPPED * whole if self._asked.deadline.expired() else 0.0
            count = search_along(
                moving, TOLERANCE, looked, FEW, AT_ONCE, LOOKED * whole, shortest, answers, waiting, count,
                distances_out,
            )  # fmt: skip
            if count <= 0:
                return count != TOUCHING
            looked = times[:0]


def _answer(row: np.ndarray) -> Smallest:
    return Smallest(float(row[DISTANCE]), float(row[BOUND]), float(row[TIME]), int(row[PAIR]))
