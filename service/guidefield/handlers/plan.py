"""Answer a plan request for one goal: its problem, the plan, and the reply, in order; prepare its robot ahead.

`restore_plan` builds the same problem for a recording that is drawn later: a change of how it is built must come to
both. What `prepare_ahead` leaves out counts as the plan's own time.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable
from typing import Any

from guidefield.case_file import Motion
from guidefield.collision.clearance import contacts_at
from guidefield.collision.preparation import Announce, is_prepared, prepare
from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.errors import GuidefieldError, Status
from guidefield.geometry.surfaces import se3
from guidefield.handlers.agreement import Certified, declare, declare_parts, keep_contradictions, require_agreement
from guidefield.handlers.asked_group import start_of
from guidefield.handlers.attached import are_large, holding
from guidefield.handlers.plan_problem import Derivation, problem_of, with_derived_planes
from guidefield.handlers.plan_reply import reply_to
from guidefield.handlers.preparation import connects, crop_to_reach, is_laid_out, prepare_links, prepare_problem
from guidefield.handlers.recording import PackedMotion, PlainMotion, Prove, Record
from guidefield.kernel_wait import seconds_waited
from guidefield.messages import requests, scene as messages
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import AttachedObject, PlanRequest
from guidefield.planner.guide.guide import ATTEMPTS, PROJECTED
from guidefield.planner.judgement import split_where_left
from guidefield.planner.motion.drawn_motion import draw_plan
from guidefield.planner.motion.submitted_motion import SubmittedMotion
from guidefield.planner.plan import Plan, Planner, make_refused_plan, plan
from guidefield.planner.quality import UNMEASURED, TimedMotion, measure_clearances
from guidefield.planner.task.problem import ConfigurationGoal, Problem
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import LimitFault, limit_faults
from guidefield.robot.model.model import JointKind, RobotModel
from guidefield.scene.scene import Scene, build


@keep_contradictions
def answer_plan(
    request: PlanRequest,
    robot: RobotModel,
    scene: Scene,
    *,
    run_id: str,
    received: float,
    began: float | None = None,
    record: Record[PlanReply] = lambda *_: None,
    preparing: Announce = lambda _: None,
    prove: Prove = lambda *_: None,
    deadline: Deadline | None = None,
) -> PlanReply:
    """Plan, and reply with the outcome.

    Args:
        received: When it arrived, on the clock of `time.monotonic` [s].
        began: When loading its robot and scene began, on the same clock [s]; None: now.
        record: Opens the recording.
        preparing: Called with the part of the robot that is prepared, where that isn't known from before.
        prove: Keeps the proof, where the request asks for it.
        deadline: When planning must end; None: when the time that the request allows is up.

    Raises:
        GuidefieldError: InvalidGroup, InvalidGoal, InvalidConfiguration, UnknownFrame, UnknownObject, SceneInvalid or
            MalformedRequest where the question is ill-posed, or asks for what this version doesn't serve.
        DeadlineExpired: if the deadline passed before robot and scene were prepared.
    """
    began = time.monotonic() if began is None else began
    deadline = Deadline(received + request.allowed_planning_time) if deadline is None else deadline
    problem, warnings = problem_of(request, robot, scene, deadline)
    guided = _is_guided(request, problem)
    if not (guided or request.proof):  # a proof contains the problem's scene: all of it, as it is declared
        problem = crop_to_reach(problem, deadline)
    attempts = ATTEMPTS[request.minimizer](problem.group) if guided or request.minimizer == "univariate" else PROJECTED
    refusal, derivation = refuse_ends(problem), Derivation()
    if refusal is None:
        prepare_problem(request, problem, preparing)
        problem, derivation = with_derived_planes(problem, request)
    recording = record(problem.group, scene)
    if recording is not None:
        problem = dataclasses.replace(problem, observer=recording)
    # stages until here report their own time: it doesn't count as loading
    others = [*(refusal.seconds.values() if refusal else ()), *([derivation.left.seconds] if derivation.left else ())]
    load_seconds, waited = time.monotonic() - began - sum(others), seconds_waited()
    made = derivation.add_to(refusal or plan(problem, Planner(request.planner), attempts))
    drawn = made.drawn
    motion = made.trajectory if drawn is None else drawn.motion.measured_among(problem.scene)
    measured = None if motion is None else measure_clearances([(motion, problem)])
    if made.trajectory is not None and measured is None:
        warnings = (*warnings, UNMEASURED)
    found = measured[0] if measured else None
    if found is not None and made.verdict.free:
        since = made.judged_from or None
        require_agreement(
            run_id, [Certified(found, problem.min_clearance, lambda: _motions(request, problem, made), since)]
        )
    if request.proof:
        certified = made.trajectory is not None and made.verdict.free
        prove(_motions(request, problem, made) if certified else [], deadline)
    seconds = {"queue": began - received, "load": load_seconds + seconds_waited() - waited}
    reply = reply_to(request, problem, made, drawn, found, run_id, received, seconds, warnings)
    if recording is not None:
        parts = 1 if drawn is None else drawn.parts
        recording.finish(reply, PlainMotion(scene, problem, found, made.trajectory, parts))
    return reply


def restore_plan(request: PlanRequest, robot: RobotModel, scene: Scene, packed: PackedMotion) -> PlainMotion:
    """Restore the motion of a plan from its log, for the recording; arguments as those of `answer_plan`.

    Its scene is cropped also where a proof was asked for: distances are the same (`crop_to_reach`).
    """
    problem, _ = problem_of(request, robot, scene, UNLIMITED)
    if not _is_guided(request, problem):
        problem = crop_to_reach(problem, UNLIMITED)
    trajectory = None if packed.knots is None else packed.knots.trajectory()
    found = None
    if packed.found is not None and trajectory is not None:
        motion: TimedMotion = trajectory
        if problem.execution is not None:
            motion = draw_plan(trajectory, problem.execution, packed.parts).motion.measured_among(problem.scene)
        found = packed.found.clearance(motion, problem)
    return PlainMotion(scene, problem, found, trajectory, packed.parts)


def _is_guided(request: PlanRequest, problem: Problem) -> bool:
    return bool(problem.guide_planes) or request.guide_planes == "auto"


def _motions(request: PlanRequest, problem: Problem, made: Plan) -> list[Motion]:
    """A plan's motion for the referee, as it is executed: in two parts where it leaves a contact at the start."""
    assert made.trajectory is not None, "it was measured"
    motion = SubmittedMotion.of(made.trajectory) if made.drawn is None else made.drawn.motion
    if not made.judged_from:
        return [declare(request, problem, motion)]
    contacts = contacts_at(problem.world_at(0.0), problem.group.expand_from_chart(problem.z_start))
    parts = split_where_left(problem, motion, contacts, motion.place_at(made.judged_from))
    return declare_parts(request, parts, contacts)


