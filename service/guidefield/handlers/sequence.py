"""The plan request with steps: its course, the sequence, and the reply, in order."""

from __future__ import annotations

import functools
import time

from guidefield.case_file import Motion
from guidefield.collision.preparation import Told
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.handlers.agreement import Certified, require_agreement
from guidefield.handlers.preparation import prepare_plan
from guidefield.handlers.recording import PackedMotion, Record
from guidefield.handlers.sequence_reply import reply_to
from guidefield.handlers.sequence_shown import SequenceMotion
from guidefield.handlers.situation import Standing
from guidefield.handlers.steps import Steps
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import PlanRequest
from guidefield.planner.quality import clearances
from guidefield.planner.sequence.sequence import SequencePlan, plan_sequence
from guidefield.planner.sequence.stretches import Stretch
from guidefield.planner.task.trace import Silent
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import Scene


def answer_steps(
    request: PlanRequest,
    robot: RobotModel,
    scene: Scene,
    *,
    run_id: str,
    received: float,
    began: float | None = None,
    record: Record[PlanReply] = lambda *_: None,
    preparing: Told = lambda _: None,
    deadline: Deadline | None = None,
) -> PlanReply:
    """Plan a sequence, and say what came of it; arguments and errors as those of `answer_plan`."""
    began = time.monotonic() if began is None else began
    deadline = Deadline(received + request.allowed_planning_time) if deadline is None else deadline
    course = Steps(request, robot, scene, deadline, preparing)
    prepare_plan(robot, scene, deadline, preparing)
    recording = record(course.whole, scene)
    load_seconds = time.monotonic() - began
    made = plan_sequence(course, course.start, course.whole, deadline, recording or Silent())
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
        recording.finish(reply, SequenceMotion.of(course, made, measured or []))
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


def restore_steps(request: PlanRequest, robot: RobotModel, scene: Scene, packed: PackedMotion) -> SequenceMotion:
    """The motion of a sequence that was packed; arguments as those of `answer_steps`."""
    return SequenceMotion.unpack(Steps(request, robot, scene, UNLIMITED, lambda _: None), packed)


def measurable(made: SequencePlan[Standing]) -> list[Stretch]:
    """The stretches of a sequence on which something moves."""
    return [stretch for stretch in made.stretches if stretch.motion.duration > 0.0]
