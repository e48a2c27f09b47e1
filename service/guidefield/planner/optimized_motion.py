"""Optimise a motion that was found, shape and time together, and certify it: among obstacles at rest and in motion.

Among obstacles at rest, a motion that the certificate refuses is optimised again with more weight on the clearance and
more samples; then with samples where it touched. Among obstacles that move there is a certified motion already: its
wait stays a wait, the rest is optimised with every obstacle where it is at the time, the departure too if there is a
wait, and the result is taken if it is better and certified. `MAX_RETRIES` limits how often motions that are refused, or
beyond torques and speeds, are optimised again, `GAINED` how fast motions within limits of the whole are.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from guidefield.planner.motion.bspline import BSpline
from guidefield.planner.motion.limit_load import TOLERANCE, measure_limit_load, stretch_to_limits
from guidefield.planner.motion.timing import length_of
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion_certificate import CertifiedMotion, Judge, certify_motion, find_excess, judge
from guidefield.planner.optimize import settings as presets
from guidefield.planner.optimize.clearance_samples import TouchedPoint, is_better, touched_points
from guidefield.planner.optimize.optimization import Optimized, Outcome, optimize
from guidefield.planner.optimize.passages import Passage, PlanePlace, first_places, move_onto_places, with_knots
from guidefield.planner.path_so_far import limits_of, retime_motion
from guidefield.planner.schedule import wait_until_begin
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Stages
from guidefield.read_only import ReadOnly
from guidefield.robot.model.joints import LocalPoints

HURRIED = "time was up while the motion was optimised: with a longer `allowed_planning_time` it gets better"
"""Warning about a motion that is certified, but slower, or nearer to obstacles, than it had to be."""


@dataclass(frozen=True, eq=False)
class CrossedPlanes(ReadOnly):
    """The guide planes that an optimised motion crosses."""

    passages: tuple[Passage, ...]
    passage_planes: tuple[int, ...]  # index of the guide plane of each passage
    # by index of each other guide plane that was reached, the knot that stays on it: the first or the last
    at_ends: Mapping[int, int]

    @classmethod
    def of(cls, problem: Problem, path: LocalPoints, crossings: Mapping[int, int]) -> CrossedPlanes:
        """Find the planes crossed by a path (n, nv); `crossings` are indices in the path by index of each plane."""
        last = len(path) - 1
        inner = sorted((at, plane) for plane, at in crossings.items() if 0 < at < last)
        return cls(
            tuple(
                Passage(PlanePlace.through(problem, problem.guide_planes[plane], path[at]), path[at])
                for at, plane in inner
            ),
            tuple(plane for _, plane in inner),
            {plane: 0 if at == 0 else -1 for plane, at in crossings.items() if at in (0, last)},
        )

    def knots(self, trajectory: Trajectory, passed: Sequence[int]) -> dict[int, int]:
        """By index of each guide plane, the knot of a trajectory that is on it."""
        last = len(trajectory.times) - 1
        at_ends = {plane: 0 if at == 0 else last for plane, at in self.at_ends.items()}
        return at_ends | dict(zip(self.passage_planes, passed, strict=True))


GAINED = 0.03
"""A motion is timed anew for limits of the whole if the limits of rates alone let it be faster by this share."""

NO_PLANES = CrossedPlanes((), (), {})  # of a motion that crosses none


MAX_RETRIES = 3  # how often a motion that is refused again is optimised with samples where it touched, at most
ANY_TIME = (0.0, -math.inf)  # `between` of a motion that begins at time 0, and may end at any


def optimize_motion(
    problem: Problem,
    motion: Trajectory,
    others: Iterable[Trajectory],
    stages: Stages,
    crossed: CrossedPlanes = NO_PLANES,
    between: tuple[float, float] = ANY_TIME,
    judged_by: Judge = judge,
) -> CertifiedMotion | None:
    """Optimise a motion; where it is refused among obstacles that rest, optimise it again, at most `MAX_RETRIES` times.

    Args:
        motion: Where it begins; among obstacles that move one that is certified, from time 0 on.
        between: Until when the robot may stand where it starts, and from when on for good where it ends [s].

    Returns:
        The motion with its verdict. None where none is to be had; among obstacles that move, where none is better.
    """
    moves, finished = problem.scene.moves, None
    if moves and problem.deadline.expired():
        return None
    begun = motion
    if moves:  # without the wait at its start
        stands = (motion.positions == motion.positions[0]).all(axis=1) & (motion.velocities == 0.0).all(axis=1)
        begin = int(np.argmin(stands)) - 1
        begun = Trajectory(motion.times[begin:], motion.positions[begin:], motion.velocities[begin:])
    settings = choose_settings(problem, passes=bool(crossed.passages))
    if settings.rough:  # it is optimised in few pieces
        settings = presets.for_long_motion(settings, length_of(begun.positions, problem.group.sizes))
    message = f"shape and time together, {'among what moves, ' if moves else ''}{problem.objective.value}"
    touched: list[TouchedPoint] = []
    heaviest = presets.HEAVIER_LOADS**2 * settings.load_weight
    for attempt in range(2 + MAX_RETRIES):
        with stages.enter("relax", message) as stage:
            optimized = optimize(problem, begun, settings, others, crossed.passages, None, *between, touched)
            stage.outcome = optimized.outcome.value
        if optimized.outcome is Outcome.NOT_WITHIN:
            break
        made = None
        if optimized.outcome is not Outcome.NOT_PASSING:
            made = _certify_optimized(problem, optimized, begun, settings, crossed, between[1], stages, judged_by)
            if made is not None and (made.verdict.free or finished is None):
                finished = made
        settled = finished is not None and finished.verdict.free
        if moves or problem.deadline.expired() or (settled and not is_overloaded(problem, finished)):
            break
        if settled and made is finished:
            if settings.load_weight >= heaviest:
                break
            weight = presets.HEAVIER_LOADS * settings.load_weight
            message = "again, minding torques and speeds, because they exceed their limits"
            settings, others = replace(settings, load_weight=weight), ()
            continue
        if attempt == 0:
            why = "a guide plane was lost" if finished is None else "the certificate refused it"
            message, settings, others = f"again, looking closer, because {why}", presets.closer(settings), ()
            continue
        found = [] if made is None else touched_points(problem, made.verdict)
        if not found:
            break
        touched += found
        message = "again, looking at where it touched, because the certificate refused it"
    return finished


def is_overloaded(problem: Problem, finished: CertifiedMotion | None) -> bool:
    """Return whether a motion exceeds limits of the whole that no scaling of its time helps.

    It can't be scaled where it begins or ends in motion; and where gravity alone takes more, no time is long enough.
    """
    return (
        (problem.effort_limit is not None or problem.in_motion)
        and finished is not None
        and find_excess(problem, finished.trajectory) is not None
    )


def choose_settings(problem: Problem, *, passes: bool = False) -> presets.OptimizationSettings:
    """Choose the settings of a problem's optimisation; `passes`: the motion has to pass something on its way."""
    return presets.scale_to_size(_choose_usual_settings(problem, passes), problem.group.size)


