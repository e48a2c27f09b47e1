"""Answer a certify request: its motion, the judgement, and the reply with its sentences, in order.

Sentences may be changed; names of `details` are the wire. `restore_certify` builds the same problem for a recording
that is drawn later: a change of how it is built must come to both.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from guidefield.case_file import Motion
from guidefield.collision.clearance import find_closed_bodies
from guidefield.collision.part_tables import robot_parts
from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline, end_reason, seconds_waited
from guidefield.errors import GuidefieldError, Status
from guidefield.handlers.agreement import Certified, declare, declare_parts, keep_contradictions, require_agreement
from guidefield.handlers.attached import are_large, holding
from guidefield.handlers.certify_problem import certify_problem, planning_group
from guidefield.handlers.plan_reply import (
    CERTIFICATE,
    clearance_figures,
    execution_figures,
    outcome,
    self_figures,
    warn_of_bounds,
    wire_cartesian_use,
    wire_deviation,
    wire_efforts,
)
from guidefield.handlers.preparation import crop_to_reach, prepare_plan
from guidefield.handlers.recording import PackedMotion, PlainMotion, Prove, Record
from guidefield.messages import replies, scene as messages
from guidefield.messages.certify_reply import describe_place
from guidefield.messages.replies import CertifyReply
from guidefield.messages.requests import CertifyRequest, RobotReference
from guidefield.planner.judgement import GivenProblem, Judgement, judge
from guidefield.planner.leaving import Leaving, judge_leaving, warn_of_left_contacts
from guidefield.planner.motion.drawn_motion import deviations
from guidefield.planner.motion.limit_load import LimitUse, measure_limit_shares
from guidefield.planner.motion.submitted_motion import QuinticMotion
from guidefield.planner.quality import (
    UNMEASURED,
    Clearance,
    ClearanceProfile,
    TimedMotion,
    measure_clearance,
    measure_clearance_profile,
    measure_clearances,
    measure_travel,
)
from guidefield.planner.task.stages import Ending, Stages, describe_kept, describe_refused_place
from guidefield.planner.task.trace import Silent
from guidefield.prove.tables import robot_bodies
from guidefield.prove.verdict import Reason, Verdict
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import Scene, build

RATES = ("velocity", "acceleration", "jerk")
"""Fields of `LimitUses` and of the reply with shares of limits of rates."""


def reply_to(
    problem: GivenProblem,
    judgement: Judgement,
    measured: Clearance | None,
    run_id: str,
    received: float,
    seconds: Mapping[str, float],
    warnings: Sequence[str],
) -> CertifyReply:
    """Build the reply from a judgement; `seconds` are times of stages [s], `measured` None if time was up before."""
    group, ended, leaving = problem.group, _ending(problem, judgement), judgement.leaving
    uses = judgement.uses
    left = [] if leaving is None or not leaving.leaves else [warn_of_left_contacts(leaving.contacts)]
    return CertifyReply(
        run_id=run_id,
        status=outcome(ended.status, ended.message, ended.details),
        warnings=[*warnings, *left, *(warn_of_bounds(measured) if measured else [UNMEASURED])],
        curve=problem.motion.kind.value,
        position_names=group.position_names,
        velocity_names=group.velocity_names,
        certificate=_certificate(problem, judgement),
        clearance=_clearance(problem, judgement, measured),
        self_clearance=self_figures(measured, 0.0 if _is_certified(judgement) else -np.inf) if measured else None,
        limits=replies.LimitShares(
            position=_position_use(problem, uses.position),
            velocity=_use(problem, uses.velocity, "velocity_owner"),
            acceleration=_use(problem, uses.acceleration, "acceleration_owner"),
            jerk=_use(problem, uses.jerk),
        ),
        cartesian=[
            wire_cartesian_use(use, jumps=problem.motion.velocities is None and not problem.motion.is_point)
            for use in judgement.cartesian
        ],
        effort=None if judgement.efforts is None else wire_efforts(judgement.efforts),
        timing=replies.Timing(**seconds, total=time.monotonic() - received),
        counters=replies.Counters(collision_checks=problem.counters.collision_checks),
        recording=None,
        execution=_execution(problem),
        deviation=_deviation(problem),
    )


def _execution(problem: GivenProblem) -> replies.ExecutionFigures | None:
    if problem.drawn is None or problem.execution is None or problem.planned is None:
        return None
    planned = problem.planned.scheduled
    assert not isinstance(planned, QuinticMotion), "rows that are given are cubic or straight"
    return execution_figures(problem.execution, planned, problem.drawn, problem.group)


def _deviation(problem: GivenProblem) -> replies.MotionDeviation | None:
    if problem.planned is None or problem.drawn is not None:
        return None
    planned = problem.planned.scheduled
    assert not isinstance(planned, QuinticMotion), "rows that are given are cubic or straight"
    return wire_deviation(deviations(planned, problem.motion), problem.group)


def _ending(problem: GivenProblem, judgement: Judgement) -> Ending:
    verdict = judgement.verdict
    if verdict.free and judgement.within_limits:
        return Ending(Status.SUCCESS, "the motion is certified free over its whole length and within its limits")
    if verdict.free:
        return _beyond_a_rate(problem, judgement)
    where = describe_place(*_locate_verdict(problem, verdict))
    details = describe_refused_place(problem.group, verdict)
    if verdict.reason is Reason.STOPPED:
        status = problem.deadline.status() or Status.TIMED_OUT
        until = describe_place(*_free_until(problem, verdict))
        return Ending(
            status, f"{end_reason(status)} before the motion was certified; it is free until {until}", details
        )
    return Ending(Status.INVALID_MOTION_PLAN, f"{_describe_refusal(problem, judgement)}, at {where}", details)


def _describe_refusal(problem: GivenProblem, judgement: Judgement) -> str:
    verdict = judgement.verdict
    pair = " and ".join(verdict.pair) if verdict.pair else "bodies"
    match verdict.reason:
        case Reason.CONTACT:
            return _describe_contact(judgement, pair)
        case Reason.TOO_CLOSE:
            return f"the motion keeps less than {1000 * problem.min_clearance:g} mm between {pair}"
        case Reason.BEYOND_LIMITS:
            fault = verdict.beyond
            assert fault is not None, "a joint is beyond its limits"
            return (
                f"joint {fault.joint} reaches {fault.value:.6g}, {fault.excess:.3g} beyond its limits"
                f" [{fault.lower:.6g}, {fault.upper:.6g}]"
            )
        case Reason.PATH_CONSTRAINT:
            return "the motion violates a path constraint"
        case _:
            if problem.motion.tube is not None:
                kept = describe_kept(problem.min_clearance)
                return (
                    f"where the execution may be, by its tolerance or between its ticks, it is undecided that {pair}"
                    f" {kept}"
                )
            kept = f"keep {1000 * problem.min_clearance:g} mm" if problem.min_clearance > 0.0 else "touch"
            return f"the motion brings {pair} so close that it is undecided whether they {kept}"


def _describe_contact(judgement: Judgement, pair: str) -> str:
    if judgement.enclosed:
        return f"the motion begins with {pair}, one wholly inside the other"
    if judgement.leaving is not None and not judgement.leaving.leaves:
        return f"the motion begins in contact and doesn't leave it without coming closer: {pair}"
    return f"the motion is in contact: {pair}"


def _beyond_a_rate(problem: GivenProblem, judgement: Judgement) -> Ending:
    group, motion = problem.group, problem.motion
    exceeded = {name: use for name in RATES if not (use := getattr(judgement.uses, name)).is_within}
    if not exceeded:
        efforts = judgement.efforts
        if efforts is not None and (beyond := efforts.excess) is not None:
            where = describe_place(*_measured_at(problem, beyond.reached.time))
            return Ending(Status.INVALID_MOTION_PLAN, *beyond.describe_excess(where))
        in_space, excess = next((use, excess) for use in judgement.cartesian if (excess := use.excess) is not None)
        where = describe_place(*_measured_at(problem, excess[2].time))
        return Ending(Status.INVALID_MOTION_PLAN, *in_space.describe_excess(where))
    name, use = max(exceeded.items(), key=lambda item: np.inf if item[1].share is None else item[1].share)
    assert use.coordinate is not None, "a limit that is exceeded is of a joint"
    joint = group.joints[_joint_of(problem, use.coordinate)].name
    place = motion.along(use.piece, use.at)
    more = f" (and {', '.join(other for other in exceeded if other != name)})" if len(exceeded) > 1 else ""
    if use.share is None:
        message = f"the acceleration of joint {joint} jumps at {describe_place(*place)}, so that it keeps no jerk limit"
    else:
        message = f"joint {joint} uses {100 * use.share:.4g} % of its {name} limit{more}, at {describe_place(*place)}"
    details: dict[str, Any] = {"stage": "limits", "limit": name, "joint": joint, "share": use.share}
    return Ending(Status.INVALID_MOTION_PLAN, message, details)


def _locate_verdict(problem: GivenProblem, verdict: Verdict) -> tuple[float, float | None]:
    if verdict.piece is None or verdict.parameter is None:
        return problem.motion.end
    return problem.motion.along(verdict.piece, verdict.parameter)


def _free_until(problem: GivenProblem, verdict: Verdict) -> tuple[float, float | None]:
    return problem.motion.end if verdict.free_until is None else problem.motion.along(*verdict.free_until)


def _describe_covered(problem: GivenProblem, leaving: Leaving | None) -> str:
    what = "path" if problem.motion.times is None else "trajectory"
    if leaving is None or not leaving.leaves:
        return what
    row, when = problem.motion.along(leaving.piece, leaving.share)
    return f"{what} after row {row:.6f}" if when is None else f"{what} after {when:.6f} s"


def _certificate(problem: GivenProblem, judgement: Judgement) -> replies.MotionCertificate:
    group, place, verdict = problem.group, None, judgement.verdict
    if verdict.local_point is not None:
        row, when = _locate_verdict(problem, verdict)
        columns = group.wire_positions(verdict.local_point)
        place = replies.Place(row=row, time=when, configuration=dict(zip(group.position_names, columns, strict=True)))
    row, when = _free_until(problem, verdict)
    return replies.MotionCertificate(
        collision_free=verdict.free,
        method=CERTIFICATE,
        covers=_describe_covered(problem, judgement.leaving),
        evaluations=verdict.evaluations,
        reason=verdict.reason.value,
        free_until=replies.Along(row=row, time=when),
        pair=list(verdict.pair) if verdict.pair else None,
        place=place,
    )


def _clearance(
    problem: GivenProblem, judgement: Judgement, measured: Clearance | None
) -> replies.MotionClearance | None:
    if measured is None:
        return None
    figures = clearance_figures(measured, problem.min_clearance if _is_certified(judgement) else -np.inf)
    row, when = (None, None) if figures.time is None else _measured_at(problem, figures.time)
    return replies.MotionClearance(**{**msgspec.structs.asdict(figures), "time": when, "row": row})


def _is_certified(judgement: Judgement) -> bool:
    return judgement.verdict.free and judgement.leaving is None


def _measured_at(problem: GivenProblem, time: float) -> tuple[float, float | None]:
    motion = problem.motion
    if not problem.scene.moves:
        return motion.along_measured(time)
    times = motion.scheduled.times
    if motion.is_point:
        return motion.along(0, 0.0)
    piece = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2))
    return motion.along(piece, float(np.clip((time - times[piece]) / (times[piece + 1] - times[piece]), 0.0, 1.0)))


def _position_use(problem: GivenProblem, use: LimitUse) -> replies.LimitUse:
    """The largest share of a position limit; that of a joint that stands still where that is beyond its own."""
    fault = problem.still_fault
    if fault is None or fault.upper <= fault.lower:
        return _use(problem, use)
    share = 2.0 * abs(fault.value - 0.5 * (fault.lower + fault.upper)) / (fault.upper - fault.lower)
    if use.share is not None and use.share >= share:
        return _use(problem, use)
    row, when = problem.motion.along(0, 0.0)
    return replies.LimitUse(share=share, joint=fault.joint, row=row, time=when)


def _use(problem: GivenProblem, use: LimitUse, owner: str = "name") -> replies.LimitUse:
    """A use on the wire; `owner` is the field of a joint with the name of the mimic joint whose limit it is, if any."""
    if use.coordinate is None:
        return replies.LimitUse()
    row, when = problem.motion.along(use.piece, use.at)
    joint = problem.group.joints[_joint_of(problem, use.coordinate)]
    name = getattr(joint, owner) or joint.name
    return replies.LimitUse(share=use.share, joint=name, row=row, time=when, steps=use.steps)


def _joint_of(problem: GivenProblem, coordinate: int) -> int:
    return next(k for k, j in enumerate(problem.group.joints) if j.idx_v <= coordinate < j.idx_v + j.nv)


@dataclass(frozen=True, eq=False)
class JudgedMotion(PlainMotion):
    """A submitted motion and its verdict."""

    conditions: GivenProblem

    def profile(self) -> ClearanceProfile:
        """As in `RecordedMotion`; distances that weren't measured in time are measured here."""
        found = self.found or measure_clearance(_motion(self.conditions), self.conditions)
        return measure_clearance_profile((found, self.conditions, self.scene))


