"""RRT-Connect (Kuffner and LaValle 2000) on SIMD batches of collision checks: two trees that grow until they meet.

The kernels are kernels/tree/rrt_connect.py and, within path constraints, constrained_connect.py; memory for them, and
the box that samples are drawn from, stay with each thread. Motions are free at samples: every user of a path certifies
what becomes of it, so the constants change which path a seed leads to and the time, `FIRST_CAPACITY` too: samples are
lost where a tree outgrows it. Those of a check change how late a deadline is noticed; `MOST_ROOTS_TRIED` and the
escapes, when a search is given up; `HARD_TO_LEAVE`, the sentence about a failed one. service/docs/algorithm.md repeats
`RESOLUTION` and `STRIDE`.
"""

from __future__ import annotations

import math
import threading
import weakref
from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.collision.batch.batch_collision import BatchCollision
from guidefield.deadline import Deadline
from guidefield.kernels.collide.layout import LINE
from guidefield.kernels.simd.packing import Words, pack
from guidefield.kernels.simd.vector import LANES
from guidefield.kernels.tree import nodes as tree_nodes, rrt_connect as kernel
from guidefield.kernels.tree.constrained_connect import Strides, grow_within
from guidefield.kernels.tree.informed_samples import Sampling
from guidefield.kernels.tree.kd_buckets import buckets_for
from guidefield.kernels.tree.path_constraints import KeptFrames
from guidefield.kernels.tree.rrt_connect import SIEVE
from guidefield.memo import memoized
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.model.joints import ROAM, ROTATION, TRANSLATION, WIND, LocalPoints

# samples of a motion per length in local coordinates [1/rad or 1/m]: VAMP's, with which its times are compared.
# A prototype's search at it left 14 of 420 paths of a Panda in contact between samples, which a certificate finds
RESOLUTION = 32.0
MOST_ITERATIONS = 100_000_000  # samples that a search draws, which cost next to nothing: for safety
MOST_MOTIONS = 3_000_000  # motions that it judges at most, which bounds the memory of trees, too. Unrecorded
# between two checks of the deadline, each of which takes some milliseconds at most: iterations that always are, nodes
# that more iterations may look at, and motions to check
ITERATIONS_PER_CHECK, NODES_PER_CHECK, MOTIONS_PER_CHECK = 256, 4_000_000, 256
MOST_ROOTS_TRIED = 20_000  # extensions of roots alone after which `can_escape` examines these. Unrecorded
FIRST_CAPACITY = 512  # nodes that each tree has memory for at first; doubled when it is full. Unrecorded
ESCAPE_LENGTHS = (0.3, 0.1, 0.03, 0.01)  # of motions by which a root may be left [rad, or m at size 1]
ESCAPE_DIRECTIONS = 1024  # of each length, beside those along coordinates; with few, roots are given up. Unrecorded
CONSTRAINT_ROOM = 0.6  # share of each path constraint's limit to within which configurations are brought. Unrecorded
CORRECTIONS = 15  # Newton steps by which one is brought back, at most. Unrecorded
STRIDE = 0.1  # length of a step of a tree within path constraints, by the metric [rad]. Unrecorded
# a step that comes nearer to where it was to go by less than this share of its length ends an extension. Unrecorded
LEAST_GAIN = 0.2
FARTHEST_STRIDE = 2.0  # so does one that is brought back to this many lengths from where it began. Unrecorded
CONSTRAINED_PER_CHECK = 32  # as `ITERATIONS_PER_CHECK`, within path constraints
# an end is hard to get away from, in the sentence about a failed search, if its tree has fewer configurations than this
# share of the motions tried there
HARD_TO_LEAVE = 0.01


