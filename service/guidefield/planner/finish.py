"""From a path that was found to the trajectory that is executed: relax, lay a spline, time it, certify it.

What the certificate refuses goes back: the spline is drawn closer to the path where it was refused (a path of straight,
certified motions is its limit); where the path itself touches, it is relaxed again with shorter segments, whose samples
see what was overlooked; and where that can't be certified either, the path that was found is taken instead.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from guidefield.collision.certify.certificate import certify
from guidefield.collision.certify.constraint_certificate import certify_constraints
from guidefield.collision.certify.position_limits import TOLERANCE
from guidefield.collision.certify.verdict import Reason, Verdict
from guidefield.collision.clearance import clearance_at
from guidefield.planner.connect.constrained_tree import Keeper
from guidefield.planner.motion.jerk import parameterize_gently
from guidefield.planner.motion.spline import CubicSpline, interpolate
from guidefield.planner.motion.timing import parameterize
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.relax.relaxation import SEGMENT, Outcome, Relaxed, relax
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Stages

REPAIRS = 12
"""How often the spline is drawn closer to the path where the certificate refused it."""

FINER = 0.5
"""Segments of a path that is relaxed again, as a share of the usual ones."""

LAST_JUDGEMENT = 0.1
"""For how long a motion may still be judged when time is up or the run is ended [s]: one that is proven is worth it."""

HURRIED = "time was up while the motion was relaxed: with a longer `allowed_planning_time` it keeps further away"
"""Warning about a motion that is certified, but nearer to obstacles than it had to be."""


@dataclass(frozen=True, eq=False)
class Finished:
    """The trajectory, the verdict about it, and the path that it follows.

    Attributes:
        trajectory: What the robot would execute.
        verdict: The certificate's judgement of it.
        path: Chart points that it runs through, shape (n, nv) [rad or m].
        crossings: By index of each guide plane, its index in `path`.
        warnings: What was odd but harmless.
    """

    trajectory: Trajectory
    verdict: Verdict
    path: np.ndarray
    crossings: dict[int, int]
    warnings: tuple[str, ...] = ()


def finish(
    problem: Problem, path: np.ndarray, crossings: dict[int, int], stages: Stages, *, proven: bool = True
) -> Finished:
    """Make a certified trajectory of a path whose straight pieces are free.

    Args:
        problem: Robot, world, limits and budget.
        path: Chart points, shape (n, nv).
        crossings: By index of each guide plane, its index in `path`; kept.
        stages: Where time is counted.
        proven: Whether the path itself is certified: only then is it worth a try where the relaxed one is refused.
    """
    with stages.entered("relax", "to the middle of the free space") as stage:
        relaxed = relax(problem, path, crossings)
        stage.outcome = relaxed.outcome
    finished = _of_relaxed(problem, relaxed, stages)
    if not (finished.verdict.free or problem.budget.spent()):
        finished = _repaired(problem, relaxed, stages) or finished
    if finished.verdict.free or not proven:
        return finished
    unrelaxed = _certified(problem, path, crossings, stages)
    if not unrelaxed.verdict.free:
        return unrelaxed if finished.verdict.reason is Reason.CONTACT else finished
    warning = (
        f"the relaxed motion was not certified ({finished.verdict.reason.value}); this is the motion as it was found"
    )
    return Finished(unrelaxed.trajectory, unrelaxed.verdict, unrelaxed.path, unrelaxed.crossings, (warning,))


def _repaired(problem: Problem, refused: Relaxed, stages: Stages) -> Finished | None:
    """The trajectory along a refused path that was relaxed again, with shorter segments; None if it is refused, too."""
    with stages.entered("relax", "again, looking closer, because the certificate refused it") as stage:
        relaxed = relax(problem, refused.path, refused.crossings, segment=FINER * SEGMENT)
        stage.outcome = relaxed.outcome
    finished = _of_relaxed(problem, relaxed, stages)
    return finished if finished.verdict.free else None


def _of_relaxed(problem: Problem, relaxed: Relaxed, stages: Stages) -> Finished:
    """The trajectory along a relaxed path, with a warning where time was up meanwhile."""
    finished = _certified(problem, relaxed.path, relaxed.crossings, stages)
    return replace(finished, warnings=(HURRIED,)) if relaxed.outcome is Outcome.OUT_OF_TIME else finished


def _certified(problem: Problem, path: np.ndarray, crossings: dict[int, int], stages: Stages) -> Finished:
    """Time and certify the spline through a path, drawing it closer to the path where it is refused."""
    knots, marks = path, dict(crossings)
    for repair in range(REPAIRS + 1):
        with stages.entered("parameterize", "as fast as the limits allow") as stage:
            spline = through(problem, knots if len(knots) > 1 else np.repeat(knots, 2, axis=0))
            trajectory = timed(problem, spline)
            stage.outcome = f"{trajectory.duration:.3f} s"
        with stages.entered("certify", "on the exact geometry, between samples too") as stage:
            verdict = _judged(problem, trajectory.bezier())
            problem.counters.collision_checks += verdict.evaluations
            stage.outcome = verdict.reason.value
        hopeless = repair == REPAIRS or verdict.piece is None or len(knots) < 2
        if verdict.free or hopeless or problem.budget.spent():
            break
        refused = trajectory.bezier()[verdict.piece].mean(axis=0)
        worst, nearest = _nearest(knots, refused)
        if _refused_at(problem, nearest, verdict.reason):
            break  # a spline that is drawn closer would be refused there, too
        knots, marks = _denser(problem, knots, marks, worst)
    return Finished(trajectory, verdict, knots, marks)


def _judged(problem: Problem, pieces: np.ndarray) -> Verdict:
    """Whether a motion is free, and keeps the path constraints."""
    stopped = _at_the_very_end(problem)
    verdict = certify(problem.world, pieces, problem.min_clearance, stopped=stopped)
    if not (verdict.free and problem.path_constraints):
        return verdict
    turns = problem.world.bodies.turns
    kept = certify_constraints(problem.constrained_frames, turns, pieces, stopped)
    return replace(kept, evaluations=verdict.evaluations + kept.evaluations)


def _at_the_very_end(problem: Problem) -> Callable[[], object]:
    """Whether time is up, and what is still allowed for a judgement that begins now has passed too."""
    until = time.monotonic() + LAST_JUDGEMENT
    return lambda: time.monotonic() >= until and problem.budget.spent()


def through(problem: Problem, path: np.ndarray) -> CubicSpline:
    """The spline through a path's chart points (n, nv), n >= 2, that keeps the joints' position limits."""
    return interpolate(path, problem.group.lower, problem.group.upper)


def timed(problem: Problem, spline: CubicSpline) -> Trajectory:
    """The motion along a curve within the problem's limits."""
    group = problem.group
    if problem.jerk_limits is None:
        return parameterize(spline, group.velocity_limits, group.acceleration_limits)
    return parameterize_gently(spline, group.velocity_limits, group.acceleration_limits, problem.jerk_limits)