def _choose_usual_settings(problem: Problem, passes: bool) -> presets.OptimizationSettings:
    settings, many = presets.OPTIMIZATION[problem.objective], problem.group.nv > presets.MANY
    if problem.path_constraints:
        return presets.for_path_constraints(presets.of_many(settings) if many else settings)
    if passes and not problem.scene.moves:
        return presets.for_guide_planes_of_many(settings) if many else presets.for_guide_planes(settings)
    if many:
        return presets.of_many(settings)
    settings = presets.free(settings)
    if problem.in_motion or problem.scene.moves:
        return presets.for_unscaled_time(settings) if problem.motion_limits and not problem.scene.moves else settings
    settings = presets.in_few_pieces(settings)
    return presets.in_space(settings) if problem.cartesian_limits else settings


def _certify_optimized(
    problem: Problem,
    optimized: Optimized,
    begun: Trajectory,
    settings: presets.OptimizationSettings,
    crossed: CrossedPlanes,
    arrive_from: float,
    stages: Stages,
    judged_by: Judge,
) -> CertifiedMotion | None:
    """Certify an optimised trajectory, with a warning if time was up in between; return None if it is no better."""
    warnings, finished = (HURRIED,) if optimized.outcome is Outcome.OUT_OF_TIME else (), None
    found = (optimized.trajectory, crossed.knots(optimized.trajectory, optimized.passed))
    candidates: Iterable[tuple[Trajectory, dict[int, int]]] = (found,)
    if problem.scene.moves:
        within = _time_within_limits(problem, optimized.trajectory, found[1], crossed, arrive_from)
        candidates = (one for one in within if is_better(problem, one[0], begun, settings))
    elif problem.motion_limits and not problem.in_motion:
        candidates = filter(None, (_retime(problem, optimized.trajectory, crossed), found))
    for shaped, passed in candidates:
        if problem.in_motion and _measure_load(problem, shaped) > 1.0 + TOLERANCE:  # its time can't be scaled
            continue
        whole = wait_until_begin(shaped)
        before = len(whole.times) - len(shaped.times)  # a knot, where it waits
        knots = {plane: before + at for plane, at in passed.items()}
        finished = replace(certify_motion(problem, whole, knots, stages, judged_by), warnings=warnings)
        if finished.verdict.free:
            break
    return finished


