"""Connect configurations: the straight motion, else a path of RRT-Connect, shortened; also within path constraints.

Of several goals the one is chosen that is estimated to be reached soonest (`find_quickest_path`); all are tried
together where none of them is reached with a few motions.

Batches judge motions by samples only: what they find is a proposal to the certificate (prove/certificate.py). A path
that is optimised anyway need not be certified before, because that moves it away from where samples overlooked
something; one within path constraints never is. So the constants here decide whether a path is found, which one for a
request's seed, and how soon, never what counts as free or kept; those that count something stay above 0.
service/docs/algorithm.md repeats some.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin

from guidefield.collision.batch.batch_collision import BatchCollision
from guidefield.errors import Status
from guidefield.kernels.tree.path_constraints import KeptFrames, bring_back
from guidefield.planner import tree_search
from guidefield.planner.motion.timing import length_of
from guidefield.planner.task.problem import Objective, Problem
from guidefield.planner.task.trace import Step, StepKind, TreeGrown
from guidefield.planner.tree_search import CONSTRAINT_ROOM, CORRECTIONS, RESOLUTION, FoundPath, explain_failed_search
from guidefield.prove.certificate import motion_free
from guidefield.read_only import ReadOnly
from guidefield.robot.group.inverse_kinematics import EXACT, SEARCH, PoseTarget
from guidefield.robot.group.path_constraints import ConstrainedFrames, keep_frames
from guidefield.robot.model.joints import ANGLE, LocalPoint, LocalPoints, LocalRate
from guidefield.robot.model.model import MARGIN

ATTEMPTS = 6  # how often the certificate may refuse what was found. Unrecorded
FINER = 2.0  # factor of the resolution after each refusal. Unrecorded
# goals tried each by itself at most, the nearest in time first. One tree for all of ten: 4 % slower motions of a Panda
GOALS_TRIED = 10
GOAL_MOTIONS = 3000  # motions that each one's tree judges at most, before all goals are tried together. Unrecorded
TIME_ROUNDS = 4  # more rounds of such trees at most, where time alone counts ..
ENOUGH = 1.15  # .. until the best score is at most this times the least bound
# share of a path's length, each joint's by its velocity limit [s/s], in its score, unless time alone counts. On the
# 420 public problems of a Panda with 0 paths were 1.5 % longer, motions 0.3 % faster, and they kept a millimetre
# less
LENGTH_SHARE = 0.2
MAX_PATHS = 5  # paths that are optimised coarsely at most, where time alone counts
# the same for balanced motions. On 60 problems, 20 each of cages, boxes and tables that are reached under, one path
# made motions 1.6 % slower, in cages 4 %, and took 15 % less time for the whole plan; five paths gained 0.4 % for 17
# % more
MAX_PATHS_BALANCED = 3
ROUND_MOTIONS = 2000  # motions that a round of making a path shorter judges at most. Unrecorded
ROUNDS_SHARE = 0.5  # such rounds end when this share of the time left is over: the rest is for what follows. A choice
LEAST_SHORTER = 1e-3  # by what share a path has to be shorter to be taken. A choice: less is not worth a round
# a path to a goal, single or one of several tried together, whose score is more than this times the straight one's is a
# detour, and has this many rounds unless a request says how many. Motions of a Fetch, a Baxter, a Panda take 1.2, 0.7,
# 0.5 % less, some a third, and whole answers 1.02, 0.99, 0.98 of the time, as shorter ones are optimised sooner; with 8
# rounds a Fetch's take 4 % less, and answers 1.11 of the time
DETOUR = 2.0
DETOUR_ROUNDS = 3  # this many. With 2 a Fetch's motions take 1.1 % less
CONSTRAINED_ITERATIONS = 10_000_000  # samples that a search within path constraints draws at most: for safety
SHORTCUTS = 60  # detours of such a path that are examined. Unrecorded
POSE_STEPS = 15  # most of Newton's steps to a pose within path constraints. From the edges of tolerances 3 to 6 do it
POSE_TRIES = 20  # after this many failures in a row no other configuration is moved: the constraint is out of reach
DAMPING = 1e-9  # of those steps, relative to the largest singular value: a row that nothing moves is given up


@dataclass(frozen=True, eq=False)
class QuickestPath(ReadOnly):
    """The path to one of several goals that is estimated to take the least time."""

    path: LocalPoints  # local coordinates, shape (n, nv), free at samples
    others: tuple[LocalPoints, ...]  # the next best, shape (n, nv) each; none where clearance counts most
    tried: int  # goals that were tried
    iterations: int  # of all trees


def find_quickest_path(
    problem: Problem, z_start: LocalPoint, goals: LocalPoints, rng: np.random.Generator
) -> QuickestPath | None:
    """Find the best path from z_start (nv,) to goals (m, nv), each by itself.

    None where all have to be tried together.
    """
    search = _PathSearch(problem, z_start, goals, rng)
    bounds = search.straight_scores()
    order = np.argsort(bounds, kind="stable")[:GOALS_TRIED].tolist()
    for round_ in range(1 + (TIME_ROUNDS if problem.objective is Objective.TIME else 0)):
        if round_ and search.least <= ENOUGH * bounds[order[0]]:
            break
        for index in order:
            if bounds[index] >= search.least or problem.deadline.expired():
                break
            search.try_goal(index)
    if not search.found:
        return None
    most = {Objective.TIME: MAX_PATHS, Objective.BALANCED: MAX_PATHS_BALANCED, Objective.CLEARANCE: 1}
    best, *others = sorted(search.found, key=lambda scored: scored[0])[: most[problem.objective]]
    return QuickestPath(best[1], tuple(path for _, path in others), len(search.straight), search.iterations)


class _PathSearch:
    def __init__(self, problem: Problem, z_start: LocalPoint, goals: LocalPoints, rng: np.random.Generator) -> None:
        self._problem, self._start, self._goals, self._rng = problem, z_start, goals, rng
        self.found: list[tuple[float, LocalPoints]] = []
        self.straight: dict[int, bool] = {}
        self.iterations = 0

    @property
    def least(self) -> float:
        return min((score for score, _ in self.found), default=np.inf)

    def straight_scores(self) -> np.ndarray:
        offsets = (self._goals - self._start) / self._problem.group.velocity_limits
        scores: np.ndarray = np.abs(offsets).max(axis=1)
        if self._problem.objective is not Objective.TIME:
            scores += LENGTH_SHARE * np.linalg.norm(offsets, axis=1)
        return scores

    def try_goal(self, index: int) -> None:
        """Look for a path to a goal; for another one by another tree, unless the straight one is free."""
        problem, goal = self._problem, self._goals[index]
        batch, clearance = problem.batch, problem.min_clearance
        path = np.array([self._start, goal])
        if self.straight.get(index, False):
            return
        if index not in self.straight:
            self.straight[index] = bool(batch.free_until(path, RESOLUTION, clearance))
        if not self.straight[index]:
            roots = np.concatenate([goal[None], problem.group.turned_otherwise(goal)])
            found = tree_search.grow(
                batch,
                self._start[None],
                roots,
                RESOLUTION,
                clearance,
                self._rng,
                problem.deadline,
                most_motions=GOAL_MOTIONS,
            )
            self.iterations += found.iterations
            _count(problem, found)
            problem.tell(TreeGrown(found.trees))
            if found.path is None:
                return
            path = batch.shorten(found.path, RESOLUTION, clearance + MARGIN * problem.group.size)
        self.found.append((score_path(problem, path), path))


def _count(problem: Problem, found: FoundPath) -> None:
    problem.counters.iterations += found.iterations
    problem.counters.collision_checks += found.motions


def score_path(problem: Problem, path: LocalPoints) -> float:
    """The score of a path (n, nv) [s]: its estimated time, and a share of its length unless time alone counts."""
    limits = problem.group.velocity_limits
    time = estimate_time(path, limits)
    if problem.objective is Objective.TIME:
        return time
    return time + LENGTH_SHARE * float(np.linalg.norm(np.diff(path, axis=0) / limits, axis=1).sum())


def estimate_time(path: LocalPoints, velocity_limits: LocalRate) -> float:
    """About how long a path (n, nv) takes once it is optimised, but for speeding up and slowing down [s]."""
    times = np.abs(np.diff(path, axis=0)) / velocity_limits
    return 0.5 * float(times.max(axis=1).sum() + times.sum(axis=0).max())


def explain_no_path(
    batch: BatchCollision, start: LocalPoint, goals: LocalPoints, resolution: float, clearance: float
) -> str | None:
    """Explain why a group of one coordinate can't get to any goal; None where it can, or has several coordinates.

    Whatever it does, it passes what is between; so one sample in contact on each path is proof. Goals (m, nv) are no
    more than half a turn away if they wrap; the resolution is samples of a motion per length in them [1/rad or
    1/m], the clearance the distance kept from obstacles [m].
    """
    group = batch.world.group
    if group.nv != 1:
        return None
    joint, ends = group.joints[0], list(goals)
    round_again = joint.kind in ANGLE
    if round_again:
        ends += [goal - 2.0 * np.pi * np.sign(goal - start) for goal in goals]
    if any(batch.free_until(np.array([start, end]), resolution, clearance) for end in ends):
        return None
    which = "either way round" if round_again else "on the only way"
    return f"joint {joint.name} can't get to the goal: {which} it comes to what it must not touch"


@dataclass(frozen=True, eq=False)
class ShortenedPath(ReadOnly):
    """A path after shortening."""

    path: LocalPoints  # local coordinates (n, nv), free as the path that it began with, and no longer
    rounds: int
    message: str


@dataclass(frozen=True)
class ShorteningRounds:
    """The settings by which a connection is made shorter."""

    number: int
    resolution: float  # samples of a motion per length in local coordinates [1/rad or 1/m]
    margin: float  # what shortcuts keep from obstacles beside the required clearance [m]


def shorten_path(
    problem: Problem,
    path: LocalPoints,
    goals: LocalPoints,
    rounds: ShorteningRounds,
    rng: np.random.Generator,
    accepts: Callable[[LocalPoints], bool],
) -> ShortenedPath:
    """Look for shorter paths from where a path (n, nv) begins to one of several free goals (m, nv)."""
    units = problem.group.units
    deadline, before, done = problem.deadline.share(ROUNDS_SHARE), length_of(path, units), 0
    batch, clearance, start = problem.batch, problem.min_clearance, path[:1]
    while done < rounds.number and not deadline.expired():
        bound = (1.0 - LEAST_SHORTER) * length_of(path, units)
        within = goals[np.linalg.norm((goals - start) / units, axis=1) < bound]
        if len(within) == 0:
            break
        found = tree_search.grow(
            batch, start, within, rounds.resolution, clearance, rng, deadline, within=bound, most_motions=ROUND_MOTIONS
        )
        _count(problem, found)
        if found.path is not None:
            candidate = batch.shorten(found.path, rounds.resolution, clearance + rounds.margin)
            if length_of(candidate, units) < bound and accepts(candidate):
                path = candidate
        done += 1
    share = 1.0 - length_of(path, units) / before
    message = f"made {share:.1%} shorter in {done} rounds"
    if deadline.expired():
        message += f" of {rounds.number}: time ended them"
    return ShortenedPath(path, done, message)


@dataclass(frozen=True, eq=False)
class Connection(ReadOnly):
    """The result of a connection."""

    status: Status
    message: str
    path: LocalPoints  # local coordinates (n, nv) from start to a goal if it succeeded, else only the start
    proven: bool = True
    # other paths to a goal, shape (n, nv) each, free at samples, that may prove quicker
    others: tuple[LocalPoints, ...] = ()


def connect(
    problem: Problem, z_start: LocalPoint, goals: LocalPoints, rng: np.random.Generator, *, prove: bool = True
) -> Connection:
    """Find a free motion from a free point (nv,) to one of several (m, nv), and shorten it.

    Where it need not be certified, one that is free at the samples of a batch is enough.
    """
    batch, clearance, margin = problem.batch, problem.min_clearance, MARGIN * problem.group.size
    near = np.array([problem.group.unwrapped(goal, z_start) for goal in goals])
    if len(near) > 1 or problem.objective is Objective.TIME:
        quickest = _connect_to_quickest(problem, z_start, near, rng, prove)
        if quickest is not None:
            return quickest
    for goal in near[np.argsort(np.linalg.norm((near - z_start) / problem.group.units, axis=1))]:
        straight = np.array([z_start, goal])
        if batch.free_until(straight, RESOLUTION, clearance) and (not prove or _certify_path(problem, straight)):
            return Connection(Status.SUCCESS, "the straight motion is free", straight, prove)
    blocked = explain_no_path(batch, z_start, near, RESOLUTION, clearance)
    if blocked is not None:
        return Connection(Status.PLANNING_FAILED, blocked, z_start[None])
    roots = np.concatenate([near, *map(problem.group.turned_otherwise, near)])
    resolution, refused = RESOLUTION, 0

    def accepts(path: LocalPoints) -> bool:
        return not prove or _certify_path(problem, path)

    for _ in range(ATTEMPTS):
        found = tree_search.grow(batch, z_start[None], roots, resolution, clearance, rng, problem.deadline)
        _count(problem, found)
        problem.tell(TreeGrown(found.trees))
        if found.path is None:
            break
        path = batch.shorten(found.path, resolution, clearance + margin)
        if accepts(path):
            message = f"found by a tree in {found.iterations} iterations"
            number = problem.optimization_iterations
            if number is None and score_path(problem, path) > DETOUR * score_path(problem, path[[0, -1]]):
                number = DETOUR_ROUNDS
            if number:
                better = shorten_path(problem, path, roots, ShorteningRounds(number, resolution, margin), rng, accepts)
                path, message = better.path, f"{message}, {better.message}"
            return _succeed(problem, message, path, prove)
        resolution, refused = resolution * FINER, refused + 1
    return _make_unconnected(problem, z_start, found, len(goals), refused)


def _connect_to_quickest(
    problem: Problem, z_start: LocalPoint, goals: LocalPoints, rng: np.random.Generator, prove: bool
) -> Connection | None:
    """To the goal (m, nv) that is estimated to be reached soonest; None where none is, or the certificate refuses."""

    def accepts(path: LocalPoints) -> bool:
        return not prove or _certify_path(problem, path)

    quickest = find_quickest_path(problem, z_start, goals, rng)
    if quickest is None or not accepts(quickest.path):
        return None
    path = quickest.path
    message = f"of {len(goals)} goals {quickest.tried} tried; " if len(goals) > 1 else ""
    straight = len(path) == 2 and (goals == path[-1]).all(axis=1).any()  # not to where a joint is turned otherwise
    message += "the straight motion is free" if straight else f"found by trees in {quickest.iterations} iterations"
    if problem.optimization_iterations and len(path) > 2:
        rounds = ShorteningRounds(problem.optimization_iterations, RESOLUTION, MARGIN * problem.group.size)
        roots = np.concatenate([goals, *map(problem.group.turned_otherwise, goals)])
        better = shorten_path(problem, path, roots, rounds, rng, accepts)
        path, message = better.path, f"{message}, {better.message}"
    return _succeed(problem, message, path, prove, quickest.others)


def _succeed(
    problem: Problem, message: str, path: LocalPoints, proven: bool, others: tuple[LocalPoints, ...] = ()
) -> Connection:
    for z in path[1:]:
        problem.tell(Step(StepKind.TREE, problem.group.from_local(z), "found by the tree"))
    return Connection(Status.SUCCESS, message, path, proven, others)


def _make_unconnected(
    problem: Problem, z_start: LocalPoint, found: tree_search.FoundPath, goals: int, refused: int
) -> Connection:
    status = problem.deadline.status()
    if found.path is None:
        message = explain_failed_search(found, goals, in_time=status is not None)
        if refused:
            message += f"; the certificate refused {refused} that looked free"
    else:
        message = "the certificate refused every path that the tree found"
    status = Status.PLANNING_FAILED if status is None or found.enclosed is not None else status
    return Connection(status, message, z_start[None])


def _certify_path(problem: Problem, path: LocalPoints) -> bool:
    for z0, z1 in pairwise(path):
        verdict = motion_free(problem.world, z0, z1, problem.min_clearance)
        problem.counters.collision_checks += verdict.evaluations
        if not verdict.free:
            return False
    return True


@dataclass(frozen=True, eq=False)
class Keeper:
    """Keeps configurations within path constraints."""

    problem: Problem
    frames: ConstrainedFrames

    def bring_back(self, z: LocalPoint) -> LocalPoint | None:
        """The point next to z (nv,), within limits, that keeps the constraints with room; None if there is none.

        Newton's steps of least length on the numbers that are too large.
        """
        there: LocalPoint = np.array(z)
        return there if bring_back(self.tables, CONSTRAINT_ROOM, CORRECTIONS, there) else None

    @property
    def tables(self) -> KeptFrames:
        """The constraints as kernels read them."""
        return keep_frames(self.frames)


def connect_constrained(
    problem: Problem, keeper: Keeper, z_start: LocalPoint, goals: LocalPoints, rng: np.random.Generator
) -> Connection:
    """Find a motion within path constraints from z_start (nv,) to one of some goals (m, nv), free by samples."""
    roots = np.array([problem.group.unwrapped(goal, z_start) for goal in goals])
    found = tree_search.grow(
        problem.batch, z_start[None], roots, RESOLUTION, 0.0, rng, problem.deadline,
        most_iterations=CONSTRAINED_ITERATIONS, frames=keeper.tables,
    )  # fmt: skip
    _count(problem, found)
    problem.tell(TreeGrown(found.trees))
    if found.path is None:
        status = problem.deadline.status()
        message = explain_failed_search(found, len(goals), in_time=status is not None)
        return Connection(status or Status.PLANNING_FAILED, f"within the path constraints {message}", z_start[None])
    path = _shorten(problem, keeper, found.path, rng)
    for z in path[1:]:
        problem.tell(Step(StepKind.TREE, problem.group.from_local(z), "found within the path constraints"))
    return Connection(Status.SUCCESS, f"found within the path constraints in {found.iterations} iterations", path)


def _shorten(problem: Problem, keeper: Keeper, path: LocalPoints, rng: np.random.Generator) -> LocalPoints:
    units = problem.group.units
    for _ in range(SHORTCUTS):
        if len(path) < 4 or problem.deadline.expired():
            break
        first, last = np.sort(rng.choice(len(path), 2, replace=False))
        ends = path[first], path[last]
        shorter = tree_search.grow(
            problem.batch, ends[0][None], ends[1][None], RESOLUTION, 0.0, rng, problem.deadline,
            most_iterations=0, frames=keeper.tables,
        ).path  # fmt: skip
        if shorter is None or np.abs(shorter[-1] - ends[1]).max() > 1e-9:  # not there, or there the other way round
            continue
        if length_of(shorter, units) < length_of(path[first : last + 1], units) - 1e-9:
            path = np.concatenate([path[:first], ends[0][None], shorter[1:-1], path[last:]])
    return path


class PoseKeeper:
    """Moves configurations that reach a pose and violate a path constraint to nearby ones that keep both."""

    def __init__(self, problem: Problem, target: PoseTarget) -> None:
        self._problem, self._target = problem, target
        self._tries = POSE_TRIES

    def __call__(self, zs: LocalPoints) -> LocalPoints:
        """Local coordinates (n, nv) that reach the pose, some moved; those that aren't helped stay."""
        if not self._problem.path_constraints:
            return zs
        moved: LocalPoints = zs.copy()
        for row, z in enumerate(zs):
            if self._tries == 0:
                break
            found = _move_within(self._problem, self._target, z)
            self._tries = self._tries - 1 if found is None else POSE_TRIES
            moved[row] = z if found is None else found
        return moved


