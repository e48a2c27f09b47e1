"""The joints of a robot: kinds and limits, the spaces of their values, and the local coordinates of each kind.

A robot's joint values stand in several spaces. For a robot of revolute joints these have the same length and the same
numbers; a continuous joint, a ball joint or a joint that follows another tells them apart.

    RobotConfiguration  --part_of-->  Configuration  --expand-->  ModelConfiguration
                                      | to_local ^                  ^
                                      v         |  from_local       |  expand_from_local
    a row of WireColumns  <--wire_positions--  LocalPoint  ---------+
                                               |
                                               +----------expand_local-->  ModelLocalPoint

These are methods of `PlanningGroup`. Each type is an ndarray whose last axis is named after its space: a LocalPoint is
no Configuration, and several points are not a single one. A copy keeps its space, and so does what NumPy makes like
another array. What arithmetic, an index or a loop yields has no named axis: it fits everywhere, and the function that
returns or takes it says its space. Where NumPy's own type says too much, as of a new array, and where two spaces share
their numbers, `typing.cast` names the space. At run time all are plain arrays.

A joint has as many local coordinates as freedoms; straight lines and splines are drawn in them.
Revolute and prismatic joints: their value. Continuous: the unwrapped angle. Planar: x, y and the unwrapped angle.
Spherical: the rotation vector from a reference orientation; floating: the position and that vector. These vectors are
kept shorter than a full turn, where they are smooth; two of them, the long and the short way round, mean the same
orientation. As the exponential map never stretches, a body turns at most by the distance between two vectors, on which
motion bounds rest (`collision/bodies.py`). Suffixes are names of the wire. `ROAM` and `WIND` bound what is drawn where
there are no limits: starts, and samples of trees; `WIND` also configurations that tell which links always touch, and so
what is tested (`pairs.py`, which has a `ROAM` of its own).
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from functools import cached_property
from typing import NewType

import numpy as np
import pinocchio as pin

LARGEST_VALUE = 1e4  # largest value of a joint [rad or m], as docs/scenes.md says: further motions take long to judge

ROAM = 2.0
"""How far from the origin's position `PlanningGroup.random` goes where a translation has no limits [m], at size 1."""

WIND = 2.0 * np.pi  # the same for an angle without limits whose whole turns count [rad]

RobotAxis = NewType("RobotAxis", int)
ConfigurationAxis = NewType("ConfigurationAxis", int)
ModelAxis = NewType("ModelAxis", int)
LocalAxis = NewType("LocalAxis", int)
LocalRateAxis = NewType("LocalRateAxis", int)
ModelLocalAxis = NewType("ModelLocalAxis", int)
TangentAxis = NewType("TangentAxis", int)
WireAxis = NewType("WireAxis", int)

RobotConfiguration = np.ndarray[tuple[RobotAxis], np.dtype[np.float64]]
"""q of all joints of a robot, mimic joints too, shape (robot.model.nq,) [rad, m, cosine and sine of a continuous or
planar joint's angle, or entries of a quaternion (x, y, z, w)]."""

RobotConfigurations = np.ndarray[tuple[int, RobotAxis], np.dtype[np.float64]]  # several, shape (n, robot.model.nq)

Configuration = np.ndarray[tuple[ConfigurationAxis], np.dtype[np.float64]]
"""q of a group's planned joints alone, shape (group.nq,), with the units of a `RobotConfiguration`."""

Configurations = np.ndarray[tuple[int, ConfigurationAxis], np.dtype[np.float64]]  # several, shape (n, group.nq)

ModelConfiguration = np.ndarray[tuple[ModelAxis], np.dtype[np.float64]]
"""q of a group's planned joints and those that follow them, shape (group.model.nq,): what Pinocchio and the kernels of
forward kinematics take. The same units."""

ModelConfigurations = np.ndarray[tuple[int, ModelAxis], np.dtype[np.float64]]  # several, shape (n, group.model.nq)

