"""A waypoint whose tip stays on a guide plane, inside the polygon, while the path is relaxed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.planner.guide.tip_reach import inset_at
from guidefield.planner.relax.settings import CROSSING
from guidefield.planner.task.problem import Problem
from guidefield.robot.model.spaces import ChartPoint
from guidefield.scene.guide_plane import GuidePlane


@dataclass(frozen=True, eq=False)
class PlaneCrossing:
    """Keeps the tip on a guide plane, at least `inset` from its edges.

    Attributes:
        problem: Robot and limits.
        plane: The guide plane.
        inset: Distance that the tip keeps from the polygon's edges [m].
    """

    problem: Problem
    plane: GuidePlane
    inset: float

    @classmethod
    def through(cls, problem: Problem, plane: GuidePlane, z: ChartPoint) -> PlaneCrossing:
        """The crossing of a plane at a chart point, with a share of the guide's inset or what it has, if less.

        Args:
            problem: Robot and guide planes.
            plane: The plane.
            z: Chart point with the tip on it, shape (nv,).
        """
        tip = problem.kinematics.tip_position(problem.group.expand_from_chart(z))
        return cls(problem, plane, inset_at(problem, plane, tip))

    def held_directions(self, z: ChartPoint, descent: ChartPoint) -> np.ndarray:
        """Directions of the chart in which the waypoint must not move, orthonormal rows, shape (r, nv).

        The plane's normal, carried to the joints; where the tip is at an edge of the inset polygon and the descent
        leads out over it, that edge's normal too.

        Args:
            z: Chart coordinates with the tip on the plane, shape (nv,).
            descent: Where the waypoint wants to go, shape (nv,).
        """
        plane = self.plane
        tip, J = self._tip(z)
        depths = plane.inward @ _foot(plane, tip) - plane.offsets - self.inset
        edges = (plane.inward[depths <= CROSSING.at_edge] @ plane.flat.axes) @ J
        return _orthonormal(np.vstack([plane.normal @ J, edges[edges @ descent < 0.0]]))

    def brought_back(self, z: ChartPoint) -> ChartPoint | None:
        """Chart coordinates next to z, within limits, with the tip on the inset polygon; None if there are none near.

        Args:
            z: Chart coordinates, shape (nv,).
        """
        group = self.problem.group
        for _ in range(CROSSING.corrections):
            tip, J = self._tip(z)
            error = self.plane.closest_point(tip, self.inset) - tip
            if np.linalg.norm(error) <= CROSSING.on_plane:
                return z
            move = np.linalg.pinv(J, rcond=1e-6) @ error
            stuck = ((z <= group.lower) & (move < 0.0)) | ((z >= group.upper) & (move > 0.0))
            if stuck.any():
                move = np.linalg.pinv(np.where(stuck, 0.0, J), rcond=1e-6) @ error
            z = np.clip(z + move, group.lower, group.upper)
        return None

    def _tip(self, z: ChartPoint) -> tuple[np.ndarray, np.ndarray]:
        """Position of the tip, shape (3,), and its derivative by the chart coordinates, shape (3, nv)."""
        group, kinematics = self.problem.group, self.problem.kinematics
        q = group.expand_from_chart(z)
        return kinematics.tip_position(q), kinematics.tip_jacobian(q)[:3] @ group.tangent_map(z)


def _foot(plane: GuidePlane, point: np.ndarray) -> np.ndarray:
    """Coordinates (2,) in the plane of a point (3,)."""
    foot: np.ndarray = plane.flat.axes @ (point - plane.flat.origin)
    return foot


def _orthonormal(rows: np.ndarray) -> np.ndarray:
    """An orthonormal basis (r, nv) of the space that rows (k, nv) span; rows that add next to nothing are left out."""
    basis: list[np.ndarray] = []
    for row in rows:
        rest = row - sum((b @ row) * b for b in basis)
        length = float(np.linalg.norm(rest))
        if length > 1e-6 * max(float(np.linalg.norm(row)), 1e-12):
            basis.append(rest / length)
    return np.array(basis).reshape(-1, rows.shape[1])
