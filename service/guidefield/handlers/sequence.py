"""The plan request with steps: its course, the sequence, and the reply, in order."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable

from guidefield.case_file import Motion
from guidefield.collision.preparation import Told
from guidefield.deadline import Deadline
from guidefield.handlers.agreement import Certified, require_agreement
from guidefield.handlers.preparation import prepare_plan
from guidefield.handlers.recording import Recording
from guidefield.handlers.sequence_reply import reply_to
from guidefield.handlers.sequence_shown import carried_scene, profile_of
from guidefield.handlers.situation import Standing
from guidefield.handlers.steps import Steps
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import PlanRequest
from guidefield.planner.quality import clearances
from guidefield.planner.sequence.sequence import SequencePlan, plan_sequence
from guidefield.planner.sequence.stretches import Stretch
from guidefield.planner.task.trace import Silent
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import Scene

RecordSteps = Callable[[PlanningGroup, Scene, Callable[[], tuple[PlanningGroup, Scene]]], Recording[PlanReply] | None]
"""Opens the recording of a run, once it is known what moves where; asks at its end what was carried where."""


def answer_steps(
    request: PlanRequest,
    robot: RobotModel,
    scene: Scene,
    *,
    run_id: str,
    received: float,
    began: float | None = None,
    record: RecordSteps = lambda *_: None,
    preparing: Told = lambda _: None,
    deadline: Deadline | None = None,
) -> PlanReply:
    """Plan a sequence, and say what came of it; arguments and errors as those of `answer_plan`."""
    began = time.monotonic() if began is None else began
    deadline = Deadline(received + request.allowed_planning_time) if deadline is None else deadline
    course = Steps(request, robot, scene, deadline, preparing)
    prepare_plan(robot, scene, deadline, preparing)
    ended: list[SequencePlan[Standing]] = []
    recording = record(course.whole, scene, lambda: _shown(course, ended[0]))
    load_seconds = time.monotonic() - began
    made = plan_sequence(course, course.start, course.whole, deadline, recording or Silent())
    ended.append(made)
    begin = time.monotonic()
    stretches = measurable(made)
    found = clearances([(stretch.motion, stretch) for stretch in stretches])
    measured = None if found is None else [*zip(stretches, found, strict=True)]
    if measured is not None:
        free = {id(one) for one, verdict in zip(made.stretches, made.verdicts, strict=False) if verdict.free}
        judged = [one for one in measured if id(one[0]) in free]
        certified = [
            Certified(found, stretch.min_clearance, functools.partial(_motion, request, made, stretch))
            for stretch, found in judged
        ]
        require_agreement(run_id, certified)
    load_seconds += made.seconds.get("load", 0.0)
    seconds = {"queue": began - received, "load": load_seconds, "measure": time.monotonic() - begin}
    reply = reply_to(request, course, made, measured, run_id, received, seconds)
    if recording is not None:
        recording.finish(reply, lambda: profile_of(measured or []))
    return reply


def _motion(request: PlanRequest, made: SequencePlan[Standing], stretch: Stretch) -> Motion:
    """A stretch for the referee."""
    return Motion(
        world=stretch.world,
        placement=request.robot_placement,
        held=[one.attached for one in made.legs[stretch.index].at.objects],
        times=stretch.motion.times,
        positions=stretch.motion.positions,
        velocities=stretch.motion.velocities,
        jerk_limits=stretch.jerk_limits,
        min_clearance=stretch.min_clearance,
    )


def _shown(course: Steps, made: SequencePlan[Standing]) -> tuple[PlanningGroup, Scene]:
    """What a recording shows: all steps with what is carried, or the one that failed with what was held."""
    if made.failed_at is None:
        return course.whole, carried_scene(course, made)
    conditions = course.conditions(len(made.legs), made.failed_at)
    return conditions.group, conditions.scene


def measurable(made: SequencePlan[Standing]) -> list[Stretch]:
    """The stretches of a sequence on which something moves."""
    return [stretch for stretch in made.stretches if stretch.motion.duration > 0.0]
