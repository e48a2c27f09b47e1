"""Univariate: the seed's own minimizer, one axis at a time, for chains of ball or universal joints.

findings-seed.md section 3 has the algorithm. A search follows the sign of a projected force or torque: steps of one
size as long as it stays, reversed and halved where it changes, halved where a trial isn't free. The tip of a fixed
chain slides with its last link; every other link turns about its far end, the links before it are closed on its near
end. A chain that nothing holds slides as a whole; its links turn about their joints, those behind are carried along.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from guidefield.kernels.chain_angles import chain_configuration
from guidefield.kernels.link_chain import close_chain, end_force, turn_from, turn_towards
from guidefield.kernels.tip_guard import TipGuard, allowed
from guidefield.planner.problem import Problem
from guidefield.planner.settling import MOST_ROUNDS, NEGLIGIBLE
from guidefield.planner.steps import Walker, reach_point
from guidefield.planner.strung import Strung, strung
from guidefield.robot.link_chain import Chain

FIRST_TURN, LAST_TURN = np.deg2rad(5.0), np.deg2rad(0.5)
"""A search for an angle begins with the one and ends below the other [rad]."""
FIRST_SLIDE, LAST_SLIDE = 0.025, 0.1 / 64
"""The same for a slide [m]: a quarter and a 64th of an advance."""
MOST_TRIALS = 80
"""Trials of one search."""

Slope = Callable[[Strung], float]
"""Force or torque along the axis of a search: where it is positive, U falls ahead."""
Trial = Callable[[Strung, float], np.ndarray | None]
"""Places of joints (n + 1, 3) after a step; None where the chain can't be closed."""