@dataclass(frozen=True, eq=False)
class Sources(ReadOnly):
    """The box that samples of a group fill: local coordinates in the group's units."""

    sampling: Sampling
    words: Words
    # which coordinates are lengths without limits, or angles without limits whose whole turns count: (k,)
    roams: np.ndarray
    around: np.ndarray  # how far beyond what is to be reached samples of those lie, shape (k,) [m or rad]

    @classmethod
    def of(cls, sampling: Sampling, roams: np.ndarray, around: np.ndarray) -> Sources:
        """Sources that fill a box; `roams` and `around` as the attributes, shape (k,)."""
        read_only(*sampling)
        return cls(sampling, pack(sampling), roams, around)

    def about(self, roots: LocalPoints) -> Sources:
        """Sources whose box extends by `around` beyond roots (n, nv), such points, in coordinates that roam."""
        if len(self.roams) == 0:
            return self
        lower, width = self.sampling.lower.copy(), self.sampling.width.copy()
        least, largest = (end(roots[:, self.roams], axis=0) for end in (np.min, np.max))
        lower[self.roams], width[self.roams] = least - self.around, largest - least + 2.0 * self.around
        return Sources.of(self.sampling._replace(lower=lower, width=width), self.roams, self.around)

    def between(self, starts: LocalPoints, goals: LocalPoints, length: float) -> Sources:
        """A box about all points through which a path of some length may lead from a start (k, nv) to a goal (m, nv).

        Of one start and one goal these are an ellipsoid with both in its foci (Gammell 2014); a coordinate that wraps
        keeps its whole turn where the path might go round the other way.
        """
        low, high = self.sampling.lower.copy(), self.sampling.lower + self.sampling.width
        least, largest = np.full(len(low), np.inf), np.full(len(low), -np.inf)
        for start in starts:
            for goal in goals:
                offset = goal - start
                distance = float(np.linalg.norm(offset))
                along = (offset / max(distance, 1e-12)) ** 2
                spare = max(length * length - distance * distance, 0.0)
                reach = 0.5 * np.sqrt(length * length * along + spare * (1.0 - along))
                least, largest = (
                    np.minimum(least, 0.5 * (start + goal) - reach),
                    np.maximum(largest, 0.5 * (start + goal) + reach),
                )
        wraps = self.sampling.period > 0.0
        round_again = wraps & (length + largest - least >= self.sampling.period)
        rotates = np.zeros(len(low), bool)
        for first in self.sampling.rotations:
            rotates[first : first + 3] = True
        narrow = ~(round_again | rotates)
        low[narrow] = np.where(wraps, least, np.clip(least, low, high))[narrow]
        high[narrow] = np.where(wraps, largest, np.clip(largest, low, high))[narrow]
        return Sources.of(self.sampling._replace(lower=low, width=high - low), self.roams, self.around)


@memoized
def sources_of(group: PlanningGroup) -> Sources:
    """The box that samples of a group fill."""
    endless = ~np.isfinite(group.upper - group.lower)
    return _alike_sources(group, group.to_local(group.q_origin)[endless].tobytes() if endless.any() else b"")


@memoized_for_alike
def _alike_sources(group: PlanningGroup, origins: bytes) -> Sources:
    """`sources_of` a group, by the values of the coordinates without limits where these start, in order."""
    lower, upper, period = group.lower.copy(), group.upper.copy(), group.periods.astype(np.float32)
    lengths, rotations = np.zeros(group.nv, bool), []
    for joint in group.joints:
        if joint.kind in TRANSLATION:
            lengths[joint.idx_v : joint.idx_v + joint.nv][TRANSLATION[joint.kind]] = True
        if joint.kind in ROTATION:
            rotations.append(joint.idx_v + ROTATION[joint.kind].start)
    endless, origin = ~np.isfinite(upper - lower), np.frombuffer(origins)
    reach = np.where(lengths, ROAM * group.sizes, np.where(group.winds, WIND, np.pi))
    lower[endless], upper[endless] = origin - reach[endless], origin + reach[endless]
    with np.errstate(divide="ignore"):
        frequency = np.where(period > 0.0, 1.0 / period, 0.0).astype(np.float32)
    vectors = np.array(rotations, np.int64)
    lower, upper, reach = lower / group.units, upper / group.units, reach / group.units
    steps, units = _steps(group.nv + 1), group.units.astype(np.float32)
    sampling = Sampling(steps, lower, upper - lower, period, frequency, units, len(vectors), vectors)
    roams = np.flatnonzero(endless & (lengths | group.winds))
    return Sources.of(sampling, roams, reach[roams])


