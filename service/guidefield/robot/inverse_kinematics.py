"""Inverse kinematics: distinct configurations of a planning group that bring its tip to a pose."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.messages.requests import PoseGoal, TargetPose
from guidefield.robot.group import PlanningGroup
from guidefield.robot.model import JointKind

EXACT = 1e-6
"""A tolerance of zero, or any smaller than this, means this [m, rad]."""

STARTS = 64
"""Random configurations that are tried for one pose at least."""
STARTS_PER_SOLUTION = 8
"""Random configurations that are tried for each solution asked, if those are more."""
DRAW = 16
"""Random configurations that are drawn at a time."""
MAX_ITERATIONS = 60
PATIENCE = 5
"""A start is given up if this many iterations in a row haven't halved the squared error."""
LEVER = 0.3
"""A rotation error of one radian counts as much as a position error of this [m]."""
DAMPING = 0.05
"""Damping per squared error. Of 0.005 to 0.5, with levers of 0.15 to 1 m, these take the fewest iterations on Panda,
UR5, xArm7 and Kinova."""
DAMPING_FLOOR = 1e-10
"""Least damping [m^2]: keeps the equations solvable where fewer joints than rows move."""
AIM = 0.9
"""The middle part of a tolerance that is aimed at, so that an approach from outside ends inside."""

DISTINCT_ANGLE = 0.1
DISTINCT_LENGTH = 0.02
"""Two solutions are distinct if a rotating joint differs by the angle [rad] or a sliding one by the length [m]."""


@dataclass(frozen=True, eq=False)
class PoseTarget:
    """A pose for the tip, and how far from it the tip may be, along and about the axes of the target's own frame.

    Attributes:
        placement: ``T_world_target``, pinocchio.SE3.
        position_tolerance: Shape (3,) [m]; infinite where an axis is free.
        orientation_tolerance: Shape (3,), about each axis, as components of the rotation vector from target to tip
            [rad]; infinite where an axis is free.
    """

    placement: Any
    position_tolerance: np.ndarray
    orientation_tolerance: np.ndarray

    @classmethod
    def from_wire(cls, pose: TargetPose | PoseGoal) -> PoseTarget:
        """The target that a message means; null is a free axis."""
        rotation = pin.Quaternion(np.array(pose.quaternion_xyzw, float)).normalized().toRotationMatrix()
        tolerances = [
            np.array([np.inf if axis is None else axis for axis in axes])
            for axes in (pose.position_tolerance, pose.orientation_tolerance)
        ]
        for array in tolerances:
            array.setflags(write=False)
        return cls(pin.SE3(rotation, np.array(pose.position, float)), *tolerances)

    def is_reached(self, T_world_tip: Any) -> bool:
        """Whether a placement of the tip (pinocchio.SE3) is within the tolerances."""
        offset = self.placement.actInv(T_world_tip)
        return bool(
            np.all(np.abs(offset.translation) <= np.maximum(self.position_tolerance, EXACT))
            and np.all(np.abs(pin.log3(offset.rotation)) <= np.maximum(self.orientation_tolerance, EXACT))
        )


@dataclass(frozen=True, eq=False)
class IkResult:
    """What was found.

    Attributes:
        solutions: Distinct configurations of the group, each shape (nq,), within the limits and accepted; first those
            reached from the given starts, in their order.
        reason: Why there are none or not as many as asked; empty if there are.
    """

    solutions: tuple[np.ndarray, ...]
    reason: str


