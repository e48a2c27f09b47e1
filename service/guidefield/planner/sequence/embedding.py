"""From the joints of one step to all that any step moves: where its columns stand among theirs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.read_only import ReadOnly
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.followers import follow
from guidefield.robot.model.spaces import ChartPoint, ChartPoints, ChartRates, Configuration, RobotConfiguration


@dataclass(frozen=True, eq=False)
class Embedding(ReadOnly):
    """The chart of some joints within that of more of them, while the others stand still.

    Attributes:
        base: Where all joints are when the step begins, shape (n,) [rad or m].
        columns: Where the step's coordinates stand among all, shape (k,).
        shift: Whole turns by which all joints' angles are beyond the step's, shape (k,) [rad].
    """

    base: ChartPoint
    columns: np.ndarray
    shift: np.ndarray

    @classmethod
    def of(cls, part: PlanningGroup, z_start: ChartPoint, whole: PlanningGroup, base: ChartPoint) -> Embedding:
        """The embedding of a group that begins at a chart point (k,), where all joints are at another (n,)."""
        at = {joint.name: joint for joint in whole.joints}
        columns = np.concatenate(
            [np.arange(at[joint.name].idx_v, at[joint.name].idx_v + joint.nv) for joint in part.joints]
        )
        turns = np.where(part.periods > 0.0, np.round((base[columns] - z_start) / np.maximum(part.periods, 1.0)), 0.0)
        return cls(base, columns, turns * part.periods)

    def points(self, zs: ChartPoints) -> ChartPoints:
        """Chart points of all joints, shape (m, n), of the step's, shape (m, k)."""
        points = np.repeat(self.base[None], len(zs), axis=0)
        points[:, self.columns] = zs + self.shift
        return cast(ChartPoints, points)

    def rates(self, rates: ChartRates) -> ChartRates:
        """Rates of all joints, shape (m, n), of the step's, shape (m, k)."""
        embedded = np.zeros((len(rates), len(self.base)))
        embedded[:, self.columns] = rates
        return cast(ChartRates, embedded)


def whole_configuration(group: PlanningGroup, q: Configuration) -> RobotConfiguration:
    """Configuration of the whole robot, shape (nq of the robot,), with a group's joints at q (nq,), others unmoved."""
    whole = np.array(group.q_reference, float)
    for joint in group.joints:
        among = group.robot.joint(joint.name)
        assert among is not None, "a group's joints are the robot's"
        whole[among.idx_q : among.idx_q + among.nq] = q[joint.idx_q : joint.idx_q + joint.nq]
    follow(group.robot.joints, whole)
    return cast(RobotConfiguration, whole)
