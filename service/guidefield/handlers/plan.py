"""Answer a plan request for one goal: its problem, the plan, and the reply, in order; prepare its robot ahead.

What is ill-posed is refused by `problem_of`, by the name of its field; the certificate takes conditions (scene,
clearance, allowed pairs, limits) from the problem as it is built there. `restore_plan` builds the same problem for a
recording that is drawn later: a change of how it is built must come to both. What `prepare_ahead` leaves out counts as
the plan's own time.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from guidefield.case_file import Motion
from guidefield.collision.clearance import contacts_at
from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline, seconds_waited, working_time
from guidefield.errors import GuidefieldError, InvalidConfiguration, InvalidGoal, MalformedRequest, Status, at_path
from guidefield.geometry.surfaces import se3
from guidefield.handlers.agreement import Certified, declare, declare_parts, keep_contradictions, require_agreement
from guidefield.handlers.attached import are_large, holding
from guidefield.handlers.plan_reply import reply_to
from guidefield.handlers.preparation import (
    Announce,
    connects,
    crop_to_reach,
    is_laid_out,
    is_prepared,
    prepare,
    prepare_links,
    prepare_problem,
)
from guidefield.handlers.recording import PackedMotion, PlainMotion, Prove, Record
from guidefield.handlers.requested_group import (
    cartesian_limits_of,
    clamp_slight,
    constraints_of,
    effort_limit_of,
    execution_of,
    goal_positions,
    jerk_limits,
    limit_group,
    rates_of,
    start_of,
    warn_of_clamped_goals,
    warn_of_missing_masses,
)
from guidefield.messages import requests, scene as messages
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import AttachedObject, GuidePlaneGoal, PlanRequest
from guidefield.planner.guide.auto_planes import derive_planes
from guidefield.planner.guide.guide import ATTEMPTS, PROJECTED
from guidefield.planner.leaving import split_where_left
from guidefield.planner.motion.drawn_motion import draw_plan
from guidefield.planner.motion.submitted_motion import SubmittedMotion
from guidefield.planner.plan import Plan, Planner, make_refused_plan, plan
from guidefield.planner.quality import UNMEASURED, TimedMotion, measure_clearances
from guidefield.planner.task.problem import ConfigurationGoal, Goal, LastPlaneGoal, Objective, Problem, TipGoal
from guidefield.planner.task.trace import StageLeft
from guidefield.potential import Precision, RobotField
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.inverse_kinematics import PoseTarget
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import LimitFault, configuration_from_wire, limit_faults
from guidefield.robot.model.joints import Configuration, JointKind
from guidefield.robot.model.model import RobotModel
from guidefield.scene import guide_plane
from guidefield.scene.guide_plane import GuidePlane
from guidefield.scene.scene import Scene, build


def given_planes(request: PlanRequest, scene: Scene, deadline: Deadline) -> tuple[GuidePlane, ...]:
    """The request's planes, else the scene's; none for planner "tree".

    Where planes are to be derived, there are none but the last of the scene's, if it is the goal.

    Raises SceneInvalid if a plane of the request isn't flat, isn't convex or has no area; DeadlineExpired if time was
    up before planes of many corners were built.
    """
    if request.planner == "tree":
        return ()
    if isinstance(request.guide_planes, list):
        return guide_plane.build_all(request.guide_planes, deadline)
    if request.guide_planes == "auto":
        return scene.guide_planes[-1:] if isinstance(request.goal, GuidePlaneGoal) else ()
    return scene.guide_planes


@dataclass(frozen=True)
class Derivation:
    """The outcome of deriving guide planes, the first stage of a plan; None if none were requested."""

    left: StageLeft | None = None
    warning: str | None = None

    def add_to(self, made: Plan) -> Plan:
        """Return a plan with this stage before its own."""
        if self.left is None:
            return made
        seconds = {**made.seconds, "guide": made.seconds.get("guide", 0.0) + self.left.seconds}
        warnings = made.warnings if self.warning is None else (*made.warnings, self.warning)
        return dataclasses.replace(made, stages=(self.left, *made.stages), seconds=seconds, warnings=warnings)


def with_derived_planes(problem: Problem, request: PlanRequest) -> tuple[Problem, Derivation]:
    """Add derived guide planes to a problem if the request wants them: among obstacles as they come to rest."""
    if request.guide_planes != "auto" or request.planner == "tree":
        return problem, Derivation()
    begin = working_time()
    planes = derive_planes(problem.at(problem.scene.end), _goal_place(problem))
    seconds = working_time() - begin
    if planes is None:
        warning = (
            "no guide planes could be derived: the tip alone finds no way to the goal, or an end of it is in contact"
        )
        return problem, Derivation(StageLeft("guide", "no guide planes derived", seconds), warning)
    left = StageLeft("guide", f"derived {len(planes)} guide planes", seconds)
    together = dataclasses.replace(problem, guide_planes=(*planes, *problem.guide_planes), derived_planes=len(planes))
    return together, Derivation(left)


def _goal_place(problem: Problem) -> np.ndarray | GuidePlane:
    if isinstance(problem.goal, ConfigurationGoal):
        return problem.kinematics.tip_position(problem.group.expand(problem.goal.configurations[0]))
    if isinstance(problem.goal, TipGoal):
        return np.array(problem.goal.target.placement.translation)
    return problem.guide_planes[-1]


GOALS_PER_CHECK = 500  # goals read between two checks of the deadline: some milliseconds


def problem_of(
    request: PlanRequest, robot: RobotModel, scene: Scene, deadline: Deadline
) -> tuple[Problem, tuple[str, ...]]:
    """Build a request's problem, without derived guide planes, and warnings about harmless peculiarities.

    Raises InvalidGroup, InvalidGoal, InvalidConfiguration, UnknownFrame, UnknownObject, SceneInvalid if the question is
    ill-posed; MalformedRequest if it asks for what this version doesn't serve; DeadlineExpired if time was up before
    its guide planes were built, or its many goals were read.
    """
    robot = holding(robot, request.attached_objects, scene, deadline)
    q_whole, warnings = start_of(request.start, robot)
    root = request.robot_placement
    group = select(robot, request.group, request.tip, q_whole, se3(root.position, root.quaternion_xyzw))
    group = limit_group(group.starting_at(request.start), request)
    planes = given_planes(request, scene, deadline)
    if request.path_constraints and request.planner == "guided":
        raise MalformedRequest("path constraints are kept by connections: planner 'guided' makes none, 'auto' does")
    if in_motion(request):
        _require_served_in_motion(request, group, planes)
    problem = Problem(
        group=group,
        scene=scene,
        world=World.build(group, scene, request.allowed_collisions),
        robot_field=RobotField(group, scene, Precision.SINGLE),
        kinematics=Kinematics(group),
        q_start=group.part_of(q_whole),
        goal=_goal(request, group, planes, deadline),
        guide_planes=planes,
        min_clearance=request.min_clearance,
        allowed_collisions=frozenset(request.allowed_collisions),
        path_constraints=constraints_of(request, group),
        execution=execution_of(request, group),
        cartesian_limits=cartesian_limits_of(request, group),
        effort_limit=effort_limit_of(request, group),
        leave_start_contact=request.leave_start_contact,
        jerk_limits=jerk_limits(group, request),
        optimization_iterations=request.optimization_iterations,
        start_velocity=rates_of(request.start_velocities, "start_velocities", group),
        start_acceleration=rates_of(request.start_accelerations, "start_accelerations", group),
        end_velocity=rates_of(request.end_velocities, "end_velocities", group),
        objective=Objective(request.objective),
        seed=request.seed,
        deadline=deadline,
    )
    return problem, (
        *robot.warnings,
        *scene.warnings,
        *warnings,
        *warn_of_clamped_goals(request.goal, robot),
        *warn_of_many_turns(request, robot),
        *warn_of_missing_masses(request),
    )


def in_motion(request: PlanRequest) -> bool:
    """Return whether a request's motion begins or ends in motion."""
    end_rates = (request.start_velocities, request.start_accelerations, request.end_velocities)
    return any(any(rates.values()) for rates in end_rates)