def prepare_ahead(
    request: PlanRequest,
    load: Callable[[requests.RobotReference], RobotModel],
    declared: Callable[[requests.SceneReference], messages.Scene],
) -> bool:
    """Prepare a request's robot and lay its links out before its time begins; return whether that was done before.

    Errors are left to `answer_plan`, whose refusals are stored.
    """
    with contextlib.suppress(GuidefieldError):
        robot = load(request.robot)
        if not connects(request):
            return is_prepared(robot)
        nowhere, base = build(messages.Scene(name="nowhere")), request.robot_placement
        held = request.attached_objects
        robots = [robot]
        if held and not are_large(held):
            robots.append(holding(robot, held, nowhere))
        picked = _picked_up(request, robot, declared)
        if picked and not are_large(picked):  # the place where it is held is known later; only its shape takes long
            picking = holding(robot, picked, nowhere)
            if not is_prepared(picking):
                prepare(picking)
        missing = [one for one in robots if not is_laid_out(one)]
        if not missing:
            return True
        q, _ = start_of(request.start, robot)
        for one in missing:
            group = select(one, request.group, request.tip, q, se3(base.position, base.quaternion_xyzw))
            prepare(one)
            prepare_links(World.build(group, nowhere), UNLIMITED)
    return False


def _picked_up(
    request: PlanRequest, robot: RobotModel, declared: Callable[[requests.SceneReference], messages.Scene]
) -> list[AttachedObject]:
    names = {step.attach.object for step in request.steps if step.attach is not None}
    if not names:
        return []
    obstacles = [one for one in declared(request.scene).obstacles if one.name in names]
    return [AttachedObject(obstacle=one, link=robot.tip) for one in obstacles]


def refuse_ends(problem: Problem) -> Plan | None:
    """Return the plan of a problem whose start or goal is beyond a joint limit; None if they are not."""
    faults = limit_faults(problem.group.robot.joints, problem.group.q_reference)
    if faults:
        return make_refused_plan(
            problem, Status.START_STATE_INVALID, *_limit_message("start", faults, problem.group.robot)
        )
    if isinstance(problem.goal, ConfigurationGoal):
        configurations = problem.goal.configurations
        faults = limit_faults(problem.group.joints, configurations[0])
        if faults:
            message, details = _limit_message("goal", faults, problem.group.robot)
            if len(configurations) > 1:
                message = (
                    f"all {len(configurations)} goals are outside of limits; {message.replace('goal', 'first', 1)}"
                )
            return make_refused_plan(problem, Status.GOAL_STATE_INVALID, message, details)
    return None


def _limit_message(end: str, faults: list[LimitFault], robot: RobotModel) -> tuple[str, dict[str, Any]]:
    """Return the sentence and its values, whose names are the wire (`Outcome.details`)."""
    first, *others = sorted(faults, key=lambda fault: -fault.excess)
    joint = robot.joint(first.joint)
    unit = {1: " m" if joint.kind is JointKind.PRISMATIC else " rad"}.get(joint.nv, "") if joint else ""
    more = f" (and {', '.join(fault.joint for fault in others)})" if others else ""
    return (
        f"the {end} has joint {first.joint} at {first.value:.6g}, {first.excess:.3g}{unit} outside its limits"
        f" [{first.lower:.6g}, {first.upper:.6g}]{more}",
        {
            "stage": end,
            "joint": first.joint,
            "value": first.value,
            "limits": [first.lower, first.upper],
            "excess": first.excess,
            "joints": [first.joint, *(fault.joint for fault in others)],
        },
    )
