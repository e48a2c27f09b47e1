"""Rounds of advance, slide and reorient towards a guide plane (service/docs/algorithm.md, "Crossing a guide plane").

A round is made step by step, or several of them in one kernel if nothing has to be judged outside it: if `Projected`
slides and reorients at once (`Blocks.ONE`), and all shapes of the robot are capsules (`SweptWorld.exact`). Both have to
do the same: kernels/guide/plane_rounds.py, which gets the constants from here. They change clearance, success and time
of the way to a plane, and that document repeats most; `ROUNDS_PER_CHECK` leaves the way. `Unrecorded`: nobody knows
what chose a constant; measure before a change.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from guidefield.collision.swept import swept_world
from guidefield.kernels.field.field_tables import frozen
from guidefield.kernels.guide import plane_rounds as kernel
from guidefield.kernels.guide.tip_constraint import (
    COUNTS,
    EVALUATIONS,
    JUDGED,
    REFUSED,
    ROUNDS,
    STEPS,
    TipGuard,
    closest_point,
)
from guidefield.planner.guide.guided_path import COMFORTABLE, MARGINS, GuidedPath
from guidefield.planner.guide.projected import Blocks, Projected, settings_of
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.trace import StepKind
from guidefield.robot.group.kinematics import find_planned_values, mover_of
from guidefield.robot.model.spaces import Configuration
from guidefield.scene.guide_plane import SLACK, GuidePlane

SMALLEST_STEP = 0.1 / 50  # below this an advance is given up, delta_min [m], at size 1. Unrecorded
GUARD = 0.5  # share of an advance's gain that slide and reorient have to keep, 1 - beta. Unrecorded
# a tip as near to the plane counts as on it, at size 1 [m]: the accuracy that the docs promise, and ten times
# `projected.ON_CONSTRAINT`
ON_PLANE = 1e-4
SHORT_STEP = 0.1 / 4  # an advance of this length is not made again with shorter ones, at size 1 [m]. By its scenes
ROUNDS_PER_CHECK = 4  # rounds in one kernel between two checks of the deadline. Unrecorded


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
    """One round towards a guide plane, or some; the guided path takes the steps of each as it is asked for."""
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