def _steps(count: int) -> np.ndarray:
    """Steps of the additive recurrence that fills a box of a given number of sides evenly (M. Roberts 2018).

    They are the powers of 1 / g, where g > 1 solves g^(n + 1) = g + 1.
    """
    g = 2.0
    for _ in range(64):
        g = (1.0 + g) ** (1.0 / (count + 1.0))
    steps: np.ndarray = g ** -np.arange(1.0, count + 1.0)
    return steps


@dataclass(frozen=True, eq=False)
class FoundPath(ReadOnly):
    """The result of a search."""

    # local coordinates (n, nv) from a start to a goal, angles unwrapped along the path; None if there is none
    path: LocalPoints | None
    counters: np.ndarray
    search: tree_nodes.TreeSearch
    units: np.ndarray  # what counts as one radian in each coordinate of their nodes, shape (nv,)
    # of which tree, 0 or 1, the roots can't be left, as far as many motions tell; None if nothing says so
    enclosed: int | None = None

    @property
    def iterations(self) -> int:
        """Samples drawn."""
        return int(self.counters[tree_nodes.ITERATION])

    @property
    def motions(self) -> int:
        """Number of straight motions that were checked."""
        return int(self.counters[tree_nodes.MOTIONS])

    @property
    def sizes(self) -> tuple[int, int]:
        """Configurations of both trees."""
        first, second = self.counters[tree_nodes.SIZE : tree_nodes.SIZE + 2].tolist()
        return first, second

    @property
    def tried(self) -> tuple[int, int]:
        """Number of extensions of both trees that were checked."""
        first, second = self.counters[tree_nodes.TRIED : tree_nodes.TRIED + 2].tolist()
        return first, second

    def trees(self) -> tuple[tuple[LocalPoints, np.ndarray], ...]:
        """Local coordinates of both trees' nodes, shape (n, nv), and each one's parent, shape (n,); -1 for a root."""
        held = zip(*held_by(self.search)[:2], self.sizes, strict=True)
        return tuple((nodes[:, :size].T * self.units, parents[:size].copy()) for nodes, parents, size in held)


