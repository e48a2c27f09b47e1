"""The certificate: Coal's judgement of a whole motion, between its samples too.

A motion is a chain of Bezier curves in the group's chart. A curve lies in the box of its control points. From the box's
middle m, with half widths e, a point of body b moves at most

    sum over joints j that move b of  2 sin(e_j / 2) rho_bj        (a sliding joint: e_j),

rho_bj being the largest distance of b from axis j *at m*: turn the joints one after the other from base to tip, and all
joints beyond the one that turns still stand at m. Of two moving bodies only the joints that move one and not the other
count. A follower has the half width of its driver times its multiplier. If Coal says that a pair keeps more than its
bound at m, it is free all along the curve; else the curve is halved, for the pairs that are left, down to a floor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from guidefield.collision.world import PairNames, World
from guidefield.errors import InvalidGroup
from guidefield.robot.model import JointKind

COAL_ACCURACY = 1e-6
"""Added to every margin: how far off Coal's answers may be [m]."""

WIDEST = 0.2
"""Curves that span more in any coordinate are halved before they are tested [rad or m]: a test there rarely decides."""

SERVED_KINDS = (JointKind.REVOLUTE, JointKind.CONTINUOUS, JointKind.PRISMATIC)


@dataclass(frozen=True, eq=False)
class Verdict:
    """What the certificate says about a motion.

    Attributes:
        free: Whether no pair touches, and robot and obstacles keep the clearance asked for, all along the motion.
        reason: free; contact: a pair touches; too close: robot and obstacle come closer than the clearance asked for;
            undecided: a pair comes so close that the floor was reached.
        piece: Index of the piece that was refused; None if free.
        parameter: Where on it, from 0 to 1: the place that was judged; None if free.
        free_until: Parameter of that piece up to which the motion is certified, as all pieces before are; None if free.
        pair: Names of the pair that was refused; None if free.
        configuration: Chart coordinates (nv,) of the place that was judged; None if free.
        evaluations: Configurations at which Coal was asked.
    """

    free: bool
    reason: str
    piece: int | None
    parameter: float | None
    free_until: float | None
    pair: PairNames | None
    configuration: np.ndarray | None
    evaluations: int


@dataclass(frozen=True, eq=False)
class _Stretch:
    """A part of a piece, not judged yet: control points (k, nv), parameters on the piece, pairs left (None: all)."""

    control: np.ndarray
    start: float
    end: float
    pairs: list[int] | None

    def halves(self, pairs: list[int] | None) -> tuple[_Stretch, _Stretch]:
        """The two halves, for some pairs, by de Casteljau's scheme."""
        row, left, right = self.control, [self.control[0]], [self.control[-1]]
        while len(row) > 1:
            row = 0.5 * (row[:-1] + row[1:])
            left.append(row[0])
            right.append(row[-1])
        middle = 0.5 * (self.start + self.end)
        return (
            _Stretch(np.array(left), self.start, middle, pairs),
            _Stretch(np.array(right[::-1]), middle, self.end, pairs),
        )


def certify(world: World, pieces: np.ndarray, min_clearance: float = 0.0, floor: float = 1e-4) -> Verdict:
    """Judge a motion.

    The pieces are judged in order; the first refusal ends it. Whether the robot is wholly inside a closed mesh at the
    start is another question: `World.enclosed`.

    Args:
        world: The robot among obstacles.
        pieces: Bezier control points of each piece in the group's chart, shape (m, k, nv) [rad or m]; any degree k - 1.
        min_clearance: What robot and obstacles must keep apart [m]; the robot and itself must only not touch.
        floor: A pair whose possible motion [m] is down to this and which still can't be told apart is undecided.

    Raises:
        InvalidGroup: if a joint of the group is neither revolute, continuous nor prismatic.
    """
    for joint in world.group.joints:
        if joint.kind not in SERVED_KINDS:
            raise InvalidGroup(
                f"joint {joint.name!r} is {joint.kind.value}; this version certifies motions of"
                f" {', '.join(SERVED_KINDS)} joints only",
                joint=joint.name,
                kind=joint.kind.value,
            )
    judge = _Judge(world, min_clearance, floor)
    for index, control in enumerate(np.asarray(pieces, float)):
        refusal = judge.refusal(control, index)
        if refusal is not None:
            return refusal
    return Verdict(True, "free", None, None, None, None, None, judge.evaluations)


def motion_free(
    world: World, z0: np.ndarray, z1: np.ndarray, min_clearance: float = 0.0, floor: float = 1e-4
) -> Verdict:
    """Judge the straight motion between two points (nv,) of the group's chart; see `certify`."""
    return certify(world, np.array([[z0, z1]]), min_clearance, floor)