LocalPoint = np.ndarray[tuple[LocalAxis], np.dtype[np.float64]]
"""z of a group's planned joints, shape (group.nv,) [rad or m]: unwrapped angles, lengths and rotation vectors, in which
straight lines and splines are drawn."""

LocalPoints = np.ndarray[tuple[int, LocalAxis], np.dtype[np.float64]]  # several, shape (n, group.nv)

LocalCurves = np.ndarray[tuple[int, int, LocalAxis], np.dtype[np.float64]]
"""Bezier curves in local coordinates, by their control points, shape (m, k, group.nv); k - 1 is their degree."""

ModelLocalPoint = np.ndarray[tuple[ModelLocalAxis], np.dtype[np.float64]]
"""z of a group's planned joints and those that follow them, shape (group.model.nv,) [rad or m]."""

LocalRate = np.ndarray[tuple[LocalRateAxis], np.dtype[np.float64]]
"""Derivatives of local coordinates by time, of any order, or limits of theirs, shape (group.nv,) [rad/s or m/s, and so
on]. Where a joint has several freedoms they are no tangent (`PlanningGroup.tangent_map`)."""

LocalRates = np.ndarray[tuple[int, LocalRateAxis], np.dtype[np.float64]]
"""Several, or derivatives by a curve's parameter, shape (n, group.nv)."""

Tangent = np.ndarray[tuple[TangentAxis], np.dtype[np.float64]]
"""v of a group's planned joints, shape (group.nv,): what Pinocchio integrates, in the moved frame of each joint [rad or
m, or per s]."""

Tangents = np.ndarray[tuple[int, TangentAxis], np.dtype[np.float64]]
"""Several, or derivatives of theirs by time, shape (n, group.nv)."""

WireColumns = np.ndarray[tuple[int, WireAxis], np.dtype[np.float64]]
"""Positions as they travel, shape (n, len(group.position_names)): local coordinates, but quaternions (x, y, z, w)
for rotation vectors [rad, m, or entries of a quaternion]."""

WireRow = list[float]  # one row of them. A plain alias: messages hold lists of numbers

Quaternion = tuple[float, float, float, float]  # x, y, z, w

IndexedConfiguration = RobotConfiguration | Configuration
"""q of joints that say by their own indices where their values stand: a robot's, or a group's."""


class JointKind(enum.StrEnum):
    """What a joint can do; the values are words of replies: URDF's, and `spherical` for a ball joint."""

    REVOLUTE = "revolute"
    CONTINUOUS = "continuous"
    PRISMATIC = "prismatic"
    PLANAR = "planar"
    SPHERICAL = "spherical"
    FLOATING = "floating"


class LimitSource(enum.StrEnum):
    """Where a limit comes from; the values are words of replies."""

    REQUEST = "request"
    CARD = "card"
    URDF = "urdf"
    DEFAULT = "default"


@dataclass(frozen=True)
class Mimic:
    """The law of a mimic joint: value = multiplier * unwrapped value of the source joint + offset."""

    source: str  # name of the source joint, which isn't a mimic joint itself
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class Joint:
    """One movable joint."""

    name: str
    kind: JointKind
    index: int  # pinocchio's joint index
    idx_q: int  # where its values stand in a configuration, and how many they are
    nq: int
    idx_v: int  # the same in the tangent space
    nv: int
    # limits, shape (nv,) [rad or m]; infinite where there are none. A revolute joint without limits is one that turns
    # on and on, but isn't the same after a whole turn, for others follow it
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray  # largest magnitude, shape (nv,) [rad/s or m/s]
    acceleration: np.ndarray  # likewise [rad/s^2 or m/s^2]
    velocity_source: LimitSource
    acceleration_source: LimitSource
    mimic: Mimic | None = None  # the joint that it follows, if it does; then it can't be planned for
    # whether the SRDF says that nothing drives it; it is planned for only where a request names it
    passive: bool = False
    velocity_owner: str | None = None  # the mimic joint whose limit those are, where it binds this joint
    acceleration_owner: str | None = None

    @property
    def is_driven(self) -> bool:
        """Whether it is planned for where a request doesn't name it."""
        return self.mimic is None and not self.passive

    @cached_property
    def limits(self) -> tuple[float, float] | None:
        """Lower and upper limit [rad or m] of a joint whose configuration is its one value; None of another."""
        if self.kind not in (JointKind.REVOLUTE, JointKind.PRISMATIC):
            return None
        return float(self.lower[0]), float(self.upper[0])


