"""Limits of a motion as a whole, and those of the speed and acceleration of a frame, or of a link's fastest point.

Limits of torque are in effort.py. What a motion reaches is known between samples too, by
`kernels.timing.carried_rates`: no point is faster than is reported by more than `ACCURACY`.

A motion is refused where a bound is beyond `KEPT_SHARE` of its limit, which also judges rates (motion/limit_load.py)
and torques. `_balls` has to contain the shape. `FEW_POINTS` changes what motions are optimised to, `PIECES_AT_ONCE`
time, and bounds within the accuracies; a larger `CLOSE_ACCURACY` refuses more that is just within.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import coal
import numpy as np

from guidefield.collision.solids import link_hulls
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.errors import MalformedRequest, UnknownFrame
from guidefield.geometry.cover import enclosing_ball
from guidefield.geometry.surfaces import transform_points
from guidefield.kernels.timing.carried_rates import (
    BOUND,
    FOUND,
    TIME,
    CarriedBody,
    MotionPolynomials,
    fastest_points,
    largest_point_rates,
)
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.group.kinematics import alike_group_joints, chain_of, group_joints
from guidefield.robot.model.joints import JointKind, LocalCurves, LocalPoints, LocalRates

ACCURACY = 1e-3  # share by which a bound may be above the largest value found: replies state it
CLOSE_ACCURACY = 1e-6  # the same where a limit is between the two
KEPT_SHARE = 1.0 + 1e-6  # a share up to this keeps its limit, for rounding: docs/certificate.md
PIECES_AT_ONCE = 10_000  # pieces of a motion that are examined between two checks of the deadline
FEW_POINTS = 12  # points of a body that represent all where no bound is needed
CORNERS = 16  # corners on each rim of the prism about a cylinder, which is up to 2 % wider; with more it is less


class CurveLimits(NamedTuple):
    """Bounds that a limit sets along a curve q(r), at g places, on x = (dr/dt)² and u = d²r/dt²."""

    caps: np.ndarray  # of x, shape (g,)
    # on_u u + on_x x is kept between -below and above, which are positive: of k rows, each of shape (g, k)
    on_u: np.ndarray
    on_x: np.ndarray
    below: np.ndarray
    above: np.ndarray


class MotionLimit(Protocol):
    """A limit of what a motion does as a whole, beside those of each coordinate's rates."""

    def scale(self, share: float) -> MotionLimit:
        """A share of the limit."""

    def stretch(self, motion: MotionPolynomials) -> float:
        """The factor by which the time of a motion has to be stretched, where it is above 1, to keep the limit."""

    def along(self, points: LocalPoints, first: LocalRates, second: LocalRates) -> CurveLimits:
        """Its bounds along a curve, by points, first and second derivatives, each of shape (g, nv)."""


class Reached(NamedTuple):
    """The largest of a rate along a motion."""

    found: float  # [m/s or m/s²]
    bound: float  # which nothing exceeds anywhere
    time: float  # when `found` is reached [s]


