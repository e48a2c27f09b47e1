"""The certificate of a plan's motion, among what rests and what moves alike: a still scene is one that ends at 0."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from guidefield.collision.enclosure import enclosed
from guidefield.deadline import Deadline
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.path_so_far import PathSoFar
from guidefield.planner.quality import certify_and_measure
from guidefield.planner.task.problem import Conditions, Problem
from guidefield.planner.task.stages import Ending, Stages
from guidefield.prove.certificate import certify, certify_constraints
from guidefield.prove.verdict import Reason, Verdict
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartCurves, ChartPoint, ChartPoints

LAST_JUDGEMENT = 0.03
"""For how long a motion may still be judged when time is up or the run is ended [s]: one that is proven is worth it."""


@dataclass(frozen=True, eq=False)
class Finished(ReadOnly):
    """A motion at the end of planning, and the certificate's verdict about it."""

    verdict: Verdict  # the certificate's judgement of `trajectory`, or of `path` where there is no trajectory
    path: ChartPoints  # chart points that it runs through, shape (n, nv) [rad or m]
    crossings: Mapping[int, int]  # by index of each guide plane that was reached, its index in `path`
    trajectory: Trajectory | None = None  # what the robot would execute; None where a stage failed before
    failure: Ending | None = None  # why a stage failed; None where none did
    warnings: tuple[str, ...] = ()
    judged_from: float = 0.0  # since when the trajectory is judged: before that it leaves a contact at the start [s]


def judge(problem: Problem, trajectory: Trajectory) -> Verdict:
    """Judge whether a motion from a free start is free of what rests and what moves, and keeps the path constraints."""
    deadline = problem.deadline.at_least(LAST_JUDGEMENT)
    pieces, times = trajectory.bezier(), trajectory.piece_times()
    if problem.scene.moves:  # a better one may follow, so that only the last is measured
        verdict = certify(problem.world, pieces, problem.min_clearance, deadline=deadline, times=times)
    else:
        verdict = certify_and_measure(trajectory, problem, deadline)
    return _with_constraints(problem, verdict, pieces, deadline)


Judge = Callable[[Problem, Trajectory], Verdict]  # judges a motion from time 0 on


def certify_motion(
    problem: Problem,
    trajectory: Trajectory,
    crossings: Mapping[int, int],
    stages: Stages,
    judged_by: Judge = judge,
    message: str = "on the exact geometry, between samples too",
) -> Finished:
    """Return a trajectory with the verdict of whoever judges it.

    Args:
        crossings: By index of each guide plane that was reached, the index of its knot.
    """
    with stages.entered("certify", message) as stage:
        verdict = judged_by(problem, trajectory)
        problem.counters.collision_checks += verdict.evaluations
        stage.outcome = verdict.reason.value
    return Finished(verdict, trajectory.positions, crossings, trajectory)


def certify_as_far_as_found(problem: Problem, found: PathSoFar, stages: Stages) -> Finished:
    """Return the motion of a stage that failed, certified as far as it goes."""
    with stages.entered("certify", "the motion as far as it got") as stage:
        pieces, times = found.bezier(), found.piece_times()
        deadline = problem.deadline.at_least(LAST_JUDGEMENT)
        verdict = enclosed_start(problem, pieces[0, 0]) or certify(
            problem.world, pieces, problem.min_clearance, deadline=deadline, times=times
        )
        stage.outcome = verdict.reason.value
    return Finished(verdict, found.path, found.crossings, failure=found.failure)


def certify_from_start(conditions: Conditions, motion: Trajectory, deadline: Deadline) -> Verdict:
    """Judge a motion from its start on, which need not be free, and the path constraints."""
    pieces, times = motion.bezier(), motion.piece_times()
    verdict = enclosed_start(conditions, pieces[0, 0], float(times[0])) or certify(
        conditions.world, pieces, conditions.min_clearance, deadline=deadline, times=times
    )
    return _with_constraints(conditions, verdict, pieces, deadline)


def _with_constraints(conditions: Conditions, verdict: Verdict, pieces: ChartCurves, deadline: Deadline) -> Verdict:
    if not (verdict.free and conditions.path_constraints):
        return verdict
    kept = certify_constraints(conditions.constrained_frames, conditions.world.bodies.turns, pieces, deadline)
    return replace(kept, evaluations=verdict.evaluations + kept.evaluations)


def enclosed_start(conditions: Conditions, z: ChartPoint, time: float = 0.0) -> Verdict | None:
    """The refusal of a motion for what is wholly inside another at its start (nv,).

    None where nothing is, or it touches. A certificate of what comes after the start doesn't see it: a mesh is a
    surface to Coal.
    """
    world = conditions.world_at(time)
    q = conditions.group.expand_from_chart(z)
    inside = enclosed(world, q)  # of most worlds known at once: it is asked first
    if inside is None or world.in_collision(q):
        return None
    return Verdict(Reason.CONTACT, 1, 0, 0.0, (0, 0.0), inside, z)
