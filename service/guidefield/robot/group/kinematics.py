"""Forward kinematics of a planning group: placements, Jacobians, the chain to its tip, and its joints for kernels.

Local rates as tangents, all rows of a motion at once: what `PlanningGroup.tangent_map` says of one point.

A tangent is T(z) z', and its rate of change T(z) z'' + T' z'. Of a rotation vector p with angle a = |p| the map is the
right Jacobian of the exponential map, T x = x - f p x x + g p x (p x x) with f = (1 - cos a) / a^2 and
g = (a - sin a) / a^3 (T. D. Barfoot, State Estimation for Robotics, 2017), so that

    T' p' = -f' p x p' + g' p x (p x p') + g p' x (p x p').

What slides beside a turn is seen from the moved frame: T x = R^T x, and T' x = -w x R^T x with the angular velocity w.

Tables have the columns of kernels/kinematics. A larger `SERIES_BELOW` needs more `_TERMS`. `DISTINCT` and the largest
steps change which configurations inverse kinematics and descents find; `MOST_UNUSED` is memory and time.
"""

from __future__ import annotations

import dataclasses
import weakref
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np
import pinocchio as pin

from guidefield.kernels.field.field import frozen
from guidefield.kernels.kinematics.forward_kinematics import (
    FLOATING,
    PLANAR,
    PRISMATIC,
    SPHERICAL,
    CarriedPoint,
    GroupJoints,
    JointTable,
    frame_positions,
    frame_slopes,
)
from guidefield.kernels.kinematics.integrate import Mover
from guidefield.kernels.kinematics.inverse_kinematics import Measure
from guidefield.kernels.kinematics.tip_chain import BALL, SLIDE, TURN, TipChain
from guidefield.memo import memoized
from guidefield.read_only import read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.model.joints import (
    ROTATION,
    TRANSLATION,
    Joint,
    JointKind,
    LocalPoint,
    LocalPoints,
    LocalRates,
    ModelConfiguration,
    Tangents,
)
from guidefield.robot.model.model import joint_indices, joint_table

SERIES_BELOW = 0.25
"""Of smaller angles f, g and their derivatives are taken from their series; terms left out are below 1e-15 [rad]."""

_TERMS = 6  # terms of these series


def tangents(group: PlanningGroup, zs: LocalPoints, rates: LocalRates) -> Tangents:
    """Return tangents T(z) z', shape (n, nv), of rates or other rows (n, nv) at local coordinates (n, nv)."""
    found = cast(Tangents, np.array(rates, float))
    if group.is_euclidean:
        return found
    turns = _rotation_columns(group)
    if turns.size:
        vectors, rows = zs[:, turns], rates[:, turns]
        (f, g, _, _), once = _factors(vectors), _cross(vectors, rows)
        found[:, turns] = rows - f * once + g * _cross(vectors, once)
    for joint in group.joints:
        if joint.kind is JointKind.PLANAR or joint.kind is JointKind.FLOATING:
            at = _slides(joint)
            found[:, at] = _see_from(group, joint, zs, rates[:, at])
    return found


def tangent_accelerations(
    group: PlanningGroup, zs: LocalPoints, rates: LocalRates, accelerations: LocalRates
) -> Tangents:
    """Return T(z) z'' + T' z', shape (n, nv), of local coordinates, rates and accelerations, each of shape (n, nv)."""
    found = tangents(group, zs, accelerations)
    if group.is_euclidean:
        return found
    there, turns = tangents(group, zs, rates), _rotation_columns(group)
    if turns.size:
        vectors, rows = zs[:, turns], rates[:, turns]
        (_, g, df, dg), once = _factors(vectors), _cross(vectors, rows)
        growing = 2.0 * (vectors * rows).sum(axis=-1, keepdims=True)  # of a^2
        found[:, turns] += growing * (dg * _cross(vectors, once) - df * once) + g * _cross(rows, once)
    for joint in group.joints:
        first = joint.idx_v
        if joint.kind is JointKind.PLANAR:
            found[:, first] += there[:, first + 2] * there[:, first + 1]
            found[:, first + 1] -= there[:, first + 2] * there[:, first]
        elif joint.kind is JointKind.FLOATING:
            found[:, first : first + 3] -= _cross(there[:, first + 3 : first + 6], there[:, first : first + 3])
    return found


