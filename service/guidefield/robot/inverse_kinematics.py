"""Inverse kinematics: distinct configurations of a planning group that bring its tip to a pose."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.geometry.placements import se3
from guidefield.messages.requests import PoseGoal, TargetPose
from guidefield.robot.group import PlanningGroup
from guidefield.robot.model import JointKind

EXACT = 1e-6
"""A tolerance of zero, or any smaller than this, means this [m, rad]."""

STARTS = 64
"""Random configurations that are tried for one pose at least."""
STARTS_PER_SOLUTION = 8
"""Random configurations that are tried for each solution asked, if those are more."""
BATCH_PER_SOLUTION, SMALLEST_BATCH, LARGEST_BATCH = 2, 4, 32
"""How many starts descend side by side: about half of them fail."""
MAX_ITERATIONS = 60
PATIENCE = 5
"""A start is given up if this many iterations in a row haven't halved the squared error."""
LEVER = 0.3
"""A rotation error of one radian counts as much as a position error of this [m]."""
WEIGHTS = np.array([1.0, 1.0, 1.0, LEVER, LEVER, LEVER])
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
        tolerances = [
            np.array([np.inf if axis is None else axis for axis in axes])
            for axes in (pose.position_tolerance, pose.orientation_tolerance)
        ]
        for array in tolerances:
            array.setflags(write=False)
        return cls(se3(pose.position, pose.quaternion_xyzw), *tolerances)

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
    fault: str = "in collision",
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
        accept: Whether a configuration may be a solution; None: all may.
        fault: What is wrong with those that may not, for the reason.

    Returns:
        The solutions, and a reason where there are fewer than `count`.
    """
    search = _Search(group, target)
    if (short := search.shortfall()) > 0.0:
        return IkResult((), f"out of reach: at least {int(1000.0 * short)} mm short")
    found: list[np.ndarray] = []
    accepted: list[np.ndarray] = []
    drawn = max(STARTS, STARTS_PER_SOLUTION * count)
    size = min(max(BATCH_PER_SOLUTION * count, SMALLEST_BATCH), LARGEST_BATCH)
    for batch in _batches(search, starts, drawn, rng, size):
        for q in search.descend(batch):
            if any(search.are_alike(q, other) for other in found):
                continue
            found.append(q)
            if accept is None or accept(q):
                accepted.append(q)
                if len(accepted) == count:
                    return IkResult(tuple(accepted), "")
    tried = f"{len(starts) + drawn} starts"
    if not found:
        position, rotation = np.linalg.norm(search.closest[:3]), np.linalg.norm(search.closest[3:])
        return IkResult((), f"no solution from {tried}; the closest is {position:.2g} m and {rotation:.2g} rad off")
    if not accepted:
        return IkResult((), f"{_solutions(len(found))} from {tried}, all {fault}")
    rejected = len(found) - len(accepted)
    others = f", {rejected} more {'is' if rejected == 1 else 'are'} {fault}" if rejected else ""
    return IkResult(tuple(accepted), f"{_solutions(len(accepted))} from {tried}{others}")


def _batches(
    search: _Search, starts: Sequence[np.ndarray], drawn: int, rng: np.random.Generator, size: int
) -> Iterator[Sequence[np.ndarray]]:
    """The given starts, then random ones, which are drawn only if they are needed."""
    for first in range(0, len(starts), size):
        yield starts[first : first + size]
    others = search.random_starts(drawn, rng)
    for first in range(0, drawn, size):
        yield others[first : first + size]


def _solutions(count: int) -> str:
    return f"{count} distinct solution{'' if count == 1 else 's'}"


class _Search:
    """One target of one group: descends from starts, and remembers how close it came."""

    def __init__(self, group: PlanningGroup, target: PoseTarget) -> None:
        self._group, self._target = group, target
        self._model, self._data = group.model, group.model.createData()
        tolerances = np.concatenate([target.position_tolerance, target.orientation_tolerance])
        self._allowed = np.where(tolerances > EXACT, tolerances, 0.5 * EXACT)  # half: others may check in another way
        self._aimed = np.where(tolerances > EXACT, AIM * tolerances, 0.0)
        bounded = [joint for joint in group.joints if joint.nq == 1]
        self._at_q = np.array([joint.idx_q for joint in bounded], int)
        self._at_v = np.array([joint.idx_v for joint in bounded], int)
        self._lower, self._upper = group.lower[self._at_v], group.upper[self._at_v]
        slides = np.concatenate([np.full(joint.nv, joint.kind is JointKind.PRISMATIC) for joint in group.joints])
        self._distinct = np.where(slides, DISTINCT_LENGTH, DISTINCT_ANGLE)
        self._least = np.inf
        self.closest = np.full(6, np.inf)

    def random_starts(self, count: int, rng: np.random.Generator) -> list[np.ndarray]:
        """Random configurations, those nearest to the target first; angles without limits are from one turn."""
        lower, upper = self._group.lower, self._group.upper
        lower, upper = np.where(np.isfinite(lower), lower, -np.pi), np.where(np.isfinite(upper), upper, np.pi)
        drawn = [self._group.from_chart(z) for z in rng.uniform(lower, upper, (count, self._group.nv))]
        residuals = WEIGHTS * self._excess(self._linearized(np.array(drawn))[0])
        return [drawn[i] for i in np.argsort(np.sum(residuals**2, axis=1), kind="stable")]

    def descend(self, starts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The configurations within the tolerances that starts lead to, in their order; some lead to none."""
        reached: dict[int, np.ndarray] = {}
        running = np.arange(len(starts))
        qs = self._clamped(np.array(starts))
        halved, patience = np.full(len(starts), np.inf), np.full(len(starts), PATIENCE)
        for _ in range(MAX_ITERATIONS):
            errors, jacobians = self._linearized(qs)
            there = (np.abs(errors) <= self._allowed).all(axis=1)
            reached.update(zip(running[there].tolist(), qs[there], strict=True))
            excesses = self._excess(errors)
            residuals = WEIGHTS * excesses
            squared = np.sum(residuals**2, axis=1)
            self._remember(squared, excesses)
            progress = squared < 0.5 * halved
            halved, patience = np.where(progress, squared, halved), np.where(progress, PATIENCE, patience - 1)
            going = ~there & (patience > 0)
            if not going.any():
                break
            running, qs, halved, patience = running[going], qs[going], halved[going], patience[going]
            steps = self._steps(qs, residuals[going], jacobians[going], squared[going])
            qs = self._clamped(
                np.array([pin.integrate(self._group.space, q, v) for q, v in zip(qs, steps, strict=True)])
            )
        return [reached[index] for index in sorted(reached)]

    def are_alike(self, q0: np.ndarray, q1: np.ndarray) -> bool:
        """Whether two configurations count as one solution."""
        return bool((np.abs(self._group.difference(q0, q1)) <= self._distinct).all())

    def shortfall(self) -> float:
        """A lower bound of the distance that the tip stays away from the target's tolerances; maybe negative [m]."""
        model, tip = self._model, self._model.frames[self._group.tip_id]
        first, *others = list(model.supports[tip.parentJoint])[1:]
        lengths = [tip.placement.translation, *(model.jointPlacements[index].translation for index in others)]
        reach = sum(float(np.linalg.norm(length)) for length in lengths) + sum(map(self._travel, (first, *others)))
        base = self._target.placement.actInv(model.jointPlacements[first].translation)
        beyond = np.maximum(np.abs(base) - self._target.position_tolerance, 0.0)
        return float(np.linalg.norm(beyond)) - reach - EXACT

    def _travel(self, index: int) -> float:
        """How far a joint of the model can move its own origin [m]."""
        joint = next((joint for joint in self._group.joints if joint.name == self._model.names[index]), None)
        kind = None if joint is None else joint.kind  # None: it follows another
        if kind in (JointKind.REVOLUTE, JointKind.CONTINUOUS, JointKind.SPHERICAL):
            return 0.0
        if joint is not None and kind is JointKind.PRISMATIC:
            return float(max(-joint.lower[0], joint.upper[0]))
        return np.inf

    def _linearized(self, qs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Errors (n, 6) at configurations (n, nq), and derivatives (n, 6, nv) of the weighted errors by the tangent."""
        errors, rates = np.empty((len(qs), 6)), np.zeros((len(qs), 6, 6))
        jacobians = np.empty((len(qs), 6, self._model.nv))
        model, data, tip = self._model, self._data, self._group.tip_id
        for q, error, rate, jacobian in zip(map(self._group.expand, qs), errors, rates, jacobians, strict=True):
            J = pin.computeFrameJacobian(model, data, q, tip, pin.ReferenceFrame.LOCAL)
            jacobian[:] = J.reshape(jacobian.shape)  # Pinocchio makes a matrix of one column a vector
            pin.forwardKinematics(model, data, q)  # the Jacobian alone leaves the placements as they were
            offset = self._target.placement.actInv(pin.updateFramePlacement(model, data, tip))
            rotation = offset.rotation
            error[:3], error[3:] = offset.translation, pin.log3(rotation)
            rate[:3, :3], rate[3:, 3:] = rotation, pin.Jlog3(rotation)
        if self._group.space is not self._model:
            jacobians = jacobians @ self._group.expand_velocity
        return errors, WEIGHTS[:, None] * (rates @ jacobians)

    def _steps(self, qs: np.ndarray, residuals: np.ndarray, jacobians: np.ndarray, squared: np.ndarray) -> np.ndarray:
        """Tangents (n, nv) of one damped step each; joints that rest on a limit and are pushed outward stay."""
        slopes, values = (residuals[:, None] @ jacobians)[:, 0, self._at_v], qs[:, self._at_q]
        free = np.ones((len(qs), self._group.nv))
        free[:, self._at_v] = ((values > self._lower) | (slopes < 0.0)) & ((values < self._upper) | (slopes > 0.0))
        J = jacobians * free[:, None] * (residuals != 0.0)[:, :, None]
        normal = J @ J.transpose(0, 2, 1)
        normal[:, range(6), range(6)] += (DAMPING * squared + DAMPING_FLOOR)[:, None]
        steps: np.ndarray = -(np.linalg.solve(normal, residuals[:, :, None]).transpose(0, 2, 1) @ J)[:, 0]
        return steps

    def _excess(self, errors: np.ndarray) -> np.ndarray:
        """What of errors (n, 6) exceeds the aimed part of the tolerances [m, rad]."""
        excess: np.ndarray = errors - np.minimum(np.maximum(errors, -self._aimed), self._aimed)
        return excess

    def _remember(self, squared: np.ndarray, excesses: np.ndarray) -> None:
        best = int(np.argmin(squared))
        if squared[best] < self._least:
            self._least, self.closest = float(squared[best]), excesses[best]

    def _clamped(self, qs: np.ndarray) -> np.ndarray:
        """Configurations (n, nq) with every bounded value within its limits, in place."""
        qs[:, self._at_q] = np.minimum(np.maximum(qs[:, self._at_q], self._lower), self._upper)
        return qs
