"""Descents of a group to a pose of its tip, from starts that are given or drawn."""

from __future__ import annotations

from typing import Any

import numpy as np

from guidefield.kernels.kinematics import inverse_kinematics as kernels
from guidefield.kernels.kinematics.inverse_kinematics import Tolerances
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.tip_chain import ChainToTip, chain_to_tip
from guidefield.robot.ik.pose_target import EXACT, PoseTarget
from guidefield.robot.ik.settings import SEARCH
from guidefield.robot.model.chart import WIND
from guidefield.robot.model.spaces import ChartPoint, ChartPoints


class PoseSearch:
    """One target of one group; remembers how close descents came.

    Attributes:
        chain: What moves the tip.
        base: Chart point (nv,) whose coordinates those have that don't move the tip, and near which whole turns are
            chosen.
        closest: Excesses over the tolerances, translation and rotation vector, of the least error met, shape (6,).
    """

    def __init__(
        self, group: PlanningGroup, target: PoseTarget, base: ChartPoint, chain: ChainToTip | None = None
    ) -> None:
        self.chain = chain_to_tip(group) if chain is None else chain
        self.base = base
        self._group = group
        self._table = self.chain.from_target(target.placement)
        tolerances = np.concatenate([target.position_tolerance, target.orientation_tolerance])
        allowed = np.where(tolerances > EXACT, tolerances, 0.5 * EXACT)  # half: others may check in another way
        self._tolerances = Tolerances(
            _frozen(allowed), _frozen(np.where(tolerances > EXACT, SEARCH.aim * tolerances, 0.0))
        )
        self._closest = np.full(7, np.inf)

    @property
    def closest(self) -> np.ndarray:
        """See the class: shape (6,)."""
        return self._closest[1:]

    def drawn(self, count: int, rng: np.random.Generator) -> ChartPoints:
        """Random chart points (count, nv), those nearest to the target first.

        What has no limits is within pi of 0, or within `WIND` of the base where it is an angle whose whole turns count.
        """
        lower, upper = self._table.lower, self._table.upper
        lower, upper = np.where(np.isfinite(lower), lower, -np.pi), np.where(np.isfinite(upper), upper, np.pi)
        lower = np.where(self._group.winds, self.base - WIND, lower)
        upper = np.where(self._group.winds, self.base + WIND, upper)
        points: ChartPoints = rng.uniform(lower, upper, (count, len(lower)))
        points[:, ~self.chain.moving] = self.base[~self.chain.moving]
        squared = np.empty(count)
        kernels.squared_errors(self._table, self._tolerances, points, squared)
        return points[np.argsort(squared, kind="stable")]

    def descend(self, starts: ChartPoints) -> ChartPoints:
        """Chart points (k, nv) within the tolerances and the limits to which starts (n, nv) lead, in their order."""
        starts = np.ascontiguousarray(starts, float)
        ends, reached = np.empty_like(starts), np.zeros(len(starts), np.bool_)
        kernels.descend(self._table, self._tolerances, starts, ends, reached, self._closest)
        return ends[reached]

    def near_base(self, points: ChartPoints) -> ChartPoints:
        """The same configurations (n, nv), by whole turns as near to the base as the limits let them."""
        turns = self.chain.turning
        if not len(turns):
            return points
        z, period = points[:, turns], self.chain.measure.periods[turns]
        least = np.ceil((self._table.lower[turns] - z) / period)
        most = np.floor((self._table.upper[turns] - z) / period)
        near = points.copy()
        near[:, turns] += period * np.minimum(np.maximum(np.rint((self.base[turns] - z) / period), least), most)
        return near

    def turned(self, z: ChartPoint) -> list[np.ndarray]:
        """For each coordinate of a chart point (nv,), the values within its limits that mean the same configuration.

        One where there are no limits: all whole turns are the same configuration then.
        """
        values = [np.array([value]) for value in z]
        for j in self.chain.turning:
            low, high, period = self._table.lower[j], self._table.upper[j], self.chain.measure.periods[j]
            if np.isfinite(high - low):
                values[j] = z[j] + period * np.arange(np.ceil((low - z[j]) / period), (high - z[j]) // period + 1)
        return values


def _frozen(array: Any) -> np.ndarray:
    frozen = np.array(array, float)
    frozen.setflags(write=False)
    return frozen
