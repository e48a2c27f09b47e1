"""The path towards a guide plane: advances of the tip, every accepted configuration, and straight motions between.

service/docs/algorithm.md, "Crossing a guide plane", has the algorithm. Motions are free by capsules about the links
(`SweptWorld`) or, where these can't tell, by the certificate. The capsules contain the links, so their yes is rigorous
whatever `SWEPT_RESOLUTION`; a smaller one says yes more often, and takes longer to say no. Where the capsules are the
robot's very shapes a no counts as contact: larger `SELF_MARGIN` and `SWEPT_RESOLUTION` refuse more of its motions.
Descents whose kernels judge steps get both numbers, too.

`RESOLUTION` is time, but for what all but touches: samples refuse that. `COMFORTABLE`, `MARGINS` (also for the kernel
of whole rounds, `rounds.py`) and `DIPS` choose between free paths. Lengths in m are for a robot of size 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import cast

import coal
import numpy as np

from guidefield.collision.world import World
from guidefield.kernels.collide.swept_bounds import SweptRobot, motion_apart
from guidefield.kernels.distance.distance import DistanceTables
from guidefield.kernels.kinematics.forward_kinematics import local_values
from guidefield.kernels.kinematics.integrate import reach
from guidefield.memo import memoized
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.trace import Note, Step, StepKind
from guidefield.prove.certificate import motion_free
from guidefield.prove.verdict import Verdict
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.group.kinematics import find_planned_values, joints_of, mover_of
from guidefield.robot.link_charges import robot_charges
from guidefield.robot.model.joints import Configuration, LocalPoint
from guidefield.scene.distance_tables import distance_tables

RESOLUTION = 32.0  # samples of a motion per length in local coordinates [1/rad or 1/m], as a tree's motions have
COMFORTABLE = 0.02  # a straight path that keeps this is taken without comparing [m], at size 1. Unrecorded
# distances from obstacles by which paths are compared, the widest first [m]. Unrecorded
MARGINS = (0.06, 0.03, 0.02, 0.01, 0.005)
# distances from obstacles [m]: a path dips without the widest one that both its ends keep. With it Univariate keeps 46
# and 17 mm in the thesis' tapered and blocked passages
DIPS = (0.06, 0.045, 0.03, 0.015)
SELF_MARGIN = 1e-4  # what capsules of the robot keep from each other [m], at size 1
SWEPT_RESOLUTION = 5e-4  # motions that the capsules can't tell apart are halved down to this [m], at size 1


@dataclass(frozen=True, eq=False)
class SweptWorld:
    """A robot as capsules among obstacles; `exact` if they are its very shapes and no pair is allowed to touch."""

    group: PlanningGroup
    robot: SweptRobot
    tables: DistanceTables
    exact: bool

    def ends(self, q0: Configuration, q1: Configuration) -> tuple[LocalPoint, LocalPoint]:
        """Return local coordinates (nv,) of two configurations (nq,) of the group, the second nearest to the first."""
        group = self.group
        if group.space is not group.model:
            z0 = group.to_local(q0)
            return z0, group.unwrapped(group.to_local(q1), z0)
        z0, z1 = cast(LocalPoint, np.empty(group.nv)), cast(LocalPoint, np.empty(group.nv))
        local_values(self.robot.joints, q0, self.robot.origin, self._zero, z0)
        local_values(self.robot.joints, q1, self.robot.origin, z0, z1)
        return z0, z1

    def apart(self, z0: LocalPoint, z1: LocalPoint, margin: float) -> bool:
        """Return whether robot and obstacles keep a margin [m] along the straight motion between points (nv,).

        True is rigorous. False means that they come too close, or that this test can't tell.
        """
        start, end = self.group.expand_local(z0), self.group.expand_local(z1)
        own, floor = SELF_MARGIN * self.group.size, SWEPT_RESOLUTION * self.group.size
        return bool(motion_apart(self.robot, self.tables, start, end, margin, own, floor))

    def keeps(self, q: Configuration, margin: float) -> bool:
        """Return `apart` at a single configuration (nq,): True is rigorous."""
        return self.apart(*self.ends(q, q), margin)

    @cached_property
    def _zero(self) -> LocalPoint:
        return cast(LocalPoint, np.zeros(self.group.nv))


@memoized
def swept_world(world: World) -> SweptWorld:
    """Build the capsules of a world; once for each."""
    group = world.group
    charges = robot_charges(group.robot)
    shapes = list(group.geometry.geometryObjects)
    capsules, parent_joints = [], []
    for charged, shape in zip(charges.shapes, shapes, strict=True):
        ends = [shape.placement.act(end) for end in (charged.capsule.p0, charged.capsule.p1)]
        capsules.append(np.r_[ends[0], ends[1], charged.capsule.radius])
        parent_joints.append(shape.parentJoint)
    robot = SweptRobot(
        joints=joints_of(group),
        origin=group.expand(group.q_origin),
        capsules=np.array(capsules, float).reshape(-1, 7),
        parent_joints=np.array(parent_joints, np.int64),
        own=world.pairs.own,
        apart=_apart(group, world.pairs.own.tobytes()),
    )
    read_only(robot.capsules, robot.parent_joints, robot.own, robot.apart, robot.origin)
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


Reach = Callable[[Problem, Configuration, np.ndarray], Iterable[Configuration]]
"""Configurations near q whose tip is at a point (3,) [m]: those to be tried, in order."""


@dataclass(frozen=True, eq=False)
class Advance(ReadOnly):
    """The result of an advance."""

    q: Configuration | None  # configuration after it; None if no step was feasible
    step: float  # distance that the tip moved [m]


class GuidedPath:
    """A path that grows by steps from q (nq,) on, with a margin from obstacles [m]."""

    def __init__(self, problem: Problem, q: Configuration, margin: float, plane: int) -> None:
        self.problem = problem
        self.path = [q]
        self.margin = margin
        self.plane = plane
        self._tip: np.ndarray | None = None
        self._refused: tuple[LocalPoint, LocalPoint] | None = None

    @property
    def size(self) -> float:
        """The robot's: chosen lengths are multiplied by it."""
        return self.problem.group.size

    @property
    def q(self) -> Configuration:
        """The present configuration, shape (nq,)."""
        return self.path[-1]

    @property
    def tip(self) -> np.ndarray:
        """The present place of the tip, shape (3,) [m]."""
        if self._tip is None:
            self._tip = self.problem.kinematics.tip_position(self.problem.group.expand(self.q))
        return self._tip

    def free(self, q0: Configuration, q1: Configuration) -> bool:
        """Return whether the straight motion between two configurations (nq,) is free over its whole length."""
        swept = swept_world(self.problem.world)
        z0, z1 = swept.ends(q0, q1)
        self.problem.counters.collision_checks += 1
        if swept.apart(z0, z1, self.margin):
            return True
        if swept.exact:
            self._refused = (z0, z1)
            return False
        return self.judge(q0, q1)

    def judge(self, q0: Configuration, q1: Configuration) -> bool:
        """`free` by the certificate, where capsules can't tell; each configuration of shape (nq,).

        A sample that is too close refuses it sooner.
        """
        z0, z1 = swept_world(self.problem.world).ends(q0, q1)
        if not self.problem.batch.free_until(np.array([z0, z1]), RESOLUTION, self.margin):
            self._refused = (z0, z1)
            return False
        verdict = motion_free(self.problem.world, z0, z1, self.margin)
        self.problem.counters.collision_checks += verdict.evaluations
        if not verdict.free:
            self._refused = (z0, z1)
        return verdict.free

    def straighten(self, since: int) -> None:
        """Go straight from an earlier configuration of the path to the last one, where that motion is free.

        Advances lead to the walls and descents back: from one plane's minimum to the next one's the straight motion is
        shorter and mostly farther from the obstacles. It need not be, so every step is kept until this is known. Where
        the straight path comes close, the first of it, one through a single step, and all steps stays that keeps the
        widest margin.
        """
        steps = self.path[since:]
        if len(steps) < 3:
            return
        if self.keeps(steps[0], steps[-1], max(COMFORTABLE * self.size, self.margin)):
            del self.path[since + 1 : -1]
            return
        for margin in (m for one in MARGINS if (m := one * self.size) > self.margin):
            for kept in ([], *([step] for step in steps[-2:0:-1]), steps[1:-1]):
                if all(self.keeps(a, b, margin) for a, b in pairwise([steps[0], *kept, steps[-1]])):
                    self.path[since + 1 : -1] = kept
                    return
        if self.free(steps[0], steps[-1]):
            del self.path[since + 1 : -1]

    def dips(self, since: int) -> bool:
        """Return whether the path from an earlier configuration comes nearer to obstacles than both its ends do."""
        swept, ends = swept_world(self.problem.world), (self.path[since], self.q)
        margins = (dip * self.size for dip in DIPS)
        margin = next((margin for margin in margins if all(swept.keeps(q, margin) for q in ends)), None)
        return margin is not None and not all(self.keeps(a, b, margin) for a, b in pairwise(self.path[since:]))

    def undo(self, since: int) -> None:
        """Go back to an earlier configuration, whose index in the path is given."""
        del self.path[since + 1 :]
        self._tip = None
        self.problem.tell(Note("comes too near to obstacles on the way: goes back, and on in shorter advances"))

    def keeps(self, q0: Configuration, q1: Configuration, margin: float) -> bool:
        """Return whether capsules can tell that the straight motion between configurations (nq,) keeps a margin [m]."""
        swept = swept_world(self.problem.world)
        self.problem.counters.collision_checks += 1
        return swept.apart(*swept.ends(q0, q1), margin)

    def refusal(self) -> Verdict | None:
        """The certificate's verdict on the last motion that was not free; None if there was none.

        Where the fast judgement is stricter than the certificate by a hair, the verdict may be that it is free.
        """
        if self._refused is None:
            return None
        return motion_free(self.problem.world, *self._refused, self.margin)

    def refused_between(self, *ends: Configuration) -> None:
        """Note the ends of the last motion that was not free, two configurations (nq,); none if there was none."""
        self._refused = swept_world(self.problem.world).ends(*ends) if ends else None

    def take(
        self, q: Configuration, kind: StepKind, message: str, potential: float | None = None, *, kept: bool = True
    ) -> None:
        """Accept a configuration (nq,); it isn't of the path where a straight path was found that leaves it out."""
        if kept:
            self.path.append(q)
            self._tip = None
        self.problem.tell(Step(kind, q, message, potential, self.plane))

    def advance(self, direction: np.ndarray, step: float, smallest: float, reached: Reach) -> Advance:
        """Move the tip along a unit vector (3,): the largest of step, step/2 .. `smallest` that is feasible."""
        start, tried = self.tip, step
        self._refused = None
        while tried >= smallest or tried == step:
            for q in reached(self.problem, self.q, start + tried * direction):
                if self.free(self.q, q):
                    self.take(q, StepKind.ADVANCE, f"tip {1000 * tried:.0f} mm towards the plane")
                    return Advance(q, tried)
            tried *= 0.5
        return Advance(None, 0.0)


def reach_point(problem: Problem, q: Configuration, point: np.ndarray) -> Configuration | None:
    """The configuration near q (nq,) with the tip at a point (3,), by the least change of joints, weighted by reach.

    None if Newton's method does not get there within the limits.
    """
    group = problem.group
    start = group.expand(q)
    reached = np.empty_like(start)
    if not reach(mover_of(group), start, point, reached):
        return None
    planned: Configuration = reached[find_planned_values(group)]
    return planned