def _move_within(problem: Problem, target: PoseTarget, z: LocalPoint) -> LocalPoint | None:
    frames, group = problem.constrained_frames, problem.group
    there = z.copy()
    for _ in range(POSE_STEPS):
        values, slopes = frames.values_and_rows(there)
        excess, rows, reached = _pose_excess(problem, target, there)
        if reached and (values <= frames.limits).all():
            return there
        beyond = values - CONSTRAINT_ROOM * frames.limits
        excess = np.concatenate([excess, np.maximum(beyond, 0.0)])
        active = excess != 0.0
        step = np.linalg.pinv(np.concatenate([rows, slopes])[active], rcond=DAMPING) @ excess[active]
        there = np.clip(there - step, group.lower, group.upper)
    return None


def _pose_excess(problem: Problem, target: PoseTarget, z: LocalPoint) -> tuple[np.ndarray, np.ndarray, bool]:
    """The tip's excess over the aimed part of the tolerances, shape (6,), its derivative (6, nv), and if it is there.

    All along and about the axes of the target's frame, translation first [m, rad].
    """
    group, kinematics = problem.group, problem.kinematics
    q = group.expand_from_local(z)
    tip = kinematics.frame_placement(q, group.tip_id)
    offset = target.placement.actInv(tip)
    away = np.concatenate([offset.translation, pin.log3(offset.rotation)])
    allowed = np.concatenate([target.position_tolerance, target.orientation_tolerance])
    aimed = np.where(allowed > EXACT, SEARCH.aim * allowed, 0.0)
    jacobian = kinematics.tip_jacobian(q) @ group.tangent_map(z)
    linear = target.placement.rotation.T @ jacobian[:3]
    angular = pin.Jlog3(offset.rotation) @ tip.rotation.T @ jacobian[3:]
    excess = np.sign(away) * np.maximum(np.abs(away) - aimed, 0.0)
    return excess, np.concatenate([linear, angular]), target.is_reached(tip)