def grow(
    batch: BatchCollision,
    starts: LocalPoints,
    goals: LocalPoints,
    resolution: float,
    clearance: float,
    rng: np.random.Generator,
    deadline: Deadline,
    *,
    within: float = math.inf,
    most_motions: int = MOST_MOTIONS,
    most_iterations: int = MOST_ITERATIONS,
    frames: KeptFrames | None = None,
) -> FoundPath:
    """Grow two trees from free roots, shapes (k, nv) and (m, nv), towards each other until they meet.

    Motions are sampled so often per length in local coordinates [1/rad or 1/m], and keep obstacles at a clearance [m].
    Samples come from where a path of at most a length by the group's metric [rad] may lead. With path constraints,
    which all roots keep, trees walk within these; with no iterations they walk straight to each goal.

    Raises:
        ValueError: if a root hasn't as many coordinates as the robot.
    """
    group, nv = batch.world.group, batch.world.group.nv
    if not starts.shape[1] == goals.shape[1] == nv:
        raise ValueError(f"roots of a tree have {nv} coordinates here, got {starts.shape[1]} and {goals.shape[1]}")
    kept_memory = _thread_memory(group, nv)
    sources, memory = kept_memory.sources, kept_memory.memory
    first, second = starts / group.units, goals / group.units
    if sources.roams.size:
        sources = sources.about(np.concatenate([first, second]))
    if within != math.inf:
        sources = sources.between(first, second, within)
    most_roots = max(len(starts), len(goals))
    if 2 * most_roots > FIRST_CAPACITY:
        memory = _TreeMemory.build(nv, 2 * most_roots)
    rng.random(out=memory.search.places)
    begins, suspected, counters = True, [0, 1], memory.search.counters
    nodes, motion_count = most_roots, 0
    strides = Strides(
        STRIDE, LEAST_GAIN, FARTHEST_STRIDE, CONSTRAINT_ROOM, CORRECTIONS,
        resolution, clearance,
    )  # fmt: skip
    while True:
        checked = max(ITERATIONS_PER_CHECK, NODES_PER_CHECK // nodes) if frames is None else CONSTRAINED_PER_CHECK
        piece = 0 if deadline.expired() else min(checked, most_iterations)
        words = batch.words, sources.words, memory.words
        if frames is None:
            motions = min(MOTIONS_PER_CHECK, most_motions - motion_count)
            ended = kernel.grow(*words, first, second, clearance, resolution, piece, motions, begins)
        else:
            ended = grow_within(*words, frames, strides, first, second, piece, begins)
        if ended == kernel.MET:
            # samples are float32: rounding may take one beyond a limit
            path = np.clip(memory.path[: counters[tree_nodes.ROWS]] * group.units, group.lower, group.upper)
            return FoundPath(path, counters.copy(), memory.search, group.units)
        begins, motion_count = False, int(counters[tree_nodes.MOTIONS])
        nodes = int(counters[tree_nodes.SIZE : tree_nodes.SIZE + 2].max())
        if ended == kernel.FULL:
            memory = memory.double()
        tried = next((tree for tree in suspected if counters[tree_nodes.TRIED + tree] >= MOST_ROOTS_TRIED), None)
        if tried is not None:
            suspected.remove(tried)
            roots, size = (starts, goals)[tried], counters[tree_nodes.SIZE + tried]
            if size == len(roots) and not can_escape(batch, roots, clearance, resolution, rng):
                return FoundPath(None, counters.copy(), memory.search, group.units, tried)
        if piece == 0 or counters[tree_nodes.ITERATION] >= most_iterations or motion_count >= most_motions:
            return FoundPath(None, counters.copy(), memory.search, group.units)


def held_by(search: tree_nodes.TreeSearch) -> tuple[np.ndarray, ...]:
    """Nodes, parents, domains and failures, tree by tree: shapes (2, nv, capacity) and (2, capacity) each."""
    nodes = search.nodes[:-LANES].reshape(2, search.nv, search.capacity)
    return nodes, *(array.reshape(2, -1) for array in (search.parents, search.domains, search.failed))


def _zeros_on_cache_line(size: int) -> np.ndarray:
    """A number of float32, all 0, that begin where a line of the cache begins."""
    floats = LINE // 4
    memory = np.zeros(size + floats, np.float32)
    begin = -memory.ctypes.data % LINE // 4
    return memory[begin : begin + size]


@dataclass(frozen=True, eq=False)
class _TreeMemory:
    search: tree_nodes.TreeSearch
    words: Words
    path: LocalPoints  # where the path is written, shape (2 * capacity, nv)

    @classmethod
    def build(cls, nv: int, capacity: int) -> _TreeMemory:
        ends_of = np.cumsum((nv, nv, nv, nv, 1, 1)) * LANES
        samples, origins, ends, judged, squares, nearest, longest = np.split(
            _zeros_on_cache_line((4 * nv + 3) * LANES), ends_of
        )
        # sixteen more: the nearest node is searched for sixteen at a time
        search = tree_nodes.TreeSearch(
            nv=nv,
            capacity=capacity,
            nodes=np.zeros(2 * nv * capacity + LANES, np.float32),
            parents=np.full(2 * capacity, -1, np.int64),
            domains=np.full(2 * capacity, np.inf, np.float32),
            failed=np.zeros(2 * capacity, np.int64),
            places=np.zeros(nv + 1),
            counters=np.zeros(tree_nodes.COUNTERS, np.int64),
            sample=np.zeros(nv, np.float32),
            target=np.zeros(nv, np.float32),
            origin=np.zeros(nv, np.float32),
            reached=np.zeros(nv, np.float32),
            first=np.zeros(nv, np.float32),
            last=np.zeros(nv, np.float32),
            samples=samples,
            squares=squares,
            nearest=nearest,
            grown_trees=np.zeros(LANES, np.int64),
            grown_nodes=np.zeros(LANES, np.int64),
            longest=longest,
            origins=origins,
            ends=ends,
            judged=judged,
            hits=np.full(3 * SIEVE, -1, np.int64),
            path=np.empty(2 * nv * capacity),
            buckets=buckets_for(nv, capacity if capacity >= tree_nodes.LATE else 0),
        )
        return cls.of(search)

    @classmethod
    def of(cls, search: tree_nodes.TreeSearch) -> _TreeMemory:
        return cls(search, pack(search), cast(LocalPoints, search.path.reshape(-1, search.nv)))

    def double(self) -> _TreeMemory:
        larger = _TreeMemory.build(self.search.nv, 2 * self.search.capacity).search
        for old, new in zip(held_by(self.search), held_by(larger), strict=True):
            new[..., : self.search.capacity] = old
        return _TreeMemory.of(larger._replace(places=self.search.places, counters=self.search.counters))


@dataclass(frozen=True, eq=False)
class _ThreadMemory:
    """Memory of a thread for its next search, and the sources of the last group."""

    memory: _TreeMemory
    group: weakref.ref[PlanningGroup]
    sources: Sources


class _ThreadMemories(threading.local):
    """Those of a thread, by number of coordinates and capacity: making them takes longer than finding a simple path."""

    def __init__(self) -> None:
        self.kept: dict[tuple[int, int], _ThreadMemory] = {}


_MEMORIES = _ThreadMemories()


def _thread_memory(group: PlanningGroup, nv: int) -> _ThreadMemory:
    kept_memory = _MEMORIES.kept.get((nv, FIRST_CAPACITY))
    if kept_memory is None or kept_memory.group() is not group:
        memory = _TreeMemory.build(nv, FIRST_CAPACITY) if kept_memory is None else kept_memory.memory
        kept_memory = _MEMORIES.kept[nv, FIRST_CAPACITY] = _ThreadMemory(memory, weakref.ref(group), sources_of(group))
    return kept_memory


def can_escape(
    batch: BatchCollision, roots: LocalPoints, clearance: float, resolution: float, rng: np.random.Generator
) -> bool:
    """Return whether any of many short motions out of some free roots (k, nv) is free; see `grow`."""
    group, along = batch.world.group, np.eye(batch.world.group.nv)
    drawn = rng.normal(size=(ESCAPE_DIRECTIONS, group.nv))
    directions = np.concatenate([along, -along, drawn / np.linalg.norm(drawn, axis=1)[:, None]]) * group.sizes
    for root in roots:
        for length in ESCAPE_LENGTHS:
            ends = np.clip(root + length * directions, group.lower, group.upper)
            ends = ends[np.linalg.norm((ends - root) / group.sizes, axis=1) > 0.5 * length]
            for end in ends[~batch.touching(ends, clearance)]:
                if batch.free_until(np.array([root, end]), resolution, clearance):
                    return True
    return False


def explain_failed_search(found: FoundPath, goals: int, *, in_time: bool) -> str:
    """Explain to people why a search ended without a path."""
    names = "start", "goal" if goals == 1 else "goals"
    if found.enclosed is not None:
        name, tried = names[found.enclosed], found.tried[found.enclosed]
        return f"the {name} can't be left: none of {tried} motions out of it is free, and no shorter one that was tried"
    start, goal = found.sizes
    ended = "in time" if in_time else f"in {MOST_MOTIONS} motions, the most that a search takes"
    message = (
        f"no connection was found {ended}: {found.motions} motions were judged, and the trees from the {names[0]} and"
        f" the {names[1]} have {start} and {goal} configurations"
    )
    narrow = int(np.argmin(np.array(found.sizes) / np.maximum(found.tried, 1)))
    if found.sizes[narrow] < HARD_TO_LEAVE * found.tried[narrow]:
        verb = "are" if narrow == 1 and goals > 1 else "is"
        message += f"; the {names[narrow]} {verb} hard to get away from: {found.tried[narrow]} motions were tried there"
    return message
