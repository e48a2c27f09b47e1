"""Potential, force and torque of a robot's charged points in a scene's field, and of its links in each other's.

Formulas are those of docs/algorithm.md. Descents use `SINGLE`, plots of recordings `COARSE` (both are compiled for
single precision alone), replies about potentials `DOUBLE`; nothing that is certified rests on a field.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np

from guidefield.kernels.field.energy import ChargedRobot, energy, potentials
from guidefield.kernels.field.field import FieldTables
from guidefield.kernels.kinematics.forward_kinematics import JointTable, joint_placements
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.group.kinematics import joints_of
from guidefield.robot.link_charges import robot_charges
from guidefield.robot.model.joints import Configuration, Configurations
from guidefield.scene.field_slice import Origin, coarse_tables, field_of_movers, single_tables
from guidefield.scene.scene import Scene


class Precision(Enum):
    """Precision of the field on a robot.

    Single takes half the time of double, with an error of about 1e-5 a few millimetres from a wall. Coarse is single
    precision with expansions for all that is far away, good to a few thousandths: for pictures.
    """

    DOUBLE = "double"
    SINGLE = "single"
    COARSE = "coarse"


@dataclass(frozen=True, eq=False)
class Energy:
    """The field on a robot at one configuration."""

    potential: float  # U, the weighted sum of the potential over the charged points, and of links on links [m]
    gradient: np.ndarray  # dU/dv, shape (nv,); the generalised force is its negative
    metric: np.ndarray  # curvature of nearby faces carried to the joints, shape (nv, nv), positive semidefinite
    wrenches: np.ndarray  # force [1], moment about the world's origin [m] on each joint's link, shape (njoints, 6)


class RobotField:
    """The field of a scene on a planning group, self-repulsion included.

    service/docs/algorithm.md, "Forces on a robot", has the formulas. Its tables are made when it is first asked: a plan
    that only connects has no use for them.

    Args:
        precision: Of the field's kernels; forces are gathered in double precision either way.

    Raises:
        RobotInvalid: if the robot has no collision geometry, which carries its charges.
    """

    def __init__(self, group: PlanningGroup, scene: Scene, precision: Precision = Precision.DOUBLE) -> None:
        group.robot.require_collision_geometry()
        self.group = group
        self.evaluations = 0
        self._scene, self._precision = scene, precision

    @cached_property
    def tables(self) -> FieldTables:
        """The scene's field."""
        return _TABLES[self._precision](self.group, self._scene)

    @cached_property
    def joints(self) -> JointTable:
        """The group's joints."""
        return joints_of(self.group)

    @cached_property
    def charged(self) -> ChargedRobot:
        """The robot's charges."""
        return _charged_robot(self.group)

    def among(self, scene: Scene) -> RobotField:
        """Return the same robot's field in another scene, in the same precision, with its own `evaluations`."""
        return RobotField(self.group, scene, self._precision)

    def evaluate(self, q: Configuration) -> Energy:
        """Return U, its gradient, the metric and the wrenches at a configuration.

        Args:
            q: Configuration of the group, shape (nq,) [rad or m].
        """
        nv, n = self.group.model.nv, self.group.model.njoints
        gradient, metric, wrenches = np.empty(nv), np.empty((nv, nv)), np.empty((n, 6))
        potential = energy(self.joints, self.charged, self.tables, self.group.expand(q), gradient, metric, wrenches)
        self.evaluations += 1
        if self.group.space is self.group.model:
            return Energy(float(potential), gradient, metric, wrenches)
        E = self.group.expand_velocity
        return Energy(float(potential), E.T @ gradient, E.T @ metric @ E, wrenches)

    def potential(self, q: Configuration) -> float:
        """Return U at a configuration of the group, shape (nq,) [m]."""
        return float(self.potentials(q[None])[0])

    def potentials(self, qs: Configurations) -> np.ndarray:
        """Return U at many configurations; unless in double precision, this takes half the time of `evaluate`.

        Args:
            qs: Configurations of the group, shape (m, nq).

        Returns:
            Shape (m,) [m].
        """
        if self._precision is Precision.DOUBLE:
            return np.array([self.evaluate(q).potential for q in qs])
        expanded = np.array([self.group.expand(q) for q in qs], dtype=np.float64).reshape(len(qs), -1)
        values = np.empty(len(qs))
        potentials(self.joints, self.charged, self.tables, expanded, values)
        self.evaluations += len(qs)
        return values

    def generalized_force(self, q: Configuration) -> np.ndarray:
        """Return -dU/dv, shape (nv,), at a configuration of the group, shape (nq,)."""
        return -self.evaluate(q).gradient

    def link_wrenches(self, q: Configuration) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return force and torque on each moving link: F = sum f_i, tau = sum (x_i - J) x f_i.

        The formulas are those of service/docs/algorithm.md, "Forces on a robot".

        Args:
            q: Configuration of the group, shape (nq,).

        Returns:
            By the link's name: force [1], shape (3,), and torque [m], shape (3,), about the origin J of the joint that
            moves the link; both in the world's axes.
        """
        wrenches = self.evaluate(q).wrenches
        placements = np.empty((self.group.model.njoints, 3, 4))
        joint_placements(self.joints, self.group.expand(q), placements)
        by_link = {}
        for index in range(1, self.group.model.njoints):
            force, moment = wrenches[index, :3], wrenches[index, 3:]
            by_link[_moved_link(self.group.model, index)] = (force, moment - np.cross(placements[index, :, 3], force))
        return by_link


def potentials_in_time(group: PlanningGroup, scene: Scene, times: np.ndarray | None, qs: Configurations) -> np.ndarray:
    """Return U at configurations of several times, good to a few thousandths.

    Args:
        times: Of each configuration, shape (n,) [s]; None: all obstacles are where they are at first.
        qs: Shape (n, nq).

    Returns:
        Shape (n,) [m].
    """
    values = RobotField(group, scene.resting, Precision.COARSE).potentials(qs)
    if scene.moves:
        charges = moving_charges(group)
        values += field_of_movers(scene, charges.place_points(qs), times)[0] @ charges.weights
    return values


@dataclass(frozen=True, eq=False)
class MovingCharges:
    """The charged points of a group that its joints move."""

    group: PlanningGroup  # the group
    points: np.ndarray  # in the frame of their joint, shape (p, 3) [m]
    weights: np.ndarray  # area that each represents, shape (p,) [m^2]
    joints: np.ndarray  # index of the joint that moves each, shape (p,)

    def place_points(self, qs: Configurations) -> np.ndarray:
        """Return the points at configurations (n, nq), shape (n, p, 3) [m, world]."""
        joints, placements = joints_of(self.group), np.empty((len(qs), self.group.model.njoints, 3, 4))
        for q, there in zip(qs, placements, strict=True):
            joint_placements(joints, self.group.expand(q), there)
        carried = placements[:, self.joints]
        placed: np.ndarray = np.einsum("npij,pj->npi", carried[..., :3], self.points) + carried[..., 3]
        return placed


def moving_charges(group: PlanningGroup) -> MovingCharges:
    """Return the charged points that the group's joints move."""
    charged = _charged_robot(group)
    moving = charged.point_joints > 0
    return MovingCharges(group, charged.points[moving], charged.weights[moving], charged.point_joints[moving])


