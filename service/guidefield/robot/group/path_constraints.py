"""Path constraints of a frame: its axis in a cone, its origin near a plane, line or point, an even turn.

Each is a number that must not exceed a limit, with its gradient, and a bound of its change under motion of the frame,
which certificates rest on (`prove/certificate.py`). A further kind needs all methods of `Cone`, a row for kernels in
`_KINDS` and `_vectors`, a branch in kernels/tree/path_constraints.py, and one in `build_constraint` for its message.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.errors import MalformedRequest
from guidefield.kernels.kinematics.tip_chain import TipChain
from guidefield.kernels.tree.path_constraints import CONE, EVEN_TURN, NEAR, VECTORS, KeptFrames
from guidefield.memo import memoized
from guidefield.messages import conditions
from guidefield.messages.values import Vector3
from guidefield.read_only import read_only
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import chain_to, lent_data
from guidefield.robot.model.joints import LocalPoint
from guidefield.robot.model.model import frame_index


@dataclass(frozen=True, eq=False)
class Cone:
    """An axis (3,) of a frame stays within an angle [rad] of a direction (3,) of the world; unit vectors."""

    frame: str
    axis: np.ndarray
    target: np.ndarray
    limit: float

    def value(self, placement: Any) -> float:
        """Return the angle between the two [rad]."""
        axis = placement.rotation @ self.axis
        return float(np.arctan2(length(cross(axis, self.target)), axis @ self.target))

    def row(self, placement: Any) -> np.ndarray:
        """Return the row (6,): turning about the common normal widens the angle; 0 where they are parallel."""
        normal = cross(self.target, placement.rotation @ self.axis)
        sine = length(normal)
        return np.concatenate([np.zeros(3), normal / sine if sine > 0.0 else np.zeros(3)])

    def change(self, shift: float, turn: float) -> float:  # noqa: ARG002 - an orientation stays where the origin moves
        """Return the bound as `PathConstraint` says: as much as the frame turns."""
        return turn

    def project_velocity(self, placement: Any) -> tuple[np.ndarray, np.ndarray]:
        """As in `PathConstraint`, shape (3, 3) each: a turn about the axis itself leaves it where it is."""
        axis = placement.rotation @ self.axis
        return np.eye(3), np.eye(3) - np.outer(axis, axis)

    def describe(self, value: float) -> str:
        """As in `PathConstraint`."""
        return f"the axis of {self.frame!r} is {value:.4g} rad off, {self.limit:.4g} rad are allowed"


@dataclass(frozen=True, eq=False)
class Near:
    """A frame's origin stays near a point, or a plane or line through it."""

    frame: str
    point: np.ndarray  # the point, shape (3,) [m, world]
    # directions in which distance counts, orthonormal rows: of a plane one, of a line two, of a point three
    across: np.ndarray
    limit: float  # the largest distance [m]

    def value(self, placement: Any) -> float:
        """Return the distance of the origin from the plane, line or point [m]."""
        return length(self.across @ (placement.translation - self.point))

    def row(self, placement: Any) -> np.ndarray:
        """As in `PathConstraint`, shape (6,): straight away from it; nothing, where the origin is on it."""
        away = self.across.T @ (self.across @ (placement.translation - self.point))
        distance = length(away)
        return np.concatenate([away / distance if distance > 0.0 else np.zeros(3), np.zeros(3)])

    def change(self, shift: float, turn: float) -> float:  # noqa: ARG002 - a place stays where the frame turns
        """Return the bound as `PathConstraint` says: as much as the origin moves."""
        return shift

    def project_velocity(self, placement: Any) -> tuple[np.ndarray, np.ndarray]:  # noqa: ARG002 - it is the same everywhere
        """As in `PathConstraint`, shapes (k, 3) and (3, 3): motion along the plane or line leaves the distance."""
        return self.across, np.eye(3)

    def describe(self, value: float) -> str:
        """As in `PathConstraint`."""
        what = ("plane", "line", "point")[len(self.across) - 1]
        return f"{self.frame!r} is {1e3 * value:.1f} mm from the {what}, {1e3 * self.limit:.1f} mm are allowed"


def plane(frame: str, point: np.ndarray, normal: np.ndarray, tolerance: float) -> Near:
    """Keep the origin of a frame near a plane through a point (3,) [m, world] with a normal (3,) of any length."""
    return Near(frame, point, (normal / np.linalg.norm(normal))[None], tolerance)


