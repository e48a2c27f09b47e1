"""Rounds of advance, slide and reorient towards a guide plane (service/docs/algorithm.md, "Crossing a guide plane").

`Projected`, the `Minimizer` for any joints, descends on the manifold of configurations on a plane. A round is made step
by step, or several of them in one kernel if nothing is to be checked outside it: if `Projected` slides and reorients at
once (`Blocks.ONE`), and all shapes of the robot are capsules (`SweptWorld.exact`). Both ways have to do the same. The
kernels (kernels/guide/plane_rounds.py and descent.py) get the constants from here.

Steps are taken if free: the constants change clearance, success and time of the path to a plane; a tip within
`ON_PLANE` has arrived, and may end there; `ROUNDS_PER_CHECK` changes counts, and the pair that a standstill names. The
document repeats `SMALLEST_STEP`, `GUARD`, `ON_PLANE`, `REGULARIZATION`, `TOLERANCE`, `CLOSE`, `FINE`. `Unrecorded`:
nobody knows what chose a constant; measure first.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from guidefield.kernels.field.field import frozen
from guidefield.kernels.guide import plane_rounds as kernel
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
    ON_PLANE as TIP_ON_PLANE,
    REFUSED,
    ROUNDS,
    SLIDING,
    STEPS,
    TipConstraint,
    TipGuard,
    closest_point,
)
from guidefield.planner.guide.guided_path import (
    COMFORTABLE,
    MARGINS,
    SELF_MARGIN,
    SWEPT_RESOLUTION,
    GuidedPath,
    reach_point,
    swept_world,
)
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.trace import StepKind
from guidefield.read_only import ReadOnly
from guidefield.robot.group.kinematics import find_planned_values, mover_of
from guidefield.robot.model.joints import Configuration
from guidefield.scene.guide_plane import SLACK, GuidePlane

SMALLEST_STEP = 0.1 / 50  # below this an advance is given up, delta_min [m], at size 1. Unrecorded
GUARD = 0.5  # share of an advance's gain that slide and reorient have to keep, 1 - beta. Unrecorded
# a tip as near to the plane counts as on it, at size 1 [m]: the accuracy that the docs promise, and ten times
# `ON_CONSTRAINT`
ON_PLANE = 1e-4
SHORT_STEP = 0.1 / 4  # an advance of this length is not made again with shorter ones, at size 1 [m]. By its scenes
ROUNDS_PER_CHECK = 4  # rounds in one kernel between two checks of the deadline. Unrecorded
# share of the metric's mean diagonal added to it. In the thesis' scenes symmetric links spin with less, and 0.1 is too
# stiff
REGULARIZATION = 1e-2
ON_CONSTRAINT = 1e-5  # largest distance of a trial from its constraint [m or rad]: a tenth of `ON_PLANE`
# a descent ends where a step promises, or brings, less than this share of U. More costs half of the clearance, less 3
# to 7 times the time
TOLERANCE = 1e-3
# where the robot is nearer to obstacles than this when it would end, it goes on .. [m]. The blocked passage keeps 15 mm
# with it, 11.6 without
CLOSE = 0.015
FINE = 1e-4  # .. with this tolerance: there the last thousandth of U is millimetres of clearance
MOST_STEPS = 60  # it ends after this many steps. Unrecorded
STEPS_AT_ONCE = 20  # steps between two checks of the deadline, after which `FINE` gives way to `TOLERANCE`. Unrecorded
MOST_ROUNDS = 6  # of slide and reorient on one plane. Unrecorded
NEGLIGIBLE = 2e-3  # such rounds end where U falls by less than this share. Unrecorded


@dataclass(frozen=True, eq=False)
class Aim:
    """A guide plane's polygon, inset."""

    plane: GuidePlane
    inset: float  # how far inside its edges the tip heads for [m]

    def closest_point(self, point: np.ndarray) -> np.ndarray:
        """The point (3,) of the inset polygon that is closest to a point (3,) [m, world]."""
        closest = np.empty(3)
        closest_point(self.table, point, closest)
        return closest

    def distance(self, point: np.ndarray) -> float:
        """Distance of a point (3,) to the inset polygon [m]."""
        return math.dist(point, self.closest_point(point))

    def within(self, farthest: float) -> TipGuard:
        """A guard: the tip may not be farther from the inset polygon than this [m]."""
        return self.table._replace(farthest=farthest)

    def inside(self, depth: float) -> TipGuard:
        """A guard: the tip's projection on the plane may not come nearer to the polygon's edges than this [m]."""
        return self.table._replace(depth=min(depth, self.plane.inradius) - SLACK * self.plane.flat.size)

    @cached_property
    def table(self) -> TipGuard:
        """The polygon for the kernels: a guard that lets the tip be anywhere."""
        flat, inset = self.plane.flat, min(self.inset, self.plane.inradius)
        return TipGuard(
            origin=frozen(flat.origin),
            axes=frozen(flat.axes),
            inward=frozen(self.plane.inward),
            offsets=frozen(self.plane.offsets),
            corners=frozen((self.plane.inset_vertices(inset) - flat.origin) @ flat.axes.T),
            inset=inset,
            farthest=np.inf,
            depth=-np.inf,
        )


