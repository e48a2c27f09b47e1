"""The planning group: a robot reduced to the joints that a request plans for, placed in the world.

It converts between the spaces of `joints.py`, and has the group's limits and metric (`LENGTH_OF_A_RADIAN`: another
value makes other motions, and docs state it). Nearly everything takes a group; results that don't depend on where it
starts are shared through `memoized_for_alike`. Columns of the wire are named and ordered here.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

import numpy as np
import pinocchio as pin

from guidefield.memo import memoized_by
from guidefield.messages.requests import Positions
from guidefield.read_only import read_only
from guidefield.robot.model.joints import (
    ANGLE,
    ROAM,
    ROTATION,
    TRANSLATION,
    WIND,
    Configuration,
    Joint,
    JointKind,
    LimitSource,
    LocalPoint,
    LocalPoints,
    LocalRate,
    ModelConfiguration,
    ModelConfigurations,
    ModelLocalPoint,
    RobotConfiguration,
    Tangent,
    WireRow,
    from_local,
    position_names,
    random_rotation,
    tangent_map,
    to_local,
    turn_otherwise,
    turn_quaternion,
    unit_quaternion,
    unwrap_near,
    velocity_names,
)
from guidefield.robot.model.mimic_joints import bind_rates
from guidefield.robot.model.model import RobotModel

Rest = ParamSpec("Rest")
Found = TypeVar("Found")


class Alike:
    """The key that groups share which differ in where they start and in limits of rates, and in nothing else."""


def memoized_for_alike(
    find: Callable[Concatenate[PlanningGroup, Rest], Found],
) -> Callable[Concatenate[PlanningGroup, Rest], Found]:
    """Memoize a function for all alike groups and the same further arguments; see `memo.memoized_by`.

    It must depend on nothing in which alike groups differ: q_reference, q_origin, whole_turns, limits of velocities and
    accelerations. Its result must not hold the group.
    """
    return memoized_by(lambda group: group.alike, find)


LENGTH_OF_A_RADIAN = 0.5
"""How far a joint slides for what counts as one radian [m], at size 1; a power of two, which divides without rounding.

Measured when shape came before time, on the public problems of Fetch, whose torso slides (`tools/bench quality` and
`connect`), and on chains whose base moves (`tools/fixed_requests`). With 1 m Fetch's motions take a fifth longer. With
0.25 m they take a fifth less, and keep as much to 1 mm, but two of 137 weren't certified at first, and motions of a
moving base become less smooth and longer in time. The tree's mean time differs little between 1 and 0.125.
"""


def units_of(joints: Sequence[Joint], size: float) -> np.ndarray:
    """Return the change in each local coordinate of a robot's joints that counts as one radian, (nv,) [rad or m]."""
    units = []
    for joint in joints:
        of_joint = np.ones(joint.nv)
        of_joint[TRANSLATION.get(joint.kind, slice(0))] = LENGTH_OF_A_RADIAN * _travel(joint, size)
        units.append(of_joint)
    return np.concatenate(units)


def _travel(joint: Joint, size: float) -> float:
    """Return the factor on lengths of a joint, by the robot's size: small robots drive and fly as far as others."""
    return size if joint.kind is JointKind.PRISMATIC else max(size, 1.0)


LONGEST_TURN = 3.0  # most that a rotation vector changes between two rows on the wire [rad]: less than half a turn


