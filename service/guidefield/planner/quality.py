"""Measure a motion: its distances from everything along the path, its length and its smoothness.

The constants decide what a figure of a reply means; messages state `END_LENGTH` and `LAST_SEARCH_S`. How many samples
there are changes `mean`, `smoothness`, the recorded profile, and the depth of a motion in contact; smallest distances
above 0 have the search's tolerance anyway.
"""

from __future__ import annotations

import itertools
import math
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol, cast

import numpy as np

from guidefield.collision.clearance import ClearanceAt, find_enclosed_pair
from guidefield.collision.world import World
from guidefield.deadline import Deadline, DeadlineExpired
from guidefield.kernels.timing.travel import (
    IN_LOCAL,
    LENGTHS,
    OF_FRAME,
    path_lengths,
    squared_turns,
    travelled,
    when_travelled,
)
from guidefield.memo import MISSING, Answers, memoized
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.task.problem import Conditions
from guidefield.prove.certificate import certify_curve, confirm, smallest_along
from guidefield.prove.closest import ClosestPairs, enclosures_at, world_at
from guidefield.prove.curve import Curve
from guidefield.prove.search import SearchQuery, SearchResult
from guidefield.prove.verdict import Verdict
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.model.joints import Configurations, LocalCurves, LocalPoint, ModelConfigurations
from guidefield.scene.scene import Scene

LENGTH_STEPS = 100  # least number of chords by which the length of a path is measured. Unrecorded

LENGTH_SHARE = 5e-5
"""Pieces are divided on where their lengths by chords and by chords twice as long differ by more, all together, than
this share of the whole. Tests hold lengths to a share of 1e-4; of the public problems' motions they were off by 3e-7
at most."""

LENGTH_LEVELS = 10  # divisions at most: a piece is 1000 times shorter by then, and so is what is missing

SAMPLE_SPACING = 0.05
"""Joint distance between samples of the clearance [rad, or m at size 1]: a choice, as the next four, that decides what
a figure means."""

MAX_SAMPLES = 100  # samples at most
SAMPLE_RATE_HZ = 10.0  # least rate of samples among obstacles that move, within the most
COARSE_STRIDE = 3  # the mean is over one sample of this number; the search of the smallest distances begins there
END_LENGTH = 0.3  # joint distance at each end that the inner clearance leaves out [rad, or m at size 1]
TIMES_A_KNOT = 20  # times at which the travelled length is computed, for each knot. Unrecorded
MAX_TIMES = 100_000  # such times at most. Unrecorded
TIMES_BETWEEN = 100  # times between two close ones, to find when exactly a length has been travelled. Unrecorded

LAST_SEARCH_S = 0.01
"""Time for the smallest distances when time is up or the run is ended. An answer may come 50 ms late: a certificate,
the layout of what is measured and the reply need the rest."""

FEW_SAMPLES = 40  # of more samples the potential is evaluated at every second


class TimedMotion(Protocol):
    """A motion that can be measured: a plan's trajectory, or one that was given."""

    @property
    def times(self) -> np.ndarray:
        """Of the knots, shape (n,), increasing [s]."""

    @property
    def duration(self) -> float:
        """[s]."""

    def bezier(self) -> np.ndarray:
        """Control points of the pieces, shape (m, k, nv) [rad or m]."""

    def piece_times(self) -> np.ndarray:
        """Times at which the pieces begin, and the last one ends, shape (m + 1,) [s]."""

    def evaluate(self, times: np.ndarray, /) -> tuple[np.ndarray, ...]:
        """Local coordinates, shape (k, nv), first of all, at times (k,) [s]."""


@dataclass(frozen=True)
class SmallestDistance:
    """The smallest distance of some pairs along a motion."""

    distance: float  # the smallest that was found, attained at `time` [m]; infinite without such a pair
    bound: float  # the distance kept all along, certified [m]: `tolerance` less, or smaller where time was short
    time: float  # when [s]
    pair: tuple[str, str] | None  # names of the two bodies, a link first; None without such a pair
    tolerance: float  # by how much the bound is smaller where there was time to tell [m]

    @property
    def exact(self) -> bool:
        """True if no distance is smaller by more than the tolerance; in contact it is the deepest measured."""
        return self.pair is None or self.distance <= 0.0 or self.distance - self.bound <= 1.01 * self.tolerance


@dataclass(frozen=True, eq=False)
class Clearance(ReadOnly):
    """Distances along a motion: the smallest, exact over its whole length, and samples."""

    obstacle: SmallestDistance
    inner: SmallestDistance | None  # the same less `END_LENGTH` of the path at each end; None if nothing is left
    own: SmallestDistance
    times: np.ndarray  # of samples, shape (k,) [s]: evenly by joint distance, by time among obstacles that move
    lengths: np.ndarray  # joint distance travelled at them, shape (k,) [rad, or m at size 1]
    mean: float  # mean distance from obstacles over one sample of `COARSE_STRIDE` [m]
    ends: float  # the smaller of the distances from obstacles at start and goal [m]
    curve: Curve
    world: World