class Minimizer(Protocol):
    """Lowers the potential of the robot while its tip stays on a plane: the thesis' slide and reorient."""

    @property
    def name(self) -> str:
        """Its name, for reports."""

    def reach(self, problem: Problem, q: Configuration, point: np.ndarray) -> Iterable[Configuration]:
        """Configurations near q (nq,) whose tip is at a point (3,) [m]: those that an advance tries, in order."""

    def minimize(self, guided: GuidedPath, point: np.ndarray, normal: np.ndarray, guard: TipGuard) -> None:
        """Slide and reorient on a plane, a point (3,) and a unit normal (3,), until U falls no more.

        The guided path takes each step.
        """


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
    return TipConstraint(TIP_ON_PLANE, _hold(point), _hold(normal), _NONE)


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


@dataclass(frozen=True)
class Attempt:
    """One way of trying a plane."""

    minimizer: Minimizer
    step: float  # length of an advance at size 1 [m]
    # whether a round that comes nearer to obstacles than its ends do is made again with shorter advances
    careful: bool = False


class Round(enum.Enum):
    """The outcome of a round of advance, slide and reorient."""

    ARRIVED = "arrived"
    NEARER = "nearer"
    BLOCKED = "blocked"


@dataclass(frozen=True)
class Made:
    """A round: how it ended, and the tip's distance to the inset polygon before and after it [m]."""

    ended: Round
    before: float
    after: float


def rounds(guided: GuidedPath, aim: Aim, attempt: Attempt) -> Iterator[Made]:
    """Yield rounds towards a guide plane, one or several at once; the guided path takes the steps of each lazily."""
    minimizer = attempt.minimizer
    in_one_kernel = isinstance(minimizer, Projected) and minimizer.blocks is Blocks.ONE
    if in_one_kernel and swept_world(guided.problem.world).exact:
        assert isinstance(minimizer, Projected)
        yield from _in_kernel(guided, aim, minimizer, attempt.step * guided.size)
        return
    before = aim.distance(guided.tip)
    yield Made(approach(guided, aim, attempt), before, aim.distance(guided.tip))


