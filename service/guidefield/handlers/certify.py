"""Answer a certify request: the motion that it gives, the judgement, and the reply, in order."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import time
from collections.abc import Callable
from dataclasses import dataclass

from guidefield.case_file import Motion
from guidefield.collision.enclosure import find_closed_bodies
from guidefield.collision.part_tables import robot_parts
from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.errors import GuidefieldError
from guidefield.handlers.agreement import Certified, declare, declare_parts, keep_contradictions, require_agreement
from guidefield.handlers.attached import are_large, holding
from guidefield.handlers.certify_problem import certify_problem, planning_group
from guidefield.handlers.certify_reply import reply_to
from guidefield.handlers.preparation import crop_to_reach, prepare_plan
from guidefield.handlers.recording import PackedMotion, PlainMotion, Prove, Record
from guidefield.messages import scene as messages
from guidefield.messages.replies import CertifyReply
from guidefield.messages.requests import CertifyRequest, RobotReference
from guidefield.planner.judgement import GivenProblem, Judgement, Leaving, judge, judge_leaving
from guidefield.planner.motion.limit_load import measure_limit_shares
from guidefield.planner.quality import (
    ClearanceProfile,
    TimedMotion,
    measure_clearance,
    measure_clearance_profile,
    measure_clearances,
    measure_travel,
)
from guidefield.planner.task.stages import Stages
from guidefield.planner.task.trace import Silent
from guidefield.prove.tables import robot_bodies
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import Scene, build


@dataclass(frozen=True, eq=False)
class JudgedMotion(PlainMotion):
    """A motion that was judged."""

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
    """Judge a motion, and reply with the verdict; arguments as those of `answer_plan`.

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
    _ = problem.motion.pieces, measure_travel(_motion(problem), sizes)  # laid out for all that is asked about it
    uses = measure_limit_shares(problem.motion, problem.group, problem.jerk_limits)
    recording = record(problem.group, scene)
    problem = dataclasses.replace(problem, observer=recording or Silent())
    load_seconds = time.monotonic() - began
    stages = Stages(problem)
    with stages.entered("certify", "on the exact geometry, between rows too") as stage:
        judgement = judge(problem, uses)
        stage.outcome = judgement.verdict.reason.value
    with stages.entered("measure", "the smallest distances along the motion"):
        found = measure_clearances([(_motion(problem), problem)])
        if request.proof:
            certified = judgement.verdict.free and judgement.within_limits
            prove(_declare_parts(request, problem, judgement.leaving) if certified else [], deadline)
    measured = None if found is None else found[0]
    if measured is not None and judgement.verdict.free:
        file = functools.partial(motions_of, request, robot, scene)
        require_agreement(run_id, [Certified(measured, problem.min_clearance, file, _since(problem, judgement))])
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
    """Load a request's robot, and make the tables that judge it, before its time begins.

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
