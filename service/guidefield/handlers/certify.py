"""The certify request: the motion that it gives, the judgement, and the reply, in order."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable

from guidefield.errors import GuidefieldError
from guidefield.handlers.certify_problem import certify_problem
from guidefield.handlers.certify_reply import reply_to
from guidefield.handlers.in_reach import in_reach
from guidefield.handlers.preparing import prepare_in_time
from guidefield.handlers.recording import Recording
from guidefield.messages.replies import CertifyReply
from guidefield.messages.requests import CertifyRequest, RobotReference
from guidefield.planner.judgement import GivenProblem, judge
from guidefield.planner.motion.given_motion import GivenMotion
from guidefield.planner.quality import Clearance, clearance, clearance_profile
from guidefield.planner.task.conditions import Budget
from guidefield.planner.task.stages import Stages
from guidefield.planner.task.trace import Silent
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import Scene

RecordGiven = Callable[[PlanningGroup, Scene, GivenMotion], Recording[CertifyReply] | None]
"""Opens the recording of a run, once it is known what moves where, and how."""


def answer_certify(
    request: CertifyRequest,
    robot: RobotModel,
    scene: Scene,
    *,
    run_id: str,
    received: float,
    began: float | None = None,
    record: RecordGiven = lambda *_: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> CertifyReply:
    """Judge a motion, and say what came of it.

    Args:
        request: What is asked.
        robot: The robot that it names.
        scene: The scene that it names.
        run_id: Name of the run.
        received: When it arrived, on the clock of `time.monotonic` [s]; the deadline counts from then.
        began: When loading its robot and scene began, on the same clock [s]; None: now.
        record: Opens the recording.
        cancelled: Whether somebody asked to stop.

    Raises:
        GuidefieldError: InvalidGroup, InvalidConfiguration, UnknownFrame, UnknownObject, SceneInvalid or
            MalformedRequest where the question is ill-posed, or asks for what this version doesn't serve.
        StoppedError: if time was up before the scene was prepared.
    """
    began = time.monotonic() if began is None else began
    budget = Budget(received + request.allowed_time, cancelled)
    problem, warnings = certify_problem(request, robot, scene, budget)
    problem = in_reach(problem, budget.spent, limited=False)
    prepare_in_time(None, problem.scene, budget.spent)
    recording = record(problem.group, scene, problem.motion)
    problem = dataclasses.replace(problem, observer=recording or Silent())
    load_seconds = time.monotonic() - began
    stages = Stages(problem)
    with stages.entered("certify", "on the exact geometry, between rows too") as stage:
        judgement = judge(problem)
        stage.outcome = judgement.verdict.reason.value
    with stages.entered("measure", "the smallest distances along the motion"):
        measured = _measured(problem)
    seconds = {"queue": began - received, "load": load_seconds, **stages.seconds}
    reply = reply_to(problem, judgement, measured, run_id, received, seconds, warnings)
    if recording is not None:
        recording.finish(reply, lambda: clearance_profile(measured, problem))
    return reply


def load_ahead(request: CertifyRequest, load: Callable[[RobotReference], RobotModel]) -> None:
    """Load a request's robot before its time begins. What can't be used is refused later, where that is kept."""
    with contextlib.suppress(GuidefieldError):
        load(request.robot)


def _measured(problem: GivenProblem) -> Clearance:
    motion = problem.motion
    return clearance(motion.scheduled if problem.scene.moves else motion.measured, problem)