def _refused_at(problem: Problem, z: np.ndarray, reason: Reason) -> bool:
    """Whether a chart point (nv,) itself is refused for a reason: contact, less than the clearance, beyond limits."""
    q = problem.group.from_chart(z)
    match reason:
        case Reason.BEYOND_LIMITS:
            return bool(((z < problem.group.lower - TOLERANCE) | (z > problem.group.upper + TOLERANCE)).any())
        case Reason.TOO_CLOSE:
            return clearance_at(problem.world, q).obstacle_distance < problem.min_clearance
        case Reason.CONTACT:
            return problem.world.in_collision(q)
    return False


def _nearest(path: np.ndarray, place: np.ndarray) -> tuple[int, np.ndarray]:
    """The segment of a path (n, nv) that is nearest to a place (nv,), and the point (nv,) of it that is."""
    along = np.diff(path, axis=0)
    share = np.einsum("ij,ij->i", place - path[:-1], along) / np.maximum(np.einsum("ij,ij->i", along, along), 1e-30)
    nearest = path[:-1] + np.clip(share, 0.0, 1.0)[:, None] * along
    segment = int(np.argmin(np.linalg.norm(place - nearest, axis=1)))
    return segment, nearest[segment]


def _denser(
    problem: Problem, path: np.ndarray, crossings: dict[int, int], worst: int
) -> tuple[np.ndarray, dict[int, int]]:
    """Midpoints inserted into a segment and those next to it, within the path constraints."""
    split = [i for i in range(worst - 1, worst + 2) if 0 <= i < len(path) - 1]
    middles = np.array([0.5 * (path[i] + path[i + 1]) for i in split])
    if problem.path_constraints:
        keeper = Keeper(problem, problem.constrained_frames)
        middles = np.array([middle if (back := keeper.brought_back(middle)) is None else back for middle in middles])
    denser = np.insert(path, np.array(split) + 1, middles, axis=0)
    return denser, {plane: index + sum(index > i for i in split) for plane, index in crossings.items()}
