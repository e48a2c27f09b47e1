"""Certify motions fast by capsules about the links; a motion that they can't decide is left to the exact certificate.

Guide planes are followed by it, and by descents whose kernels get both numbers, too (planner/guide). The capsules
contain the links, so a yes is rigorous whatever the resolution; a smaller one says yes more often, and takes longer to
say no. Guides take a no for contact where the robot is `exact`: larger numbers refuse more of its motions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import coal
import numpy as np

from guidefield.collision.world import World
from guidefield.kernels.distance.distance import DistanceTables
from guidefield.kernels.kinematics.forward_kinematics import chart_values
from guidefield.kernels.sweep.swept_bounds import SweptRobot, motion_apart
from guidefield.memo import memoized
from guidefield.read_only import read_only
from guidefield.robot.bodies.charges import robot_charges
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.group.kinematics import joints_of
from guidefield.robot.model.spaces import ChartPoint, Configuration
from guidefield.scene.distance_tables import distance_tables

SELF_MARGIN = 1e-4  # what capsules of the robot keep from each other [m], at size 1
SWEPT_RESOLUTION = 5e-4  # motions that the capsules can't tell apart are halved down to this [m], at size 1


@dataclass(frozen=True, eq=False)
class SweptWorld:
    """A robot as capsules among obstacles; `exact` if they are its very shapes and no pair is allowed to touch."""

    group: PlanningGroup
    robot: SweptRobot
    tables: DistanceTables
    exact: bool

    def ends(self, q0: Configuration, q1: Configuration) -> tuple[ChartPoint, ChartPoint]:
        """Return chart points (nv,) of two configurations (nq,) of the group, the second one nearest to the first."""
        group = self.group
        if group.space is not group.model:
            z0 = group.chart(q0)
            return z0, group.unwrapped(group.chart(q1), z0)
        z0, z1 = cast(ChartPoint, np.empty(group.nv)), cast(ChartPoint, np.empty(group.nv))
        chart_values(self.robot.joints, q0, self.robot.origin, self._zero, z0)
        chart_values(self.robot.joints, q1, self.robot.origin, z0, z1)
        return z0, z1

    def apart(self, z0: ChartPoint, z1: ChartPoint, margin: float) -> bool:
        """Return whether robot and obstacles keep a margin [m] along the straight motion between chart points (nv,).

        True is rigorous. False means that they come too close, or that this test can't tell.
        """
        start, end = self.group.expand_chart(z0), self.group.expand_chart(z1)
        own, floor = SELF_MARGIN * self.group.size, SWEPT_RESOLUTION * self.group.size
        return bool(motion_apart(self.robot, self.tables, start, end, margin, own, floor))

    def keeps(self, q: Configuration, margin: float) -> bool:
        """Return `apart` at a single configuration (nq,): True is rigorous."""
        return self.apart(*self.ends(q, q), margin)

    @cached_property
    def _zero(self) -> ChartPoint:
        return cast(ChartPoint, np.zeros(self.group.nv))


@memoized
def swept_world(world: World) -> SweptWorld:
    """Build the capsules of a world; once for each."""
    group = world.group
    charges = robot_charges(group.robot)
    shapes = list(group.geometry.geometryObjects)
    capsules, carriers = [], []
    for charged, shape in zip(charges.shapes, shapes, strict=True):
        ends = [shape.placement.act(end) for end in (charged.capsule.p0, charged.capsule.p1)]
        capsules.append(np.r_[ends[0], ends[1], charged.capsule.radius])
        carriers.append(shape.parentJoint)
    robot = SweptRobot(
        joints=joints_of(group),
        origin=group.expand(group.q_origin),
        capsules=np.array(capsules, float).reshape(-1, 7),
        carriers=np.array(carriers, np.int64),
        own=world.pairs.own,
        apart=_apart(group, world.pairs.own.tobytes()),
    )
    read_only(robot.capsules, robot.carriers, robot.own, robot.apart, robot.origin)
    exact = not len(world.pairs.left_out) and all(isinstance(shape.geometry, coal.Capsule) for shape in shapes)
    return SweptWorld(group, robot, distance_tables(world.scene), exact)


@memoized_for_alike
def _apart(group: PlanningGroup, own_pairs: bytes) -> np.ndarray:
    supports = [list(group.model.supports[shape.parentJoint]) for shape in group.geometry.geometryObjects]
    apart = [
        [_first_apart(supports[one], supports[other]) for one, other in ((a, b), (b, a))]
        for a, b in np.frombuffer(own_pairs, np.int64).reshape(-1, 2).tolist()
    ]
    return np.array(apart, np.int64).reshape(-1, 2)


def _first_apart(one: list[int], other: list[int]) -> int:
    return next((joint for joint, beside in zip(one, [*other, *one], strict=False) if joint != beside), 0)