@dataclass(frozen=True, eq=False)
class ClearanceProfile(ReadOnly):
    """Distances along a motion, exact at its samples."""

    times: np.ndarray  # shape (n,) [s]; those at which distances are smallest are among them
    configurations: Configurations  # of the group, shape (n, nq)
    lengths: np.ndarray  # joint distance travelled, shape (n,) [rad, or m at size 1]
    obstacle_distance: np.ndarray  # from moving links to obstacles, shape (n,) [m]; infinite without obstacles
    obstacle_pair: tuple[tuple[str, str] | None, ...]  # names of the closest pair (link, obstacle), or None
    witness: np.ndarray  # the closest points, shape (n, 2, 3) [m, world]
    self_distance: np.ndarray  # from the robot to itself, shape (n,) [m]; infinite without pairs
    self_pair: tuple[tuple[str, str] | None, ...]  # names of the closest links, or None
    # evaluates the potential U at every second of many samples, and the last: times (k,) [s] and values (k,) [m]
    potentials: Callable[[], tuple[np.ndarray, np.ndarray]]

    @cached_property
    def potential(self) -> tuple[np.ndarray, np.ndarray]:
        """U along the motion: times (k,) [s] and values (k,) [m]; evaluated at first use."""
        return self.potentials()


@dataclass(frozen=True)
class Figures:
    """Length, duration and smoothness of a motion."""

    joint_path_length: float  # length in local coordinates [rad or m]
    tip_path_length: float  # length of the tip's path [m]
    duration: float  # [s]
    peak_jerk: float  # largest jerk within a piece of the trajectory [rad/s^3 or m/s^3]
    # bending energy of the path in local coordinates times its length, dimensionless; 0 for a straight motion
    smoothness: float


UNMEASURED = "time was up before distances were measured: `clearance` and `self_clearance` are left out"
"""Warning about motions that were not measured."""


def measure_clearances(motions: Sequence[tuple[TimedMotion, Conditions]]) -> list[Clearance] | None:
    """Measure motions, each under its conditions; None if the deadline passed before."""
    try:
        return [measure_clearance(*one) for one in motions]
    except DeadlineExpired:
        return None


def measure_clearance(trajectory: TimedMotion, problem: Conditions) -> Clearance:
    """Measure a trajectory, among the obstacles where they are at each time.

    The smallest distances are searched for until the deadline, and for `LAST_SEARCH_S` at least: see
    `SmallestDistance.exact`.

    Raises:
        DeadlineExpired: if the deadline passed before any were found.
    """
    deadline = problem.deadline.at_least(LAST_SEARCH_S)
    known, world = _SEARCHED.of(trajectory, None), problem.world
    if known is not MISSING and known[2]() is world:  # with its certificate
        queries, found = known[:2]
        found = confirm(world, queries.curve, queries.coarse, queries.spans, found)
    else:
        queries = _make_clearance_queries(trajectory, problem)
        deadline.check("the motion was measured")
        found = smallest_along(world, queries.curve, queries.coarse, queries.spans, deadline=deadline)
    times, lengths, coarse, spans, curve = queries
    distances = found.distances
    closest = [
        SmallestDistance(
            one.distance, one.bound, one.time, None if one.pair < 0 else world.pair_names(one.pair), one.tolerance
        )
        for one in (*found.obstacle, found.own)
    ]
    start = world.group.expand_from_local(cast(LocalPoint, curve.pieces[0, 0]))
    # what is in the open at the start and touches nothing stays there
    if min(one.distance for one in closest) <= 0.0 or find_enclosed_pair(world_at(world, times[0]), start) is not None:
        n_self, begins = world.pairs.n_self, np.array([*(begin for begin, _ in spans), times[0]])
        inside = enclosures_at(world, curve, begins, deadline)
        obstacles = [[pair for pair in pairs if pair >= n_self] for pairs in inside[:-1]]
        own = [pair for pair in inside[-1] if pair < n_self]
        closest = [
            _with_enclosure(one, pairs, time, world)
            for one, pairs, time in zip(closest, [*obstacles, own], begins.tolist(), strict=True)
        ]
        apart = np.flatnonzero(distances > 0.0)
        within = [len(pairs) > 0 for pairs in enclosures_at(world, curve, coarse[apart], deadline, since=n_self)]
        distances = distances.copy()
        distances[apart[within]] = 0.0
    obstacle, *inner, own_closest = closest
    return Clearance(
        obstacle=obstacle,
        inner=inner[0] if inner else None,
        own=own_closest,
        times=times,
        lengths=lengths,
        mean=float(distances.mean()),
        ends=float(min(distances[0], distances[-1])),
        curve=curve,
        world=world,
    )


