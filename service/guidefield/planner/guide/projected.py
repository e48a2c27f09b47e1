"""Projected, a `Minimizer` (rounds.py) for any joints: it descends on the manifold of configurations on a plane.

Kernels take its steps by the same settings, alone or in whole rounds (kernels/guide). A step is taken if it is free, so
the constants change success, clearance and time; service/docs/algorithm.md repeats most of them.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from guidefield.collision.swept import SELF_MARGIN, SWEPT_RESOLUTION, swept_world
from guidefield.kernels.guide.descent import (
    ENDED,
    REACHED,
    SHARE,
    TRIAL,
    UNDECIDED,
    Settings,
    descend as descend_kernel,
)
from guidefield.kernels.guide.tip_constraint import (
    COUNTS,
    EVALUATIONS,
    HELD,
    JUDGED,
    ON_PLANE,
    SLIDING,
    STEPS,
    TipConstraint,
    TipGuard,
)
from guidefield.planner.guide.guided_path import GuidedPath, reach_point
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.trace import StepKind
from guidefield.read_only import ReadOnly
from guidefield.robot.group.kinematics import find_planned_values, mover_of
from guidefield.robot.model.spaces import Configuration

# share of the metric's mean diagonal added to it. In the thesis' scenes symmetric links spin with less, and 0.1 is too
# stiff
REGULARIZATION = 1e-2
ON_CONSTRAINT = 1e-5  # largest distance of a trial from its constraint [m or rad]: a tenth of `rounds.ON_PLANE`
# a descent ends where a step promises, or brings, less than this share of U. More costs half of the clearance, less 3
# to 7 times the time
TOLERANCE = 1e-3
# where the robot is nearer to obstacles than this when it would end, it goes on .. [m]. The blocked passage keeps 15 mm
# with it, 11.6 without
CLOSE = 0.015
FINE = 1e-4  # .. with this tolerance: there the last thousandth of U is millimetres of clearance
MOST_STEPS = 60  # it ends after this many steps. Unrecorded
STEPS_AT_ONCE = 20  # steps between two checks of the deadline. Unrecorded
MOST_ROUNDS = 6  # of slide and reorient on one plane. Unrecorded
NEGLIGIBLE = 2e-3  # such rounds end where U falls by less than this share. Unrecorded


@dataclass(frozen=True, eq=False)
class Descent(ReadOnly):
    """The steps of a descent."""

    path: tuple[Configuration, ...]
    potentials: tuple[float, ...]  # U at the first and at each of them [m]

    @property
    def potential(self) -> float:
        """U at the end [m]."""
        return self.potentials[-1]


def settings_of(guided: GuidedPath, tolerance: float) -> Settings:
    """The settings of descents, for the kernels."""
    exact, size = int(swept_world(guided.problem.world).exact), guided.size
    return Settings(
        regularization=REGULARIZATION,
        on_constraint=ON_CONSTRAINT * size,
        tolerance=tolerance,
        fine=FINE,
        close=CLOSE * size,
        margin=guided.margin,
        self_margin=SELF_MARGIN * size,
        floor=SWEPT_RESOLUTION * size,
        exact=exact,
    )


def descend(
    guided: GuidedPath,
    constraint: TipConstraint,
    guard: TipGuard,
    tolerance: float = TOLERANCE,
    most_steps: int = MOST_STEPS,
) -> Descent:
    """Reduce U while the tip keeps a constraint, from where a guided path stands; it takes no step itself.

    Args:
        tolerance: It ends where a step promises, or brings, less than this share of U.
    """
    problem, group = guided.problem, guided.problem.group
    swept, field = swept_world(problem.world), problem.robot_field
    q, planned, longest = group.expand(guided.q), find_planned_values(group), 1.0
    path: list[Configuration] = []
    potentials: list[float] = []
    trial, counts = np.empty(TRIAL), np.zeros(COUNTS, np.int64)
    while True:
        found = np.empty((min(STEPS_AT_ONCE, most_steps - len(path)), len(q)))
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
            if guided.judge(path[-1] if path else guided.q, found[steps][planned]):
                q = found[steps]
                path.append(q[planned])
                potentials.append(float(trial[REACHED]))
                if before - potentials[-1] < tolerance * before and guided.keeps(
                    path[-1], path[-1], CLOSE * guided.size
                ):
                    answer = ENDED
            else:
                longest = 0.5 * float(trial[SHARE])
        if answer == ENDED or len(path) >= most_steps or problem.deadline.expired():
            break
    problem.counters.iterations += len(path)
    return Descent(tuple(path), tuple(potentials))


_NONE = np.eye(3)


def on_plane(point: np.ndarray, normal: np.ndarray) -> TipConstraint:
    """The tip stays on a plane, a point (3,) and a unit normal (3,) [world]: slide and reorient at once."""
    return TipConstraint(ON_PLANE, _hold(point), _hold(normal), _NONE)


def sliding(point: np.ndarray, normal: np.ndarray, rotation: np.ndarray) -> TipConstraint:
    """The tip stays on a plane, a point (3,) and a unit normal (3,), turned as (3, 3): the thesis' slide."""
    return TipConstraint(SLIDING, _hold(point), _hold(normal), _hold(rotation))