@dataclass(frozen=True, eq=False)
class CartesianLimit(ReadOnly):
    """Limits of the speed and acceleration of a body's points."""

    name: str  # of the frame or link
    is_link: bool
    body: CarriedBody
    speed: float  # [m/s]
    acceleration: float = math.inf  # [m/s²]

    def scale(self, share: float) -> CartesianLimit:
        """A share of the limit."""
        return replace(self, speed=share * self.speed, acceleration=share * self.acceleration)

    @cached_property
    def sketched(self) -> CartesianLimit:
        """The limit of few of the body's points, those farthest apart: for what needs no bound."""
        points, body = self.body.points, self.body
        if len(points) <= FEW_POINTS:
            return self
        chosen = [int(np.argmax(np.linalg.norm(points - body.centre, axis=1)))]
        distances = np.full(len(points), np.inf)
        while len(chosen) < FEW_POINTS:
            distances = np.minimum(distances, np.linalg.norm(points - points[chosen[-1]], axis=1))
            chosen.append(int(np.argmax(distances)))
        few = np.ascontiguousarray(points[chosen]), np.ascontiguousarray(body.radii[chosen])
        read_only(*few)
        return replace(self, body=body._replace(points=few[0], radii=few[1]))

    def measure(self, motion: MotionPolynomials, accuracy: float = ACCURACY) -> tuple[Reached, Reached]:
        """The largest speed and acceleration along a motion; the bound of the acceleration only counts if limited."""
        found = np.empty((2, 3))
        largest_point_rates(self.body, motion, accuracy, math.isfinite(self.acceleration), found)
        speed, acceleration = (Reached(*row[[FOUND, BOUND, TIME]].tolist()) for row in found)
        return speed, acceleration

    def stretch(self, motion: MotionPolynomials) -> float:
        """As in `MotionLimit`: bounds are stretched with what they bound."""
        speed, acceleration = self.measure(motion)
        return max(speed.bound / self.speed, math.sqrt(acceleration.bound / self.acceleration))

    def along(self, points: LocalPoints, first: LocalRates, second: LocalRates) -> CurveLimits:
        """As in `MotionLimit`.

        Limits of acceleration count along the path of the fastest point and across it, each for itself.
        """
        count = len(points)
        speeds, velocities, bends = np.empty(count), np.empty((count, 3)), np.empty((count, 3))
        z, dz, ddz = (np.ascontiguousarray(one, float) for one in (points, first, second))
        fastest_points(self.body, z, dz, ddz, speeds, velocities, bends)
        with np.errstate(divide="ignore"):
            caps = (self.speed / speeds) ** 2
        if not math.isfinite(self.acceleration):
            none = np.empty((count, 0))
            return CurveLimits(caps, none, none, none, none)
        tangents = velocities / np.maximum(np.linalg.norm(velocities, axis=1), 1e-30)[:, None]
        forward = np.einsum("gk,gk->g", tangents, bends)
        across = np.linalg.norm(bends - forward[:, None] * tangents, axis=1)
        with np.errstate(divide="ignore"):
            caps = np.minimum(caps, SHARED * self.acceleration / across)
        kept = np.full((count, 1), SHARED * self.acceleration)
        return CurveLimits(caps, speeds[:, None], forward[:, None], kept, kept)


SHARED = 0.85
"""Share of an acceleration's limit that is allowed along the path, and as much across it.

With the root of a half (0.71) both together keep the limit; with more they may exceed it, and the motion is stretched.
"""


def frame_limit(group: PlanningGroup, frame: str, speed: float, acceleration: float) -> CartesianLimit:
    """The limit of a frame's origin; raises UnknownFrame, MalformedRequest."""
    _require_chain(group, group.model.frames[group.robot.frame_id(frame)].parentJoint, frame)
    return CartesianLimit(frame, False, _body_of(group, ("frame", frame)), speed, acceleration)


def link_limit(group: PlanningGroup, link: str, speed: float, acceleration: float) -> CartesianLimit:
    """The limit of the fastest point of a link's collision geometry, or of an object that is held.

    Raises:
        UnknownFrame: if the robot has no such link.
        MalformedRequest: if it has no collision geometry, or a ball or floating joint leads to it.
    """
    if link not in group.robot.links:
        available = list(group.robot.links)
        raise UnknownFrame(
            f"the robot has no link {link!r}; it has {', '.join(available)}", link=link, available=available
        )
    _require_chain(group, group.model.frames[group.robot.frame_id(link)].parentJoint, link)
    if not _shapes_of(group, link):
        raise MalformedRequest(f"link {link!r} has no collision geometry, so that no point of it is the fastest")
    return CartesianLimit(link, True, _body_of(group, ("link", link)), speed, acceleration)


def _require_chain(group: PlanningGroup, parent_joint: int, name: str) -> None:
    for joint in group.joints:
        index = group.model.getJointId(joint.name)
        if joint.kind in (JointKind.SPHERICAL, JointKind.FLOATING) and index in group.model.supports[parent_joint]:
            raise MalformedRequest(
                f"limits of speed in space are not served for {name!r}: {joint.name!r}, which carries it, is"
                f" {joint.kind.value}",
                joint=joint.name,
            )