@dataclass(frozen=True, eq=False)
class PlanningGroup:
    """A robot whose joints outside the group stand still.

    Its configurations ``q`` (nq,) and tangents ``v`` (nv,) are those of the planned joints alone. Joints that mimic a
    planned one move with it. In *local coordinates* ``z`` (nv,), joint by joint (`joints.py`), straight lines and
    splines are drawn. Its methods convert between these spaces, see `joints.py`.
    """

    robot: RobotModel  # the whole robot
    model: Any  # pinocchio model of the planned joints and their mimic joints, placed in the world
    geometry: Any  # collision geometry on that model, with the pairs that count
    space: Any  # pinocchio model of the planned joints alone, for integrate and difference
    joints: tuple[Joint, ...]  # planned joints; their indices are those of this group's q and v
    tip: str  # name of the frame that goals are about
    tip_id: int  # its index in `model`
    # configuration of the whole robot, shape (robot.model.nq,), from which the others are taken
    q_reference: RobotConfiguration
    q_origin: Configuration  # the planned joints' part of it, shape (nq,): where rotation vectors start
    lower: LocalPoint  # local limits, shape (nv,) [rad or m]; infinite where there are none
    upper: LocalPoint
    velocity_limits: LocalRate  # shape (nv,)
    acceleration_limits: LocalRate
    expand_velocity: np.ndarray  # matrix (model.nv, nv) from this group's tangents to those of `model`
    expand_offset: (
        ModelLocalPoint  # shape (model.nv,): local coordinates of `model` are expand_velocity @ z + expand_offset
    )
    places: np.ndarray  # where the planned joints' values stand in a configuration of the whole robot, shape (nq,)
    alike: Alike  # shared by groups that differ only in q_reference, q_origin, whole_turns and limits of rates
    # whole turns that the wire adds to local angles, shape (nv,) [rad]: where the start was given beyond (-pi,
    # pi]; None: none
    whole_turns: LocalPoint | None = None

    @cached_property
    def nq(self) -> int:
        """Length of a configuration."""
        return int(self.space.nq)

    @cached_property
    def nv(self) -> int:
        """Length of a tangent, and of local coordinates."""
        return int(self.space.nv)

    @property
    def position_names(self) -> list[str]:
        """Names of the position columns of a reply, as `wire_positions` orders them."""
        return [name for joint in self.joints for name in position_names(joint)]

    @property
    def velocity_names(self) -> list[str]:
        """Names of the tangent's columns."""
        return [name for joint in self.joints for name in velocity_names(joint)]

    @property
    def size(self) -> float:
        """The robot's, see `RobotModel`."""
        return self.robot.size

    @cached_property
    def is_euclidean(self) -> bool:
        """Whether local velocities are the tangent's velocities: no planar, spherical or floating joint."""
        return all(joint.nv == 1 for joint in self.joints)

    @cached_property
    def limited(self) -> bool:
        """Whether any local coordinate has a limit."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())

    @cached_property
    def units(self) -> np.ndarray:
        """The change in each local coordinate that counts as one radian, shape (nv,) [rad or m]: the group's metric."""
        return _scales(self)[0]

    @cached_property
    def sizes(self) -> np.ndarray:
        """How many times as far as at size 1 each local coordinate goes, shape (nv,): 1 for angles."""
        return _scales(self)[1]

    @cached_property
    def periods(self) -> np.ndarray:
        """By how much an angle that wraps comes back to where it was, 0 for other coordinates, shape (nv,) [rad]."""
        return _scales(self)[2]

    @cached_property
    def winds(self) -> np.ndarray:
        """Which local coordinates are angles without limits whose whole turns count, shape (nv,), bool."""
        return _scales(self)[3]

    def part_of(self, q_whole: RobotConfiguration) -> Configuration:
        """Return the planned joints' part, shape (nq,), of a whole robot's configuration (robot.model.nq,)."""
        part: Configuration = q_whole[self.places]
        return part

    def integrate(self, q: Configuration, v: Tangent) -> Configuration:
        """Return the configuration, shape (nq,), reached from q, shape (nq,), along the tangent v, shape (nv,)."""
        reached: Configuration = pin.integrate(self.space, q, v)
        return reached

    def difference(self, q0: Configuration, q1: Configuration) -> Tangent:
        """Return the tangent, shape (nv,), that leads from q0 to q1, each of shape (nq,), the short way."""
        tangent: Tangent = pin.difference(self.space, q0, q1)
        return tangent

    def interpolate(self, q0: Configuration, q1: Configuration, t: float) -> Configuration:
        """Return the configuration, shape (nq,), at the fraction t between q0 and q1, each of shape (nq,)."""
        between: Configuration = pin.interpolate(self.space, q0, q1, t)
        return between

    def expand(self, q: Configuration) -> ModelConfiguration:
        """Return the configuration of `model`, shape (model.nq,), mimic joints included, of one of the group, (nq,)."""
        if self.space is self.model:
            return cast(ModelConfiguration, q)
        z = self.expand_local(self.to_local(q))
        expanded = np.empty(self.model.nq)
        for at, at_v, planned in self._expanded:
            if planned is not None:
                expanded[at] = q[planned]
            elif at.stop - at.start == 1:
                expanded[at] = z[at_v]
            else:
                expanded[at] = np.cos(z[at_v]), np.sin(z[at_v])
        return expanded

    @cached_property
    def _expanded(self) -> tuple[tuple[slice, int, slice | None], ...]:
        """Of each joint of `model`: its part of a configuration, its first tangent row, the planned joint's part."""
        planned = {joint.name: _at_q(joint) for joint in self.joints}
        joints = [(self.model.joints[index], self.model.names[index]) for index in range(1, self.model.njoints)]
        return tuple((_at_q(joint), joint.idx_v, planned.get(name)) for joint, name in joints)

    def expand_from_local(self, z: LocalPoint) -> ModelConfiguration:
        """Return the configuration (model.nq,) of local coordinates (nv,), with mimic joints by unwrapped values."""
        if self.space is self.model:
            return cast(ModelConfiguration, self.from_local(z))
        expanded = self.expand_local(z)
        return np.concatenate([from_local(joint, expanded[at], origin) for joint, at, origin in self._all_joints])

    def expand_each(self, zs: LocalPoints) -> ModelConfigurations:
        """Return `expand_from_local` of local coordinates (k, nv), shape (k, model.nq)."""
        if self.space is self.model and self.nq == self.nv:
            return cast(ModelConfigurations, zs)
        expanded = np.array([self.expand_from_local(z) for z in zs])
        return cast(ModelConfigurations, expanded.reshape(len(zs), self.model.nq))

    @cached_property
    def _all_joints(self) -> tuple[tuple[Joint, slice, np.ndarray], ...]:
        joints, origin = [], self.expand(self.q_origin)
        for index in range(1, self.model.njoints):
            at, joint = self.model.joints[index], self.robot.joint(self.model.names[index])
            assert joint is not None, "a group's joints are the robot's"
            joints.append((joint, slice(at.idx_v, at.idx_v + at.nv), origin[at.idx_q : at.idx_q + at.nq]))
        return tuple(joints)

    def expand_local(self, z: LocalPoint) -> ModelLocalPoint:
        """Return local coordinates of `model`, shape (model.nv,), mimic joints included, of the group's, (nv,)."""
        if self.space is self.model:
            return cast(ModelLocalPoint, z)
        expanded: ModelLocalPoint = self.expand_velocity @ z + self.expand_offset
        return expanded

    def to_local(self, q: Configuration) -> LocalPoint:
        """Return local coordinates (nv,) of q (nq,): angles in (-pi, pi], rotation vectors at most pi long."""
        if self.nq == self.nv:
            return cast(LocalPoint, q.copy())
        parts = [to_local(j, q[_at_q(j)], self.q_origin[_at_q(j)]) for j in self.joints]
        return np.concatenate(parts)

    def from_local(self, z: LocalPoint) -> Configuration:
        """Return the configuration, shape (nq,), of local coordinates, shape (nv,)."""
        if self.nq == self.nv:
            return np.array(z, float)
        return np.concatenate([from_local(j, z[_at_v(j)], self.q_origin[_at_q(j)]) for j in self.joints])

    def clamped(self, q: Configuration) -> Configuration:
        """Return a copy of a configuration, shape (nq,), with every value brought within its limits."""
        clamped = q.copy()
        if not self.limited:
            return clamped
        for joint in self.joints:
            if joint.nq == 1:
                clamped[joint.idx_q] = min(max(q[joint.idx_q], joint.lower[0]), joint.upper[0])
        return clamped

    def local_path(self, qs: Sequence[Configuration], start: LocalPoint | None = None) -> LocalPoints:
        """Return local coordinates (n, nv) along configurations of shape (nq,), each unwrapped next to the one before.

        The first is near `start`, shape (nv,), if that is given.
        """
        zs = [self.to_local(qs[0]) if start is None else self.unwrapped(self.to_local(qs[0]), start)]
        for q in qs[1:]:
            zs.append(self.unwrapped(self.to_local(q), zs[-1]))
        return np.array(zs)

    def unwrapped(self, z: LocalPoint, near: LocalPoint) -> LocalPoint:
        """Return local coordinates of the same configuration as z nearest to `near`, both (nv,): whole turns added."""
        if self.nq == self.nv:
            return z.copy()
        return np.concatenate([unwrap_near(j, z[_at_v(j)], near[_at_v(j)]) for j in self.joints])

    def turned_otherwise(self, z: LocalPoint) -> LocalPoints:
        """Return the configuration of z (nv,) with each floating joint turned the other way round, shape (k, nv).

        A body that flies free may have to turn the long way.
        """
        ways = []
        for joint in self.joints:
            if joint.kind is JointKind.FLOATING:
                ways.append(z.copy())
                ways[-1][_at_v(joint)] = turn_otherwise(joint, z[_at_v(joint)])
        return cast(LocalPoints, np.array(ways).reshape(-1, self.nv))

    def tangent_map(self, z: LocalPoint) -> np.ndarray:
        """Return the matrix, shape (nv, nv), from local velocities at z, shape (nv,), to tangent velocities."""
        matrix = np.zeros((self.nv, self.nv))
        for joint in self.joints:
            at = _at_v(joint)
            matrix[at, at] = tangent_map(joint, z[at], self.q_origin[_at_q(joint)])
        return matrix

    def wire_positions(self, z: LocalPoint) -> WireRow:
        """Return local coordinates (nv,) as the wire's columns: quaternions for rotations, unwrapped angles."""
        values: WireRow = self._turned(z).tolist()
        if self.is_euclidean:
            return values
        row: WireRow = []
        for first, past, begin in self._wired:
            if begin is None:
                row += values[first:past]
            else:
                row += values[first : past - 3]
                row += turn_quaternion(begin, *values[past - 3 : past])
        return row

    @cached_property
    def _wired(self) -> tuple[tuple[int, int, tuple[float, float, float, float] | None], ...]:
        """Where each joint's local coordinates stand, and where its rotation vectors start, if it has such."""
        starts = (unit_quaternion(self.q_origin[_at_q(j)][-4:]) if j.kind in ROTATION else None for j in self.joints)
        return tuple((j.idx_v, j.idx_v + j.nv, start) for j, start in zip(self.joints, starts, strict=True))

    def wire_rows(self, zs: LocalPoints) -> list[WireRow]:
        """Return local coordinates (n, nv), each as `wire_positions` has it."""
        if self.is_euclidean:
            rows: list[WireRow] = self._turned(zs).tolist()
            return rows
        return [self.wire_positions(z) for z in zs]

    def _turned(self, zs: np.ndarray) -> np.ndarray:
        return zs if self.whole_turns is None else zs + self.whole_turns

    def wire_path(self, zs: LocalPoints) -> list[WireRow]:
        """Return local coordinates (n, nv), straight from each to the next, as rows of the wire's position columns.

        An orientation doesn't say which way it was turned to, and its reader takes the shorter one: points
        `LONGEST_TURN` or more apart have rows between them.
        """
        if self.is_euclidean:
            return self.wire_rows(zs)
        rows = self.wire_rows(zs[:1])
        for before, after, turn in zip(zs, zs[1:], self.turns(zs), strict=False):
            parts = math.floor(turn / LONGEST_TURN) + 1
            rows += [self.wire_positions(before + (after - before) * (k / parts)) for k in range(1, parts)]
            rows.append(self.wire_positions(after))
        return rows

    def turns(self, zs: LocalPoints) -> np.ndarray:
        """Return the largest change of a joint's rotation vector between points (n, nv), shape (n - 1,) [rad]."""
        found = np.zeros(max(0, len(zs) - 1))
        for joint in self.joints:
            if joint.kind in ROTATION:
                vectors = zs[:, _at_v(joint)][:, ROTATION[joint.kind]]
                found = np.maximum(found, np.linalg.norm(np.diff(vectors, axis=0), axis=1))
        return found

    def random(self, rng: np.random.Generator) -> Configuration:
        """Draw a configuration, shape (nq,), evenly within the limits.

        Angles without limits are drawn from one turn, or where whole turns count within `WIND` of the origin's;
        rotations from all, positions within `ROAM` of the origin's.
        """
        origin = self.to_local(self.q_origin)
        middle, reach = np.where(self.winds, origin, 0.0), np.where(self.winds, WIND, np.pi)
        for joint in self.joints:
            lengths = np.arange(self.nv)[_at_v(joint)][TRANSLATION.get(joint.kind, slice(0, 0))]
            middle[lengths], reach[lengths] = origin[lengths], ROAM * _travel(joint, self.size)
        endless = ~np.isfinite(self.lower)
        z = rng.uniform(np.where(endless, middle - reach, self.lower), np.where(endless, middle + reach, self.upper))
        for joint in self.joints:
            if joint.kind in ROTATION:
                z[_at_v(joint)][ROTATION[joint.kind]] = random_rotation(rng)
        return self.from_local(z)

    def starting_at(self, start: Positions) -> PlanningGroup:
        """Return the group with the whole turns of a start: the wire's angles begin at these values by joint name."""
        turns = np.zeros(self.nv)
        for joint in self.joints:
            value = start.get(joint.name)
            if joint.kind not in ANGLE or value is None:
                continue
            at = ANGLE[joint.kind]
            angle = value[at] if isinstance(value, list) else value
            away = angle - float(np.arctan2(np.sin(angle), np.cos(angle)))
            turns[joint.idx_v + at] = away if abs(away) > np.pi else 0.0
        if not turns.any():
            return self
        read_only(turns)
        return dataclasses.replace(self, whole_turns=cast(LocalPoint, turns))

    def with_limits(
        self,
        velocity: Mapping[str, float],
        acceleration: Mapping[str, float],
        velocity_scaling: float,
        acceleration_scaling: float,
    ) -> PlanningGroup:
        """Return the same group with other limits by joint name, then scaled: a mimic joint's bind its source."""
        if not (velocity or acceleration) and velocity_scaling == acceleration_scaling == 1.0:
            return self
        stated = [_with_rates(joint, velocity, acceleration) for joint in self.robot.joints]
        joints = with_bound_rates(self.joints, stated) if velocity or acceleration else self.joints
        return dataclasses.replace(
            self,
            joints=joints,
            velocity_limits=velocity_scaling * np.concatenate([joint.velocity for joint in joints]),
            acceleration_limits=acceleration_scaling * np.concatenate([joint.acceleration for joint in joints]),
        )


