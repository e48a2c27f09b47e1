"""Inverse kinematics: distinct configurations of a planning group that bring its tip to a pose, far from each other."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.kernels.kinematics.inverse_kinematics import distinct, farthest_apart
from guidefield.read_only import ReadOnly
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.ik.pose_search import SEARCH, PoseSearch, PoseTarget
from guidefield.robot.ik.unreachable import Cause, Unreached, out_of_reach, why_unreached
from guidefield.robot.model.spaces import ChartPoint, ChartPoints

Accept = Callable[[ChartPoints], np.ndarray]
"""Which of some chart points, shape (n, nv), may be solutions: shape (n,), bool."""

Refine = Callable[[ChartPoints], ChartPoints]
"""Moves chart points, shape (n, nv), to others."""


@dataclass(frozen=True, eq=False)
class IkResult(ReadOnly):
    """The solutions of inverse kinematics.

    Attributes:
        solutions: Chart points (nv,) of distinct configurations in the limits and accepted; first those reached from
            the given starts, in their order, then each as far as can be from those before.
        reason: Why there are fewer than asked for; else empty.
        details: The values in the reason.
        rejected: Those found that were not accepted.
        cause: The obstacle if nothing was found, not even something that was not accepted.
        exhausted: Whether nothing was accepted, the last starts led to nothing new, and all that was found is in
            `rejected`: the same search with another rule for what is accepted finds the same.
    """

    solutions: tuple[ChartPoint, ...]
    reason: str
    details: dict[str, Any] = field(default_factory=dict)
    rejected: tuple[ChartPoint, ...] = ()
    cause: Cause | None = None
    exhausted: bool = False

    @classmethod
    def unreached(cls, why: Unreached) -> IkResult:
        """Nothing found, and why."""
        return cls((), why.reason, why.details, cause=why.cause)


def solve(
    group: PlanningGroup,
    target: PoseTarget,
    starts: Sequence[ChartPoint],
    count: int,
    *,
    rng: np.random.Generator,
    refine: Refine | None = None,
    accept: Accept | None = None,
    fault: str = "in collision",
    most: int = SEARCH.most_rejected,
    deadline: Deadline = UNLIMITED,
) -> IkResult:
    """Find distinct configurations of a group that bring its tip to a pose.

    Descents from the given starts and then from random ones, several at once, until there are enough to choose those
    that lie far from each other. Configurations that differ by whole turns alone count as one until there are no
    others. Joints that don't move the tip are as in the first start. Nothing is proved where nothing is found, except
    what is out of reach.

    Args:
        group: The joints that may move; its `tip` is brought to the target.
        target: The pose.
        starts: Chart points to start from, each of shape (nv,).
        count: How many solutions to look for.
        rng: The same state gives the same solutions.
        refine: Moves configurations that reach the target, shape (n, nv), to better ones that do.
        accept: Decides which configurations may be a solution.
        fault: What is wrong with those that may not, for the reason.
        most: Random starts after which a pose counts as reachable only by what isn't accepted.
        deadline: Ends the search between rounds.
    """
    given = cast(ChartPoints, np.array(starts).reshape(-1, group.nv))
    base = given[0] if len(given) else group.chart(group.part_of(group.q_reference))
    search = PoseSearch(group, target, base)
    if (short := out_of_reach(search.chain, target)) is not None:
        return IkResult.unreached(short)
    found = _Found(search, refine, accept)
    found.add(search.descend(given))
    from_starts = len(found.accepted)
    drawn = 0
    while not (_enough(found, count, drawn, most) or deadline.expired()):
        size = (
            SEARCH.first_round
            if count == 1 and drawn < SEARCH.round
            else SEARCH.large_round
            if drawn >= SEARCH.large_round
            else SEARCH.round
        )
        found.add(search.near_base(search.descend(search.drawn(size, rng))))
        drawn += size
    tried = f"{len(starts) + drawn} starts"
    rejected = tuple(found.rejected)
    if not len(found.accepted) and not rejected:
        return IkResult.unreached(why_unreached(group, target, search, tried, rng))
    if not len(found.accepted):
        details = {"cause": fault, "solutions": len(rejected)}
        more = "at least " if len(rejected) == SEARCH.most_kept else ""
        reason = f"{more}{_solutions(len(rejected))} from {tried}, all {fault}"
        exhausted = not found.fresh and len(rejected) < SEARCH.most_kept
        return IkResult((), reason, details, rejected, exhausted=exhausted)
    chosen = _choose(search, found.accepted, from_starts, len(starts) > 0, count)
    solutions = tuple(chosen)
    if len(solutions) == count:
        return IkResult(solutions, "", rejected=rejected)
    others = f", {len(rejected)} more {'is' if len(rejected) == 1 else 'are'} {fault}" if rejected else ""
    return IkResult(solutions, f"{_solutions(len(solutions))} from {tried}{others}", rejected=rejected)


class _Found:
    """Distinct solutions, accepted (n, nv) and at most `SEARCH.most_kept` rejected ones; `fresh` were added last."""

    def __init__(self, search: PoseSearch, refine: Refine | None, accept: Accept | None) -> None:
        self._measure, self._refine, self._accept = search.chain.measure, refine, accept
        self.accepted = self.rejected = cast(ChartPoints, np.empty((0, len(search.base))))
        self.fresh = 0

    def add(self, ends: ChartPoints) -> None:
        """Take those ends of descents, shape (k, nv), that are like none before."""
        before = len(self.accepted) + len(self.rejected)
        if self._refine is not None:
            known = np.concatenate([self.accepted, self.rejected])
            ends = self._refine(cast(ChartPoints, self._with(known, ends)[len(known) :]))
        free = np.ones(len(ends), bool)
        if self._accept is not None and len(ends):
            free = self._accept(ends)
        self.accepted = self._with(self.accepted, ends[free])
        if len(self.rejected) < SEARCH.most_kept:
            self.rejected = self._with(self.rejected, ends[~free])[: SEARCH.most_kept]
        self.fresh = len(self.accepted) + len(self.rejected) - before

    def _with(self, known: ChartPoints, others: ChartPoints) -> ChartPoints:
        """Distinct points (n, nv) with those of others (k, nv) that are like none before."""
        points = np.concatenate([known, others])
        kept = np.empty(len(points), np.int64)
        distinct_ones: ChartPoints = points[kept[: distinct(self._measure, points, len(known), kept)]]
        return distinct_ones


def _enough(found: _Found, count: int, drawn: int, most: int) -> bool:
    accepted, rejected = len(found.accepted), len(found.rejected)
    if not accepted and not rejected:
        return drawn >= SEARCH.most_unreached
    if not accepted:
        return drawn >= most or (drawn >= SEARCH.most_unreached and not found.fresh and rejected < SEARCH.most_kept)
    if count == 1 or accepted >= SEARCH.choice * count or drawn >= SEARCH.most_per_solution * count:
        return True
    return drawn >= SEARCH.round and not found.fresh


def _choose(search: PoseSearch, points: ChartPoints, from_starts: int, nearest: bool, count: int) -> list[ChartPoint]:
    """Choose some of chart points (n, nv), far from each other; then the same by whole turns.

    The first `from_starts` are chosen anyway; without such the nearest to the base, if `nearest`.
    """
    if nearest and from_starts == 0:
        first = int(np.argmin(np.linalg.norm((points - search.base) / search.chain.measure.units, axis=1)))
        points = np.concatenate([points[first : first + 1], np.delete(points, first, axis=0)])
    order = np.empty(min(count, len(points)), np.int64)
    farthest_apart(search.chain.measure, points, max(from_starts, 1), order)
    chosen = list(points[order])
    for z in chosen.copy():
        if len(chosen) == count:
            break
        same = (np.array(values) for values in itertools.product(*search.turned(z)))
        others = (other for other in same if np.abs(other - z).max() > 1.0)
        chosen += itertools.islice(others, count - len(chosen))
    return chosen


def _solutions(count: int) -> str:
    return f"{count} distinct solution{'' if count == 1 else 's'}"
