"""Univariate: the thesis' own minimizer, one axis at a time, for chains of ball or universal joints.

service/docs/algorithm.md, "Univariate", has the algorithm. A search follows the sign of a projected force or torque:
steps of one size as long as it stays, reversed and halved where it changes, halved where a trial isn't free. The tip of
a fixed chain slides with its last link; every other link turns about its far end, the links before it are closed on its
near end. A chain that nothing holds slides as a whole; its links turn about their joints, those behind are carried
along.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from guidefield.collision.swept import FLOOR, SELF_MARGIN, swept_world
from guidefield.kernels.guide.coordinate_descent import Searching, sweep
from guidefield.kernels.guide.tip_constraint import COUNTS, EVALUATIONS, JUDGED, TipGuard
from guidefield.kernels.kinematics.link_chain import chain_configuration, close_chain
from guidefield.planner.guide.guided_path import GuidedPath, reach_point
from guidefield.planner.guide.settings import SETTLING, UNIVARIATE
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.trace import StepKind
from guidefield.robot.group.link_chain import SerialChain
from guidefield.robot.group.mover import mover_of
from guidefield.robot.model.spaces import Configuration, Configurations


@dataclass(frozen=True, eq=False)
class Univariate:
    """The seed's minimizer for one chain."""

    chain: SerialChain
    negligible: float = SETTLING.negligible
    most_rounds: int = SETTLING.most_rounds

    @property
    def name(self) -> str:
        """Its name, for reports."""
        return "univariate"

    def reach(self, problem: Problem, q: Configuration, point: np.ndarray) -> Iterator[Configuration]:
        """A floating chain as a whole; a fixed one with its last link's rotation held, then by the least change.

        Args:
            q: Where the robot is, shape (nq,).
            point: Where its tip shall be, shape (3,) [m, world].

        Yields:
            Shape (nq,).
        """
        joints, rotations = self.chain.places(q)
        n = self.chain.n
        if self.chain.leads:
            shifted = self._configuration(q, rotations, joints + (point - joints[0]))
        else:
            near_end = joints[n - 1] + (point - joints[n])
            moved = joints.copy()
            moved[n] = point
            shifted = self._configuration(q, rotations, moved) if close_chain(moved, n - 1, near_end) else None
        if shifted is not None:
            yield shifted
        if not self.chain.leads and (reached := reach_point(problem, q, point)) is not None:
            yield reached

    def settle(self, guided: GuidedPath, point: np.ndarray, normal: np.ndarray, guard: TipGuard) -> None:  # noqa: ARG002
        """Slide and reorient on a plane until U falls by next to nothing, or rounds are over.

        Every step is parallel to the plane: its point is not needed. See `Minimizer`, with the same shapes.
        """
        problem, field = guided.problem, guided.problem.robot_field
        before = field.potential(guided.q)
        for _ in range(self.most_rounds):
            taken = self._swept(guided, normal, guard)
            if not len(taken):
                return
            after = field.potential(taken[-1])
            if after >= before:  # U is the referee: the round is undone
                return
            if len(taken) > 1 and guided.free(guided.q, taken[-1]):
                taken = taken[-1:]
            for q in taken:
                guided.take(q, StepKind.SWEEP, f"U = {after:.4g}", after)
            fallen, before = before - after, after
            if fallen < self.negligible * (before + fallen) or problem.deadline.expired():
                return

    def _swept(self, guided: GuidedPath, normal: np.ndarray, guard: TipGuard) -> Configurations:
        """One round: configurations (n, nq) after every step that was taken."""
        problem, chain, mover = guided.problem, self.chain, mover_of(self.chain.group)
        swept = swept_world(problem.world)
        searching = Searching(
            UNIVARIATE.first_turn,
            UNIVARIATE.last_turn,
            UNIVARIATE.first_slide * guided.size,
            UNIVARIATE.last_slide * guided.size,
            guided.margin,
            SELF_MARGIN * guided.size,
            FLOOR * guided.size,
        )
        path, counts = np.empty((UNIVARIATE.most_steps, len(guided.q))), np.zeros(COUNTS, np.int64)
        taken = sweep(
            chain.table, chain.joints, chain.carriers, int(chain.leads), problem.robot_field.charged,
            problem.robot_field.tables, swept.robot, swept.tables, guard, searching, mover.values, mover.lower,
            mover.upper, normal, guided.q, path, counts,
        )  # fmt: skip
        problem.robot_field.evaluations += int(counts[EVALUATIONS])
        problem.counters.collision_checks += int(counts[JUDGED])
        return path[:taken]

    def _configuration(self, q: Configuration, rotations: np.ndarray, joints: np.ndarray) -> Configuration | None:
        """Configuration (nq,) near q within the limits whose joints stand at places; None if there is none."""
        found, turned = np.empty_like(q), np.empty_like(rotations)
        if not chain_configuration(self.chain.table, joints, q, rotations, found, turned):
            return None
        group = self.chain.group
        if group.limited:
            z = group.chart(found)
            if np.any((z < group.lower) | (z > group.upper)):
                return None
        return found