def _shapes_of(group: PlanningGroup, link: str) -> list[int]:
    names = {one.name for one in group.robot.geometry_choices if one.link == link}
    return [k for k, shape in enumerate(group.geometry.geometryObjects) if shape.name in names]


def _body_of(group: PlanningGroup, kind_and_name: tuple[str, str]) -> CarriedBody:
    made = _alike_body(group, kind_and_name)
    return made._replace(joints=made.joints._replace(origin=group_joints(group).origin))


@memoized_for_alike
def _alike_body(group: PlanningGroup, kind_and_name: tuple[str, str]) -> CarriedBody:
    """The body of a frame or link, but for where rotation vectors start."""
    kind, name = kind_and_name
    frame = group.model.frames[group.robot.frame_id(name)]
    joints = alike_group_joints(group)
    joints = joints._replace(table=chain_of(joints.table, int(frame.parentJoint)))
    points, radii = np.array([frame.placement.translation]), np.zeros(1)
    if kind == "link":
        shapes = [(group.geometry.geometryObjects[k], link_hulls(group)[k]) for k in _shapes_of(group, name)]
        balls = [_balls(shape.geometry if hull is None else hull) for shape, hull in shapes]
        points = np.concatenate(
            [transform_points(shape.placement, at) for (shape, _), (at, _) in zip(shapes, balls, strict=True)]
        )
        radii = np.concatenate([of for _, of in balls])
    ball = enclosing_ball(points)
    read_only(points, radii, ball)
    return CarriedBody(joints, np.ascontiguousarray(points), radii, ball[:3], float(ball[3] + radii.max()))


