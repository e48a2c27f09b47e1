"""Judge a given motion for a certify request: collisions, joint, Cartesian and effort limits, path constraints.

`LimitUses` checks limits of rates before. The judgement begins as a plan does: with a body wholly inside another,
or a slight contact that may be left (`leaving.py`). Then certificates judge the motion among obstacles at rest and in
motion, and its path constraints; of their refusals the first along the motion counts. handlers/certify.py words each
refusal: a further check or reason needs a branch there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from guidefield.deadline import DeadlineExpired
from guidefield.planner.leaving import (
    Leaving,
    judge_leaving,
)
from guidefield.planner.motion.drawn_motion import DrawnMotion
from guidefield.planner.motion.limit_load import LimitUses
from guidefield.planner.motion.submitted_motion import SubmittedMotion
from guidefield.planner.motion_certificate import certify_given, find_enclosed_start
from guidefield.planner.task.effort import Efforts, measure_efforts
from guidefield.planner.task.motion_limits import CartesianUse, measure_cartesian
from guidefield.planner.task.problem import Conditions
from guidefield.prove.certificate import certify_constraints
from guidefield.prove.verdict import LIMIT_TOLERANCE, Reason, Verdict, first_refused
from guidefield.robot.model.configuration import LimitFault, limit_faults


@dataclass(frozen=True, eq=False, kw_only=True)
class GivenProblem(Conditions):
    """A given motion with the conditions that it has to meet."""

    motion: SubmittedMotion
    planned: SubmittedMotion | None = None  # the motion that `motion` is to follow, if there is another one
    drawn: DrawnMotion | None = None  # what a controller is sent to draw `motion`; None: it is the one that was given

    @cached_property
    def still_fault(self) -> LimitFault | None:
        """The joint that stands still farthest beyond a limit; None if none does."""
        joints, moving = self.group.robot.joints, {joint.name for joint in self.group.joints}
        still = [j for j in joints if (j.name if j.mimic is None else j.mimic.source) not in moving]
        # what a mimic joint's law gives is rounded
        faults = [fault for fault in limit_faults(still, self.group.q_reference) if fault.excess > LIMIT_TOLERANCE]
        return max(faults, key=lambda fault: fault.excess, default=None)


@dataclass(frozen=True, eq=False)
class Judgement:
    """The result of judging a motion."""

    verdict: Verdict
    uses: LimitUses
    enclosed: bool = False  # whether what is refused is a body wholly inside another at the start
    # how a contact at the start is left; None where there is none, or it may not be left
    leaving: Leaving | None = None
    cartesian: tuple[CartesianUse, ...] = ()
    efforts: Efforts | None = None  # None of what has no accelerations

    @property
    def within_limits(self) -> bool:
        """True if no rate exceeds its limit."""
        uses = self.uses
        rates = all(use.is_within for use in (uses.velocity, uses.acceleration, uses.jerk))
        kept = self.efforts is None or self.efforts.excess is None
        return rates and kept and all(use.excess is None for use in self.cartesian)


def judge(problem: GivenProblem, uses: LimitUses) -> Judgement:
    """Judge a motion until time is up.

    Raises:
        ValueError: if obstacles move and the motion has no times.
        DeadlineExpired: if time is up before all of a long motion is examined for limits beside those of rates.
    """
    if (fault := problem.still_fault) is not None:
        z = problem.motion.start
        return Judgement(Verdict(Reason.BEYOND_LIMITS, 0, 0, 0.0, (0, 0.0), None, z, beyond=fault), uses)
    begin = problem.motion.along(0, 0.0)[1] or 0.0
    if (inside := find_enclosed_start(problem, problem.motion.start, begin)) is not None:
        return Judgement(inside, uses, enclosed=True)
    kept, leaving = _judge_constraints(problem), None
    if problem.leave_start_contact:
        leaving = judge_leaving(problem, problem.motion)
    verdict = first_refused(kept, _judge_freedom(problem, kept) if leaving is None else leaving.verdict)
    problem.counters.collision_checks += verdict.evaluations
    cartesian: tuple[CartesianUse, ...] = ()
    if problem.cartesian_limits:
        cartesian = measure_cartesian(problem.cartesian_limits, problem.motion.polynomials, problem.deadline)
    return Judgement(verdict, uses, leaving=leaving, cartesian=cartesian, efforts=_judge_efforts(problem))


def _judge_efforts(problem: GivenProblem) -> Efforts | None:
    motion = problem.motion
    if motion.times is None or (motion.velocities is None and not motion.is_point):
        return None
    try:
        return measure_efforts(problem.group, problem.effort_limit, motion.polynomials, problem.deadline)
    except DeadlineExpired:
        if problem.effort_limit is not None:
            raise
        return Efforts("the time that is allowed was up")


def _judge_constraints(problem: GivenProblem) -> Verdict:
    if not problem.path_constraints:
        return Verdict(Reason.FREE, 0)
    turns = problem.world.bodies.turns
    motion = problem.motion
    return certify_constraints(problem.constrained_frames, turns, motion.pieces, problem.deadline, motion.tube)


def _judge_freedom(problem: GivenProblem, kept: Verdict) -> Verdict:
    motion, deadline = problem.motion, problem.deadline
    count = len(motion.pieces) if kept.piece is None else kept.piece + 1
    return certify_given(problem, motion, deadline, count)