def approach(guided: GuidedPath, aim: Aim, attempt: Attempt) -> Round:
    """One round towards a guide plane: advance, slide and reorient; the guided path takes every step."""
    distance, on_plane = aim.distance(guided.tip), ON_PLANE * guided.size
    if distance <= on_plane:
        return Round.ARRIVED
    direction = (aim.closest_point(guided.tip) - guided.tip) / distance
    since = len(guided.path) - 1
    step = min(attempt.step * guided.size, distance)
    smallest = min(SMALLEST_STEP * guided.size, 0.5 * distance)
    moved = guided.advance(direction, step, smallest, attempt.minimizer.reach)
    if moved.q is None:
        return Round.BLOCKED
    arrived = moved.step >= distance - on_plane
    if arrived:  # minimise in the guide plane itself, inside its polygon
        plane = aim.plane
        attempt.minimizer.minimize(guided, plane.centroid, plane.normal, aim.inside(0.5 * aim.inset))
    else:
        gained = distance - aim.distance(guided.tip)
        attempt.minimizer.minimize(guided, guided.tip, direction, aim.within(distance - GUARD * gained))
    guided.straighten(since)
    if attempt.careful and step > SHORT_STEP * guided.size and guided.dips(since):
        guided.undo(since)
        return approach(guided, aim, replace(attempt, step=0.5 * step / guided.size))
    return Round.ARRIVED if arrived else Round.NEARER


_ENDED = {kernel.NEARER: Round.NEARER, kernel.ARRIVED: Round.ARRIVED, kernel.BLOCKED: Round.BLOCKED}


def _in_kernel(guided: GuidedPath, aim: Aim, minimizer: Projected, step: float) -> Iterator[Made]:
    problem, group = guided.problem, guided.problem.group
    field, swept, q = problem.robot_field, swept_world(problem.world), group.expand(guided.q)
    rows = ROUNDS_PER_CHECK * (minimizer.most_steps + 1)
    record = kernel.Record(
        steps=np.empty((rows, len(q))), values=np.empty(rows), kinds=np.empty(rows, np.int64),
        kept=np.empty(rows, np.int64), gaps=np.empty((ROUNDS_PER_CHECK, kernel.GAPS)),
        ends=np.empty(ROUNDS_PER_CHECK, np.int64), refused=np.empty((2, len(q))), counts=np.zeros(COUNTS, np.int64),
    )  # fmt: skip
    ended = kernel.approach(
        mover_of(group), field.charged, field.tables, swept.robot, swept.tables, aim.table,
        settings_of(guided, minimizer.tolerance), _rounds_of(aim, step, guided.size), minimizer.most_steps, q, record,
    )  # fmt: skip
    counts = record.counts.tolist()
    field.evaluations += counts[EVALUATIONS]
    problem.counters.collision_checks += counts[JUDGED]
    problem.counters.iterations += counts[STEPS]
    planned = find_planned_values(group)
    guided.refused_between(*(q[planned] for q in record.refused[: counts[REFUSED]]))
    made = counts[ROUNDS]
    past = record.ends[:made].tolist()
    for k, (before, after) in enumerate(record.gaps[:made].tolist()):
        _take(guided, record, planned, past[k - 1] if k else 0, past[k])
        arrived = k == made - 1 and ended == kernel.ARRIVED
        yield Made(Round.ARRIVED if arrived else Round.NEARER, before, after)
    if ended == kernel.BLOCKED or not made:
        distance = aim.distance(guided.tip)
        yield Made(_ENDED[ended], distance, distance)


def _take(guided: GuidedPath, record: kernel.Record, planned: np.ndarray, first: int, past: int) -> None:
    rows = slice(first, past)
    steps = record.steps[rows].take(planned, axis=1)
    for q, value, kind, kept in zip(
        steps, record.values[rows].tolist(), record.kinds[rows].tolist(), record.kept[rows].tolist(), strict=True
    ):
        if kind == kernel.ADVANCED:
            guided.take(q, StepKind.ADVANCE, f"tip {1000 * value:.0f} mm towards the plane", kept=bool(kept))
        else:
            guided.take(q, StepKind.DESCEND, f"U = {value:.4g}", value, kept=bool(kept))


def _rounds_of(aim: Aim, step: float, size: float) -> kernel.Rounds:
    return kernel.Rounds(
        step=step,
        smallest=SMALLEST_STEP * size,
        guard=GUARD,
        on_plane=ON_PLANE * size,
        depth=aim.inside(0.5 * aim.inset).depth,
        comfortable=COMFORTABLE * size,
        middle=frozen(aim.plane.centroid),
        normal=frozen(aim.plane.normal),
        margins=frozen(size * np.array(MARGINS)),
    )
