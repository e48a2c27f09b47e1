"""Descent of the potential on the manifold of configurations whose tip keeps a constraint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.collision.swept import FLOOR, SELF_MARGIN, swept_world
from guidefield.kernels.guide.descent import (
    ENDED,
    REACHED,
    SHARE,
    TRIAL,
    UNDECIDED,
    Settings,
    descend as descend_kernel,
)
from guidefield.kernels.guide.tip_constraint import COUNTS, EVALUATIONS, JUDGED, STEPS, TipConstraint, TipGuard
from guidefield.planner.guide.guided_path import GuidedPath
from guidefield.planner.guide.settings import DESCENT
from guidefield.read_only import ReadOnly
from guidefield.robot.group.mover import mover_of, planned_values
from guidefield.robot.model.spaces import Configuration


@dataclass(frozen=True, eq=False)
class Descent(ReadOnly):
    """Where a descent ended.

    Attributes:
        path: The configurations accepted on the way, without the first.
        potentials: U at the first and at each of them [m].
    """

    path: tuple[Configuration, ...]
    potentials: tuple[float, ...]

    @property
    def potential(self) -> float:
        """U at the end [m]."""
        return self.potentials[-1]


def settings_of(guided: GuidedPath, tolerance: float) -> Settings:
    """How descents go, for the kernels."""
    exact = int(swept_world(guided.problem.world).exact)
    return Settings(
        regularization=DESCENT.regularization,
        on_constraint=DESCENT.on_constraint,
        tolerance=tolerance,
        fine=DESCENT.fine,
        close=DESCENT.close,
        margin=guided.margin,
        self_margin=SELF_MARGIN,
        floor=FLOOR,
        exact=exact,
    )


def descend(
    guided: GuidedPath,
    constraint: TipConstraint,
    guard: TipGuard,
    tolerance: float = DESCENT.tolerance,
    most_steps: int = DESCENT.most_steps,
) -> Descent:
    """Reduce U while the tip keeps a constraint, from where a guided path stands; it takes no step itself.

    Args:
        guided: The robot, on the constraint; it judges motions.
        constraint: What the tip has to keep.
        guard: Where the tip may be.
        tolerance: It ends where a step promises, or brings, less than this share of U.
        most_steps: It ends after so many steps.
    """
    problem, group = guided.problem, guided.problem.group
    swept, field = swept_world(problem.world), problem.robot_field
    q, planned, longest = group.expand(guided.q), planned_values(group), 1.0
    path: list[Configuration] = []
    potentials: list[float] = []
    trial, counts = np.empty(TRIAL), np.zeros(COUNTS, np.int64)
    while True:
        found = np.empty((min(DESCENT.at_once, most_steps - len(path)), len(q)))
        values = np.empty(len(found) + 1)
        answer = descend_kernel(
            mover_of(group), field.charged, field.tables, swept.robot, swept.tables, constraint, guard,
            settings_of(guided, tolerance), q, longest, found, values, trial, counts,
        )  # fmt: skip
        steps = int(counts[STEPS])
        field.evaluations += int(counts[EVALUATIONS])
        problem.counters.collision_checks += int(counts[JUDGED])
        path += [row[planned] for row in found[:steps]]
        potentials += [float(value) for value in values[min(1, len(potentials)) : steps + 1]]
        q, longest = found[steps - 1] if steps else q, 1.0
        if answer == UNDECIDED:
            before = potentials[-1]
            if guided.judged(path[-1] if path else guided.q, found[steps][planned]):
                q = found[steps]
                path.append(q[planned])
                potentials.append(float(trial[REACHED]))
                if before - potentials[-1] < tolerance * before and guided.keeps(path[-1], path[-1], DESCENT.close):
                    answer = ENDED
            else:
                longest = 0.5 * float(trial[SHARE])
        if answer == ENDED or len(path) >= most_steps or problem.deadline.expired():
            break
    problem.counters.iterations += len(path)
    return Descent(tuple(path), tuple(potentials))
