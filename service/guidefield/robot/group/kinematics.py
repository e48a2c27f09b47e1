"""Forward kinematics of a planning group: placements, Jacobians, and tables of its joints for kernels."""

from __future__ import annotations

import weakref
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.kernels.field.field_tables import frozen
from guidefield.kernels.kinematics.forward_kinematics import (
    CarriedPoint,
    GroupJoints,
    JointTable,
    frame_positions,
    frame_slopes,
)
from guidefield.kernels.kinematics.integrate import Mover
from guidefield.read_only import read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.model.chart import TRANSLATION
from guidefield.robot.model.frames import joint_indices, joint_table
from guidefield.robot.model.spaces import ChartPoint, ChartPoints, ModelConfiguration

MOST = 3  # of alike groups no more are kept that nobody has: a plan needs as many


def lent_data(group: PlanningGroup, borrower: object) -> Any:
    """Lend `pinocchio.Data` of a group's model to a borrower for as long as it lives; no view may outlive it.

    For a chain of 48 ball joints new data takes as long as half a search.
    """
    unused = _find_unused(group)
    try:
        data = unused.pop()
    except IndexError:
        data = group.model.createData()
    weakref.finalize(borrower, lambda: unused.append(data) if len(unused) < MOST else None).atexit = False
    return data


@memoized_for_alike
def _find_unused(group: PlanningGroup) -> list[Any]:  # noqa: ARG001 - they are its model's
    return []


@memoized_for_alike
def joints_of(group: PlanningGroup) -> JointTable:
    """Tables of the joints of a group's model; made once."""
    return joint_table(group.model)


def group_joints(group: PlanningGroup) -> GroupJoints:
    """Tables of a group's joints and of the local coordinates that move them."""
    origin = np.array(group.expand(group.q_origin), float)
    origin.setflags(write=False)
    return alike_group_joints(group)._replace(origin=origin)


@memoized_for_alike
def alike_group_joints(group: PlanningGroup) -> GroupJoints:
    """The same, but for the origin of rotation vectors; made once."""
    expand = group.expand_velocity
    sources, multipliers = np.abs(expand).argmax(axis=1), expand.sum(axis=1)
    assert (np.count_nonzero(expand, axis=1) <= 1).all(), "a joint follows at most one coordinate"
    joints = GroupJoints(joints_of(group), sources, multipliers, np.array(group.expand_offset, float), np.empty(0))
    read_only(*joints[1:])
    return joints


def chain_of(joints: JointTable, last: int) -> JointTable:
    """The joints from the world to one of a table, which is the last: all that decide where it is."""
    rows = [last]
    while rows[0] > 0:
        rows.insert(0, int(joints.parents[rows[0]]))
    parents = np.maximum(np.arange(len(rows)) - 1, 0)
    chain = JointTable(
        parents,
        joints.kinds[rows],
        joints.axes[rows],
        joints.placements[rows],
        joints.idx_q[rows],
        joints.idx_v[rows],
        joints.nv[rows],
    )
    read_only(*chain)
    return chain