def _require_served_in_motion(request: PlanRequest, group: PlanningGroup, planes: tuple[GuidePlane, ...]) -> None:
    if not group.is_euclidean:
        several = [joint.name for joint in group.joints if joint.nv > 1]
        raise InvalidConfiguration(
            "velocities and accelerations at the ends are served for joints of one coordinate, and planned for is"
            f" {', '.join(several)}",
            joints=several,
        )
    asks_for_planes = request.guide_planes == "auto" and request.planner != "tree"
    unserved = {
        "path_constraints": (bool(request.path_constraints), "leave them out"),
        "leave_start_contact": (request.leave_start_contact, "leave it out"),
        "guide_planes": (bool(planes) or asks_for_planes, "give them as []"),
    }
    for what, (is_requested, instead) in unserved.items():
        if is_requested:
            raise MalformedRequest(
                f"with velocities or accelerations at the ends `{what}` is not served: {instead}",
                unserved=what,
                path=f"$.{what}",
            )
    if any(request.end_velocities.values()) and not isinstance(
        request.goal, requests.JointsGoal | requests.JointSetGoal
    ):
        raise MalformedRequest(
            "`end_velocities` need a `goal` of type 'joints' or 'joint_set'", path="$.end_velocities"
        )


def _why_no_plane(request: PlanRequest) -> str:
    if request.planner == "tree":
        return "planner 'tree' uses none"
    if request.guide_planes == []:
        return "`guide_planes` is empty; null takes the scene's"
    return "the scene has none; give some in `guide_planes`"