def certify_and_measure(trajectory: TimedMotion, problem: Conditions, deadline: Deadline) -> Verdict:
    """Certify a motion, and search in the same pass the distances that `measure_clearance` asks for."""
    queries = _make_clearance_queries(trajectory, problem)
    goal = SearchQuery(problem.min_clearance, in_time=problem.scene.moves, spans=queries.spans, samples=queries.coarse)
    found = certify_curve(problem.world, queries.curve, goal, deadline)
    if found.obstacle:
        _SEARCHED.keep(trajectory, None, (queries, found, weakref.ref(problem.world)))
    return found.verdict


class _ClearanceQueries(NamedTuple):
    times: np.ndarray  # of samples, shape (k,) [s]
    lengths: np.ndarray  # joint distance travelled at them, shape (k,) [rad, or m at size 1]
    coarse: np.ndarray  # those at which distances are measured, shape (l,) [s]
    spans: list[tuple[float, float]]  # the whole motion, and the inner span if there is one [s]
    curve: Curve


def _make_clearance_queries(trajectory: TimedMotion, problem: Conditions) -> _ClearanceQueries:
    times, lengths, inside = _choose_samples(trajectory, problem)
    spans = [(float(times[0]), float(times[-1])), *([inside] if inside else [])]
    coarse = times[::COARSE_STRIDE].copy()
    coarse = coarse if coarse[-1] >= times[-1] else np.append(coarse, times[-1])
    return _ClearanceQueries(times, lengths, coarse, spans, Curve(trajectory.bezier(), trajectory.piece_times()))


_SEARCHED = Answers[tuple[_ClearanceQueries, SearchResult, "weakref.ref[World]"]](1)
"""Queries and results of the last certificate's search, by its motion, and its world."""


def measure_clearance_profile(*parts: tuple[Clearance, Conditions, Scene], every: int = 1) -> ClearanceProfile:
    """Return distances and potential at the samples of a measured motion, for its recording.

    Args:
        parts: The motion's parts, one after the other: what was measured, its conditions, and the scene whose field is
            felt: all of it, where the conditions have what is in reach alone.
        every: Of the samples one in a given number of is taken, the first and the last of each part always.
    """
    from guidefield.potential import potentials_in_time  # its kernels are loaded where a recording needs them

    samples = list[_Samples]()
    for measured, problem, _ in parts:
        smallest_at = [one.time for one in (measured.obstacle, measured.inner, measured.own) if one and one.pair]
        times = np.unique(np.concatenate([measured.times[::every], measured.times[-1:], smallest_at]))
        lengths = np.interp(times, measured.times, measured.lengths)
        evaluated = np.zeros(len(times), bool)
        evaluated[:: 1 + (len(times) > FEW_SAMPLES)] = evaluated[-1] = True
        if samples:  # it begins where the one before ends
            times, lengths, evaluated = times[1:], samples[-1].lengths[-1] + lengths[1:], evaluated[1:]
        zs, group = measured.curve.at(times), problem.group
        configurations = np.array([group.from_local(z) for z in zs])
        samples.append(_Samples(times, lengths, evaluated, configurations, group.expand_each(zs)))
    found = list[ClearanceAt]()
    runs = [[*run] for _, run in itertools.groupby(range(len(parts)), lambda number: id(parts[number][1].world))]
    for run in runs:
        # without contact all along, and nothing enclosed at the start, nothing ever is
        is_open = min(min(parts[k][0].obstacle.bound, parts[k][0].own.bound) for k in run) > 0.0
        expanded = cast(ModelConfigurations, np.concatenate([samples[k].expanded for k in run]))
        times = np.concatenate([samples[k].times for k in run])
        found += ClosestPairs(parts[run[0]][1].world).clearances(expanded, times, is_open=is_open)

    def potentials() -> tuple[np.ndarray, np.ndarray]:
        times = [one.times[one.evaluated] for one in samples]
        at = [one.configurations[one.evaluated] for one in samples]
        values = [potentials_in_time(p.group, s, t, qs) for (_, p, s), t, qs in zip(parts, times, at, strict=True)]
        return np.concatenate(times), np.concatenate(values)

    return ClearanceProfile(
        times=np.concatenate([one.times for one in samples]),
        configurations=np.concatenate([one.configurations for one in samples]),
        lengths=np.concatenate([one.lengths for one in samples]),
        obstacle_distance=np.array([one.obstacle_distance for one in found]),
        obstacle_pair=tuple(one.obstacle_pair for one in found),
        witness=np.array([np.full((2, 3), np.nan) if one.witness is None else one.witness for one in found]),
        self_distance=np.array([one.self_distance for one in found]),
        self_pair=tuple(one.self_pair for one in found),
        potentials=potentials,
    )