@keep_contradictions
def answer_certify(
    request: CertifyRequest,
    robot: RobotModel,
    scene: Scene,
    *,
    run_id: str,
    received: float,
    began: float | None = None,
    record: Record[CertifyReply] = lambda *_: None,
    prove: Prove = lambda *_: None,
    deadline: Deadline | None = None,
) -> CertifyReply:
    """Judge a motion, and reply with the verdict; arguments as those of `plan.answer_plan`.

    Raises:
        GuidefieldError: InvalidGroup, InvalidConfiguration, UnknownFrame, UnknownObject, SceneInvalid or
            MalformedRequest where the question is ill-posed, or asks for what this version doesn't serve.
        DeadlineExpired: if the deadline passed before the scene or the motion was prepared, or before speeds in space
            and torques that are limited were found.
    """
    began = time.monotonic() if began is None else began
    deadline = Deadline(received + request.allowed_time) if deadline is None else deadline
    problem, warnings = certify_problem(request, robot, scene, deadline)
    if not request.proof:  # a proof is about the whole scene
        problem = crop_to_reach(problem, deadline, limited=False)
    prepare_plan(None, problem.scene, deadline)
    deadline.check("the motion was laid out")
    sizes = tuple(problem.group.sizes.tolist())
    _ = problem.motion.pieces, measure_travel(_motion(problem), sizes)  # computed once for all later queries
    uses = measure_limit_shares(problem.motion, problem.group, problem.jerk_limits)
    recording = record(problem.group, scene)
    problem = dataclasses.replace(problem, observer=recording or Silent())
    load_seconds, waited = time.monotonic() - began, seconds_waited()
    stages = Stages(problem)
    with stages.enter("certify", "on the exact geometry, between rows too") as stage:
        judgement = judge(problem, uses)
        stage.outcome = judgement.verdict.reason.value
    with stages.enter("measure", "the smallest distances along the motion"):
        found = measure_clearances([(_motion(problem), problem)])
        if request.proof:
            certified = judgement.verdict.free and judgement.within_limits
            prove(_declare_parts(request, problem, judgement.leaving) if certified else [], deadline)
    measured = None if found is None else found[0]
    if measured is not None and judgement.verdict.free:
        file = functools.partial(motions_of, request, robot, scene)
        require_agreement(run_id, [Certified(measured, problem.min_clearance, file, _since(problem, judgement))])
    load_seconds += seconds_waited() - waited
    seconds = {"queue": began - received, "load": load_seconds, **stages.seconds}
    reply = reply_to(problem, judgement, measured, run_id, received, seconds, warnings)
    if recording is not None:
        recording.finish(reply, JudgedMotion(scene, problem, measured))
    return reply


