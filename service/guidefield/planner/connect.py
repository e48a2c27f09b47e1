"""Connect two configurations: the straight motion, else a tree, then shortcuts; certified if that is asked for.

The tree grows on the lane kernels where they know the robot and the scene (`LaneTree`), else on Coal (`SampledTree`).
Both judge motions by samples only: what they find is a proposal to the certificate. A proposal of the lanes that is
relaxed anyway need not be certified before: relaxing moves it away from where samples overlooked something.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from guidefield.collision.certificate import Verdict, motion_free
from guidefield.collision.lanes import Lanes
from guidefield.errors import Status
from guidefield.planner import lane_tree, tree
from guidefield.planner.problem import Problem
from guidefield.planner.trace import Step, TreeGrown

LANE_RESOLUTION, LANE_ATTEMPTS, LANE_FINER = 32.0, 6, 2.0
"""Samples per length [1/rad or 1/m] by which a tree on lanes judges a motion; how often the certificate may refuse what
it found; how much finer it looks then."""

LANE_MARGIN = 2e-3
"""What shortcuts on lanes keep from obstacles beside the clearance asked for [m]: they end where they graze something,
and samples overlook corners; with it the certificate refuses a tenth as many paths, 0.5 % longer ones."""

SAMPLED_RESOLUTION, SAMPLED_ATTEMPTS, SAMPLED_FINER = 20.0, 3, 4.0
"""The same for a tree on Coal."""

SHORTCUTS = 60
"""Shortcuts tried on a path that the tree found."""


@dataclass(frozen=True, eq=False)
class Connection:
    """What came of a connection.

    Attributes:
        status: SUCCESS, or PLANNING_FAILED, TIMED_OUT, PREEMPTED.
        message: One sentence for a person.
        path: Chart points (n, nv) from start to a goal if it succeeded, else only the start.
        proven: Whether the path is certified, not only free at samples.
    """

    status: Status
    message: str
    path: np.ndarray
    proven: bool = True


def connect(
    problem: Problem, z_start: np.ndarray, goals: np.ndarray, rng: np.random.Generator, *, prove: bool = True
) -> Connection:
    """Find a free motion from a chart point to one of several.

    Args:
        problem: Robot, world and budget.
        z_start: Chart point, shape (nv,), free.
        goals: Chart points, shape (m, nv), free.
        rng: Randomness of the tree and the shortcuts.
        prove: Whether the motion must be certified; if not, one that lanes found free at samples is enough.

    Returns:
        What the tree found is shortened.
    """
    prove = prove or problem.lanes is None
    near = np.array([problem.group.unwrapped(goal, z_start) for goal in goals])
    for goal in near[np.argsort(np.linalg.norm(near - z_start, axis=1))]:
        way = np.array([z_start, goal])
        if problem.lanes is not None and not problem.lanes.free_until(way, LANE_RESOLUTION, problem.min_clearance):
            continue
        if not prove or _certified(problem, z_start, goal).free:
            return Connection(Status.SUCCESS, "the straight motion is free", way, prove)
    proposer: Proposer = SampledTree(problem) if problem.lanes is None else LaneTree(problem, problem.lanes)
    resolution = proposer.resolution
    for _ in range(proposer.attempts):
        before = problem.counters.iterations
        found = proposer.propose(z_start[None], goals, resolution, rng)
        if found is None:
            break
        if not prove or all(_certified(problem, a, b).free for a, b in pairwise(found)):
            for z in found[1:]:
                problem.tell(Step("tree", problem.group.from_chart(z), "found by the tree"))
            iterations = problem.counters.iterations - before
            short = proposer.shortened(found, rng)
            return Connection(Status.SUCCESS, f"found by a tree in {iterations} iterations", short, prove)
        resolution *= proposer.finer
    spent = problem.budget.spent()
    if spent is not None:
        return Connection(spent, "no connection was found in time", z_start[None])
    return Connection(Status.PLANNING_FAILED, "the tree search ended without a connection", z_start[None])


def shortcut(problem: Problem, path: np.ndarray, rng: np.random.Generator, tries: int = SHORTCUTS) -> np.ndarray:
    """Shorten a path by straight motions between random places on it, each certified.

    Args:
        problem: Robot, world and budget.
        path: Chart points, shape (n, nv).
        rng: Randomness.
        tries: How many places are tried.
    """
    points = [point.copy() for point in path]
    for _ in range(tries):
        if len(points) < 3 or problem.budget.spent():
            break
        lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
        low, high = np.sort(rng.uniform(0.0, lengths[-1], 2))
        first, last = (int(np.searchsorted(lengths, s, side="right")) - 1 for s in (low, high))
        last = min(last, len(points) - 2)
        if first == last:
            continue
        a, b = (
            points[i] + (s - lengths[i]) / max(lengths[i + 1] - lengths[i], 1e-12) * (points[i + 1] - points[i])
            for i, s in ((first, low), (last, high))
        )
        if _certified(problem, a, b).free:
            points = [*points[: first + 1], a, b, *points[last + 1 :]]
    kept = [points[0]]
    kept += [point for point in points[1:-1] if np.linalg.norm(point - kept[-1]) > 1e-6]
    return np.array([*kept, points[-1]])


def _certified(problem: Problem, z0: np.ndarray, z1: np.ndarray) -> Verdict:
    verdict = motion_free(problem.world, z0, z1, problem.min_clearance)
    problem.counters.collision_checks += verdict.evaluations
    return verdict


class Proposer(Protocol):
    """Finds paths that are free by samples."""

    resolution: float
    attempts: int
    finer: float

    def propose(
        self, starts: np.ndarray, goals: np.ndarray, resolution: float, rng: np.random.Generator
    ) -> np.ndarray | None:
        """Chart points (n, nv) from one of some starts (k, nv) to one of some goals (m, nv); None if none was found."""
        ...

    def shortened(self, path: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """A certified path (n, nv) made shorter, certified too."""
        ...


class LaneTree:
    """Trees on the lane kernels."""

    resolution, attempts, finer = LANE_RESOLUTION, LANE_ATTEMPTS, LANE_FINER

    def __init__(self, problem: Problem, lanes: Lanes) -> None:
        self._problem = problem
        self._lanes = lanes

    def propose(
        self, starts: np.ndarray, goals: np.ndarray, resolution: float, rng: np.random.Generator
    ) -> np.ndarray | None:
        """See `Proposer`, with the same shapes."""
        problem = self._problem
        found = lane_tree.grow(self._lanes, starts, goals, resolution, problem.min_clearance, rng, problem.budget)
        problem.counters.iterations += found.iterations
        problem.counters.collision_checks += found.motions
        problem.tell(TreeGrown(found.trees))
        if found.path is None:
            return None
        return self._lanes.shortened(found.path, resolution, problem.min_clearance + LANE_MARGIN)

    def shortened(self, path: np.ndarray, rng: np.random.Generator) -> np.ndarray:  # noqa: ARG002 - lanes need none
        """See `Proposer`: what was proposed, shape (n, nv), is as short as lanes make it."""
        return path


class SampledTree:
    """Trees that ask Coal at each sample: any kind of joint and shape, and slow."""

    resolution, attempts, finer = SAMPLED_RESOLUTION, SAMPLED_ATTEMPTS, SAMPLED_FINER

    def __init__(self, problem: Problem) -> None:
        self._problem = problem

    def propose(
        self, starts: np.ndarray, goals: np.ndarray, resolution: float, rng: np.random.Generator
    ) -> np.ndarray | None:
        """See `Proposer`, with the same shapes."""
        problem = self._problem
        free = _Sampled(problem, 1.0 / resolution).free
        found = tree.grow(problem.group, starts, goals, free, rng, problem.budget)
        problem.counters.iterations += found.iterations
        problem.tell(TreeGrown(found.trees))
        return None if found.path is None else np.array(found.path)

    def shortened(self, path: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """See `Proposer`, with the same shapes."""
        return shortcut(self._problem, path, rng)


class _Sampled:
    """Judges straight motions by samples: quick, and only ever a proposal to the certificate."""

    def __init__(self, problem: Problem, resolution: float) -> None:
        self._problem = problem
        self._resolution = resolution

    def free(self, z0: np.ndarray, z1: np.ndarray) -> bool:
        """Whether no sample of the motion is in collision: the far end first, then ever finer between."""
        world, group = self._problem.world, self._problem.group
        count = max(1, int(np.ceil(np.linalg.norm(z1 - z0) / self._resolution)))
        for step in _spread(count):
            self._problem.counters.collision_checks += 1
            if world.in_collision(group.from_chart(z0 + step / count * (z1 - z0))):
                return False
        return True


def _spread(count: int) -> list[int]:
    """1 .. count in an order that looks everywhere coarsely before it looks anywhere finely."""
    order, stride, seen = [count], 1, {count}
    while stride < count:
        stride *= 2
    while stride >= 1:
        for step in range(stride, count, stride):
            if step not in seen:
                seen.add(step)
                order.append(step)
        stride //= 2
    return order