class Kinematics:
    """Placements and Jacobians of one group at configurations of its model; owns scratch data (one per thread)."""

    def __init__(self, group: PlanningGroup) -> None:
        self.group = group

    @cached_property
    def _data(self) -> Any:
        return lent_data(self.group, self)

    def frame_placement(self, q: ModelConfiguration, frame_id: int) -> Any:
        """Return ``T_world_frame``, a pinocchio.SE3, of a frame of the model at a configuration (model.nq,)."""
        model = self.group.model
        pin.forwardKinematics(model, self._data, q)
        return pin.updateFramePlacement(model, self._data, frame_id).copy()

    def tip_position(self, q: ModelConfiguration) -> np.ndarray:
        """Position of the tip in the world, shape (3,) [m], at a configuration of `group.model`, shape (model.nq,)."""
        position: np.ndarray = self.frame_placement(q, self.group.tip_id).translation
        return position

    def tip_positions(self, zs: ChartPoints) -> np.ndarray:
        """Positions of the tip in the world, shape (k, 3) [m], at chart points of the group, shape (k, nv)."""
        positions = np.empty((len(zs), 3))
        frame_positions(self.tip, np.ascontiguousarray(zs, float), positions)
        return positions

    def tip_slopes(self, z: ChartPoint) -> np.ndarray:
        """Derivative of the tip's position by the chart at a point of the group's, shape (nv,): shape (3, nv) [m]."""
        slopes = np.empty((3, len(z)))
        frame_slopes(self.tip, np.ascontiguousarray(z, float), slopes)
        return slopes

    @cached_property
    def tip(self) -> CarriedPoint:
        """The group's tip, as kernels know it."""
        tip, origin = _alike_tip(self.group, self.group.tip_id), group_joints(self.group).origin
        return tip._replace(joints=tip.joints._replace(origin=origin))

    def tip_jacobian(self, q: ModelConfiguration) -> np.ndarray:
        """Return the tip's Jacobian (6, nv), linear rows first, in the world's axes, at a configuration (model.nq,)."""
        model = self.group.model
        J = pin.computeFrameJacobian(model, self._data, q, self.group.tip_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        # Pinocchio gives one joint's Jacobian as a vector
        jacobian: np.ndarray = J.reshape(6, -1) @ self.group.expand_velocity
        return jacobian


@memoized_for_alike
def _alike_tip(group: PlanningGroup, tip_id: int) -> CarriedPoint:
    """A frame of a group, but for where rotation vectors start; of the joints those that lead to it."""
    frame = group.model.frames[tip_id]
    joints, point = alike_group_joints(group), np.array(frame.placement.translation)
    read_only(point)
    chain = chain_of(joints.table, int(frame.parentJoint))
    return CarriedPoint(joints._replace(table=chain), len(chain.parents) - 1, point)


LARGEST_TURN = np.deg2rad(15.0)  # no joint turns more than this in one step of a descent [rad]
LARGEST_SLIDE = 0.1  # none slides more than this in one step [m], at size 1


@memoized_for_alike
def mover_of(group: PlanningGroup) -> Mover:
    """Tables of a group; computed once for each."""
    E, model = group.expand_velocity, group.model
    leaders = np.argmax(E != 0.0, axis=1)
    factors = E[np.arange(model.nv), leaders]
    largest, stops = np.full(group.nv, LARGEST_TURN), np.zeros(group.nv, np.int64)
    values, indices = np.full(group.nv, -1), joint_indices(model)
    for joint in group.joints:
        slides = TRANSLATION.get(joint.kind, slice(0, 0))
        largest[joint.idx_v : joint.idx_v + joint.nv][slides] = LARGEST_SLIDE * group.size
        first = model.joints[indices[joint.name]].idx_q
        for k in range(1 if joint.nq == 1 else slides.stop):
            at = joint.idx_v + k
            if np.isfinite(group.lower[at]) or np.isfinite(group.upper[at]):
                values[at], stops[at] = first + k, joint.nq == 1
    tip = model.frames[group.tip_id]
    supports = np.zeros(model.njoints, np.int64)
    supports[[index for index in model.supports[tip.parentJoint] if index]] = 1
    placement = np.c_[tip.placement.rotation, tip.placement.translation]
    return Mover(
        joints=joints_of(group),
        leaders=frozen(leaders),
        factors=frozen(factors),
        norms=frozen((E**2).sum(axis=0)),
        largest=frozen(largest / group.sizes),
        size=group.size,
        sizes=group.sizes,
        values=frozen(values),
        lower=frozen(group.lower),
        upper=frozen(group.upper),
        stops=frozen(stops),
        supports=frozen(supports),
        tip_joint=int(tip.parentJoint),
        tip=frozen(placement),
    )


@memoized_for_alike
def find_planned_values(group: PlanningGroup) -> np.ndarray:
    """Where a group's configuration stands in its model's, shape (nq,) of indices."""
    at, indices = [], joint_indices(group.model)
    for joint in group.joints:
        first = group.model.joints[indices[joint.name]].idx_q
        at += list(range(first, first + joint.nq))
    return np.array(at)
