"""Descents of a group to a target pose of its tip, from starts that are given or drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.geometry.placements import se3
from guidefield.kernels.kinematics import inverse_kinematics as kernels
from guidefield.kernels.kinematics.inverse_kinematics import Tolerances
from guidefield.messages.requests import PoseGoal, TargetPose
from guidefield.read_only import read_only
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import ChainToTip, chain_to_tip
from guidefield.robot.model.chart import WIND
from guidefield.robot.model.spaces import ChartPoint, ChartPoints

EXACT = 1e-6  # a tolerance of zero, or any smaller than this, means this [m, rad]


@dataclass(frozen=True, eq=False)
class PoseTarget:
    """A pose of the tip with tolerances along and about the target's own axes, (3,) each [m, rad]; inf if free.

    Those about the axes are components of the rotation vector from target to tip.
    """

    placement: Any
    position_tolerance: np.ndarray
    orientation_tolerance: np.ndarray

    @classmethod
    def from_wire(cls, pose: TargetPose | PoseGoal) -> PoseTarget:
        """The target that a message means; null is a free axis."""
        tolerances = [
            np.array([np.inf if axis is None else axis for axis in axes])
            for axes in (pose.position_tolerance, pose.orientation_tolerance)
        ]
        read_only(*tolerances)
        return cls(se3(pose.position, pose.quaternion_xyzw), *tolerances)

    def is_reached(self, T_world_tip: Any) -> bool:
        """Whether a placement of the tip (pinocchio.SE3) is within the tolerances."""
        offset = self.placement.actInv(T_world_tip)
        return bool(
            np.all(np.abs(offset.translation) <= np.maximum(self.position_tolerance, EXACT))
            and np.all(np.abs(pin.log3(offset.rotation)) <= np.maximum(self.orientation_tolerance, EXACT))
        )


@dataclass(frozen=True)
class SearchSettings:
    """Of the search for configurations that reach a pose."""

    # the middle part of a tolerance that is aimed at, so that an approach from outside ends inside. Unrecorded
    aim: float = 0.9
    round: int = 64  # random starts of a round. Unrecorded
    first_round: int = 16  # the same of the first rounds where one solution is asked for. Unrecorded
    # the same where nothing was accepted that often: poses in narrow places need many starts. The value is unrecorded
    large_round: int = 512
    # accepted solutions for each that is asked for, from which those farthest apart are chosen. Unrecorded
    choice: int = 2
    # random starts after which a pose counts as unreachable. With it all of 1000 reachable poses of a Panda are solved
    most_unreached: int = 256
    most_rejected: int = 1024  # the same after which it counts as reachable only by what isn't accepted. Unrecorded
    most_per_solution: int = 64  # the same for each solution asked for, where there are some. Unrecorded
    most_kept: int = 256  # distinct solutions that are kept of those not accepted: they tell what stands in the way
    why_starts: int = 64  # random starts for each question that is asked after a failure. Unrecorded
    why_halvings: int = 8  # how often half a turn is halved to find the nearest orientation in reach: to 0.7 degrees


SEARCH = SearchSettings()


class PoseSearch:
    """Descents of one group to one target.

    Attributes:
        chain: The chain that moves the tip.
        base: Chart point (nv,) that gives coordinates that don't move the tip, and near which whole turns are chosen.
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
            _freeze(allowed),
            _freeze(np.where(tolerances > EXACT, SEARCH.aim * tolerances, 0.0)),
            group.size,
            group.sizes,
        )
        self._closest = np.full(7, np.inf)

    @property
    def closest(self) -> np.ndarray:
        """See the class: shape (6,)."""
        return self._closest[1:]

    def draw(self, count: int, rng: np.random.Generator) -> ChartPoints:
        """Draw chart points (count, nv), those nearest to the target first.

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
        """Return, for each coordinate of a point (nv,), the values in its limits that mean the same configuration.

        One where there are no limits: all whole turns are the same configuration then.
        """
        values = [np.array([value]) for value in z]
        for j in self.chain.turning:
            low, high, period = self._table.lower[j], self._table.upper[j], self.chain.measure.periods[j]
            if np.isfinite(high - low):
                values[j] = z[j] + period * np.arange(np.ceil((low - z[j]) / period), (high - z[j]) // period + 1)
        return values


def _freeze(array: Any) -> np.ndarray:
    frozen = np.array(array, float)
    frozen.setflags(write=False)
    return frozen