@dataclass(frozen=True, eq=False)
class Univariate:
    """The seed's minimizer for one chain.

    Attributes:
        chain: The chain.
        negligible: It ends where a round brings less than this share of U.
        most_rounds: It ends after so many rounds.
    """

    chain: Chain
    negligible: float = NEGLIGIBLE
    most_rounds: int = MOST_ROUNDS

    @property
    def name(self) -> str:
        """Its name, for reports."""
        return "univariate"

    def reach(self, problem: Problem, q: np.ndarray, point: np.ndarray) -> Iterator[np.ndarray]:
        """A floating chain as a whole; a fixed one with its last link's rotation held, then by the least change."""
        here = strung(problem, self.chain, q)
        joints, n = here.joints.copy(), self.chain.n
        if self.chain.leads:
            shifted = self._configuration(here, joints + (point - joints[0]))
        else:
            near_end = joints[n - 1] + (point - joints[n])
            joints[n] = point
            shifted = self._configuration(here, joints) if close_chain(joints, n - 1, near_end) else None
        if shifted is not None:
            yield shifted[0]
        if not self.chain.leads and (reached := reach_point(problem, q, point)) is not None:
            yield reached

    def settle(self, walker: Walker, point: np.ndarray, normal: np.ndarray, guard: TipGuard) -> None:  # noqa: ARG002
        """Slide and reorient on a plane until U falls by next to nothing, or rounds are over.

        Every step is parallel to the plane: its point is not needed.
        """
        here = strung(walker.problem, self.chain, walker.q)
        for _ in range(self.most_rounds):
            sweep = _Sweep(self, walker, here, guard)
            sweep.slide(normal)
            sweep.reorient()
            before, after = here.potential, sweep.here.potential
            if after >= before:  # U is the referee: the round is undone
                return
            sweep.take()
            here = sweep.here
            if before - after < self.negligible * before or walker.problem.budget.spent():
                return

    def _configuration(self, here: Strung, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Configuration (nq,) within the limits and rotations of links whose joints stand at places; None if none."""
        q, rotations = np.empty_like(here.q), np.empty_like(here.rotations)
        if not chain_configuration(self.chain.table, joints, here.q, here.rotations, q, rotations):
            return None
        group = self.chain.group
        if group.limited:
            z = group.chart(q)
            if np.any((z < group.lower) | (z > group.upper)):
                return None
        return q, rotations


class _Sweep:
    """One round: a slide, then every link in turn; what was accepted, in order."""

    def __init__(self, minimizer: Univariate, walker: Walker, here: Strung, guard: TipGuard) -> None:
        self.here = here
        self._minimizer, self._walker, self._guard = minimizer, walker, guard
        self._chain = minimizer.chain
        self._taken = [here]

    def slide(self, normal: np.ndarray) -> None:
        """Slide the tip on the plane along the force, as projected on it."""
        force = self._sliding_force(self.here)
        across = force - (force @ normal) * normal
        length = float(np.linalg.norm(across))
        if length <= 0.0:
            return
        u = across / length
        trial = self._slid_whole if self._chain.leads else self._slid_last
        self._search(
            lambda at: float(self._sliding_force(at) @ u), lambda at, s: trial(at, s * u), FIRST_SLIDE, LAST_SLIDE
        )

    def reorient(self) -> None:
        """Turn every link about two axes across it: from the tip on, down to link 2 (fixed), or to the last one."""
        n = self._chain.n
        if self._chain.leads:
            for k in range(1, n + 1):
                self._turn_about_two(k, self._own_torque, _turned_from)
            return
        for k in range(n, 2, -1):
            self._turn_about_two(k, self._level_torque, _turned_towards)
        if n >= 2:
            line = self.here.joints[2] - self.here.joints[0]
            length = float(np.linalg.norm(line))
            if length > 1e-9:
                a = line / length
                self._search(
                    lambda at: float(self._pair_torque(at) @ a),
                    lambda at, s: _turned_towards(at.joints, 2, a, s),
                    FIRST_TURN,
                    LAST_TURN,
                )

    def take(self) -> None:
        """Have the walker take the round: its end alone where the straight motion there is free, else every step."""
        taken = self._taken[1:]
        if len(taken) > 1 and self._walker.free(self._taken[0].q, self.here.q):
            taken = taken[-1:]
        for at in taken:
            self._walker.take(at.q, "sweep", f"sweep to U = {self.here.potential:.4g}", at.potential)

    def _turn_about_two(
        self,
        k: int,
        torque: Callable[[Strung, int], np.ndarray],
        turned: Callable[[np.ndarray, int, np.ndarray, float], np.ndarray | None],
    ) -> None:
        """Search for an angle about one axis across a link, then about the other."""
        for which in range(2):
            e = self.here.across(k)[which]
            self._search(
                lambda at, e=e: float(torque(at, k) @ e),  # type: ignore[misc]
                lambda at, s, e=e: turned(at.joints, k, e, s),  # type: ignore[misc]
                FIRST_TURN,
                LAST_TURN,
            )

    def _search(self, slope: Slope, trial: Trial, first: float, last: float) -> None:
        """Follow the sign of a slope with steps from `first` down to `last`."""
        steepness = slope(self.here)
        if steepness == 0.0:
            return
        step = first if steepness > 0.0 else -first
        for _ in range(MOST_TRIALS):
            if abs(step) < last:
                return
            there = self._accepted(trial(self.here, step))
            if there is None:
                step *= 0.5
                continue
            self.here = there
            self._taken.append(there)
            if slope(there) * step < 0.0:
                step *= -0.5

    def _accepted(self, joints: np.ndarray | None) -> Strung | None:
        """The chain at places of joints if the guard allows it, it has a configuration, and the way there is free."""
        if joints is None:
            return None
        tip = joints[0] if self._chain.leads else joints[-1]
        if not allowed(self._guard, tip):
            return None
        found = self._minimizer._configuration(self.here, joints)
        if found is None or not self._walker.free(self.here.q, found[0]):
            return None
        return self.here.at(found[0], joints, found[1])

    def _sliding_force(self, at: Strung) -> np.ndarray:
        """On the last link, with what the others exert on it; on the whole chain where it is carried as a whole."""
        if self._chain.leads:
            total: np.ndarray = at.forces.sum(axis=0)
            return total
        force: np.ndarray = at.forces[-1] + _end_force(at, self._chain.n - 1)
        return force

    def _level_torque(self, at: Strung, k: int) -> np.ndarray:
        """tau_k - l_k x (F_k + f2): about the far end of link k, f2 what the links before it exert on its near end."""
        link = at.joints[k] - at.joints[k - 1]
        torque: np.ndarray = at.torques[k - 1] - np.cross(link, at.forces[k - 1] + _end_force(at, k - 1))
        return torque

    def _own_torque(self, at: Strung, k: int) -> np.ndarray:
        """tau_k alone, about the joint before it: the seed's sequential strategy for a moving base."""
        torque: np.ndarray = at.torques[k - 1]
        return torque

    def _pair_torque(self, at: Strung) -> np.ndarray:
        """Of links 1 and 2 together, about J_0."""
        link = at.joints[1] - at.joints[0]
        torque: np.ndarray = at.torques[0] + at.torques[1] + np.cross(link, at.forces[1])
        return torque

    def _slid_whole(self, at: Strung, shift: np.ndarray) -> np.ndarray:
        joints: np.ndarray = at.joints + shift
        return joints

    def _slid_last(self, at: Strung, shift: np.ndarray) -> np.ndarray | None:
        joints, n = at.joints.copy(), self._chain.n
        joints[n] += shift
        return joints if close_chain(joints, n - 1, at.joints[n - 1] + shift) else None


def _end_force(at: Strung, m: int) -> np.ndarray:
    force = np.empty(3)
    end_force(at.joints, at.forces, at.torques, m, force)
    return force


def _turned_from(joints: np.ndarray, k: int, axis: np.ndarray, angle: float) -> np.ndarray:
    turned = np.empty_like(joints)
    turn_from(joints, k, axis, angle, turned)
    return turned


def _turned_towards(joints: np.ndarray, k: int, axis: np.ndarray, angle: float) -> np.ndarray | None:
    turned = np.empty_like(joints)
    return turned if turn_towards(joints, k, axis, angle, turned) else None
