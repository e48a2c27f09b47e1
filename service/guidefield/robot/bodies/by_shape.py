"""Searches made once for each collision shape of a robot, in parallel and in any order, and kept on disk."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from guidefield.geometry.cache import name_of, recalled, remembered
from guidefield.geometry.entries import Arrays
from guidefield.kernels.jit.compilers import load_imported
from guidefield.memo import MISSING, Answers
from guidefield.parallel import run_queue
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.size import power_of_two
from guidefield.system import usable_processors

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


Progress = Callable[[ShapeTask], None]
"""Called before each task is begun, by one thread at a time."""


def logged(task: ShapeTask) -> None:
    """Say in the log what is done."""
    _log.info("%s", task.told)


def find_in_parallel(tasks: Sequence[ShapeTask], progress: Progress, threads: int | None = None) -> None:
    """Do tasks, the longest first, on all processors; kernels are loaded before, as threads must not load them.

    Args:
        tasks: The tasks.
        progress: Where it raises, no more are begun, and that is raised.
        threads: How many; 1 for what may well be known: to load all kernels takes longer than to read it.
    """
    threads = min(threads or usable_processors(), len(tasks))
    if threads > 1:
        load_imported("cover.", "distance.", "linalg.")

    def begun() -> Iterator[Callable[[], object]]:
        for task in tasks:
            progress(task)
            yield task.find

    run_queue(begun(), max(threads, 1))


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

    def known(self, robot: RobotModel, asked: Hashable) -> tuple[Found | None, ...]:
        """The same as far as it is known without computing anything; None elsewhere."""
        return self.search(robot, asked).found()

    def search(self, robot: RobotModel, asked: Hashable) -> Search[Found]:
        """What is known, and what has to be found."""
        known, unit = self._known.of(robot, asked), power_of_two(robot.size)

        def restored(arrays: Arrays) -> Found | None:
            return self._restored(arrays, unit)

        if known is not MISSING:
            return Search(known, (), restored, lambda found: found)
        return Search(
            None, self._asked_of(robot, asked, unit), restored, lambda found: self._known.keep(robot, asked, found)
        )

    def _asked_of(
        self, robot: RobotModel, asked: Hashable, unit: float
    ) -> list[tuple[Question | None, Callable[..., ShapeTask]]]:
        """What is found for each shape, in the geometry's order, and what makes a task of it."""
        return [
            (self._question(shape.geometry, asked, unit), functools.partial(ShapeTask.of, self._doing, robot, index))
            for index, shape in enumerate(robot.geometry.geometryObjects)
        ]


class Search(Generic[Found]):
    """The results about a robot's shapes that are known, and the tasks for the others, the largest shape first."""

    def __init__(
        self,
        known: tuple[Found | None, ...] | None,
        questions: Sequence[tuple[Question | None, Callable[..., ShapeTask]]],
        restored: Callable[[Arrays], Found | None],
        keep: Callable[[tuple[Found | None, ...]], tuple[Found | None, ...]],
    ) -> None:
        self._known, self._restored, self._keep = known, restored, keep
        self._names: list[str | None] = []
        self._answers: dict[str, Found | None] = {}
        unfound: dict[str, ShapeTask] = {}
        for question, task_of in questions:
            name = None if question is None else name_of(*question)
            self._names.append(name)
            if question is None or name is None or name in self._answers or name in unfound:
                continue
            arrays = recalled(*question)
            if arrays is None:
                unfound[name] = task_of(_extent(question[1]), functools.partial(self._find, name, question))
            else:
                self._answers[name] = restored(arrays)
        self.tasks = sorted(unfound.values(), key=lambda task: -task.extent)

    def found(self) -> tuple[Found | None, ...]:
        """What is known by now for each shape, in the geometry's order; None elsewhere."""
        if self._known is not None:
            return self._known
        return tuple(None if name is None else self._answers.get(name) for name in self._names)

    def keep(self) -> tuple[Found | None, ...]:
        """The same once all is found; it is kept with the robot."""
        return self._keep(self.found())

    def _find(self, name: str, question: Question) -> None:
        self._answers[name] = self._restored(remembered(*question))


def _extent(inputs: Arrays) -> float:
    """How large a shape is [m]: that of its vertices, or its largest number."""
    if "vertices" in inputs:
        return float(np.linalg.norm(np.ptp(inputs["vertices"], axis=0)))
    return max(float(np.max(array)) for array in inputs.values())
