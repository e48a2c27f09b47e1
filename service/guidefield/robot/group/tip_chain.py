"""The chain of joints from the world to a group's tip, or to another frame, as the kernels want it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.kernels.kinematics.forward_kinematics import FLOATING, PLANAR, PRISMATIC, SPHERICAL
from guidefield.kernels.kinematics.inverse_kinematics import Measure
from guidefield.kernels.kinematics.tip_chain import BALL, SLIDE, TURN, TipChain
from guidefield.memo import memoized
from guidefield.read_only import read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.group.kinematics import joints_of
from guidefield.robot.model.chart import ROTATION
from guidefield.robot.model.model import JointKind

DISTINCT = 0.1  # two solutions are distinct if a joint differs by this, by the group's metric [rad]

_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class ChainToTip:
    """The part of a group that moves its tip."""

    table: TipChain  # the chain; its first placement is in the world
    moving: np.ndarray  # which chart coordinates move the tip, shape (nv,)
    measure: Measure  # how far chart points are from each other; one unit makes solutions distinct
    turning: np.ndarray  # coordinates that have room for more than a turn, shape (k,)
    reach: float  # the farthest that the tip can be from where the chain begins [m]

    def from_target(self, T_world_target: Any) -> TipChain:
        """The chain in a target's frame (pinocchio.SE3), so that the tip's placement is its offset from the target."""
        first = self.table.first.reshape(3, 4)
        placed = T_world_target.actInv(pin.SE3(first[:, :3], first[:, 3]))
        return self.table._replace(first=_rows(placed))


@memoized
def chain_to_tip(group: PlanningGroup) -> ChainToTip:
    """The chain to a group's tip; of groups that are alike it is the same, but for where balls' charts start."""
    turns_freely = any(joint.kind in (JointKind.SPHERICAL, JointKind.FLOATING) for joint in group.joints)
    return _find_chain(group) if turns_freely else _found_once(group)


def _find_chain(group: PlanningGroup) -> ChainToTip:
    table = chain_to(group, group.tip_id)
    moved_by = np.count_nonzero(group.expand_velocity, axis=0)
    periods = np.zeros(group.nv)
    for joint in group.joints:
        if joint.kind in (JointKind.REVOLUTE, JointKind.CONTINUOUS, JointKind.PLANAR):
            angle = joint.idx_v + joint.nv - 1
            returns = joint.kind is not JointKind.REVOLUTE or moved_by[angle] == 1  # followers may be elsewhere
            periods[angle] = 2.0 * np.pi if returns else 0.0
    moving = np.zeros(group.nv, bool)
    for kind, driver, (scale, _) in zip(table.kinds, table.drivers, table.scales, strict=True):
        moving[driver : driver + (3 if kind == BALL else 1)] |= scale != 0.0
    units = DISTINCT * group.units
    rotations = [joint.idx_v + ROTATION[joint.kind].start for joint in group.joints if joint.kind in ROTATION]
    measure = Measure(periods, units, np.array(rotations, np.int64))
    turning = np.flatnonzero((periods > 0.0) & (group.upper - group.lower >= periods))
    read_only(*measure, moving, turning)
    return ChainToTip(table, moving, measure, turning, _reach(table))


_found_once = memoized_for_alike(_find_chain)


def chain_to(group: PlanningGroup, frame: int) -> TipChain:
    """The chain to a frame of a group's model, by its index."""
    model, joints = group.model, joints_of(group)
    end = model.frames[frame]
    parts = _Parts()
    for index in list(model.supports[end.parentJoint])[1:]:
        parts.fixed = parts.fixed * model.jointPlacements[index]
        kind, own = joints.kinds[index], next((j for j in group.joints if j.name == model.names[index]), None)
        if joints.nv[index] == 1:
            row = group.expand_velocity[joints.idx_v[index]]
            driver = int(np.argmax(np.abs(row)))
            scale = (row[driver], group.expand_offset[joints.idx_v[index]])
            parts.add(SLIDE if kind == PRISMATIC else TURN, driver, joints.axes[index], scale)
            continue
        assert own is not None, "joints with several degrees of freedom follow none"
        if kind in (PLANAR, FLOATING):
            for axis in range(2 if kind == PLANAR else 3):
                parts.add(SLIDE, own.idx_v + axis, np.eye(3)[axis])
        if kind == PLANAR:
            parts.add(TURN, own.idx_v + 2, _Z)
        if kind in (SPHERICAL, FLOATING):
            reference = pin.Quaternion(group.q_origin[own.idx_q : own.idx_q + own.nq][-4:]).normalized()
            parts.fixed = parts.fixed * pin.SE3(reference.matrix(), np.zeros(3))
            parts.add(BALL, own.idx_v + ROTATION[own.kind].start, _Z)
    parts.fixed = parts.fixed * end.placement
    return parts.chain(group)


class _Parts:
    """Parts in the order from the world to the tip; `fixed` is what is fixed since the last."""

    def __init__(self) -> None:
        self.fixed = pin.SE3.Identity()
        self.kinds: list[int] = []
        self.drivers: list[int] = []
        self.scales: list[tuple[float, float]] = []
        self.placements: list[np.ndarray] = []

    def add(self, kind: int, driver: int, axis: np.ndarray, scale: tuple[float, float] = (1.0, 0.0)) -> None:
        """A part along or about an axis (3,) of the frame so far."""
        turn = pin.SE3(pin.Quaternion.FromTwoVectors(_Z, axis).matrix(), np.zeros(3))
        self.placements.append(_rows(self.fixed * turn))
        self.kinds.append(kind)
        self.drivers.append(driver)
        self.scales.append(scale)
        self.fixed = turn.inverse()

    def chain(self, group: PlanningGroup) -> TipChain:
        """The parts so far, with the group's limits."""
        first, *others = [*self.placements, _rows(self.fixed)]
        table = TipChain(
            kinds=np.array(self.kinds, np.int64),
            drivers=np.array(self.drivers, np.int64),
            scales=np.array(self.scales, float).reshape(-1, 2),
            placements=np.array(others, float).reshape(-1, 12),
            first=first,
            lower=group.lower,
            upper=group.upper,
        )
        read_only(*table)
        return table


def _reach(table: TipChain) -> float:
    """The length of everything between the first part's place and the tip, slides drawn out [m]."""
    reach = float(np.linalg.norm(table.placements[:, 3::4], axis=1).sum())
    for kind, driver, (scale, offset) in zip(table.kinds, table.drivers, table.scales, strict=True):
        if kind == SLIDE:
            ends = np.array([table.lower[driver], table.upper[driver]] if scale else [0.0, 0.0])  # not 0 * inf
            reach += float(np.abs(scale * ends + offset).max())
    return reach


def without_limits(chain: ChainToTip) -> ChainToTip:
    """The same chain without limits."""
    infinite = np.full(len(chain.moving), np.inf)
    lower = -infinite
    read_only(infinite, lower)
    return dataclasses.replace(chain, table=chain.table._replace(lower=lower, upper=infinite))


def _rows(placement: Any) -> np.ndarray:
    rows = np.column_stack([placement.rotation, placement.translation]).ravel()
    read_only(rows)
    return rows