class _Judge:
    """One judgement's constants and counters."""

    def __init__(self, world: World, min_clearance: float, floor: float) -> None:
        self.world = world
        self.floor = floor
        self.evaluations = 0
        self._sweep_matrix = np.abs(world.group.expand_velocity)
        self._kept = np.where(world.is_obstacle_pair, min_clearance, 0.0)
        own, mixed = world.pairs[: world.n_self], world.pairs[world.n_self :]
        moved_by = world.bodies.moved_by
        self._own, self._bodies_of_obstacle_pairs = own, mixed[:, 0]
        self._first_only = moved_by[own[:, 0]] & ~moved_by[own[:, 1]]
        self._second_only = moved_by[own[:, 1]] & ~moved_by[own[:, 0]]
        self._moved_robot = moved_by[: len(world.bodies.joints)]
        self._radii = world.bodies.radii[:, None] * world.bodies.turns
        self._margins = np.zeros((world.geometry.ngeoms, world.geometry.ngeoms))
        self._at = (world.pairs[:, 0], world.pairs[:, 1])

    def refusal(self, control: np.ndarray, piece: int) -> Verdict | None:
        """Why a curve is refused, or None if it is free."""
        waiting = [_Stretch(control, 0.0, 1.0, None)]
        while waiting:
            stretch = waiting.pop()
            low, high = stretch.control.min(axis=0), stretch.control.max(axis=0)
            if stretch.pairs is None and (high - low).max() > WIDEST:
                waiting.extend(reversed(stretch.halves(None)))
                continue
            left, bounds = self._left(stretch, 0.5 * (low + high), 0.5 * (high - low))
            if not left:
                continue
            first, second = stretch.halves(left if len(left) < 0.5 * len(self._kept) else None)
            found = self._touching(second.control[0], left)
            if found is None:
                lost = [pair for pair in left if bounds[pair] <= self.floor]
                found = ("undecided", lost[0]) if lost else None
            if found is not None:
                return Verdict(
                    free=False,
                    reason=found[0],
                    piece=piece,
                    parameter=second.start,
                    free_until=stretch.start,
                    pair=self.world.pair_names(found[1]),
                    configuration=second.control[0],
                    evaluations=self.evaluations,
                )
            waiting += [second, first]
        return None

    def _left(self, stretch: _Stretch, middle: np.ndarray, half_widths: np.ndarray) -> tuple[list[int], np.ndarray]:
        """Pairs of a stretch that are within their bounds at its box's middle; the bounds (n,) of all pairs [m]."""
        world, group = self.world, self.world.group
        self.evaluations += 1
        q = group.expand(group.from_chart(middle))
        jacobian = pin.computeJointJacobians(world.model, world.data, q)
        centres = world.bodies.centres_in_world(world.data)
        bounds = self._motion_bounds(jacobian, centres, half_widths)
        margins = bounds + self._kept + COAL_ACCURACY
        self._margins[self._at] = margins
        world.margin_data.setSecurityMargins(world.geometry, self._margins, True, True)
        if stretch.pairs is None:
            if not pin.computeCollisions(world.model, world.data, world.margin_broad_phase, q, True):
                return [], bounds
            apart = world.bodies.separations(centres, world.pairs, world.n_self)
            pairs = np.flatnonzero(apart <= margins).tolist()
        else:
            pin.updateGeometryPlacements(world.model, world.data, world.geometry, world.margin_data)
            pairs = stretch.pairs
        return [pair for pair in pairs if pin.computeCollision(world.geometry, world.margin_data, pair)], bounds

    def _motion_bounds(self, jacobian: np.ndarray, centres: np.ndarray, half_widths: np.ndarray) -> np.ndarray:
        """How much closer each pair can come within a box about a configuration, shape (n,) [m].

        Args:
            jacobian: Joint Jacobian in the world frame, shape (6, model.nv): at a unit speed of joint j a point c moves
                at v_j + w_j x c, which is as fast as c is far from the axis.
            centres: Centres of the balls about the robot's bodies, shape (r, 3).
            half_widths: Of the box, shape (group.nv,).
        """
        bodies = self.world.bodies
        spread = self._sweep_matrix @ half_widths
        sweep = np.where(bodies.turns, 2.0 * np.sin(0.5 * np.minimum(spread, np.pi)), spread)
        (vx, vy, vz), (wx, wy, wz) = jacobian[:3], jacobian[3:]
        zero = np.zeros_like(vx)
        twist = np.array([[zero, wz, -wy], [-wz, zero, wx], [wy, -wx, zero]]).reshape(3, -1)
        velocities = (centres @ twist + jacobian[:3].ravel()).reshape(len(centres), 3, -1)
        reach = np.sqrt(np.einsum("bij,bij->bj", velocities, velocities)) + self._radii
        shares = reach * sweep * self._moved_robot
        own = (shares[self._own[:, 0]] * self._first_only + shares[self._own[:, 1]] * self._second_only).sum(axis=1)
        return np.concatenate([own, shares.sum(axis=1)[self._bodies_of_obstacle_pairs]])

    def _touching(self, z: np.ndarray, pairs: list[int]) -> tuple[str, int] | None:
        """What is wrong at a point (nv,) of the curve, contact or too close, and with which of some pairs; or None."""
        world, group = self.world, self.world.group
        self.evaluations += 1
        q = group.expand(group.from_chart(z))
        pin.updateGeometryPlacements(world.model, world.data, world.geometry, world.geometry_data, q)
        for pair in pairs:
            if pin.computeCollision(world.geometry, world.geometry_data, pair):
                return "contact", pair
        wanting = [pair for pair in pairs if self._kept[pair] > 0.0]
        if wanting:
            self._margins[self._at] = self._kept
            world.margin_data.setSecurityMargins(world.geometry, self._margins, True, True)
            pin.updateGeometryPlacements(world.model, world.data, world.geometry, world.margin_data)
        for pair in wanting:
            if pin.computeCollision(world.geometry, world.margin_data, pair):
                return "too close", pair
        return None
