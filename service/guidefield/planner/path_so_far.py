"""The motion found so far: what one stage of a plan hands to the next."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from guidefield.planner.task.ending import Ending
from guidefield.planner.task.problem import Problem
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