def _rotation_columns(group: PlanningGroup) -> np.ndarray:
    """Return the indices of the local coordinates that are rotation vectors, shape (k, 3)."""
    columns = [np.arange(j.idx_v, j.idx_v + j.nv)[ROTATION[j.kind]] for j in group.joints if j.kind in ROTATION]
    return np.array(columns, int).reshape(-1, 3)


def _slides(joint: Joint) -> slice:
    return slice(joint.idx_v, joint.idx_v + (2 if joint.kind is JointKind.PLANAR else 3))


def _see_from(group: PlanningGroup, joint: Joint, zs: LocalPoints, rows: np.ndarray) -> np.ndarray:
    """Express translations (n, 2) or (n, 3) in the frame that a planar or floating joint has moved."""
    if joint.kind is JointKind.PLANAR:
        return _turn_back(zs[:, joint.idx_v + 2], rows)
    reference = pin.Quaternion(np.asarray(group.q_origin[joint.idx_q + 3 : joint.idx_q + 7], float)).normalized()
    return _rotate_back(zs[:, joint.idx_v + 3 : joint.idx_v + 6], rows @ reference.matrix())


def _turn_back(angles: np.ndarray, rows: np.ndarray) -> np.ndarray:
    c, s = np.cos(angles), np.sin(angles)
    return np.column_stack([c * rows[:, 0] + s * rows[:, 1], c * rows[:, 1] - s * rows[:, 0]])