POSITION_SUFFIXES = {
    JointKind.PLANAR: (".x", ".y", ".theta"),
    JointKind.SPHERICAL: (".qx", ".qy", ".qz", ".qw"),
    JointKind.FLOATING: (".x", ".y", ".z", ".qx", ".qy", ".qz", ".qw"),
}
"""Names of a joint's position columns on the wire, after its own; joints with one value have just their name."""

VELOCITY_SUFFIXES = {
    JointKind.PLANAR: (".vx", ".vy", ".wz"),
    JointKind.SPHERICAL: (".wx", ".wy", ".wz"),
    JointKind.FLOATING: (".vx", ".vy", ".vz", ".wx", ".wy", ".wz"),
}
"""Names of velocity columns likewise; velocities are tangents in the moved frame."""

_SMALL = 1e-4  # below this angle a series represents a sine, as in kernels [rad]: off by less than rounding

ROTATION = {JointKind.SPHERICAL: slice(0, 3), JointKind.FLOATING: slice(3, 6)}
"""Which of a joint's local coordinates are a rotation vector."""

ANGLE = {JointKind.CONTINUOUS: 0, JointKind.PLANAR: 2}  # which of a joint's local coordinates is an angle that wraps

TRANSLATION = {JointKind.PRISMATIC: slice(0, 1), JointKind.PLANAR: slice(0, 2), JointKind.FLOATING: slice(0, 3)}
"""Which of a joint's local coordinates are lengths [m]."""


def position_names(joint: Joint) -> tuple[str, ...]:
    """Return the names of a joint's position columns on the wire."""
    return tuple(joint.name + suffix for suffix in POSITION_SUFFIXES.get(joint.kind, ("",)))


def velocity_names(joint: Joint) -> tuple[str, ...]:
    """Return the names of a joint's velocity columns on the wire."""
    return tuple(joint.name + suffix for suffix in VELOCITY_SUFFIXES.get(joint.kind, ("",)))


