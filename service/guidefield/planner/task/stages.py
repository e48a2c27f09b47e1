"""The stages of a plan as they run: their time, how they ended, and the way out when one fails."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from guidefield.errors import Status
from guidefield.planner.task.conditions import Conditions
from guidefield.planner.task.ending import Ending
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.trace import StageEntered, StageLeft
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoints


@dataclass(frozen=True, eq=False)
class PathSoFar(ReadOnly):
    """The motion found so far, and why it goes no further where a stage failed.

    Attributes:
        path: Chart points (n, nv).
        crossings: By index of each guide plane that was reached, its index in `path`.
        proven: Whether its straight pieces are certified, not only free at samples.
        others: Other ways from the same start to a goal, shape (n, nv) each, free at samples: they may prove quicker.
        failure: Why the stage after it found nothing; None while none failed.
    """

    path: ChartPoints
    crossings: Mapping[int, int] = field(default_factory=dict)
    proven: bool = True
    others: tuple[ChartPoints, ...] = ()
    failure: Ending | None = None

    @classmethod
    def at_start(cls, problem: Problem) -> PathSoFar:
        """Nothing but a problem's start."""
        return cls(problem.z_start[None])

    def extended(self, points: ChartPoints, *, proven: bool = True, others: tuple[ChartPoints, ...] = ()) -> PathSoFar:
        """Gone on from where the path ends.

        Args:
            points: Chart points, shape (n, nv), the first of which is where the path ends.
            proven: Whether they are certified.
            others: Other ways on from there, shape (n, nv) each.
        """
        path, *rest = (np.concatenate([self.path, way[1:]]) for way in (points, *others))
        return dataclasses.replace(self, path=path, proven=self.proven and proven, others=tuple(rest))

    def on_plane(self, index: int) -> PathSoFar:
        """The same, with the guide plane of an index reached where the path ends."""
        return dataclasses.replace(self, crossings={**self.crossings, index: len(self.path) - 1})

    def back_at_start(self) -> PathSoFar:
        """Nothing but the first point."""
        return PathSoFar(self.path[:1])

    def failed(self, failure: Ending) -> PathSoFar:
        """The same, as far as it goes."""
        return dataclasses.replace(self, failure=failure)


class StageFailed(Exception):
    """An end of the motion is none: nothing was found, so no path belongs to it.

    Args:
        status: Code of the ending.
        message: One sentence that a person can act on.
        details: The values that the message speaks about.

    Attributes:
        ending: The three as a value.
    """

    def __init__(self, status: Status, message: str, **details: Any) -> None:
        super().__init__(message)
        self.ending = Ending(status, message, details)


@dataclass
class Stage:
    """A stage under way; whoever runs it says how it ended."""

    outcome: str = ""


class Stages:
    """Keeps the time of every stage and tells the observer.

    A stage begins where the one before ended, the first where this is made: what leads from one to the next is counted.
    """

    def __init__(self, conditions: Conditions) -> None:
        self._conditions = conditions
        self._ended = time.perf_counter()
        self._within = 0
        self.left: list[StageLeft] = []
        self.seconds: dict[str, float] = {}

    @contextmanager
    def entered(self, name: str, message: str, plane: int | None = None) -> Iterator[Stage]:
        """Run a stage: its time is counted under its name, and its end is reported however it ends.

        Args:
            name: guide, connect, relax, parameterize or certify.
            message: One sentence for a person.
            plane: Index of the guide plane that it is about.
        """
        begin = time.perf_counter() if self._within else self._ended
        self._conditions.tell(StageEntered(name, message))
        stage = Stage()
        self._within += 1
        try:
            yield stage
        except StageFailed as failed:
            stage.outcome = stage.outcome or failed.ending.message
            raise
        finally:
            self._within -= 1
            self._ended = time.perf_counter()
            seconds = self._ended - begin
            self.seconds[name] = self.seconds.get(name, 0.0) + seconds
            left = StageLeft(name, stage.outcome, seconds, plane)
            self.left.append(left)
            self._conditions.tell(left)