class _Samples(NamedTuple):
    """Samples of a part of a motion: times (n,) [s], lengths so far (n,), those whose potential is evaluated (n,)."""

    times: np.ndarray
    lengths: np.ndarray
    evaluated: np.ndarray
    configurations: Configurations
    expanded: ModelConfigurations


def _with_enclosure(found: SmallestDistance, inside: list[int], time: float, world: World) -> SmallestDistance:
    """The smallest distance along a motion, given the pairs one of whose bodies is inside the other when it begins.

    What is inside stays there until it touches, so the rest of the motion need not be examined.
    """
    if not inside or found.distance <= 0.0:
        return found
    return replace(found, distance=0.0, bound=min(found.bound, 0.0), time=time, pair=world.pair_names(inside[0]))


def measure_figures(trajectory: Trajectory, kinematics: Kinematics) -> Figures:
    """Length, duration and smoothness of a trajectory."""
    steps, lengths = 4 * math.ceil(max(1.0, 0.25 * LENGTH_STEPS / max(1, len(trajectory.times) - 1))), np.empty(LENGTHS)
    path_lengths(*trajectory.tables, kinematics.tip, steps, LENGTH_SHARE, LENGTH_LEVELS, lengths)
    path = measure_travel(trajectory, tuple(kinematics.group.sizes.tolist()))
    bending = 0.0  # the integral of the squared curvature by length, times the length
    if path.length > 0.0 and len(path.evenly) > 2:
        bending = squared_turns(path.pieces, path.begins, path.evenly) / path.stride * path.length
    return Figures(
        joint_path_length=float(lengths[IN_LOCAL]),
        tip_path_length=float(lengths[OF_FRAME]),
        duration=trajectory.duration,
        peak_jerk=trajectory.peak_jerk,
        smoothness=bending,
    )


class TravelledPath(NamedTuple):
    """A motion as curves, and how far it has travelled, of coordinates over their sizes."""

    pieces: LocalCurves  # control points of the curves, shape (m, k, nv) [rad, or m at size 1]
    begins: np.ndarray  # when they begin and the last one ends, shape (m + 1,) [s]
    times: np.ndarray  # many times along it, shape (n,) [s]
    lengths: np.ndarray  # joint distance travelled by then, shape (n,) [rad, or m at size 1]
    stride: float  # equal joint distances up to its length are so far apart [rad, or m at size 1]
    evenly: np.ndarray  # when it has travelled them, shape (k,) [s]

    @property
    def length(self) -> float:
        """Joint distance of all of it [rad, or m at size 1]."""
        return float(self.lengths[-1])


@memoized
def measure_travel(trajectory: TimedMotion, sizes: tuple[float, ...]) -> TravelledPath:
    """Lay out a motion by how far it has travelled by sizes of coordinates, once: of many rows it takes 0.1 s."""
    pieces, begins = np.ascontiguousarray(trajectory.bezier() / sizes), np.array(trajectory.piece_times(), float)
    many = min(TIMES_A_KNOT * len(trajectory.times) + 2, MAX_TIMES)
    times = np.linspace(trajectory.times[0], trajectory.times[-1], many)
    lengths = np.empty(many)
    travelled(pieces, begins, times, lengths)
    length = float(lengths[-1])
    count = min(max(math.ceil(length / SAMPLE_SPACING) + 1, 2), MAX_SAMPLES)
    evenly = np.linspace(0.0, length, count)
    path = TravelledPath(
        cast(LocalCurves, pieces), begins, times, lengths, float(evenly[1]), np.interp(evenly, lengths, times)
    )
    read_only(*path)
    return path


def _choose_samples(
    trajectory: TimedMotion, problem: Conditions
) -> tuple[np.ndarray, np.ndarray, tuple[float, float] | None]:
    """Times of samples, the distances travelled by then, and between which times the inner path is, if there is one."""
    path, inside = measure_travel(trajectory, tuple(problem.group.sizes.tolist())), None
    if path.length > 2.0 * END_LENGTH:
        ends = np.array([END_LENGTH, path.length - END_LENGTH])
        when_travelled(path.pieces, path.begins, path.times, path.lengths, TIMES_BETWEEN, ends)
        inside = (float(ends[0]), float(ends[1]))
    times = path.evenly.copy()
    if problem.scene.moves or path.length <= 0.0:
        count = max(len(times), int(np.ceil(trajectory.duration * SAMPLE_RATE_HZ)) + 1)
        times = np.linspace(path.times[0], path.times[-1], min(count, MAX_SAMPLES))
    times[[0, -1]] = path.times[[0, -1]]
    if not (times[1:] > times[:-1]).all():
        times = np.unique(times)
    return times, np.interp(times, path.times, path.lengths), inside
