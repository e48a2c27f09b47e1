"""Tree search on the lane kernels, for groups all of whose joints have one degree of freedom."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from guidefield.collision.lanes import Lanes
from guidefield.kept import kept_with
from guidefield.kernels import lane_tree as kernel
from guidefield.kernels.lane_branch import joined
from guidefield.kernels.lanes import LANES
from guidefield.kernels.packing import Words, packed
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
        search: Its trees, until this thread begins another search.
    """

    path: np.ndarray | None
    iterations: int
    motions: int
    search: kernel.Search

    def trees(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """Of both trees, chart points of the nodes, shape (n, nv), and each one's parent, shape (n,); -1 for a root."""
        search = self.search
        nodes = search.nodes[:-LANES].reshape(2, search.nv, search.capacity)
        parents = search.parents.reshape(2, search.capacity)
        sizes = search.counters[[kernel.SIZE, kernel.SIZE + 1]].tolist()
        return tuple(
            (nodes[tree, :, :size].T.astype(float), parents[tree, :size].copy()) for tree, size in enumerate(sizes)
        )


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
    nv: int = lanes.world.group.nv
    sampling, sources = _sampling(lanes.world.group)
    room = _room(nv, max(FIRST_CAPACITY, 2 * max(len(starts), len(goals))))
    room.begin((starts, goals), rng.random(nv))
    counters = room.search.counters
    lanes.forget()
    while counters[kernel.ITERATION] < MOST_ITERATIONS and budget.spent() is None:
        ended = kernel.grow(lanes.words, sources, room.words, clearance, resolution, PIECE)
        if ended == kernel.FULL:
            room = room.roomier()
        if ended == kernel.MET:
            path = _joined(room, sampling, sources, starts, goals)
            return Found(path, int(counters[kernel.ITERATION]), int(counters[kernel.MOTIONS]), room.search)
    return Found(None, int(counters[kernel.ITERATION]), int(counters[kernel.MOTIONS]), room.search)


@kept_with
def _sampling(group: PlanningGroup) -> tuple[kernel.Sampling, Words]:
    """The box that samples of a group fill, and that packed."""
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
    sampling = kernel.Sampling(_steps(group.nv), lower, upper - lower, period, frequency)
    for array in sampling:
        array.setflags(write=False)
    return sampling, packed(sampling)


def _steps(count: int) -> np.ndarray:
    """Steps of the additive recurrence that fills a box of so many sides evenly (M. Roberts 2018).

    They are the powers of 1 / g, where g > 1 solves g^(n + 1) = g + 1.
    """
    g = 2.0
    for _ in range(64):
        g = (1.0 + g) ** (1.0 / (count + 1.0))
    steps: np.ndarray = g ** -np.arange(1.0, count + 1.0)
    return steps


@dataclass(frozen=True, eq=False)
class _Room:
    """Memory of two trees.

    Attributes:
        search: The trees.
        words: Those packed.
    """

    search: kernel.Search
    words: Words

    @classmethod
    def build(cls, nv: int, capacity: int) -> _Room:
        """Room for so many nodes in each tree."""
        # sixteen more: the nearest node is looked for sixteen at a time
        search = kernel.Search(
            nv=nv,
            capacity=capacity,
            nodes=np.zeros(2 * nv * capacity + LANES, np.float32),
            parents=np.full(2 * capacity, -1, np.int64),
            domains=np.full(2 * capacity, np.inf, np.float32),
            places=np.zeros(nv),
            counters=np.zeros(kernel.COUNTERS, np.int64),
            sample=np.zeros(nv, np.float32),
            target=np.zeros(nv, np.float32),
            origin=np.zeros(nv, np.float32),
            reached=np.zeros(nv, np.float32),
        )
        return cls(search, packed(search))

    def begin(self, roots: tuple[np.ndarray, np.ndarray], shift: np.ndarray) -> None:
        """Leave only the roots (k, nv) of both trees, and begin a sequence of samples that is shifted by (nv,)."""
        search = self.search
        search.places[:] = shift
        search.counters[:] = 0
        search.counters[kernel.ACTIVE] = 1
        nodes = search.nodes[:-LANES].reshape(2, search.nv, search.capacity)
        for tree in range(2):
            first, size = tree * search.capacity, len(roots[tree])
            search.counters[kernel.SIZE + tree] = size
            nodes[tree, :, :size] = roots[tree].T
            search.parents[first : first + size] = -1
            search.domains[first : first + size] = np.inf

    def roomier(self) -> _Room:
        """The same trees with room for twice as many nodes."""
        nv, capacity = self.search.nv, self.search.capacity
        larger = _Room.build(nv, 2 * capacity)
        for name in ("nodes", "parents", "domains"):
            ours, theirs = getattr(self.search, name), getattr(larger.search, name)
            rows = 2 * nv if name == "nodes" else 2
            theirs[: 2 * rows * capacity].reshape(rows, 2 * capacity)[:, :capacity] = ours[: rows * capacity].reshape(
                rows, capacity
            )
        kept = {name: getattr(self.search, name) for name in ("places", "counters")}
        search = larger.search._replace(**kept)
        return _Room(search, packed(search))


class _Rooms(threading.local):
    """The memory that a thread's searches begin in: to make it takes longer than to find a simple path."""

    def __init__(self) -> None:
        self.kept: dict[int, _Room] = {}


_ROOMS = _Rooms()


def _room(nv: int, capacity: int) -> _Room:
    """Room for trees with so many nodes each; that of the usual size is the thread's."""
    if capacity != FIRST_CAPACITY:
        return _Room.build(nv, capacity)
    room = _ROOMS.kept.get(nv)
    if room is None or room.search.capacity != capacity:
        room = _ROOMS.kept[nv] = _Room.build(nv, capacity)
    return room


def _joined(
    room: _Room, sampling: kernel.Sampling, sources: Words, starts: np.ndarray, goals: np.ndarray
) -> np.ndarray:
    """The path through where the trees met; they hold float32, so the roots are put back as they were given."""
    counters = room.search.counters
    rows = np.empty((counters[kernel.SIZE] + counters[kernel.SIZE + 1], room.search.nv))
    path = rows[: joined(sources, room.words, rows)].copy()
    goal = goals[counters[kernel.ROOT + 1]]
    turns = np.rint((path[-1] - goal) * sampling.frequency)
    path[0], path[-1] = starts[counters[kernel.ROOT]], goal + 2.0 * np.pi * turns
    return path