def line(frame: str, point: np.ndarray, direction: np.ndarray, tolerance: float) -> Near:
    """Keep the origin of a frame near a line through a point (3,) [m, world] with a direction (3,) of any length."""
    return Near(frame, point, np.linalg.svd(direction[None])[2][1:], tolerance)


def point(frame: str, place: np.ndarray, tolerance: float) -> Near:
    """Keep the origin of a frame near a place (3,) [m, world]."""
    return Near(frame, place, np.eye(3), tolerance)


@dataclass(frozen=True, eq=False)
class EvenTurn:
    """A frame turns evenly while its origin goes from one point to another."""

    frame: str
    begin: Any  # where it is at first, a pinocchio.SE3 [m, world]
    # from there to where its origin is in the end, shape (3,) [m, world]; zero: it is turned as at first
    shift: np.ndarray
    # rotation vector from how it is turned at first to how it is in the end, in the world's axes, shape (3,)
    turn: np.ndarray
    limit: float  # the largest angle by which it may be turned away from the even turn [rad]

    @property
    def by_place(self) -> np.ndarray:
        """The derivative of the share of the way by the origin's place, shape (3,) [1/m]."""
        by_place: np.ndarray = self.shift / max(float(self.shift @ self.shift), 1e-300)
        return by_place

    def value(self, placement: Any) -> float:
        """Return the angle from where the even turn is, by the origin's share of the way [rad]."""
        return length(self._away(placement))

    def row(self, placement: Any) -> np.ndarray:
        """As in `PathConstraint`, shape (6,); nothing, where the frame is turned as the even turn is."""
        away = self._away(placement)
        angle = length(away)
        axis = away / angle if angle > 0.0 else np.zeros(3)
        return np.concatenate([-(axis @ self.turn) * self.by_place, axis])

    def change(self, shift: float, turn: float) -> float:
        """Return the bound: as much as the frame turns, and as the even turn does while the origin moves so far."""
        return turn + shift * float(np.linalg.norm(self.turn) * np.linalg.norm(self.by_place))

    def project_velocity(self, placement: Any) -> tuple[np.ndarray, np.ndarray]:  # noqa: ARG002 - it is the same everywhere
        """As in `PathConstraint`, shape (3, 3) each: all of both."""
        return np.eye(3), np.eye(3)

    def describe(self, value: float) -> str:
        """As in `PathConstraint`."""
        return f"{self.frame!r} is turned by {value:.4g} rad from its even turn, {self.limit:.4g} rad are allowed"

    def _away(self, placement: Any) -> np.ndarray:
        share = float(self.by_place @ (placement.translation - self.begin.translation))
        away: np.ndarray = pin.log3(placement.rotation @ (pin.exp3(share * self.turn) @ self.begin.rotation).T)
        return away


PathConstraint = Cone | Near | EvenTurn
"""A number about a frame that must not exceed a limit.

Each has its value where the frame is placed (pinocchio.SE3), at least 0 [rad or m], and its derivative, a row of shape
(6,), by the frame's velocity at its origin in the world's axes, linear first; the most that it changes while the origin
moves by `shift` [m] and the frame turns by `turn` [rad]; and the parts of linear and angular velocity that change it,
as rows (k, 3) of orthogonal projections. Those of the linear velocity are the same everywhere, those of the angular
velocity turn with the frame.
"""


def build_constraint(one: conditions.PathConstraint, where: str) -> PathConstraint:
    """Build the path constraint of a request, named `where` in it; raises MalformedRequest if a direction is zero."""
    if isinstance(one, conditions.OrientationCone):
        axis, target = _unit(one.axis, f"`{where}.axis`"), _unit(one.target_axis, f"`{where}.target_axis`")
        return Cone(one.frame, axis, target, one.half_angle)
    place = np.array(one.point)
    if isinstance(one, conditions.PlaneConstraint):
        return plane(one.frame, place, _unit(one.normal, f"`{where}.normal`"), one.tolerance)
    return line(one.frame, place, _unit(one.direction, f"`{where}.direction`"), one.tolerance)


def _unit(vector: Vector3, where: str) -> np.ndarray:
    size = float(np.linalg.norm(vector))
    if not (np.isfinite(size) and size > 1e-9):
        raise MalformedRequest(f"{where} must be a finite direction that isn't zero, got {list(vector)}")
    unit: np.ndarray = np.array(vector) / size
    return unit


