"""The judgement of a motion that somebody else made: free, within its limits, keeping what is asked for; and how far.

It begins as a plan does: a body wholly inside another, or a slight contact that may be left. Then certificates judge
what rests, what moves, and what frames have to keep; of their refusals the first along the motion counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from guidefield.planner.given_leaving import Leaving, judge_leaving
from guidefield.planner.motion.given_motion import GivenMotion
from guidefield.planner.motion.limit_shares import Uses
from guidefield.planner.motion_certificate import enclosed_start
from guidefield.planner.task.conditions import Conditions
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
