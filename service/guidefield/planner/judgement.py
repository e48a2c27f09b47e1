"""The judgement of a motion that somebody else made: free, within its limits, keeping what is asked for; and how far.

It begins as a plan does: a body wholly inside another, or a slight contact that may be left. Then certificates judge
what rests, what moves, and what frames have to keep; of their refusals the first along the motion counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.planner.finish import LAST_JUDGEMENT, Finished
from guidefield.planner.given_leaving import Leaving, judge_leaving
from guidefield.planner.motion.given_motion import GivenMotion
from guidefield.planner.motion.limit_shares import Uses
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.start_enclosure import enclosed_start
from guidefield.planner.task.conditions import Conditions
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Stages
from guidefield.planner.timed_guide import TimedPath
from guidefield.prove.certificate import certify, certify_timed
from guidefield.prove.constraint_certificate import certify_constraints
from guidefield.prove.verdict import Reason, Verdict, first_refused
from guidefield.robot.model.configuration import LimitFault, limit_faults


@dataclass(frozen=True, eq=False, kw_only=True)
class GivenProblem(Conditions):
    """A motion that somebody else made, and what it is judged by.

    Attributes:
        motion: The motion.
    """

    motion: GivenMotion

    @cached_property
    def still_fault(self) -> LimitFault | None:
        """The joint that stands still farthest beyond a limit; None if none does."""
        joints, moving = self.group.robot.joints, {joint.name for joint in self.group.joints}
        still = [j for j in joints if (j.name if j.mimic is None else j.mimic.driver) not in moving]
        faults = limit_faults(still, self.group.q_reference)
        return max(faults, key=lambda fault: fault.excess, default=None)


@dataclass(frozen=True, eq=False)
class Judgement:
    """What is said about a motion.

    Attributes:
        verdict: Whether it is free and keeps what is asked for.
        uses: How much of its limits it uses.
        enclosed: Whether what is refused is a body wholly inside another at the start.
        leaving: How a contact at the start is left; None where there is none, or it may not be left.
    """

    verdict: Verdict
    uses: Uses
    enclosed: bool = False
    leaving: Leaving | None = None

    @property
    def within_limits(self) -> bool:
        """True if no rate exceeds its limit."""
        uses = self.uses
        return all(use.kept for use in (uses.velocity, uses.acceleration, uses.jerk))


def judge(problem: GivenProblem, uses: Uses) -> Judgement:
    """Judge a motion until time is up.

    Args:
        problem: The motion, and what it is judged by.
        uses: How much of its limits it uses.

    Raises:
        ValueError: if obstacles move and the motion has no times.
    """
    if (fault := problem.still_fault) is not None:
        z = problem.motion.start
        return Judgement(Verdict(Reason.BEYOND_LIMITS, 0, 0, 0.0, (0, 0.0), None, z, beyond=fault), uses)
    begin = problem.motion.along(0, 0.0)[1] or 0.0
    if (inside := enclosed_start(problem, problem.motion.start, begin)) is not None:
        return Judgement(inside, uses, enclosed=True)
    kept, leaving = _constraints(problem), None
    if problem.leave_start_contact:
        leaving = judge_leaving(problem, problem.motion.pieces)
    verdict = first_refused(kept, _freedom(problem, kept) if leaving is None else leaving.verdict)
    problem.counters.collision_checks += verdict.evaluations
    return Judgement(verdict, uses, leaving=leaving)


def _constraints(problem: GivenProblem) -> Verdict:
    """Return whether frames keep what they have to."""
    if not problem.path_constraints:
        return Verdict(Reason.FREE, 0)
    turns = problem.world.bodies.turns
    return certify_constraints(problem.constrained_frames, turns, problem.motion.pieces, problem.deadline)


def _freedom(problem: GivenProblem, kept: Verdict) -> Verdict:
    """Whether nothing touches or comes too close, as far as the path constraints are kept."""
    motion, deadline = problem.motion, problem.deadline
    count = len(motion.pieces) if kept.piece is None else kept.piece + 1
    if not problem.scene.moves:
        return certify(problem.world, motion.pieces[:count], problem.min_clearance, deadline=deadline)
    pieces, times = motion.scheduled.bezier()[:count], motion.scheduled.piece_times()[: count + 1]
    return certify_timed(problem.world, pieces, times, problem.min_clearance, deadline=deadline)


def judged_in_time(problem: Problem, motion: Trajectory, deadline: Deadline | None = None) -> Verdict:
    """Return whether a motion is free of what rests and what moves, and keeps the path constraints.

    Args:
        problem: Robot, obstacles and constraints.
        motion: From time 0 on.
        deadline: Ends the judgement. None: the problem's.
    """
    deadline = problem.deadline if deadline is None else deadline
    verdict, pieces = _free_in_time(problem, motion, deadline), motion.bezier()
    if verdict.free and problem.path_constraints:
        kept = certify_constraints(problem.constrained_frames, problem.world.bodies.turns, pieces, deadline)
        verdict = replace(kept, evaluations=verdict.evaluations + kept.evaluations)
    return verdict


def finish_timed(problem: Problem, found: TimedPath, stages: Stages) -> Finished:
    """Judge a guided motion among obstacles that move, whose schedule is the trajectory's.

    Args:
        problem: Robot, world, obstacles and path constraints.
        found: The motion, or how far it got: then only whether that is free.
        stages: Where time is counted.
    """
    trajectory, failure = found.trajectory(), found.failure
    whole = "on the exact geometry, in time, between samples too"
    with stages.entered("certify", whole if failure is None else "the motion as far as it got, in time") as stage:
        if failure is None:
            verdict = judged_in_time(problem, trajectory, problem.deadline.at_least(LAST_JUDGEMENT))
        else:
            verdict = _free_in_time(problem, trajectory, UNLIMITED)
        stage.outcome = verdict.reason.value
    if failure is not None:
        return Finished(verdict, np.array(found.points), found.crossings, failure=failure)
    problem.counters.collision_checks += verdict.evaluations
    return Finished(verdict, trajectory.positions, found.knots, trajectory)


def _free_in_time(problem: Problem, motion: Trajectory, deadline: Deadline) -> Verdict:
    pieces, times = motion.bezier(), motion.piece_times()
    if (inside := enclosed_start(problem, pieces[0, 0], float(times[0]))) is not None:
        return inside
    return certify_timed(problem.world, pieces, times, problem.min_clearance, deadline=deadline)
