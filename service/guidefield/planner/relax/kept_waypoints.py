"""The waypoints of a path that keep their place or their plane while all others are spread anew."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from guidefield.planner.motion.waypoints import respaced
from guidefield.planner.relax.plane_crossing import PlaneCrossing
from guidefield.planner.task.problem import Problem
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoints


@dataclass(frozen=True, eq=False)
class KeptWaypoints(ReadOnly):
    """Waypoints that are told apart from the others.

    Attributes:
        at: Where they are in the path, ascending, the first and the last waypoint among them, shape (m,).
        crossings: What keeps each of them on its guide plane; None for one that stays where it is.
        planes: By index of each guide plane, which of them is on it.
    """

    at: np.ndarray
    crossings: tuple[PlaneCrossing | None, ...]
    planes: Mapping[int, int]

    @classmethod
    def of(
        cls, problem: Problem, path: ChartPoints, crossings: Mapping[int, int], fixed: np.ndarray | None
    ) -> KeptWaypoints:
        """The ends and fixed waypoints, which stay, and those on guide planes; on two planes at once they stay too.

        Args:
            problem: Robot and guide planes.
            path: Chart points, shape (n, nv).
            crossings: By index of each guide plane, its index in the path.
            fixed: Which waypoints stay besides the ends, shape (n,); None: none.
        """
        stays = {0, len(path) - 1}
        if fixed is not None:
            stays |= set(np.flatnonzero(fixed).tolist())
        on_planes = list(crossings.values())
        stays |= {index for index in on_planes if on_planes.count(index) > 1}
        at = sorted(stays | set(on_planes))
        plane_of = {index: problem.guide_planes[plane] for plane, index in crossings.items() if index not in stays}
        return cls(
            np.array(at),
            tuple(PlaneCrossing.through(problem, plane_of[k], path[k]) if k in plane_of else None for k in at),
            {plane: at.index(index) for plane, index in crossings.items()},
        )

    @property
    def held(self) -> list[int]:
        """Indices in the path of those that stay."""
        return [index for index, crossing in zip(self.at.tolist(), self.crossings, strict=True) if crossing is None]

    @property
    def on_planes(self) -> dict[int, PlaneCrossing]:
        """Those that stay on guide planes, by index in the path."""
        pairs = zip(self.at.tolist(), self.crossings, strict=True)
        return {index: crossing for index, crossing in pairs if crossing is not None}

    @property
    def marks(self) -> dict[int, int]:
        """By index of each guide plane, its index in the path."""
        return {plane: int(self.at[which]) for plane, which in self.planes.items()}

    def spread(self, path: ChartPoints, segments: int) -> tuple[ChartPoints, KeptWaypoints]:
        """The path with its other waypoints spread evenly over about so many segments, and these in it.

        Args:
            path: Chart points, shape (n, nv) [rad or m].
            segments: About how many segments there are to be.

        Returns:
            Chart points, shape (k, nv), and the kept ones among them.
        """
        points, at = respaced(path, self.at, segments)
        return points, replace(self, at=at)
