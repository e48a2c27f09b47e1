"""Tree search on the lane kernels."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from guidefield.collision.lanes import Lanes
from guidefield.kernels import lane_nodes, lane_tree as kernel
from guidefield.kernels.lane_branch import joined
from guidefield.kernels.lane_buckets import buckets_for
from guidefield.kernels.lane_sieve import SIEVE
from guidefield.kernels.lanes import LANES
from guidefield.kernels.packing import Words, packed
from guidefield.planner.enclosed import can_be_left
from guidefield.planner.lane_sources import Sources, sources_of
from guidefield.planner.problem import Budget

MOST_ITERATIONS, MOST_MOTIONS = 100_000_000, 3_000_000
"""Samples that a search draws, most of which cost next to nothing, and motions that it judges."""

PIECE = 256
"""Iterations between two looks at the budget: some milliseconds."""

ENCLOSED = 20_000
"""After so many extensions of nothing but roots it is asked whether these can be left at all."""

FIRST_CAPACITY = 512
"""Nodes that each tree has room for at first; doubled when it is full."""


@dataclass(frozen=True, eq=False)
class Found:
    """What a search came to.

    Attributes:
        path: Chart points (n, nv) from a start to a goal, angles unwrapped along the way; None if there is none.
        iterations: Samples drawn.
        motions: Straight motions judged.
        sizes: Configurations of both trees.
        tried: Extensions of both trees that were judged.
        search: Its trees, until this thread begins another search.
        enclosed: Of which tree, 0 or 1, the roots can't be left, as far as many motions tell; None if nothing says so.
    """

    path: np.ndarray | None
    iterations: int
    motions: int
    sizes: tuple[int, int]
    tried: tuple[int, int]
    search: lane_nodes.Search
    enclosed: int | None = None

    @classmethod
    def by(cls, search: lane_nodes.Search, path: np.ndarray | None, enclosed: int | None = None) -> Found:
        """What a search says of itself; `path` as the attribute, shape (n, nv)."""
        counted = search.counters.tolist()
        sizes, tried = ((counted[first], counted[first + 1]) for first in (lane_nodes.SIZE, lane_nodes.TRIED))
        return cls(path, counted[lane_nodes.ITERATION], counted[lane_nodes.MOTIONS], sizes, tried, search, enclosed)

    def trees(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """Of both trees, chart points of the nodes, shape (n, nv), and each one's parent, shape (n,); -1 for a root."""
        search = self.search
        nodes = search.nodes[:-LANES].reshape(2, search.nv, search.capacity)
        parents = search.parents.reshape(2, search.capacity)
        sizes = search.counters[[lane_nodes.SIZE, lane_nodes.SIZE + 1]].tolist()
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
    *,
    within: float = np.inf,
    most_motions: int = MOST_MOTIONS,
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
        within: Samples come from where a path of at most this length [rad or m] may lead.
        most_motions: After so many motions it ends.
    """
    nv: int = lanes.world.group.nv
    sources = sources_of(lanes.world.group).about(np.concatenate([starts, goals]))
    if np.isfinite(within):
        sources = sources.between(starts, goals, within)
    room = _room(nv, max(FIRST_CAPACITY, 2 * max(len(starts), len(goals))))
    room.begin((starts, goals), rng.random(nv))
    counters = room.search.counters
    lanes.forget()
    suspected = [0, 1]
    while (
        counters[lane_nodes.ITERATION] < MOST_ITERATIONS
        and counters[lane_nodes.MOTIONS] < most_motions
        and budget.spent() is None
    ):
        ended = kernel.grow(lanes.words, sources.words, room.words, clearance, resolution, PIECE)
        if ended == kernel.FULL:
            room = room.roomier()
        if ended == kernel.MET:
            return Found.by(room.search, _joined(room, sources, starts, goals))
        tried = next((tree for tree in suspected if counters[lane_nodes.TRIED + tree] >= ENCLOSED), None)
        if tried is not None:
            suspected.remove(tried)
            roots, size = (starts, goals)[tried], counters[lane_nodes.SIZE + tried]
            if size == len(roots) and not can_be_left(lanes, roots, clearance, resolution, rng):
                return Found.by(room.search, None, tried)
    return Found.by(room.search, None)


@dataclass(frozen=True, eq=False)
class _Room:
    """Memory of two trees.

    Attributes:
        search: The trees.
        words: Those packed.
        nodes, parents, domains: What the trees hold, tree by tree: shapes (2, nv, capacity), (2, capacity) each.
    """

    search: lane_nodes.Search
    words: Words
    nodes: np.ndarray
    parents: np.ndarray
    domains: np.ndarray

    @classmethod
    def build(cls, nv: int, capacity: int) -> _Room:
        """Room for so many nodes in each tree."""
        # sixteen more: the nearest node is looked for sixteen at a time
        search = lane_nodes.Search(
            nv=nv,
            capacity=capacity,
            nodes=np.zeros(2 * nv * capacity + LANES, np.float32),
            parents=np.full(2 * capacity, -1, np.int64),
            domains=np.full(2 * capacity, np.inf, np.float32),
            failed=np.zeros(2 * capacity, np.int64),
            places=np.zeros(nv),
            counters=np.zeros(lane_nodes.COUNTERS, np.int64),
            sample=np.zeros(nv, np.float32),
            target=np.zeros(nv, np.float32),
            origin=np.zeros(nv, np.float32),
            reached=np.zeros(nv, np.float32),
            grown=np.zeros(2 * LANES, np.int64),
            ends=np.zeros(nv * LANES, np.float32),
            hits=np.full(3 * SIEVE, -1, np.int64),
            buckets=buckets_for(nv, capacity if capacity > lane_nodes.LATE else 0),
        )
        return cls.of(search)

    @classmethod
    def of(cls, search: lane_nodes.Search) -> _Room:
        """The memory of some trees."""
        nodes = search.nodes[:-LANES].reshape(2, search.nv, search.capacity)
        return cls(search, packed(search), nodes, search.parents.reshape(2, -1), search.domains.reshape(2, -1))

    def begin(self, roots: tuple[np.ndarray, np.ndarray], shift: np.ndarray) -> None:
        """Leave only the roots (k, nv) of both trees, and begin a sequence of samples that is shifted by (nv,)."""
        counters = self.search.counters
        self.search.places[:] = shift
        counters[:] = 0
        counters[lane_nodes.ACTIVE] = 1
        self.search.hits[:] = -1
        self.search.buckets.state[:] = 0
        for tree, points in enumerate(roots):
            size = len(points)
            counters[lane_nodes.SIZE + tree] = size
            self.nodes[tree, :, :size] = points.T
            self.parents[tree, :size] = -1
            self.domains[tree, :size] = np.inf
            self.search.failed.reshape(2, -1)[tree, :size] = 0

    def roomier(self) -> _Room:
        """The same trees with room for twice as many nodes."""
        capacity = self.search.capacity
        larger = _Room.build(self.search.nv, 2 * capacity)
        larger.nodes[:, :, :capacity] = self.nodes
        larger.parents[:, :capacity] = self.parents
        larger.domains[:, :capacity] = self.domains
        larger.search.failed.reshape(2, -1)[:, :capacity] = self.search.failed.reshape(2, -1)
        return _Room.of(larger.search._replace(places=self.search.places, counters=self.search.counters))


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


def _joined(room: _Room, sources: Sources, starts: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """The path through where the trees met; they hold float32, so the roots are put back as they were given."""
    counters = room.search.counters
    rows = np.empty((counters[lane_nodes.SIZE] + counters[lane_nodes.SIZE + 1], room.search.nv))
    path = rows[: joined(sources.words, room.words, rows)].copy()
    goal = goals[counters[lane_nodes.ROOT + 1]]
    if sources.wraps:
        goal = goal + 2.0 * np.pi * np.rint((path[-1] - goal) * sources.sampling.frequency)
    path[0], path[-1] = starts[counters[lane_nodes.ROOT]], goal
    return path
