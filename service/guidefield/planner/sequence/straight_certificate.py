"""The certificate that a frame keeps to its straight way all along a motion, between samples too.

A Bezier curve lies in the box of its control points. Let ``m`` be the box's middle and ``e_j`` its half width in joint
``j``, ``E`` the sum of ``e_j`` over the joints that turn, and ``c_j`` how far the frame's origin is from axis ``j`` at
``m``, plus the motion bound ``D`` of the origin; 1 for a joint that slides. For ``m + d`` in the box:

- The origin is within ``E sum_j c_j e_j`` of ``p(m) + J d``: the second derivative by joints ``i`` and ``j`` is no
  longer than the origin's distance from the axis of the one nearer to it, which changes by at most ``D`` in the box.
- The frame is turned away by at most ``E^2 / 4`` from ``exp(J_w d) R(m)``: an axis turns by at most what the joints
  before it turn, and two rotations differ by at most the integral of how their rates differ.

Both first terms are linear in ``d``, so the control points bound them: what goes along the way, and turns as the way
does, costs nothing. Where the sum can't exceed a tolerance the curve keeps it; else it is halved.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np
import pinocchio as pin

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.planner.sequence.straight_way import StraightWay
from guidefield.prove.bezier import halved
from guidefield.prove.settings import CONSTRAINT_RESOLUTION
from guidefield.prove.verdict import Reason, Verdict
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.frames import frame_index
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ChartPoints

AT_ONCE = 64
"""So many pieces of a motion are judged together."""


class Deviation(NamedTuple):
    """How far a frame may be off its way.

    Attributes:
        aside: From the line [m].
        beyond: Beyond an end of it [m].
        turned: From the orientation of the way there [rad].
    """

    aside: float
    beyond: float
    turned: float

    def within(self, way: StraightWay) -> bool:
        """Return whether that is within the tolerances."""
        return max(self.aside, self.beyond) <= way.line_tolerance and self.turned <= way.turn_tolerance


def certify_straight(
    way: StraightWay,
    group: PlanningGroup,
    turns: np.ndarray,
    pieces: ChartCurves,
    deadline: Deadline = UNLIMITED,
) -> Verdict:
    """Judge whether a frame keeps to its straight way along a motion.

    Args:
        turns: Whether a joint turns rather than slides, shape (nv of the model,).
        pieces: Bezier control points in the group's chart, shape (m, k, nv) [rad or m].
    """
    frame = _Frame(way, group, turns)
    waiting = deque((index, 0.0, 1.0, piece) for index, piece in enumerate(np.asarray(pieces, float)))
    evaluations = 0
    while waiting:
        batch = [waiting.popleft() for _ in range(min(AT_ONCE, len(waiting)))]
        if deadline.expired():
            index, start, _, control = batch[0]
            return Verdict(Reason.STOPPED, evaluations, index, start, (index, start), None, control[0])
        evaluations += len(batch)
        halves = []
        for (index, start, end, control), bound in zip(batch, frame.bounds([one[-1] for one in batch]), strict=True):
            if bound.within(way):
                continue
            narrow = np.ptp(control, axis=0).max() <= CONSTRAINT_RESOLUTION
            if narrow or not frame.off(control[0]).within(way):
                return Verdict(Reason.PATH_CONSTRAINT, evaluations, index, start, (index, start), None, control[0])
            (one, other), half = halved(control[None]), 0.5 * (start + end)
            halves += [(index, start, half, one), (index, half, end, other)]
        waiting.extendleft(reversed(halves))
    return Verdict(Reason.FREE, evaluations)


class _Frame:
    """A frame that is to keep to its way; owns scratch data (one per thread)."""

    def __init__(self, way: StraightWay, group: PlanningGroup, turns: np.ndarray) -> None:
        frame = frame_index(group.model, way.frame)
        assert frame is not None, "the way's frame is the robot's"
        self._way, self._group, self._turns, self._frame = way, group, turns, frame
        self._data = group.model.createData()
        self._widths = np.abs(group.expand_velocity)

    def place_frame(self, z: ChartPoint) -> tuple[Any, np.ndarray]:
        """Where the frame is at a chart point (nv,), a pinocchio.SE3, and its Jacobian (6, nv of the model) there."""
        model, q = self._group.model, self._group.expand_from_chart(z)
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pin.computeFrameJacobian(model, self._data, q, self._frame, axes).reshape(6, -1)
        return pin.updateFramePlacement(model, self._data, self._frame).copy(), jacobian

    def off(self, z: ChartPoint) -> Deviation:
        """How far the frame is off its way at a chart point (nv,)."""
        return self._off(self.place_frame(z)[0])

    def _off(self, placement: Any) -> Deviation:
        way = self._way
        share = 0.0 if way.is_point else way.share(placement)
        beyond = max(-share, share - 1.0, 0.0) * way.length
        return Deviation(float(np.linalg.norm(way.aside(placement))), beyond, way.turned(placement))

    def bounds(self, controls: Sequence[ChartPoints]) -> list[Deviation]:
        """How far the frame can be off its way on each of some Bezier curves, control points (k, nv)."""
        way, curves = self._way, np.array(controls)
        low, high = curves.min(axis=1), curves.max(axis=1)
        middles, e = 0.5 * (low + high), 0.5 * (high - low) @ self._widths.T
        placements, each = zip(*(self.place_frame(cast(ChartPoint, z)) for z in middles), strict=True)
        jacobians = np.array(each)
        moves = (curves - middles[:, None]) @ (jacobians @ self._group.expand_velocity).swapaxes(1, 2)
        shifts, rotations = np.split(moves, 2, axis=2)
        place_rest, turn_rest = self._rests(jacobians, e)
        off = np.array([self._off(placement) for placement in placements])
        along = shifts @ way.direction
        aside = np.linalg.norm(shifts - along[..., None] * way.direction, axis=2).max(axis=1)
        share = np.array([0.0 if way.is_point else way.share(placement) for placement in placements])
        ahead = share[:, None] * way.length + along
        beyond = np.maximum(np.maximum(-ahead.min(axis=1), ahead.max(axis=1) - way.length), 0.0)
        if way.is_point:
            axis = way.turn / way.angle if way.angle > 0.0 else np.zeros(3)
            even, even_rest = (rotations @ axis)[..., None] * axis, np.zeros(len(curves))
        else:
            even, even_rest = along[..., None] / way.length * way.turn, place_rest * way.angle / way.length
            beyond += place_rest
        uneven = np.linalg.norm(rotations - even, axis=2).max(axis=1)
        found = np.column_stack([off[:, 0] + aside + place_rest, beyond, off[:, 2] + uneven + turn_rest + even_rest])
        return [Deviation(*row) for row in found.tolist()]

    def _rests(self, jacobians: np.ndarray, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far places [m] and orientations [rad] can be from their linear terms within half widths e (n, nv)."""
        from_axes = np.linalg.norm(jacobians[:, :3], axis=1)
        sweep = np.where(self._turns, 2.0 * np.sin(0.5 * np.minimum(e, np.pi)), e)
        swept = (sweep * from_axes).sum(axis=1, keepdims=True)
        distances = np.where(self._turns, from_axes + swept, from_axes > 0.0)
        turning = (e * (self._turns & (np.linalg.norm(jacobians[:, 3:], axis=1) > 0.0))).sum(axis=1)
        return turning * (distances * e).sum(axis=1), 0.25 * turning**2