def restore_certify(request: CertifyRequest, robot: RobotModel, scene: Scene, packed: PackedMotion) -> JudgedMotion:
    """Restore the motion of a judgement from its log, for the recording; arguments as those of `answer_certify`."""
    problem, _ = certify_problem(request, robot, scene, UNLIMITED)
    problem = crop_to_reach(problem, UNLIMITED, limited=False)
    found = None if packed.found is None else packed.found.clearance(_motion(problem), problem)
    return JudgedMotion(scene, problem, found)


def lay_out_ahead(request: CertifyRequest, load: Callable[[RobotReference], RobotModel]) -> None:
    """Load a request's robot, and make the tables for the certificate, before its time begins.

    Errors are left to `answer_certify`, whose refusals are stored.
    """
    with contextlib.suppress(GuidefieldError):
        robot = load(request.robot)
        nowhere = build(messages.Scene(name="nowhere"))
        if request.attached_objects and not are_large(request.attached_objects):
            robot = holding(robot, request.attached_objects, nowhere)
        group = planning_group(request, robot)
        robot_bodies(World.build(group, nowhere))
        find_closed_bodies(group)
        robot_parts(group)


def _motion(problem: GivenProblem) -> TimedMotion:
    return problem.motion.measured_among(problem.scene)


def _since(problem: GivenProblem, judgement: Judgement) -> float | None:
    """The time from which a motion is certified [s, as measured]: after the piece on which it leaves a contact."""
    if judgement.leaving is None or not judgement.leaving.leaves:
        return None
    times = _motion(problem).piece_times()
    return float(times[min(judgement.leaving.piece + 1, len(times) - 1)])


def motions_of(request: CertifyRequest, robot: RobotModel, scene: Scene) -> list[Motion]:
    """The motion of a request for the referee; in two parts where it leaves a contact at the start.

    Raises GuidefieldError as `certify_problem`, where the question is ill-posed.
    """
    problem, _ = certify_problem(request, robot, scene, Deadline(time.monotonic() + request.allowed_time))
    leaving = judge_leaving(problem, problem.motion) if request.leave_start_contact else None
    return _declare_parts(request, problem, leaving)


def _declare_parts(request: CertifyRequest, problem: GivenProblem, leaving: Leaving | None) -> list[Motion]:
    if leaving is None or not leaving.parts:
        return [declare(request, problem, problem.motion)]
    return declare_parts(request, leaving.parts, leaving.contacts)
