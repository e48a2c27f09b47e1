"""Motions past goals along rounded corners: timed as a whole, certified, rounded more tightly where that is refused.

Away from its corners the motion goes along the curves that were planned for the steps; a corner lies within the radius
of the goal that is passed.

A corner is where a curve A ends at the place c at which the next one, B, begins. From where A has a length ``a`` left
to where B has gone a length ``b``, with ``u`` from 0 to 1,

    q(u) = A(a (1 - u)²) + B(b u²) - c,

lengths counted from c, takes their place. It begins along A and ends along B, as a parabola between two straight lines;
nothing else of the curves is changed. (With u³ (2 - u) for u² the curvature has no step, and motions were 2 % slower,
with limits of jerk up to 7 %.)

Each part is certified, and passes its goal within the radius: constants change how fast motions are, and the time to
find them. `NO_RADIUS` is `passages.REACHED` at least, `MOST_OF_CURVE` a half at most; docs/steps.md has `TIME_SHARE`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np

from guidefield.collision.world import World
from guidefield.planner.goal_among_movers import keep_schedule
from guidefield.planner.held_paths import without_movers
from guidefield.planner.motion.timing import length_of
from guidefield.planner.motion.trajectory import Trajectory, concatenate
from guidefield.planner.motion_certificate import CertifiedMotion, find_excess
from guidefield.planner.optimize import settings as presets
from guidefield.planner.optimize.clearance_samples import CONSTRAINT_ROOM, Sections
from guidefield.planner.optimize.optimization import Outcome, optimize
from guidefield.planner.optimize.passages import Passage
from guidefield.planner.optimized_motion import CrossedPlanes, bring_onto_planes
from guidefield.planner.path_so_far import retime_motion, time_path, time_path_ignoring_jerk
from guidefield.planner.sequence.cartesian_line import CartesianLine
from guidefield.planner.sequence.segments import (
    GoalPassage,
    JoinedMotion,
    PassedGoal,
    StepPart,
    find_passage,
    find_refused_part,
    find_slowest,
)
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Stages
from guidefield.prove.verdict import Reason, Verdict
from guidefield.read_only import ReadOnly
from guidefield.robot.group.path_constraints import ConstrainedFrames, EvenTurn, PathConstraint, line, point
from guidefield.robot.model.joints import LocalPoints

PIECE_SHARE = 0.5  # length of a piece before the last subdivision, as a share of the smallest radius
LEAST_PIECES = 16  # for each step
MOST_PIECES = 160  # for all steps
INSIDE = 0.95  # share of a radius up to which the tip is at a goal
TIME_SHARE = 0.5  # share of the remaining time that may be taken: later steps need some, too
# motions to certify at most; after the first with more weight on the clearance and twice the pieces
OPTIMIZED_TRIES = 2
EDGE_HALVINGS = 20  # of a piece of a motion, until the edge of a goal's radius is found


def optimize_past_goals(parts: Sequence[StepPart], first: JoinedMotion, stages: Stages) -> JoinedMotion | None:
    """The optimised motion, certified; None where none is, or not all steps may be optimised.

    Args:
        first: A motion past the goals with which it begins, whatever its jerk.
    """
    problem = find_slowest(parts)  # with a share of the time that is left: later steps need some, too
    problem = dataclasses.replace(problem, deadline=problem.deadline.share(TIME_SHARE))
    if not _can_be_optimized(parts) or problem.deadline.expired():
        return None
    passages = _passages(parts, first)
    sections, settings = _sections(problem, parts), _choose_settings(problem, parts, first.motion)
    best: JoinedMotion | None = None
    for _ in range(OPTIMIZED_TRIES):
        with stages.enter("relax", f"past the goals, shape and time together, {problem.objective.value}") as stage:
            optimized = optimize(problem, first.motion, settings, (), passages, sections)
            stage.outcome = optimized.outcome.value
        joined = (
            None if optimized.outcome is Outcome.NOT_PASSING else _join(optimized.trajectory, optimized.passed, parts)
        )
        if joined is not None:
            with stages.enter("certify", "between the goals and past them, between samples too") as stage:
                fault = find_refused_part(parts, joined)
                stage.outcome = "free" if fault is None else fault[1].reason.value
            if fault is None:
                found = _retime(parts, joined, stages) or joined
                best = found if best is None else min(best, found, key=lambda one: one.motion.duration)
                if not problem.motion_limits or best.motion.duration < first.motion.duration:
                    return best
        if problem.deadline.expired():
            break
        pieces = 2 * settings.least_pieces
        settings = dataclasses.replace(
            presets.closer(settings), least_pieces=pieces, most_pieces=2 * settings.most_pieces
        )
    return best


def _can_be_optimized(parts: Sequence[StepPart]) -> bool:
    """Return whether steps may be optimised: of few coordinates, straight ones along a line and next to tip goals."""
    if parts[0].problem.group.nv > presets.MANY:
        return False
    for k, one in enumerate(parts):
        problem, straight = one.problem, one.line
        if one.motion.duration == 0.0 or problem.guide_planes or problem.optimization_iterations == 0:
            return False
        goals = [beside.goal for beside in parts[max(k - 1, 0) : k + 1] if beside.goal is not None]
        if straight is not None and (straight.is_point or not all(goal.is_of_tip for goal in goals)):
            return False
    return True


def _sections(problem: Problem, parts: Sequence[StepPart]) -> Sections:
    """Constraints of the whole motion; and on a straight line itself, or one beside it, or being at a goal between."""
    constraints: list[PathConstraint] = list(problem.path_constraints)
    groups, near = [-1] * len(constraints), [range(len(parts))] * len(constraints)
    for k, one in enumerate(parts):  # what is at a goal isn't held to a line as well
        if one.goal is not None and one.goal.is_of_tip:
            constraints += _make_goal_section(one.goal)
            groups += 2 * [k]
            near += 2 * [range(k, k + 2)]
    for k, one in enumerate(parts):
        if one.line is not None:
            constraints += _make_line_section(one.line)
            groups += 2 * [len(parts) + k]
            near += 2 * [range(k - 1, k + 2)]
    straight = [one.line is not None for one in parts]
    active = np.array(
        [
            [group == -1 or (straight[k] and k in sections) for group, sections in zip(groups, near, strict=True)]
            for k in range(len(parts))
        ],
        np.int64,
    ).reshape(len(parts), -1)
    return Sections(ConstrainedFrames(problem.group, tuple(constraints)), np.array(groups, np.int64), active)


def _make_goal_section(goal: PassedGoal) -> tuple[PathConstraint, PathConstraint]:
    frame, here = goal.problem.group.tip, goal.placement
    limit = INSIDE / CONSTRAINT_ROOM * goal.radius
    return point(frame, here.translation, limit), EvenTurn(frame, here, np.zeros(3), np.zeros(3), limit)


def _make_line_section(straight: CartesianLine) -> tuple[PathConstraint, PathConstraint]:
    begin = straight.begin
    return (
        line(straight.frame, begin.translation, straight.direction, straight.line_tolerance),
        EvenTurn(straight.frame, begin, straight.shift, straight.turn, straight.turn_tolerance),
    )


def _choose_settings(problem: Problem, parts: Sequence[StepPart], motion: Trajectory) -> presets.OptimizationSettings:
    radius = min(one.goal.radius for one in parts if one.goal is not None)
    wanted = math.ceil(length_of(motion.positions) / (PIECE_SHARE * radius))
    least = min(max(wanted, LEAST_PIECES * len(parts)), MOST_PIECES)
    settings = presets.scale_to_size(presets.OPTIMIZATION[problem.objective], problem.group.size)
    keeps = problem.path_constraints or any(one.line is not None for one in parts)
    settings = presets.for_path_constraints(settings) if keeps else settings
    return dataclasses.replace(settings, least_pieces=least, most_pieces=max(MOST_PIECES, least))


def _passages(parts: Sequence[StepPart], joined: JoinedMotion) -> tuple[Passage, ...]:
    goals = [one.goal for one in parts if one.goal is not None]
    return tuple(
        Passage(goal, joined.motion.positions[at.nearest]) for goal, at in zip(goals, joined.passages, strict=True)
    )


def _join(motion: Trajectory, passed: Sequence[int], parts: Sequence[StepPart]) -> JoinedMotion:
    goals = [one.goal for one in parts if one.goal is not None]
    straight = [one.line is not None for one in parts]
    next_to_lines = [goal for goal, *both in zip(goals, straight, straight[1:], strict=False) if any(both)]
    knots, motion = motion.times[[0, *passed, -1]], _add_edges(motion, next_to_lines)
    bounds = np.searchsorted(motion.times, knots).tolist()
    passages = list[GoalPassage]()
    for goal, first, about, last in zip(goals, bounds, bounds[1:], bounds[2:], strict=False):
        since = max(first, passages[-1].nearest) if passages else first  # within large radii they stay in order, too
        passages.append(find_passage(goal, motion, (since, about, last)))
    return JoinedMotion(motion, tuple(passages))


def _add_edges(motion: Trajectory, goals: Sequence[PassedGoal]) -> Trajectory:
    """Return the same motion with a knot wherever it enters or leaves a goal's radius, just within it.

    From its last knot within a radius on it has to keep to a straight line, which it may reach at the edge alone.
    """
    times, edges = motion.times, list[float]()
    for goal in goals:
        within = goal.distances(motion.positions) <= goal.radius
        for k in np.flatnonzero(within[:-1] != within[1:]).tolist():
            inside, outside = (times[k], times[k + 1]) if within[k] else (times[k + 1], times[k])
            for _ in range(EDGE_HALVINGS):
                middle = 0.5 * (inside + outside)
                is_within = goal.distances(motion.evaluate(np.array([middle]))[0])[0] <= goal.radius
                inside, outside = (middle, outside) if is_within else (inside, middle)
            edges.append(inside)
    refined = np.unique([*times.tolist(), *edges])
    return Trajectory(refined, *motion.evaluate(refined)[:2])


CHORDS_PER_PIECE = 8  # of a motion, by which its length is measured
RADIUS_SHARE = 0.9  # of a radius that a corner takes: a spline through its places stays within the radius, too
MOST_OF_CURVE = 0.5  # share of a curve's length that a corner takes at most: the other end has as much
LEAST_PLACES = 16  # on a corner, at least
FINE_PLACES = 200  # places by which a corner is drawn, and its length measured


class CurveByLength:
    """The curve of a motion by its length."""

    def __init__(self, motion: Trajectory) -> None:
        within = np.arange(CHORDS_PER_PIECE) / CHORDS_PER_PIECE
        times = (motion.times[:-1, None] + within * np.diff(motion.times)[:, None]).ravel()
        self._motion, self._times = motion, np.append(times, motion.times[-1])
        self.places = motion.evaluate(self._times)[0]
        self.lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(self.places, axis=0), axis=1))]

    @property
    def length(self) -> float:
        """[rad or m]."""
        return float(self.lengths[-1])

    def at(self, lengths: np.ndarray) -> LocalPoints:
        """Points of the curve at lengths (k,): shape (k, nv)."""
        return self._motion.evaluate(np.interp(lengths, self.lengths, self._times))[0]


@dataclass(frozen=True, eq=False)
class RoundedPath(ReadOnly):
    """A path through rounded corners."""

    path: LocalPoints  # its places, shape (n, nv)
    corners: tuple[tuple[int, int], ...]  # for each corner, where it begins and ends in `path`


def round_corners(
    curves: Sequence[CurveByLength], goals: Sequence[PassedGoal], radii: Sequence[float], spacing: float
) -> RoundedPath:
    """A path along curves, each of which begins where the one before ends.

    Args:
        spacing: Between places, at most [rad or m].
    """
    begin, path, corners, count = 0.0, [], [], 0
    for k, (curve, after) in enumerate(zip(curves, [*curves[1:], None], strict=True)):
        if after is None:
            path.append(_space_evenly(curve, begin, curve.length, spacing))
            break
        left, right = _measure_reach(curve, after, goals[k], radii[k])
        straight = _space_evenly(curve, begin, curve.length - left, spacing)
        bend = _make_corner(curve, after, left, right, spacing)
        path += [straight, bend[1:-1]]
        first = count + len(straight) - 1
        count = first + len(bend) - 1
        corners.append((first, count))
        begin = right
    return RoundedPath(cast(LocalPoints, np.concatenate(path)), tuple(corners))


def _measure_reach(curve: CurveByLength, after: CurveByLength, goal: PassedGoal, radius: float) -> tuple[float, float]:
    """Lengths before and after a goal that a corner takes [rad or m]."""
    within = RADIUS_SHARE * radius
    return (
        _find_length_until(goal.distances(curve.places)[::-1], curve.length - curve.lengths[::-1], within),
        _find_length_until(goal.distances(after.places), after.lengths, within),
    )


def _find_length_until(distances: np.ndarray, lengths: np.ndarray, within: float) -> float:
    """The length at which the distances first reach a bound; at most the share of the whole that a corner may take."""
    most = MOST_OF_CURVE * float(lengths[-1])
    beyond = np.flatnonzero(distances > within)
    if not len(beyond):
        return most
    k = int(beyond[0])
    share = (within - distances[k - 1]) / (distances[k] - distances[k - 1])
    return min(most, float(lengths[k - 1] + share * (lengths[k] - lengths[k - 1])))


def _space_evenly(curve: CurveByLength, begin: float, end: float, spacing: float) -> LocalPoints:
    count = max(2, math.ceil((end - begin) / spacing) + 1)
    return curve.at(np.linspace(begin, end, count))


def _make_corner(curve: CurveByLength, after: CurveByLength, left: float, right: float, spacing: float) -> LocalPoints:
    """Places of a corner, evenly spaced, its first on the one curve and its last on the other."""
    u = np.linspace(0.0, 1.0, FINE_PLACES + 1)
    corner = curve.at(np.array([curve.length]))
    bend = curve.at(curve.length - left * (1.0 - u) ** 2) + after.at(right * u**2) - corner
    lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(bend, axis=0), axis=1))]
    count = max(LEAST_PLACES, math.ceil(lengths[-1] / spacing)) + 1
    places = np.linspace(0.0, lengths[-1], count)
    return cast(LocalPoints, np.column_stack([np.interp(places, lengths, column) for column in bend.T]))


SPACING = 0.03  # between places of the path that is timed, at most [rad or m]
TRIES = 10  # motions to certify at most
TIGHTER = 0.5  # the corners next to what is refused are this much smaller the next time
# places, and the pieces of a motion with limits of jerk, are this many times as dense the next time where a line, or a
# goal, isn't kept to
DENSER = 2
DENSEST = 32  # this many times as dense at most


def round_motion(parts: Sequence[StepPart], stages: Stages) -> tuple[JoinedMotion, RoundedPath] | None:
    """The motion along rounded corners, certified, and its path; None where none is."""
    curves = [CurveByLength(one.motion) for one in parts]
    goals = [one.goal for one in parts if one.goal is not None]
    radii, density = [goal.radius for goal in goals], 1
    problem = find_slowest(parts)
    for _ in range(TRIES):
        with stages.enter("parameterize", "past the goals, as fast as the limits allow") as stage:
            path = round_corners(curves, goals, radii, SPACING / density)
            motion = time_path(problem, path.path, density)
            joined = JoinedMotion(motion, find_passages(motion, path, goals))
            stage.outcome = f"{motion.duration:.3f} s"
        with stages.enter("certify", "between the goals and past them, between samples too") as stage:
            fault = find_refused_part(parts, joined)
            stage.outcome = "free" if fault is None else fault[1].reason.value
        if fault is None:
            return joined, path
        if problem.deadline.expired():
            break
        at, verdict = fault
        coarse = verdict.reason in (Reason.PATH_CONSTRAINT, Reason.FREE) and density < DENSEST
        if coarse:
            density *= DENSER
        if not coarse or problem.path_constraints:
            for k in (at - 1, at):
                if 0 <= k < len(radii):
                    radii[k] *= TIGHTER
    return None


def find_passages(motion: Trajectory, path: RoundedPath, goals: Sequence[PassedGoal]) -> tuple[GoalPassage, ...]:
    """Find where a motion along a path passes each goal: about the middle of its corner, by length."""
    travelled = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(motion.positions, axis=0), axis=1))]
    lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path.path, axis=0), axis=1))]
    lengths *= travelled[-1] / max(lengths[-1], 1e-300)
    bounds = [0.0, *(0.5 * (lengths[a[1]] + lengths[b[0]]) for a, b in pairwise(path.corners)), travelled[-1]]
    passages = []
    for k, (goal, (begin, end)) in enumerate(zip(goals, path.corners, strict=True)):
        first, last = np.searchsorted(travelled, bounds[k]), np.searchsorted(travelled, bounds[k + 1], side="right") - 1
        low, high = (
            (np.searchsorted(travelled, lengths[[begin, end]]) + np.array([-1, 2])).clip(first, last + 1).tolist()
        )
        about = low + int(np.argmin(goal.distances(motion.positions[low:high])))
        passages.append(find_passage(goal, motion, (int(first), about, int(last))))
    return tuple(passages)


NO_RADIUS = 1e-6
"""Goals with a radius up to this are stopped at: optimised motions pass places that closely, no closer [m, rad]."""


def join_motions(parts: Sequence[StepPart], stages: Stages) -> JoinedMotion:
    """Join motions of the same joints; what is past goals among what rests is gone when nothing that moves is met."""
    knots = np.cumsum([max(len(one.motion.times) - 1, 0) for one in parts]).tolist()
    passages = tuple(GoalPassage(knot, knot, knot, 0.0) for knot in knots[:-1])
    stopping = JoinedMotion(concatenate([one.motion for one in parts]), passages, stops=True)
    if min(one.goal.radius for one in parts if one.goal is not None) <= NO_RADIUS:
        return stopping
    still = [dataclasses.replace(one, problem=without_movers(one.problem)) for one in parts]
    along = round_motion(still, stages)
    first = stopping if along is None else _time_path_ignoring_jerk(still, along[1])
    optimized = optimize_past_goals(still, first, stages)
    past = [optimized, None if along is None else along[0]]
    found = [_schedule(parts, one, stages) for one in past if one is not None and not _exceeds(still, one)]
    return min(filter(None, [*found, stopping]), key=lambda one: one.motion.duration)


def _exceeds(parts: Sequence[StepPart], joined: JoinedMotion) -> bool:
    """Return whether a motion past goals exceeds a limit of the whole, for which no time is long enough."""
    return find_excess(find_slowest(parts), joined.motion) is not None


def _retime(parts: Sequence[StepPart], joined: JoinedMotion, stages: Stages) -> JoinedMotion | None:
    """A motion past goals timed for limits beside those of rates along its path, certified; None where that's slower.

    It passes goals at the same places.
    """
    problem = find_slowest(parts)
    crossed = CrossedPlanes(_passages(parts, joined), tuple(range(len(joined.passages))), {})
    spline = retime_motion(problem, joined.motion) if problem.motion_limits else None
    found = None if spline is None else bring_onto_planes(problem, spline, crossed)
    if found is None or found[0].duration >= joined.motion.duration:
        return None
    made = _join(found[0], [found[1][k] for k in crossed.passage_planes], parts)
    with stages.enter("certify", "the same, timed anew for limits of the whole") as stage:
        fault = find_refused_part(parts, made)
        stage.outcome = "free" if fault is None else fault[1].reason.value
    return made if fault is None else None


def _schedule(parts: Sequence[StepPart], joined: JoinedMotion, stages: Stages) -> JoinedMotion | None:
    """The motion past the goals when nothing that moves is met, each part certified then; None where there is none."""
    problem = find_slowest(parts)
    if not problem.scene.moves:
        return joined
    allowed = frozenset[tuple[str, str]]().union(*(one.problem.allowed_collisions for one in parts))
    world = World.build(problem.group, problem.scene, allowed)
    problem = dataclasses.replace(problem, world=world, allowed_collisions=allowed)
    goals = [one.goal for one in parts if one.goal is not None]
    path = RoundedPath(joined.motion.positions, tuple((one.entered, one.left) for one in joined.passages))

    def judge_parts(motion: Trajectory) -> Verdict:
        refused = find_refused_part(parts, JoinedMotion(motion, find_passages(motion, path, goals)))
        if refused is None:
            return Verdict(Reason.FREE, 0)
        return Verdict(Reason.PATH_CONSTRAINT, 0) if refused[1].free else refused[1]

    finished = CertifiedMotion(Verdict(Reason.FREE, 0), joined.motion.positions, {}, joined.motion)
    motion = keep_schedule(problem, finished, stages, judge_parts).trajectory
    return None if motion is None else JoinedMotion(motion, find_passages(motion, path, goals))


def _time_path_ignoring_jerk(parts: Sequence[StepPart], path: RoundedPath) -> JoinedMotion:
    motion = time_path_ignoring_jerk(find_slowest(parts), path.path)
    return JoinedMotion(motion, find_passages(motion, path, [one.goal for one in parts if one.goal is not None]))