def solve(
    group: PlanningGroup,
    target: PoseTarget,
    starts: Sequence[np.ndarray],
    count: int,
    *,
    rng: np.random.Generator,
    accept: Callable[[np.ndarray], bool] | None = None,
) -> IkResult:
    """Distinct configurations of a group that bring its tip to a pose.

    Damped least squares from the given starts and then from random ones, nearest to the target first: the damping
    follows the squared error (T. Sugihara, "Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt
    method", IEEE T-RO 27(5), 2011), the error is what exceeds the tolerances, and joints rest on their limits while
    the error pushes them outward. Nothing is proved where nothing is found, except what is out of reach.

    Args:
        group: The joints that may move; its `tip` is brought to the target.
        target: Where to.
        starts: Configurations of the group to start from, each shape (nq,).
        count: How many solutions to look for.
        rng: Where random starts come from; the same state gives the same solutions.
        accept: Whether a configuration is free of collision; None: all are taken.

    Returns:
        The solutions, and a reason where there are fewer than `count`.
    """
    search = _Search(group, target)
    if (short := search.shortfall()) > 0.0:
        return IkResult((), f"out of reach: at least {short:.2g} m short")
    found: list[np.ndarray] = []
    accepted: list[np.ndarray] = []
    drawn = max(STARTS, STARTS_PER_SOLUTION * count)
    for start in chain(starts, search.random_starts(drawn, rng)):
        q = search.descend(start)
        if q is None or any(search.are_alike(q, other) for other in found):
            continue
        found.append(q)
        if accept is None or accept(q):
            accepted.append(q)
            if len(accepted) == count:
                return IkResult(tuple(accepted), "")
    return IkResult(tuple(accepted), _reason(len(found), len(accepted), len(starts) + drawn, search.closest))


def _reason(found: int, accepted: int, tried: int, closest: np.ndarray) -> str:
    """Why there are not more, after all starts."""
    if not found:
        position, rotation = np.linalg.norm(closest[:3]), np.linalg.norm(closest[3:])
        return f"no solution from {tried} starts; the closest is {position:.2g} m and {rotation:.2g} rad off"
    if not accepted:
        return f"{found} distinct solutions from {tried} starts, all in collision"
    rejected = f", {found - accepted} more are in collision" if found > accepted else ""
    return f"{accepted} distinct solutions from {tried} starts{rejected}"


