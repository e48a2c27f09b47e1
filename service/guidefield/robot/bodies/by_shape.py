"""Searches made once for each collision shape of a robot, in parallel and in any order, and kept on disk."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from guidefield.geometry.cache import Arrays, entry_name, find_or_compute, recall
from guidefield.kernels.jit.compilers import load_imported
from guidefield.memo import MISSING, Answers
from guidefield.parallel import run_queue, usable_processors
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.size import power_of_two

_log = logging.getLogger(__name__)

Found = TypeVar("Found")

Question = tuple[str, Arrays, Callable[[], Arrays]]
"""What is found for a shape: the name it is kept under, what it depends on, and how it is found."""


class ShapeTask(NamedTuple):
    """Work on a collision shape, and those like it: ``covering link2, shape 3 of 8``, and its extent [m]."""

    told: str
    extent: float
    find: Callable[[], object]

    @classmethod
    def of(cls, doing: str, robot: RobotModel, index: int, extent: float, find: Callable[[], object]) -> ShapeTask:
        """What is done about a robot's collision shape."""
        shapes = robot.geometry.geometryObjects
        link = robot.model.frames[shapes[index].parentFrame].name
        return cls(f"{doing} {link}, shape {index + 1} of {len(shapes)}", extent, find)


Progress = Callable[[ShapeTask], None]  # called before each task is begun, by one thread at a time


def log_task(task: ShapeTask) -> None:
    """Say in the log what is done."""
    _log.info("%s", task.told)


def find_in_parallel(tasks: Sequence[ShapeTask], progress: Progress, threads: int | None = None) -> None:
    """Do tasks, the longest first, on all processors; kernels are loaded before, as threads must not load them.

    Args:
        progress: Where it raises, no more are begun, and that is raised.
        threads: How many; 1 for what may well be known: to load all kernels takes longer than to read it.
    """
    threads = min(threads or usable_processors(), len(tasks))
    if threads > 1:
        load_imported("cover.", "distance.", "linalg.")

    def begin_each() -> Iterator[Callable[[], object]]:
        for task in tasks:
            progress(task)
            yield task.find

    run_queue(begin_each(), max(threads, 1))


class ByShape(Generic[Found]):
    """A search for each shape of a robot, whose results are kept with the robot.

    Args:
        doing: A word for the search.
        question: Of a Coal shape, the further argument and the unit of its lengths [m]; None: nothing is found for it.
        restored: Makes a result in metres from its arrays and that unit.
    """

    def __init__(
        self,
        doing: str,
        question: Callable[[Any, Any, float], Question | None],
        restored: Callable[[Arrays, float], Found | None],
    ) -> None:
        self._doing, self._question, self._restored = doing, question, restored
        self._known = Answers[tuple[Found | None, ...]]()

    def all(self, robot: RobotModel, asked: Hashable, progress: Progress) -> tuple[Found | None, ...]:
        """What is found for each shape, in the geometry's order; what `progress` raises comes through."""
        search = self.search(robot, asked)
        find_in_parallel(search.tasks, progress)
        return search.keep()

    def recall(self, robot: RobotModel, asked: Hashable) -> tuple[Found | None, ...]:
        """The same as far as it is known without computing anything; None elsewhere."""
        return self.search(robot, asked).found()

    def search(self, robot: RobotModel, asked: Hashable) -> ShapeSearch[Found]:
        """Return the results that are known, and tasks for the others, the largest shape first."""
        known, unit = self._known.of(robot, asked), power_of_two(robot.size)
        if known is not MISSING:
            return ShapeSearch([], lambda: known, lambda: known)
        names: list[str | None] = []
        answers: dict[str, Found | None] = {}
        tasks: dict[str, ShapeTask] = {}

        def find(name: str, question: Question) -> None:
            answers[name] = self._restored(find_or_compute(*question), unit)

        def collect() -> tuple[Found | None, ...]:
            return tuple(None if name is None else answers.get(name) for name in names)

        for index, shape in enumerate(robot.geometry.geometryObjects):
            question = self._question(shape.geometry, asked, unit)
            names.append(None if question is None else entry_name(*question))
            name = names[-1]
            if question is None or name is None or name in answers or name in tasks:
                continue
            arrays, inputs = recall(*question), question[1]
            if arrays is not None:
                answers[name] = self._restored(arrays, unit)
                continue
            extent = max(float(np.max(array)) for array in inputs.values())
            if "vertices" in inputs:
                extent = float(np.linalg.norm(np.ptp(inputs["vertices"], axis=0)))
            work = functools.partial(find, name, question)
            tasks[name] = ShapeTask.of(self._doing, robot, index, extent, work)
        largest_first = sorted(tasks.values(), key=lambda task: -task.extent)
        return ShapeSearch(largest_first, collect, lambda: self._known.keep(robot, asked, collect()))


class ShapeSearch(NamedTuple, Generic[Found]):
    """Results about a robot's shapes, in the geometry's order."""

    tasks: list[ShapeTask]  # work that finds those that aren't known
    found: Callable[[], tuple[Found | None, ...]]  # returns those that are known by now, None elsewhere
    keep: Callable[[], tuple[Found | None, ...]]  # returns them once all are found, and keeps them with the robot