def with_bound_rates(joints: Sequence[Joint], stated: Sequence[Joint]) -> tuple[Joint, ...]:
    """Return planned joints with the rates at which their mimic joints keep the limits stated for all joints."""
    bound = {joint.name: joint for joint in bind_rates(stated)}
    of_rates = [f"{rate}{what}" for rate in ("velocity", "acceleration") for what in ("", "_source", "_owner")]
    return tuple(
        dataclasses.replace(joint, **{field: getattr(bound[joint.name], field) for field in of_rates})
        for joint in joints
    )


def _with_rates(joint: Joint, velocity: Mapping[str, float], acceleration: Mapping[str, float]) -> Joint:
    if joint.name in velocity:
        limit = np.full(joint.nv, velocity[joint.name])
        joint = dataclasses.replace(joint, velocity=limit, velocity_source=LimitSource.REQUEST)
    if joint.name in acceleration:
        limit = np.full(joint.nv, acceleration[joint.name])
        joint = dataclasses.replace(joint, acceleration=limit, acceleration_source=LimitSource.REQUEST)
    return joint


@memoized_for_alike
def _scales(group: PlanningGroup) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    units = units_of(group.joints, group.size)
    sizes = np.where(units_of(group.joints, 1.0) == 1.0, 1.0, units / LENGTH_OF_A_RADIAN)
    periods = np.zeros(group.nv)
    for joint in group.joints:
        if joint.kind in ANGLE:
            periods[joint.idx_v + ANGLE[joint.kind]] = 2.0 * np.pi
    turns = np.concatenate([np.full(joint.nv, joint.kind is JointKind.REVOLUTE) for joint in group.joints])
    winds: np.ndarray = turns & ~np.isfinite(group.upper - group.lower)
    read_only(units, sizes, periods, winds)
    return units, sizes, periods, winds


def _at_q(joint: Any) -> slice:
    return slice(joint.idx_q, joint.idx_q + joint.nq)


def _at_v(joint: Joint) -> slice:
    return slice(joint.idx_v, joint.idx_v + joint.nv)


def reference_of(model: Any, robot: RobotModel, q_reference: RobotConfiguration) -> np.ndarray:
    """Return the part, shape (model.nq,), of a whole configuration (robot.model.nq,) that a reduced model has."""
    q: np.ndarray = pin.neutral(model)
    for index in range(1, model.njoints):
        joint, whole = model.joints[index], robot.joint(model.names[index])
        assert whole is not None, "a reduced model has the robot's joints"
        q[joint.idx_q : joint.idx_q + joint.nq] = q_reference[whole.idx_q : whole.idx_q + whole.nq]
    return q
