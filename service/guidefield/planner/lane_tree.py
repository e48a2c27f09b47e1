"""Tree search on the lane kernels, for groups all of whose joints have one degree of freedom."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.collision.lanes import Lanes
from guidefield.kept import kept_with
from guidefield.kernels import lane_tree as kernel
from guidefield.kernels.lanes import LANES
from guidefield.kernels.packing import packed
from guidefield.planner.problem import Budget
from guidefield.robot.chart import ANGLE
from guidefield.robot.group import ROAM, PlanningGroup

MOST_ITERATIONS = 200_000

PIECE = 256
"""Iterations between two looks at the budget: some milliseconds."""

FIRST_CAPACITY = 512
"""Nodes that each tree has room for at first; doubled when it is full."""


@dataclass(frozen=True, eq=False)
class Found:
    """What a search came to.

    Attributes:
        path: Chart points (n, nv) from a start to a goal, angles unwrapped along the way; None if there is none.
        iterations: Samples drawn.
        motions: Straight motions judged.
    """

    path: np.ndarray | None
    iterations: int
    motions: int


def grow(
    lanes: Lanes,
    starts: np.ndarray,
    goals: np.ndarray,
    resolution: float,
    clearance: float,
    rng: np.random.Generator,
    budget: Budget,
) -> Found:
    """Grow two trees towards each other until they meet.

    Args:
        lanes: Robot and obstacles.
        starts: Roots of the one tree, shape (k, nv), free.
        goals: Roots of the other, shape (m, nv), free.
        resolution: Samples of a motion per length in the chart [1/rad or 1/m].
        clearance: What to keep from obstacles [m].
        rng: Shifts the sequence of samples.
        budget: How long.
    """
    group = lanes.world.group
    sampling = _sampling(group)._replace(shift=rng.random(group.nv))
    sources = packed(sampling)
    search = _search((starts, goals), max(FIRST_CAPACITY, 2 * max(len(starts), len(goals))))
    trees, counters = packed(search), search.counters
    lanes.forget()
    while counters[kernel.ITERATION] < MOST_ITERATIONS and budget.spent() is None:
        ended = kernel.grow(lanes.words, sources, trees, clearance, resolution, PIECE)
        if ended == kernel.FULL:
            search = _roomier(search)
            trees = packed(search)
        if ended == kernel.MET:
            first, second = (_branch(search, tree) for tree in range(2))
            path = _joined(group, first, second, starts, goals)
            return Found(path, int(counters[kernel.ITERATION]), int(counters[kernel.MOTIONS]))
    return Found(None, int(counters[kernel.ITERATION]), int(counters[kernel.MOTIONS]))


@kept_with
def _sampling(group: PlanningGroup) -> kernel.Sampling:
    """The box that samples of a group fill, not shifted."""
    lower, upper, period = group.lower.copy(), group.upper.copy(), np.zeros(group.nv, np.float32)
    origin = group.chart(group.q_origin)
    for joint in group.joints:
        at = joint.idx_v
        if joint.kind in ANGLE:
            period[at] = 2.0 * np.pi
        if not np.isfinite(upper[at] - lower[at]):
            reach = np.pi if joint.kind in ANGLE else ROAM
            lower[at], upper[at] = origin[at] - reach, origin[at] + reach
    with np.errstate(divide="ignore"):
        frequency = np.where(period > 0.0, 1.0 / period, 0.0).astype(np.float32)
    sampling = kernel.Sampling(_primes(group.nv), np.zeros(group.nv), lower, upper - lower, period, frequency)
    for array in sampling:
        array.setflags(write=False)
    return sampling


def _primes(count: int) -> np.ndarray:
    primes: list[int] = []
    number = 2
    while len(primes) < count:
        if all(number % prime for prime in primes):
            primes.append(number)
        number += 1
    return np.array(primes, np.int64)


def _search(roots: tuple[np.ndarray, np.ndarray], capacity: int) -> kernel.Search:
    nv = roots[0].shape[1]
    # sixteen more: the nearest node is looked for sixteen at a time
    nodes = np.zeros(2 * nv * capacity + LANES, np.float32)
    counters = np.zeros(kernel.COUNTERS, np.int64)
    counters[kernel.ACTIVE] = 1
    for tree in range(2):
        counters[kernel.SIZE + tree] = len(roots[tree])
        nodes[tree * nv * capacity : (tree + 1) * nv * capacity].reshape(nv, capacity)[:, : len(roots[tree])] = roots[
            tree
        ].T
    return kernel.Search(
        nv=nv,
        capacity=capacity,
        nodes=nodes,
        parents=np.full(2 * capacity, -1, np.int64),
        domains=np.full(2 * capacity, np.inf, np.float32),
        digits=np.tile(np.array([0, 1], np.int64), nv),
        counters=counters,
        sample=np.zeros(nv, np.float32),
        target=np.zeros(nv, np.float32),
        origin=np.zeros(nv, np.float32),
        reached=np.zeros(nv, np.float32),
    )


def _roomier(search: kernel.Search) -> kernel.Search:
    """The same search with room for twice as many nodes."""
    capacity, nv = search.capacity, search.nv
    nodes = np.zeros(4 * nv * capacity + LANES, np.float32)
    nodes[:-LANES].reshape(2 * nv, 2 * capacity)[:, :capacity] = search.nodes[:-LANES].reshape(2 * nv, capacity)
    parents, domains = np.full((2, 2 * capacity), -1, np.int64), np.full((2, 2 * capacity), np.inf, np.float32)
    parents[:, :capacity] = search.parents.reshape(2, capacity)
    domains[:, :capacity] = search.domains.reshape(2, capacity)
    return search._replace(capacity=2 * capacity, nodes=nodes, parents=parents.ravel(), domains=domains.ravel())


def _branch(search: kernel.Search, tree: int) -> tuple[int, np.ndarray]:
    """A tree's root that leads to where the trees met, and the chart points (n, nv) from it."""
    capacity, nv = search.capacity, search.nv
    nodes = search.nodes[:-LANES].reshape(2, nv, capacity)[tree]
    index = int(search.counters[kernel.MEETING + tree])
    indices = []
    while index >= 0:
        indices.append(index)
        index = int(search.parents[tree * capacity + index])
    return indices[-1], nodes[:, indices[::-1]].T.astype(float)


def _joined(
    group: PlanningGroup,
    first: tuple[int, np.ndarray],
    second: tuple[int, np.ndarray],
    starts: np.ndarray,
    goals: np.ndarray,
) -> np.ndarray:
    """The branch from the start and that from the goal as one path; whole turns are added to the second.

    Trees hold float32: the roots are put back as they were given.
    """
    points = list(first[1])
    points[0] = starts[first[0]]
    rest = list(second[1])
    rest[0] = goals[second[0]]
    # the trees met where a step of the second towards the first one's last point would end
    for point in rest[::-1]:
        points.append(group.unwrapped(point, points[-1]))
    return np.array(points)