def _balls(shape: Any) -> tuple[np.ndarray, np.ndarray]:
    """Centres (n, 3) and radii (n,) of balls whose hull contains a shape [m]; of a mesh, its hull's corners."""
    if isinstance(shape, coal.Sphere):
        return np.zeros((1, 3)), np.array([shape.radius])
    if isinstance(shape, coal.Capsule):
        return np.array([[0, 0, -shape.halfLength], [0, 0, shape.halfLength]], float), np.full(2, shape.radius)
    if isinstance(shape, coal.Cylinder):
        angles = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
        rim = shape.radius / math.cos(np.pi / CORNERS) * np.column_stack([np.cos(angles), np.sin(angles)])
        rims = [np.column_stack([rim, np.full(CORNERS, height)]) for height in (-shape.halfLength, shape.halfLength)]
        return np.concatenate(rims), np.zeros(2 * CORNERS)
    if isinstance(shape, coal.ConvexBase):
        points = np.array(shape.points(), float)
        return points, np.zeros(len(points))
    shape.computeLocalAABB()
    corners = np.array([shape.aabb_local.min_, shape.aabb_local.max_])
    grid = np.stack(np.meshgrid(*corners.T, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid, np.zeros(len(grid))


@dataclass(frozen=True)
class CartesianUse:
    """The largest speed and acceleration of a body along a motion."""

    limit: CartesianLimit
    speed: Reached
    acceleration: Reached

    @property
    def excess(self) -> tuple[str, str, Reached, float] | None:
        """The rate that exceeds its limit by the larger share: its name, its unit, what is reached, the limit."""
        limit = self.limit
        both = [
            ("speed", "m/s", self.speed, limit.speed),
            ("acceleration", "m/s²", self.acceleration, limit.acceleration),
        ]
        worst = max(both, key=lambda one: one[2].bound / one[3])
        return None if worst[2].bound <= KEPT_SHARE * worst[3] else worst

    def describe_excess(self, place: str) -> tuple[str, dict[str, Any]]:
        """The excess as a sentence and values; `place` is where it is, in words."""
        assert self.excess is not None, "it exceeds a limit"
        name, unit, reached, most = self.excess
        kind = "link" if self.limit.is_link else "frame"
        message = (
            f"{kind} {self.limit.name!r} reaches {reached.bound:.6g} {unit}, its limit is {most:g} {unit}, at {place}"
        )
        details = {"stage": "limits", "limit": f"cartesian_{name}", kind: self.limit.name}
        return message, {**details, "value": reached.bound, "most": most, "share": reached.bound / most}


def polynomials_of(pieces: LocalCurves, times: np.ndarray) -> MotionPolynomials:
    """Bezier curves (m, k, nv) by powers of time; each runs from one of the times (m + 1,) [s] to the next."""
    differences: np.ndarray = pieces
    spans, powers = np.diff(times)[:, None], []
    for power in range(pieces.shape[1]):
        powers.append(math.comb(pieces.shape[1] - 1, power) * differences[:, 0] / spans**power)
        differences = np.diff(differences, axis=1)
    by_power = np.ascontiguousarray(np.stack(powers, axis=1))
    known = np.array(times, float)
    read_only(known, by_power)
    return MotionPolynomials(known, by_power)


def measure_cartesian(
    limits: Sequence[CartesianLimit], motion: MotionPolynomials, deadline: Deadline = UNLIMITED
) -> tuple[CartesianUse, ...]:
    """The largest speeds and accelerations along a motion, more closely where a limit is between a value and its bound.

    Through straight pieces, whose velocities jump, no acceleration is reported, and none is limited.

    Raises DeadlineExpired if time is up before the last limit, or the last `PIECES_AT_ONCE` pieces.
    """
    found, jumps = [], motion.powers.shape[1] <= 2  # straight pieces
    for index, one in enumerate(limits):
        if index:
            deadline.check("speeds in space were found")
        looked = replace(one, acceleration=math.inf) if jumps else one  # what takes any acceleration keeps no limit
        parts = [_closely(looked, part) for part in parts_of(motion, deadline)]
        speed, acceleration = (join_reached(each) for each in zip(*parts, strict=True))
        found.append(CartesianUse(one, speed, Reached(0.0, 0.0, 0.0) if jumps else acceleration))
    return tuple(found)


def _closely(limit: CartesianLimit, motion: MotionPolynomials) -> tuple[Reached, Reached]:
    made = limit.measure(motion)
    if any(it.found <= most < it.bound for it, most in zip(made, (limit.speed, limit.acceleration), strict=True)):
        made = limit.measure(motion, CLOSE_ACCURACY)
    return made


def parts_of(motion: MotionPolynomials, deadline: Deadline) -> Iterator[MotionPolynomials]:
    """A motion in parts of `PIECES_AT_ONCE` pieces at most; raises DeadlineExpired before another than the first."""
    yield MotionPolynomials(motion.times[: PIECES_AT_ONCE + 1], motion.powers[:PIECES_AT_ONCE])
    for k in range(PIECES_AT_ONCE, len(motion.powers), PIECES_AT_ONCE):
        deadline.check("the whole motion was looked at")
        yield MotionPolynomials(motion.times[k : k + PIECES_AT_ONCE + 1], motion.powers[k : k + PIECES_AT_ONCE])


def join_reached(parts: Sequence[Reached]) -> Reached:
    """The largest of a rate along all parts of a motion."""
    if len(parts) == 1:
        return parts[0]
    largest = max(parts, key=lambda one: one.found)
    return largest._replace(bound=max(one.bound for one in parts))


def take_lowest(limits: Sequence[CartesianLimit]) -> tuple[CartesianLimit, ...]:
    """Merge limits: the lowest of each frame and link."""
    lowest: dict[tuple[str, bool], CartesianLimit] = {}
    for one in limits:
        known = lowest.setdefault((one.name, one.is_link), one)
        lowest[one.name, one.is_link] = replace(
            known, speed=min(known.speed, one.speed), acceleration=min(known.acceleration, one.acceleration)
        )
    return tuple(lowest.values())