def reorienting(point: np.ndarray) -> TipConstraint:
    """The tip stays where it is, at a point (3,) [m, world]: the thesis' reorient."""
    return TipConstraint(HELD, _hold(point), _hold(np.zeros(3)), _NONE)


def _hold(values: np.ndarray) -> np.ndarray:
    return np.array(values, dtype=np.float64, order="C")


class Blocks(enum.Enum):
    """The order of slide and reorient: both at once, or in turn (a second try where the first got stuck)."""

    ONE = "one block"
    TWO = "two blocks"


@dataclass(frozen=True)
class Projected:
    """Newton's steps in the metric of nearby faces' curvature, projected on the tip's constraint."""

    blocks: Blocks = Blocks.ONE
    tolerance: float = TOLERANCE  # a descent ends where a step promises, or brings, less than this share of U
    most_steps: int = MOST_STEPS

    @property
    def name(self) -> str:
        """Its name, for reports."""
        return f"projected in {self.blocks.value}"

    def reach(self, problem: Problem, q: Configuration, point: np.ndarray) -> Iterator[Configuration]:
        """The configuration (nq,) with the tip at a point (3,) [m] that changes the joints least, if one is near."""
        reached = reach_point(problem, q, point)
        if reached is not None:
            yield reached

    def minimize(self, guided: GuidedPath, point: np.ndarray, normal: np.ndarray, guard: TipGuard) -> None:
        """Slide and reorient on a plane until U falls no more; see `Minimizer`, with the same shapes."""
        problem, group = guided.problem, guided.problem.group
        if self.blocks is Blocks.ONE:
            self._descend(guided, on_plane(point, normal), guard, StepKind.DESCEND)
            return
        before = problem.robot_field.potential(guided.q)
        for _ in range(MOST_ROUNDS):
            rotation = problem.kinematics.frame_placement(group.expand(guided.q), group.tip_id).rotation
            self._descend(guided, sliding(point, normal, rotation), guard, StepKind.SLIDE)
            after = self._descend(guided, reorienting(guided.tip), guard, StepKind.REORIENT)
            if before - after < NEGLIGIBLE * before or problem.deadline.expired():
                return
            before = after

    def _descend(self, guided: GuidedPath, constraint: TipConstraint, guard: TipGuard, kind: StepKind) -> float:
        descent = descend(guided, constraint, guard, self.tolerance, self.most_steps)
        for q, potential in zip(descent.path, descent.potentials[1:], strict=True):
            guided.take(q, kind, f"U = {potential:.4g}", potential)
        return descent.potential