def _rotate_back(vectors: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Express rows (n, 3) in frames turned by rotation vectors (n, 3): Rodrigues' formula, turned back."""
    angles, once = np.linalg.norm(vectors, axis=1, keepdims=True), _cross(vectors, rows)
    back: np.ndarray = rows - np.sinc(angles / np.pi) * once + _factors(vectors)[0] * _cross(vectors, once)
    return back


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products, shape (..., 3) each; NumPy's own takes several times as long."""
    return np.stack([a[..., i] * b[..., j] - a[..., j] * b[..., i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=-1)


def _factors(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return f, g and their derivatives by a^2, for rotation vectors (..., 3); each of shape (..., 1).

    f = sum (-s)^k / (2 k + 2)! and g = sum (-s)^k / (2 k + 3)! with s = a^2.
    """
    s = (vectors * vectors).sum(axis=-1, keepdims=True)
    a = np.sqrt(np.maximum(s, SERIES_BELOW**2))
    sine, opposite = np.sin(a), 2.0 * np.sin(0.5 * a) ** 2  # 1 - cos a
    exact = (
        opposite / a**2,
        (a - sine) / a**3,
        (0.5 * a * sine - opposite) / a**4,
        (0.5 * a * opposite - 1.5 * (a - sine)) / a**5,
    )
    k = np.arange(_TERMS)
    f = np.cumprod(np.r_[0.5, -1.0 / ((2 * k[1:] + 1) * (2 * k[1:] + 2))])
    g = np.cumprod(np.r_[1.0 / 6.0, -1.0 / ((2 * k[1:] + 2) * (2 * k[1:] + 3))])
    series = s**k @ f, s**k @ g, s ** k[:-1] @ (k[1:] * f[1:]), s ** k[:-1] @ (k[1:] * g[1:])
    f0, g0, df, dg = (
        np.where(s < SERIES_BELOW**2, few[..., None], one) for few, one in zip(series, exact, strict=True)
    )
    return f0, g0, df, dg


DISTINCT = 0.1  # two solutions of inverse kinematics are distinct if a joint differs by this, by the metric [rad]

_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class ChainToTip:
    """The part of a group that moves its tip."""

    table: TipChain  # the chain; its first placement is in the world
    moving: np.ndarray  # which local coordinates move the tip, shape (nv,)
    measure: Measure  # how far local coordinates are from each other; one unit makes solutions distinct
    turning: np.ndarray  # coordinates that have room for more than a turn, shape (k,)
    reach: float  # the farthest that the tip can be from where the chain begins [m]

    def from_target(self, T_world_target: Any) -> TipChain:
        """Return the chain in a target's frame (pinocchio.SE3): the tip's placement is its offset from the target."""
        first = self.table.first.reshape(3, 4)
        placed = T_world_target.actInv(pin.SE3(first[:, :3], first[:, 3]))
        return self.table._replace(first=_rows(placed))


@memoized
def chain_to_tip(group: PlanningGroup) -> ChainToTip:
    """Build the chain to a group's tip; shared by alike groups, unless rotation vectors have an origin."""
    turns_freely = any(joint.kind in (JointKind.SPHERICAL, JointKind.FLOATING) for joint in group.joints)
    return _find_chain(group) if turns_freely else _found_once(group)


def _find_chain(group: PlanningGroup) -> ChainToTip:
    table = chain_to(group, group.tip_id)
    moved_by = np.count_nonzero(group.expand_velocity, axis=0)
    periods = np.zeros(group.nv)
    for joint in group.joints:
        if joint.kind in (JointKind.REVOLUTE, JointKind.CONTINUOUS, JointKind.PLANAR):
            angle = joint.idx_v + joint.nv - 1
            returns = joint.kind is not JointKind.REVOLUTE or moved_by[angle] == 1  # mimic joints may be elsewhere
            periods[angle] = 2.0 * np.pi if returns else 0.0
    moving = np.zeros(group.nv, bool)
    for kind, source, (scale, _) in zip(table.kinds, table.sources, table.scales, strict=True):
        moving[source : source + (3 if kind == BALL else 1)] |= scale != 0.0
    units = DISTINCT * group.units
    rotations = [joint.idx_v + ROTATION[joint.kind].start for joint in group.joints if joint.kind in ROTATION]
    measure = Measure(periods, units, np.array(rotations, np.int64))
    turning = np.flatnonzero((periods > 0.0) & (group.upper - group.lower >= periods))
    read_only(*measure, moving, turning)
    return ChainToTip(table, moving, measure, turning, _reach(table))


_found_once = memoized_for_alike(_find_chain)


def chain_to(group: PlanningGroup, frame: int) -> TipChain:
    """Build the chain to a frame of a group's model, by its index."""
    model, joints = group.model, joints_of(group)
    end = model.frames[frame]
    parts = _Parts()
    for index in list(model.supports[end.parentJoint])[1:]:
        parts.fixed = parts.fixed * model.jointPlacements[index]
        kind, own = joints.kinds[index], next((j for j in group.joints if j.name == model.names[index]), None)
        if joints.nv[index] == 1:
            row = group.expand_velocity[joints.idx_v[index]]
            source = int(np.argmax(np.abs(row)))
            scale = (row[source], group.expand_offset[joints.idx_v[index]])
            parts.add(SLIDE if kind == PRISMATIC else TURN, source, joints.axes[index], scale)
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
    """Collects the parts of a chain from the world to the tip; `fixed` is the placement since the last one."""

    def __init__(self) -> None:
        self.fixed = pin.SE3.Identity()
        self.kinds: list[int] = []
        self.sources: list[int] = []
        self.scales: list[tuple[float, float]] = []
        self.placements: list[np.ndarray] = []

    def add(self, kind: int, source: int, axis: np.ndarray, scale: tuple[float, float] = (1.0, 0.0)) -> None:
        """Add a part that slides along or turns about an axis (3,) of the frame so far."""
        turn = pin.SE3(pin.Quaternion.FromTwoVectors(_Z, axis).matrix(), np.zeros(3))
        self.placements.append(_rows(self.fixed * turn))
        self.kinds.append(kind)
        self.sources.append(source)
        self.scales.append(scale)
        self.fixed = turn.inverse()

    def chain(self, group: PlanningGroup) -> TipChain:
        first, *others = [*self.placements, _rows(self.fixed)]
        table = TipChain(
            kinds=np.array(self.kinds, np.int64),
            sources=np.array(self.sources, np.int64),
            scales=np.array(self.scales, float).reshape(-1, 2),
            placements=np.array(others, float).reshape(-1, 12),
            first=first,
            lower=group.lower,
            upper=group.upper,
        )
        read_only(*table)
        return table


def _reach(table: TipChain) -> float:
    """Bound the distance of the tip from the first part's place by all lengths between, slides drawn out [m]."""
    reach = float(np.linalg.norm(table.placements[:, 3::4], axis=1).sum())
    for kind, source, (scale, offset) in zip(table.kinds, table.sources, table.scales, strict=True):
        if kind == SLIDE:
            ends = np.array([table.lower[source], table.upper[source]] if scale else [0.0, 0.0])  # not 0 * inf
            reach += float(np.abs(scale * ends + offset).max())
    return reach


def without_limits(chain: ChainToTip) -> ChainToTip:
    """Return the same chain without limits."""
    infinite = np.full(len(chain.moving), np.inf)
    lower = -infinite
    read_only(infinite, lower)
    return dataclasses.replace(chain, table=chain.table._replace(lower=lower, upper=infinite))


def _rows(placement: Any) -> np.ndarray:
    rows = np.column_stack([placement.rotation, placement.translation]).ravel()
    read_only(rows)
    return rows


MOST_UNUSED = 3  # of alike groups no more are kept that nobody has: a plan needs as many


def lent_data(group: PlanningGroup, borrower: object) -> Any:
    """Lend `pinocchio.Data` of a group's model to a borrower for as long as it lives; no view may outlive it.

    For a chain of 48 ball joints new data takes as long as half a search.
    """
    unused = _find_unused(group)
    try:
        data = unused.pop()
    except IndexError:
        data = group.model.createData()
    weakref.finalize(borrower, lambda: unused.append(data) if len(unused) < MOST_UNUSED else None).atexit = False
    return data


@memoized_for_alike
def _find_unused(group: PlanningGroup) -> list[Any]:  # noqa: ARG001 - they are its model's
    return []


@memoized_for_alike
def joints_of(group: PlanningGroup) -> JointTable:
    """Build the tables of the joints of a group's model; once."""
    return joint_table(group.model)


def group_joints(group: PlanningGroup) -> GroupJoints:
    """Build the tables of a group's joints and of the local coordinates that move them."""
    origin = np.array(group.expand(group.q_origin), float)
    origin.setflags(write=False)
    return alike_group_joints(group)._replace(origin=origin)


@memoized_for_alike
def alike_group_joints(group: PlanningGroup) -> GroupJoints:
    """Build `group_joints` but for the origin of rotation vectors; once for alike groups."""
    expand = group.expand_velocity
    sources, multipliers = np.abs(expand).argmax(axis=1), expand.sum(axis=1)
    assert (np.count_nonzero(expand, axis=1) <= 1).all(), "a joint follows at most one coordinate"
    joints = GroupJoints(joints_of(group), sources, multipliers, np.array(group.expand_offset, float), np.empty(0))
    read_only(*joints[1:])
    return joints


def chain_of(joints: JointTable, last: int) -> JointTable:
    """Return the part of a table with the joints from the world to one of them, which is the last row."""
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
        """Return the tip's position in the world, shape (3,) [m], at a configuration of `group.model`, (model.nq,)."""
        position: np.ndarray = self.frame_placement(q, self.group.tip_id).translation
        return position

    def tip_positions(self, zs: LocalPoints) -> np.ndarray:
        """Return the tip's positions in the world, shape (k, 3) [m], at local coordinates (k, nv) of the group."""
        positions = np.empty((len(zs), 3))
        frame_positions(self.tip, np.ascontiguousarray(zs, float), positions)
        return positions

    def tip_slopes(self, z: LocalPoint) -> np.ndarray:
        """Return the derivative of the tip's position by local coordinates at a point (nv,), shape (3, nv) [m]."""
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
    """Build a frame of a group with the joints that lead to it, but for where rotation vectors start."""
    frame = group.model.frames[tip_id]
    joints, point = alike_group_joints(group), np.array(frame.placement.translation)
    read_only(point)
    chain = chain_of(joints.table, int(frame.parentJoint))
    return CarriedPoint(joints._replace(table=chain), len(chain.parents) - 1, point)


LARGEST_TURN = np.deg2rad(15.0)  # no joint turns more than this in one step of a descent [rad]
LARGEST_SLIDE = 0.1  # none slides more than this in one step [m], at size 1


@memoized_for_alike
def mover_of(group: PlanningGroup) -> Mover:
    """Build the tables of a group for descents; once for alike groups."""
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
    """Return the indices of a group's configuration within its model's, shape (nq,)."""
    at, indices = [], joint_indices(group.model)
    for joint in group.joints:
        first = group.model.joints[indices[joint.name]].idx_q
        at += list(range(first, first + joint.nq))
    return np.array(at)