class ConstrainedFrames:
    """k constraints of a group with limits (k,) [rad or m], at points (nv,); owns scratch data (one per thread)."""

    def __init__(self, group: PlanningGroup, constraints: tuple[PathConstraint, ...]) -> None:
        self.group = group
        self.constraints = constraints
        self.limits = np.array([constraint.limit for constraint in constraints])
        self.indices = [_frame_id(group.model, constraint.frame) for constraint in constraints]
        self._data = lent_data(group, self)

    def values(self, z: LocalPoint) -> np.ndarray:
        """Return the constraints' numbers [rad or m] at local coordinates (nv,), shape (k,)."""
        return np.array([c.value(placed) for c, placed in zip(self.constraints, self.placements(z), strict=True)])

    def values_and_rows(self, z: LocalPoint) -> tuple[np.ndarray, np.ndarray]:
        """Return the numbers at local coordinates (nv,), shape (k,), and their derivatives by these, shape (k, nv)."""
        placed, jacobians = self.placements(z), self.jacobians(z)
        map_to_tangent = self.group.expand_velocity @ self.group.tangent_map(z)
        values = np.array([c.value(T) for c, T in zip(self.constraints, placed, strict=True)])
        rows = [c.row(T) @ J @ map_to_tangent for c, T, J in zip(self.constraints, placed, jacobians, strict=True)]
        return values, np.array(rows)

    def jacobians(self, z: LocalPoint) -> list[np.ndarray]:
        """Return Jacobians (6, model.nv) of the frames, linear rows first, in the world's axes, at a point (nv,)."""
        model, q = self.group.model, self.group.expand_from_local(z)
        return [
            pin.computeFrameJacobian(model, self._data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED).reshape(6, -1)
            for frame in self.indices
        ]

    def placements(self, z: LocalPoint) -> list[Any]:
        """Return the placement in the world of each constraint's frame at local coordinates (nv,), pinocchio.SE3."""
        pin.forwardKinematics(self.group.model, self._data, self.group.expand_from_local(z))
        return [pin.updateFramePlacement(self.group.model, self._data, frame).copy() for frame in self.indices]


def _frame_id(model: Any, name: str) -> int:
    index = frame_index(model, name)
    assert index is not None, "the request's frames are checked"
    return index


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross product (3,) of two vectors (3,), in less time than NumPy's."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def length(vector: np.ndarray) -> float:
    """Return the length of a vector (n,), in less time than NumPy's."""
    return math.sqrt(vector.dot(vector))


_KINDS: Mapping[type, int] = MappingProxyType({Cone: CONE, Near: NEAR, EvenTurn: EVEN_TURN})


@memoized
def keep_frames(frames: ConstrainedFrames) -> KeptFrames:
    """Build the kernels' constraints, each with the chain of joints that moves its frame; there may be none."""
    assert not frames.constraints or frames.group.is_euclidean, "path constraints are for joints of one coordinate"
    chains = [chain_to(frames.group, frame) for frame in frames.indices]
    group = frames.group
    made = KeptFrames(
        kinds=np.array([_KINDS[type(one)] for one in frames.constraints], np.int64),
        vectors=np.array([_vectors(one) for one in frames.constraints]).reshape(-1, VECTORS),
        limits=frames.limits.copy(),
        begins=np.cumsum([0, *(len(one.kinds) for one in chains)]),
        firsts=np.array([one.first for one in chains]).reshape(-1, 12),
        sames=np.array([frames.indices.index(frame) for frame in frames.indices], np.int64),
        chain=TipChain(
            kinds=np.concatenate([np.empty(0, np.int64), *(one.kinds for one in chains)]),
            sources=np.concatenate([np.empty(0, np.int64), *(one.sources for one in chains)]),
            scales=np.concatenate([np.empty((0, 2)), *(one.scales for one in chains)]),
            placements=np.concatenate([np.empty((0, 12)), *(one.placements for one in chains)]),
            first=np.zeros(12),
            lower=group.lower,
            upper=group.upper,
        ),
    )
    read_only(*made[:6], *made.chain)
    return made


def _vectors(constraint: PathConstraint) -> np.ndarray:
    row = np.zeros(VECTORS)
    match constraint:
        case Cone(axis=axis, target=target):
            row[:6] = *axis, *target
        case Near(point=point, across=across):
            row[: 3 + across.size] = *point, *across.ravel()
        case EvenTurn(begin=begin, turn=turn):
            row[:] = *begin.translation, *constraint.by_place, *turn, *begin.rotation.ravel()
    return row
