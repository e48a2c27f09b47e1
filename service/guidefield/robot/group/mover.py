"""Tables for the kernels of the motion of a model by a planning group's joints."""

from __future__ import annotations

import numpy as np

from guidefield.kernels.field.field_tables import frozen
from guidefield.kernels.kinematics.integrate import Mover
from guidefield.robot.group.alike import memoized_for_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.joint_table import joints_of
from guidefield.robot.model.chart import TRANSLATION
from guidefield.robot.model.frames import joint_indices

LARGEST_TURN = np.deg2rad(15.0)
"""No joint turns more than this in one step of a descent [rad]."""
LARGEST_SLIDE = 0.1
"""None slides more than this in one step [m], at size 1."""


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
        largest=frozen(largest),
        values=frozen(values),
        lower=frozen(group.lower),
        upper=frozen(group.upper),
        stops=frozen(stops),
        supports=frozen(supports),
        tip_joint=int(tip.parentJoint),
        tip=frozen(placement),
    )


@memoized_for_alike
def planned_values(group: PlanningGroup) -> np.ndarray:
    """Where a group's configuration stands in its model's, shape (nq,) of indices."""
    at, indices = [], joint_indices(group.model)
    for joint in group.joints:
        first = group.model.joints[indices[joint.name]].idx_q
        at += list(range(first, first + joint.nq))
    return np.array(at)
