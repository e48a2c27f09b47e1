"""How fast bodies close in on each other between two times, and how fast that changes: rigorous bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.collision.motion_bound import MotionBound, cross
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartRates, ModelTangents


@dataclass(frozen=True, eq=False)
class Closing(ReadOnly):
    """Bounds of the velocity and acceleration of points of one body as seen from another.

    They are for *movers*: first each of the robot's bodies as the world sees it, then each of the robot's own pairs,
    one body as the other sees it from the joint below which their chains part. With rates v_j and w_j of the joints
    that move a body, and rho_j its largest distance from axis j (1 where the joint slides), any point of it has

        |x'|  <=  sum_j v_j rho_j
        |x''| <=  sum_j rho_j (w_j + v_j (2 sum_{i before j} v_i + v_j)),   i and the last v_j only where they turn

    since d/dq_i of a column v_j (axis_j x r_j) turns it about axis i, and no later joint moves axis j. A ball joint
    turns at a rate of at most the norm of its coordinates', and its angular acceleration is at most the norm of theirs
    and the square of that rate: what the exponential map bends is at most 1.

    Attributes:
        bound: The world's bound of motions, whose tables these are.
        bodies: Body of each row, shape (p,): each of r bodies, then first and second body of each of the own pairs.
        masks: Joints that count in it, shape (p, nv of the model).
        radii: Radius of the ball about it, shape (p,) [m].
    """

    bound: MotionBound
    bodies: np.ndarray
    masks: np.ndarray
    radii: np.ndarray

    @classmethod
    def of(cls, bound: MotionBound, radii: np.ndarray) -> Closing:
        """For bodies with balls of some radii about them, shape (r,) [m]."""
        bodies = np.concatenate([np.arange(len(radii)), bound.own[:, 0], bound.own[:, 1]])
        masks = np.concatenate([bound.moved_by, bound.first_only, bound.second_only])
        return cls(bound, bodies, masks.astype(float), radii[bodies])

    def speeds(self, jacobians: np.ndarray, centres: np.ndarray, tangents: ModelTangents) -> np.ndarray:
        """Bounds of the speeds at configurations, shape (s, movers) [m/s].

        Args:
            jacobians: Joint Jacobians there in the world frame, shape (s, 6, nv of the model).
            centres: Centres there of the balls about the robot's bodies, shape (s, r, 3) [m, world].
            tangents: Velocities of all joints there, shape (s, nv of the model).
        """
        columns = jacobians * tangents[:, None, :]
        twists = columns @ self.masks.T
        linear, angular = twists[:, :3], twists[:, 3:]
        at = centres[:, self.bodies].swapaxes(1, 2)
        moved = linear + cross(angular, at)
        return self._of_movers(np.sqrt((moved**2).sum(axis=1)) + np.sqrt((angular**2).sum(axis=1)) * self.radii)

    def over(
        self,
        movers: np.ndarray,
        reach: np.ndarray,
        speeds: np.ndarray,
        rates: ChartRates,
        accelerations: ChartRates,
        spans: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the speeds and the accelerations between two times, both of shape (s, k) [m/s, m/s^2].

        Args:
            movers: Whose, in ascending order, shape (k,).
            reach: The larger of what `reach` is at the two times, shape (s, r, nv of the model).
            speeds: The mean of what `speeds` are there, shape (s, movers) [m/s].
            rates: Largest rates of the chart's coordinates between them, shape (s, group.nv) [rad/s or m/s].
            accelerations: Largest rates of those, shape (s, group.nv) [rad/s^2 or m/s^2].
            spans: How far apart they are, shape (s,) [s].
        """
        bound, own = self.bound, movers[movers >= len(self.bound.moved_by)]
        rows = np.concatenate([movers, own + len(bound.own)])
        v, w = bound.spread(rates)[:, None], bound.spread(accelerations)[:, None]
        sweep = bound.sweep(0.5 * spans[:, None] * rates)
        masks = self.masks[rows]
        turning_masks = masks * bound.turns
        rho = reach[:, self.bodies[rows]] * masks
        # whatever is between is no farther from one of the two in time than half of it
        rho += (rho @ sweep[..., None]) * turning_masks
        turning = v * turning_masks
        before = np.cumsum(turning, axis=2) - turning
        fastest = (rho @ v.swapaxes(1, 2))[..., 0]
        changing = (rho * (w + v * (2.0 * before + bound.doubled * v))).sum(axis=2)
        for both in (fastest, changing):
            both[:, len(movers) - len(own) : len(movers)] += both[:, len(movers) :]
        fastest, changing = fastest[:, : len(movers)], changing[:, : len(movers)]
        return np.minimum(fastest, speeds[:, movers] + 0.5 * changing * spans[:, None]), changing

    def _of_movers(self, rows: np.ndarray) -> np.ndarray:
        """Those of movers (s, movers), of those of the rows (s, p): own pairs add up those of both bodies."""
        count, first = len(self.bound.moved_by), len(self.bound.moved_by) + len(self.bound.own)
        found = rows[:, :first].copy()
        found[:, count:] += rows[:, first:]
        return found