class _Search:
    """One target of one group: descends from starts, and remembers how close it came."""

    def __init__(self, group: PlanningGroup, target: PoseTarget) -> None:
        self._group, self._target = group, target
        self._model, self._data = group.model, group.model.createData()
        self._has_followers = group.space is not group.model
        tolerances = np.concatenate([target.position_tolerance, target.orientation_tolerance])
        self._allowed = np.where(tolerances > EXACT, tolerances, 0.5 * EXACT)  # half: others may check in another way
        self._aimed = np.where(tolerances > EXACT, AIM * tolerances, 0.0)
        self._has_tolerances = bool(self._aimed.any())
        self._weights = np.array([1.0, 1.0, 1.0, LEVER, LEVER, LEVER])
        self._error_rate = np.zeros((6, 6))
        bounded = [joint for joint in group.joints if joint.nq == 1]
        self._at_q = np.array([joint.idx_q for joint in bounded], int)
        self._at_v = np.array([joint.idx_v for joint in bounded], int)
        self._lower, self._upper = group.lower[self._at_v], group.upper[self._at_v]
        slides = np.concatenate([np.full(joint.nv, joint.kind is JointKind.PRISMATIC) for joint in group.joints])
        self._distinct = np.where(slides, DISTINCT_LENGTH, DISTINCT_ANGLE)
        self._least = np.inf
        self.closest = np.full(6, np.inf)

    def random_starts(self, count: int, rng: np.random.Generator) -> Iterator[np.ndarray]:
        """Random configurations; of each draw those nearest to the target first."""
        for done in range(0, count, DRAW):
            drawn = [self._group.random(rng) for _ in range(min(DRAW, count - done))]
            errors = [self._weights * self._excess(self._error(self._offset(q))) for q in drawn]
            yield from (drawn[i] for i in np.argsort([error.dot(error) for error in errors], kind="stable"))

    def descend(self, start: np.ndarray) -> np.ndarray | None:
        """The configuration within the tolerances that a start leads to; None if it leads to none."""
        q = self._clamped(start)
        halved, patience = np.inf, PATIENCE
        for _ in range(MAX_ITERATIONS):
            offset = self._offset(q)
            error = self._error(offset)
            if (np.abs(error) <= self._allowed).all():
                return q
            excess = self._excess(error)
            residual = self._weights * excess
            squared = float(residual.dot(residual))
            if squared < self._least:
                self._least, self.closest = squared, excess
            if squared < 0.5 * halved:
                halved, patience = squared, PATIENCE
            elif (patience := patience - 1) == 0:
                return None
            step = self._step(q, offset, residual, squared)
            q = self._clamped(pin.integrate(self._group.space, q, step))
        return None

    def are_alike(self, q0: np.ndarray, q1: np.ndarray) -> bool:
        """Whether two configurations count as one solution."""
        return bool((np.abs(self._group.difference(q0, q1)) <= self._distinct).all())

    def shortfall(self) -> float:
        """A lower bound of the distance that the tip stays away from the target's tolerances; maybe negative [m]."""
        model, joints = self._model, self._chain()
        reach = float(np.linalg.norm(model.frames[self._group.tip_id].placement.translation))
        for index in joints:
            if index != joints[0]:
                reach += float(np.linalg.norm(model.jointPlacements[index].translation))
            reach += self._travel(index)
        here = self._target.placement.actInv(model.jointPlacements[joints[0]].translation)
        beyond = np.maximum(np.abs(here) - self._target.position_tolerance, 0.0)
        return float(np.linalg.norm(beyond)) - reach - EXACT

    def _chain(self) -> list[int]:
        """Indices of the joints between the world and the tip."""
        return list(self._model.supports[self._model.frames[self._group.tip_id].parentJoint])[1:]

    def _travel(self, index: int) -> float:
        """How far a joint can move its own origin [m]."""
        joint = next((j for j in self._group.joints if j.name == self._model.names[index]), None)
        if joint is not None and joint.kind in (JointKind.REVOLUTE, JointKind.CONTINUOUS, JointKind.SPHERICAL):
            return 0.0
        if joint is not None and joint.kind is JointKind.PRISMATIC:
            return float(max(-joint.lower[0], joint.upper[0]))
        rotates = self._model.joints[index].shortname().startswith("JointModelR")  # a joint that follows another
        return 0.0 if rotates else np.inf

    def _offset(self, q: np.ndarray) -> Any:
        """``T_target_tip`` (pinocchio.SE3) at a configuration."""
        pin.forwardKinematics(self._model, self._data, self._group.expand(q))
        return self._target.placement.actInv(pin.updateFramePlacement(self._model, self._data, self._group.tip_id))

    def _error(self, offset: Any) -> np.ndarray:
        return np.concatenate([offset.translation, pin.log3(offset.rotation)])

    def _excess(self, error: np.ndarray) -> np.ndarray:
        """What of the error exceeds the aimed part of the tolerances, shape (6,) [m, rad]."""
        excess: np.ndarray = error - np.minimum(np.maximum(error, -self._aimed), self._aimed)
        return excess

    def _step(self, q: np.ndarray, offset: Any, residual: np.ndarray, squared: float) -> np.ndarray:
        """Tangent (nv,) of one damped step; joints that rest on a limit and are pushed outward stay."""
        J = self._jacobian(q, offset)
        if self._has_tolerances:
            J[residual == 0.0] = 0.0
        values, slope = q[self._at_q], residual.dot(J)[self._at_v]
        stuck = ((values <= self._lower) & (slope > 0.0)) | ((values >= self._upper) & (slope < 0.0))
        if np.count_nonzero(stuck):
            J[:, self._at_v[stuck]] = 0.0
        normal = J.dot(J.T)
        normal.flat[::7] += DAMPING * squared + DAMPING_FLOOR
        step: np.ndarray = -np.linalg.solve(normal, residual).dot(J)
        return step

    def _jacobian(self, q: np.ndarray, offset: Any) -> np.ndarray:
        """Derivative (6, nv) of the weighted error by the group's tangent."""
        J = pin.computeFrameJacobian(
            self._model, self._data, self._group.expand(q), self._group.tip_id, pin.ReferenceFrame.LOCAL
        )
        if self._has_followers:
            J = J @ self._group.expand_velocity
        self._error_rate[:3, :3] = offset.rotation
        self._error_rate[3:, 3:] = LEVER * pin.Jlog3(offset.rotation)
        derivative: np.ndarray = self._error_rate.dot(J)
        return derivative

    def _clamped(self, q: np.ndarray) -> np.ndarray:
        """The configuration with every bounded value within its limits."""
        clamped = q.copy()
        clamped[self._at_q] = np.minimum(np.maximum(q[self._at_q], self._lower), self._upper)
        return clamped
