"""What the planner tells about the joints of one step, told about all joints of the sequence."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from guidefield.planner.sequence.embedding import Embedding
from guidefield.planner.task.trace import Event, Observer, PathRelaxed, Step, TreeGrown
from guidefield.robot.group.group import PlanningGroup


@dataclass(frozen=True)
class Translated:
    """An observer of a step who tells an observer of the sequence.

    Attributes:
        observer: Who is told.
        part: The step's joints.
        whole: All joints.
        embedding: From the one's chart to the others'.
    """

    observer: Observer
    part: PlanningGroup
    whole: PlanningGroup
    embedding: Embedding

    def observe(self, event: Event) -> None:
        """Pass an event on, its configurations those of all joints."""
        self.observer.observe(self._of_all(event))

    def _of_all(self, event: Event) -> Event:
        match event:
            case Step(q=q):
                z = self.embedding.points(self.part.chart(q)[None])[0]
                return dataclasses.replace(event, q=self.whole.from_chart(z), plane=None)
            case PathRelaxed(path=path):
                return dataclasses.replace(event, path=self.embedding.points(path))
            case TreeGrown(trees=trees):
                return TreeGrown(lambda: tuple((self.embedding.points(nodes), parents) for nodes, parents in trees()))
            case _:
                return event