@memoized_for_alike
def origin_of(group: PlanningGroup) -> Origin:
    """Return the place of the robot's first joint [m, world]: single precision is best near it."""
    x, y, z = group.model.jointPlacements[min(1, group.model.njoints - 1)].translation.tolist()
    return x, y, z


_TABLES: dict[Precision, Callable[[PlanningGroup, Scene], FieldTables]] = {
    Precision.DOUBLE: lambda _, scene: scene.tables,
    Precision.SINGLE: lambda group, scene: single_tables(scene, origin_of(group)),
    Precision.COARSE: lambda group, scene: coarse_tables(scene, origin_of(group)),
}


@memoized_for_alike
def _charged_robot(group: PlanningGroup) -> ChargedRobot:
    charges = robot_charges(group.robot)
    points, weights, joints, capsules, capsule_joints = [], [], [], [], []
    starts = [0]
    shapes = list(zip(charges.shapes, group.geometry.geometryObjects, strict=True))
    order = sorted(range(len(shapes)), key=lambda i: shapes[i][1].parentJoint)  # points of a joint stand together
    rank = {shape: row for row, shape in enumerate(order)}
    for charged, shape in (shapes[i] for i in order):
        rotation, translation = shape.placement.rotation, shape.placement.translation
        points.append(charged.points @ rotation.T + translation)
        weights.append(charged.weights)
        joints.append(np.full(len(charged.points), shape.parentJoint, np.int64))
        ends = [rotation @ end + translation for end in (charged.capsule.p0, charged.capsule.p1)]
        capsules.append(np.r_[ends[0], ends[1], charged.capsule.radius])
        capsule_joints.append(shape.parentJoint)
        starts.append(starts[-1] + len(charged.points))
    pairs = [
        (starts[a], starts[a + 1], b)
        for i, j in charges.repelling
        for a, b in ((rank[i], rank[j]), (rank[j], rank[i]))
        if capsule_joints[a] != capsule_joints[b]
    ]
    arrays = ChargedRobot(
        np.ascontiguousarray(np.concatenate(points)),
        np.concatenate(weights),
        np.concatenate(joints),
        np.array(capsules),
        np.array(capsule_joints, np.int64),
        np.array(pairs, np.int64).reshape(-1, 3),
        np.array(_merge_runs(pairs, int((np.concatenate(joints) == 0).sum())), np.int64).reshape(-1, 3),
    )
    for array in arrays:
        array.setflags(write=False)
    return arrays


def _merge_runs(pairs: list[tuple[int, int, int]], fixed: int) -> list[tuple[int, int, int]]:
    """Merge consecutive ranges of points that repel the same capsule; the first `fixed` points, at rest, stay apart."""
    runs: list[tuple[int, int, int]] = []
    for first, past, capsule in sorted(pairs, key=lambda pair: (pair[2], pair[0])):
        if runs and runs[-1][1:] == (first, capsule) and first != fixed:
            runs[-1] = (runs[-1][0], past, capsule)
        else:
            runs.append((first, past, capsule))
    return runs


def _moved_link(model: Any, joint: int) -> str:
    for frame in model.frames:
        if frame.parentJoint == joint and frame.type.name == "BODY":
            return str(frame.name)
    return str(model.names[joint])