def _goal(request: PlanRequest, group: PlanningGroup, planes: tuple[GuidePlane, ...], deadline: Deadline) -> Goal:
    goal = request.goal
    assert goal is not None, "a request with steps has one for each of them"
    if isinstance(goal, requests.GuidePlaneGoal):
        if not planes:
            raise InvalidGoal(f"the goal is the last guide plane, but there is none: {_why_no_plane(request)}")
        return LastPlaneGoal()
    if request.planner == "guided":
        raise InvalidGoal(
            "planner 'guided' takes only a goal of type 'guide_plane'; 'auto' goes on to configurations and poses"
        )
    if isinstance(goal, requests.PoseGoal):
        return TipGoal(PoseTarget.from_wire(goal))
    of_set = isinstance(goal, requests.JointSetGoal)
    configurations: list[Configuration] = []
    for index, positions in enumerate(goal_positions(goal)):
        if len(configurations) % GOALS_PER_CHECK == GOALS_PER_CHECK - 1:
            deadline.check("the goals were read")
        with at_path(f"$.goal.positions[{index}]" if of_set else "$.goal.positions"):
            configurations.append(_goal_configuration(group, positions))
    # beyond a limit only counts where no other goal is left: then it is the reason of the refusal
    within = tuple(q for q in configurations if not limit_faults(group.joints, q))
    return ConfigurationGoal(within or tuple(configurations))


def _goal_configuration(group: PlanningGroup, positions: requests.Positions) -> Configuration:
    planned = {joint.name for joint in group.joints}
    q = configuration_from_wire(group.robot, positions, base=group.q_reference, error=InvalidGoal)
    for name in positions:
        if name not in planned:
            raise InvalidGoal(
                f"the goal gives joint {name!r}, which is not planned for; planned are {', '.join(sorted(planned))}",
                joint=name,
                available=sorted(planned),
                path=f"$.{name}",
            )
    return group.part_of(clamp_slight(group.robot, q))


HARDLY_RADIANS = 4.0 * math.pi
"""A goal that is further from the start was probably given in degrees [rad]: no whole turn is ever needed."""


def warn_of_many_turns(request: PlanRequest, robot: RobotModel) -> list[str]:
    """Warn about each continuous joint whose goal is further than `HARDLY_RADIANS` from its start.

    A joint with limits needs none: there such a goal is refused.
    """
    warnings: dict[str, str] = {}
    for positions in goal_positions(request.goal):
        for name, value in positions.items():
            joint, start = robot.joint(name), request.start.get(name, 0.0)
            if joint is None or joint.kind is not JointKind.CONTINUOUS or isinstance(value, list):
                continue
            if not isinstance(start, list) and (away := abs(value - start)) > HARDLY_RADIANS:
                turns = f"{value:g} is {away / (2.0 * math.pi):.1f} turns from the start"
                warnings[name] = f"the goal of joint {name!r} is hardly in radians: {turns}"
    return list(warnings.values())


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

    Its scene is cropped also where a proof is requested: distances are the same (`crop_to_reach`).
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
    contacts = contacts_at(problem.world_at(0.0), problem.group.expand_from_local(problem.z_start))
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
