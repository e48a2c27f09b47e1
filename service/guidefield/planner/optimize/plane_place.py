"""A guide plane as a place that a motion passes: its tip comes to the plane, inside the polygon."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from guidefield.kernels.optimize.tip_plane import TipPlane
from guidefield.planner.guide.tip_reach import inset_at
from guidefield.planner.task.problem import Problem
from guidefield.read_only import read_only
from guidefield.robot.model.spaces import ChartPoint, ChartPoints
from guidefield.scene.guide_plane import GuidePlane


@dataclass(frozen=True)
class PlanePlace:
    """The tip on a guide plane, at least `inset` from its edges.

    Its misses are the height over the plane, and for each edge how far the tip is beyond it [m].

    Attributes:
        problem: The robot.
        plane: The guide plane.
        inset: Distance that the tip keeps from the polygon's edges [m].
    """

    problem: Problem
    plane: GuidePlane
    inset: float

    @classmethod
    def through(cls, problem: Problem, plane: GuidePlane, z: ChartPoint) -> PlanePlace:
        """The crossing of a plane at a chart point, with a share of the guide's inset or what it has, if less.

        Args:
            problem: Robot and guide planes.
            plane: The plane.
            z: Chart point with the tip on it, shape (nv,).
        """
        return cls(problem, plane, inset_at(problem, plane, problem.kinematics.tip_positions(z[None])[0]))

    @cached_property
    def tip_plane(self) -> TipPlane:
        """As in `Place`."""
        directions, offsets = self._heights
        rows = np.ascontiguousarray(directions.T), offsets + self.plane.flat.origin @ directions
        read_only(*rows)
        return TipPlane(self.problem.kinematics.tip, *rows)

    def missed(self, zs: ChartPoints) -> np.ndarray:
        """As in `Place`, shape (n, 1 + edges)."""
        directions, offsets = self._heights
        missed: np.ndarray = (self.problem.kinematics.tip_positions(zs) - self.plane.flat.origin) @ directions - offsets
        np.minimum(missed[:, 1:], 0.0, out=missed[:, 1:])
        return missed

    @cached_property
    def _heights(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions (3, 1 + edges) and offsets (1 + edges,) of the heights over the plane and its inset edges."""
        plane = self.plane
        rows = np.vstack([plane.normal, plane.inward @ plane.flat.axes]).T, np.r_[0.0, plane.offsets + self.inset]
        read_only(*rows)
        return rows

    def rows(self, z: ChartPoint) -> np.ndarray:
        """As in `Place`, shape (1 + edges, nv); zero for an edge that the tip is inside of."""
        rows: np.ndarray = self._heights[0].T @ self.problem.kinematics.tip_slopes(z)
        rows[1:][self.missed(z[None])[0, 1:] >= 0.0] = 0.0
        return rows
