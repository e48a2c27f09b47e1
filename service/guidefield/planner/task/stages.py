"""The stages of a plan as they run: their time, how they ended, and the way out when one fails."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from guidefield.errors import Status
from guidefield.planner.task.conditions import Conditions
from guidefield.planner.task.ending import Ending
from guidefield.planner.task.trace import StageEntered, StageLeft


class StageFailed(Exception):
    """An end of the motion is none: nothing was found, so no path belongs to it."""

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
        """Run a stage: its time is counted under its name, and its end is reported however it ends."""
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