def to_local(joint: Joint, values: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return local coordinates (nv,) of a joint's values (nq,); rotation vectors start from a reference (nq,)."""
    if joint.kind is JointKind.CONTINUOUS:
        return np.array([np.arctan2(values[1], values[0])])
    if joint.kind is JointKind.PLANAR:
        return np.array([values[0], values[1], np.arctan2(values[3], values[2])])
    if joint.kind not in ROTATION:
        return np.array(values)
    return np.array([*values[:-4].tolist(), *_rotation_between(reference[-4:], values[-4:])])


def from_local(joint: Joint, z: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return configuration values (nq,) of a joint's local coordinates (nv,); the inverse of `to_local`."""
    if joint.kind is JointKind.CONTINUOUS:
        return np.array([np.cos(z[0]), np.sin(z[0])])
    if joint.kind is JointKind.PLANAR:
        return np.array([z[0], z[1], np.cos(z[2]), np.sin(z[2])])
    if joint.kind not in ROTATION:
        return np.array(z)
    return np.array([*z[:-3].tolist(), *turn_quaternion(unit_quaternion(reference[-4:]), *z[-3:].tolist())])


def unwrap_near(joint: Joint, z: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Add whole turns to a joint's local coordinates (nv,), to be nearest to others (nv,)."""
    turned = z.copy()
    if joint.kind in ANGLE:
        i = ANGLE[joint.kind]
        turned[i] += 2.0 * np.pi * np.round((near[i] - z[i]) / (2.0 * np.pi))
    if joint.kind in ROTATION:
        other = turn_otherwise(joint, z)
        if math.dist(other.tolist(), near.tolist()) < math.dist(z.tolist(), near.tolist()):
            turned = other
    return turned


def turn_otherwise(joint: Joint, z: np.ndarray) -> np.ndarray:
    """Turn the rotation vector in local coordinates (nv,) the other way round; one of no length stays."""
    other, at = z.copy(), ROTATION[joint.kind]
    angle = math.hypot(*z[at].tolist())
    if angle > 0.0:
        other[at] *= 1.0 - 2.0 * np.pi / angle
    return other


def tangent_map(joint: Joint, z: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return the matrix (nv, nv) from local velocities at z (nv,) to tangent velocities, in the moved frame.

    The rotation vector's part is the right Jacobian of the exponential map; positions are turned into the moved frame.
    """
    matrix = np.eye(joint.nv)
    if joint.kind is JointKind.PLANAR:
        c, s = np.cos(z[2]), np.sin(z[2])
        matrix[:2, :2] = [[c, s], [-s, c]]
    if joint.kind in ROTATION:
        at = ROTATION[joint.kind]
        vector = np.ascontiguousarray(z[at])
        matrix[at, at] = pin.Jexp3(vector)
        if joint.kind is JointKind.FLOATING:
            matrix[:3, :3] = (_rotation_matrix(reference[-4:]) @ pin.exp3(vector)).T
    return matrix


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """Draw a rotation evenly and return its vector (3,): of a normal quaternion, normalised (Muller 1959)."""
    quaternion = rng.normal(size=4)
    vector: np.ndarray = pin.log3(_rotation_matrix(quaternion / np.linalg.norm(quaternion)))
    return vector


def unit_quaternion(quaternion_xyzw: np.ndarray) -> Quaternion:
    """Normalize a quaternion of shape (4,); in plain numbers, which take a tenth of NumPy's time."""
    x, y, z, w = quaternion_xyzw.tolist()
    over = 1.0 / math.hypot(x, y, z, w)
    return over * x, over * y, over * z, over * w


def turn_quaternion(begin: tuple[float, float, float, float], a: float, b: float, c: float) -> Quaternion:
    """Turn an orientation, a unit quaternion (x, y, z, w), by a rotation vector (a, b, c).

    Of the two quaternions w is positive, or where that is below a half the largest of the others.
    """
    x, y, z, w = begin
    angle = math.hypot(a, b, c)
    scale = math.sin(0.5 * angle) / angle if angle > _SMALL else 0.5 - angle * angle / 48.0
    a, b, c, d = scale * a, scale * b, scale * c, math.cos(0.5 * angle)
    i, j, k = w * a + x * d + y * c - z * b, w * b - x * c + y * d + z * a, w * c + x * b - y * a + z * d
    r = w * d - x * a - y * b - z * c
    leading = r if abs(r) > 0.5 else max(i, j, k, key=abs)
    return (i, j, k, r) if leading > 0.0 else (-i, -j, -k, -r)


def _rotation_between(begin_xyzw: np.ndarray, end_xyzw: np.ndarray) -> tuple[float, float, float]:
    """Return the rotation vector from one orientation to another, by at most half a turn; quaternions of shape (4,).

    From the quaternions themselves: towards half a turn Pinocchio's logarithm of a matrix is off by up to 6e-11.
    """
    x, y, z, w = unit_quaternion(begin_xyzw)
    a, b, c, d = unit_quaternion(end_xyzw)
    i, j, k = w * a - x * d - y * c + z * b, w * b + x * c - y * d - z * a, w * c - x * b + y * a - z * d
    cosine, sine = w * d + x * a + y * b + z * c, math.hypot(i, j, k)
    over = math.copysign(2.0 * math.atan2(sine, abs(cosine)) / sine, cosine) if sine > 0.0 else 2.0
    return over * i, over * j, over * k


def _rotation_matrix(quaternion_xyzw: np.ndarray) -> np.ndarray:
    matrix: np.ndarray = pin.Quaternion(np.asarray(quaternion_xyzw, float)).normalized().matrix()
    return matrix
