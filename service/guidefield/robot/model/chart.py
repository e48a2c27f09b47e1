"""The chart of a joint: local coordinates, as many numbers as it has freedoms, in which lines and splines are drawn.

Revolute and prismatic joints: their value. Continuous: the unwrapped angle. Planar: x, y and the unwrapped angle.
Spherical: the rotation vector from a reference orientation; floating: the position and that vector. These vectors are
kept shorter than a full turn, where the chart is smooth; two of them, the long and the short way round, mean the same
orientation. As the exponential map never stretches, a body turns at most by the distance between two vectors, on which
motion bounds rest (`collision/bodies.py`). Suffixes are names of the wire. `ROAM` and `WIND` bound what is drawn where
there are no limits: starts, and samples of trees; `WIND` also configurations that tell which links always touch, and so
what is tested (`pairs.py`, which has a `ROAM` of its own).
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from guidefield.robot.model.model import Joint, JointKind

ROAM = 2.0
"""How far from the origin's position `PlanningGroup.random` goes where a translation has no limits [m], at size 1."""

WIND = 2.0 * np.pi  # the same for an angle without limits whose whole turns count [rad]

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

_SMALL = 1e-4  # below this angle a series represents a sine [rad]: off by less than rounding

ROTATION = {JointKind.SPHERICAL: slice(0, 3), JointKind.FLOATING: slice(3, 6)}
"""Which of a joint's chart coordinates are a rotation vector."""

ANGLE = {JointKind.CONTINUOUS: 0, JointKind.PLANAR: 2}  # which of a joint's chart coordinates is an angle that wraps

TRANSLATION = {JointKind.PRISMATIC: slice(0, 1), JointKind.PLANAR: slice(0, 2), JointKind.FLOATING: slice(0, 3)}
"""Which of a joint's chart coordinates are lengths [m]."""


def position_names(joint: Joint) -> tuple[str, ...]:
    """Return the names of a joint's position columns on the wire."""
    return tuple(joint.name + suffix for suffix in POSITION_SUFFIXES.get(joint.kind, ("",)))


def velocity_names(joint: Joint) -> tuple[str, ...]:
    """Return the names of a joint's velocity columns on the wire."""
    return tuple(joint.name + suffix for suffix in VELOCITY_SUFFIXES.get(joint.kind, ("",)))


def to_chart(joint: Joint, values: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return chart coordinates (nv,) of a joint's values (nq,); rotation vectors start from a reference (nq,)."""
    if joint.kind is JointKind.CONTINUOUS:
        return np.array([np.arctan2(values[1], values[0])])
    if joint.kind is JointKind.PLANAR:
        return np.array([values[0], values[1], np.arctan2(values[3], values[2])])
    if joint.kind not in ROTATION:
        return np.array(values)
    return np.array([*values[:-4].tolist(), *_turn(reference[-4:], values[-4:])])


def from_chart(joint: Joint, z: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return configuration values (nq,) of a joint's chart coordinates (nv,); the inverse of `to_chart`."""
    if joint.kind is JointKind.CONTINUOUS:
        return np.array([np.cos(z[0]), np.sin(z[0])])
    if joint.kind is JointKind.PLANAR:
        return np.array([z[0], z[1], np.cos(z[2]), np.sin(z[2])])
    if joint.kind not in ROTATION:
        return np.array(z)
    return np.array([*z[:-3].tolist(), *turned(unit(reference[-4:]), *z[-3:].tolist())])


def unwrapped(joint: Joint, z: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Add whole turns to a joint's chart coordinates (nv,), to be nearest to others (nv,)."""
    turned = z.copy()
    if joint.kind in ANGLE:
        i = ANGLE[joint.kind]
        turned[i] += 2.0 * np.pi * np.round((near[i] - z[i]) / (2.0 * np.pi))
    if joint.kind in ROTATION:
        other = turned_otherwise(joint, z)
        if math.dist(other.tolist(), near.tolist()) < math.dist(z.tolist(), near.tolist()):
            turned = other
    return turned


def turned_otherwise(joint: Joint, z: np.ndarray) -> np.ndarray:
    """Turn the rotation vector in chart coordinates (nv,) the other way round; one of no length stays."""
    other, at = z.copy(), ROTATION[joint.kind]
    angle = math.hypot(*z[at].tolist())
    if angle > 0.0:
        other[at] *= 1.0 - 2.0 * np.pi / angle
    return other


def tangent_map(joint: Joint, z: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return the matrix (nv, nv) from chart velocities at z (nv,) to tangent velocities, in the moved frame.

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
            matrix[:3, :3] = (_matrix(reference[-4:]) @ pin.exp3(vector)).T
    return matrix


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """Draw a rotation evenly and return its vector (3,): of a normal quaternion, normalised (Muller 1959)."""
    quaternion = rng.normal(size=4)
    vector: np.ndarray = pin.log3(_matrix(quaternion / np.linalg.norm(quaternion)))
    return vector


def unit(quaternion_xyzw: np.ndarray) -> tuple[float, float, float, float]:
    """Normalize a quaternion of shape (4,); in plain numbers, which take a tenth of NumPy's time."""
    x, y, z, w = quaternion_xyzw.tolist()
    over = 1.0 / math.hypot(x, y, z, w)
    return over * x, over * y, over * z, over * w


def turned(begin: tuple[float, float, float, float], a: float, b: float, c: float) -> tuple[float, float, float, float]:
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


def _turn(begin_xyzw: np.ndarray, end_xyzw: np.ndarray) -> tuple[float, float, float]:
    """Return the rotation vector from one orientation to another, by at most half a turn; quaternions of shape (4,).

    From the quaternions themselves: towards half a turn Pinocchio's logarithm of a matrix is off by up to 6e-11.
    """
    x, y, z, w = unit(begin_xyzw)
    a, b, c, d = unit(end_xyzw)
    i, j, k = w * a - x * d - y * c + z * b, w * b + x * c - y * d - z * a, w * c - x * b + y * a - z * d
    cosine, sine = w * d + x * a + y * b + z * c, math.hypot(i, j, k)
    over = math.copysign(2.0 * math.atan2(sine, abs(cosine)) / sine, cosine) if sine > 0.0 else 2.0
    return over * i, over * j, over * k


def _matrix(quaternion_xyzw: np.ndarray) -> np.ndarray:
    matrix: np.ndarray = pin.Quaternion(np.asarray(quaternion_xyzw, float)).normalized().matrix()
    return matrix
