"""The motion of a robot that executes the pieces of a stream, each followed by another or executed to its stop."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from guidefield.messages.streams import Piece

MAX_WAITING_PIECES = 64  # the largest number of pieces that wait to begin; the oldest are dropped


@dataclass(frozen=True)
class Motion:
    """The state of a robot, in the order of a stream's `position_names`.

    Attributes:
        positions: [rad or m].
        velocities: [rad/s or m/s].
        accelerations: [rad/s^2 or m/s^2].
    """

    positions: tuple[float, ...]
    velocities: tuple[float, ...]
    accelerations: tuple[float, ...]


class Execution:
    """The motion of a robot that takes a stream's pieces.

    A piece is executed from where it begins, if it is there before, and if then the piece is executed that it follows.
    What no piece follows is executed to its end, where the robot stands. It is not for two threads.

    Args:
        start: Where it stands [rad or m].

    Attributes:
        late: How many pieces came after they began.
    """

    def __init__(self, start: Sequence[float]) -> None:
        self.late = 0
        self._start = tuple(start)
        self._piece: Piece | None = None
        self._waiting: deque[Piece] = deque(maxlen=MAX_WAITING_PIECES)

    def take(self, piece: Piece, now: float) -> bool:
        """Take a piece unless it begins before now [s]; return whether it follows the piece that is executed then."""
        if piece.begins < now:
            self.late += 1
            return False
        self._go_on(now)
        number = self._number
        for waiting in self._waiting:
            if waiting.begins <= piece.begins and waiting.follows == number:
                number = waiting.number
        self._waiting.append(piece)
        return piece.follows == number

    def executing(self, now: float) -> int:
        """Return the number of the piece that is executed at a time [s]; 0: none yet. Times must not decrease."""
        self._go_on(now)
        return self._number

    def stops(self) -> float | None:
        """Return the end of the executed piece [s]; None: the robot stands at the start."""
        return None if self._piece is None else self._piece.stops

    def stands(self, now: float) -> bool:
        """Return whether the robot stands at a time [s]. Times must not decrease."""
        self._go_on(now)
        return self._piece is None or now >= self._piece.stops

    def at_goal(self, now: float) -> bool:
        """Return whether it stands at the goal of its piece at a time [s]. Times must not decrease."""
        return self.stands(now) and self._piece is not None and self._piece.reaches_goal

    def at(self, now: float) -> Motion:
        """Return the state of the robot at a time [s]. Times must not decrease."""
        self._go_on(now)
        still = (0.0,) * len(self._start)
        if self._piece is None:
            return Motion(self._start, still, still)
        trajectory = self._piece.trajectory
        if now >= trajectory.times[-1]:
            return Motion(tuple(trajectory.positions[-1]), still, still)
        k = max(0, bisect_right(trajectory.times, now) - 1)
        s, span = now - trajectory.times[k], trajectory.times[k + 1] - trajectory.times[k]
        positions, velocities = trajectory.positions[k], trajectory.velocities[k]
        rows = zip(positions, velocities, trajectory.accelerations[k], trajectory.accelerations[k + 1], strict=True)
        states = []
        for q, v, a, after in rows:
            jerk = (after - a) / span
            states.append((q + s * (v + s * (a / 2 + s * jerk / 6)), v + s * (a + s * jerk / 2), a + s * jerk))
        return Motion(*zip(*states, strict=True))

    @property
    def _number(self) -> int:
        return 0 if self._piece is None else self._piece.number

    def _go_on(self, now: float) -> None:
        while self._waiting and self._waiting[0].begins <= now:
            piece = self._waiting.popleft()
            if piece.follows == self._number:
                self._piece = piece