def _retime(problem: Problem, motion: Trajectory, crossed: CrossedPlanes) -> tuple[Trajectory, dict[int, int]] | None:
    if _measure_load(problem, motion) > 1.0 - GAINED:
        return None
    spline = retime_motion(problem, motion)
    made = None if spline is None else bring_onto_planes(problem, spline, crossed)
    return None if made is None or made[0].duration >= motion.duration else made


def _measure_load(problem: Problem, motion: Trajectory) -> float:
    knots = (motion.times - motion.times[0], motion.positions, motion.velocities)
    return measure_limit_load(*knots, *limits_of(problem)[:3])


def bring_onto_planes(
    problem: Problem, spline: BSpline, crossed: CrossedPlanes
) -> tuple[Trajectory, dict[int, int]] | None:
    """A motion brought exactly onto the guide planes that it crosses, as fast as its limits allow, and its knots there.

    None where it can't be brought there.
    """
    sizes = problem.group.sizes
    about = first_places(crossed.passages, Trajectory(*spline.knots()), spline.pieces, sizes)
    exact = move_onto_places(spline, crossed.passages, about, sizes)
    if exact is None:
        return None
    knots, passed = with_knots(*exact)
    limits = limits_of(problem)
    trajectory = stretch_to_limits(*knots, *limits[:3], limits.motion_limits, limits.deadline)
    return trajectory, crossed.knots(trajectory, passed)


def _time_within_limits(
    problem: Problem, motion: Trajectory, passed: dict[int, int], crossed: CrossedPlanes, arrive_from: float
) -> Iterator[tuple[Trajectory, dict[int, int]]]:
    """A motion as fast as it may go, if it doesn't arrive too soon then; and as it is, if it is within its limits.

    With its knots on guide planes. For limits beside those of rates it is timed anew along its path as well.
    """
    begin, rates = float(motion.times[0]), limits_of(problem)
    knots = (motion.times - begin, motion.positions, motion.velocities)
    fast = stretch_to_limits(*knots, *rates[:3], rates.motion_limits, rates.deadline)
    anew = _retime(problem, fast, crossed) if rates.motion_limits else None
    for one, on_planes in filter(None, (anew, (fast, passed))):
        if begin + one.duration >= arrive_from:
            yield Trajectory(begin + one.times, one.positions, one.velocities), on_planes
    if _measure_load(problem, motion) <= 1.0 and all(
        it.stretch(motion.polynomials) <= 1.0 for it in rates.motion_limits
    ):
        yield motion, passed
