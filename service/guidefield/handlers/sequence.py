"""The plan request with steps: its course, the sequence, and the reply, in order."""

from __future__ import annotations

import functools
import time
from collections.abc import Sequence
from itertools import groupby

import numpy as np

from guidefield.case_file import Motion
from guidefield.collision.preparation import Told
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.errors import Status
from guidefield.handlers.agreement import Certified, declare, keep_contradictions, require_agreement
from guidefield.handlers.plan_reply import (
    CERTIFICATE,
    STAGES,
    cartesian_uses,
    clearance_figures,
    covered,
    effort_figures,
    motion_metrics,
    outcome,
    self_figures,
    unmeasured,
    wire_execution,
    wire_planes,
    wire_trajectory,
)
from guidefield.handlers.preparation import prepare_plan
from guidefield.handlers.recording import PackedMotion, Prove, Record
from guidefield.handlers.sequence_shown import SequenceMotion, executed_in_time
from guidefield.handlers.situation import Standing
from guidefield.handlers.steps import Steps
from guidefield.messages import replies
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import PlanRequest
from guidefield.planner.quality import UNMEASURED, Clearance, measure_clearances
from guidefield.planner.sequence.sequence import SequencePlan, StepResult, plan_sequence
from guidefield.planner.sequence.stretches import Stretch
from guidefield.planner.task.trace import Silent
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import Scene


@keep_contradictions
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
    prove: Prove = lambda *_: None,
    deadline: Deadline | None = None,
) -> PlanReply:
    """Plan a sequence, and say what came of it; arguments and errors as those of `answer_plan`."""
    began = time.monotonic() if began is None else began
    deadline = Deadline(received + request.allowed_planning_time) if deadline is None else deadline
    course = Steps(request, robot, scene, deadline, preparing)
    course.require_posed()
    prepare_plan(robot, scene, deadline, preparing)
    recording = record(course.whole, scene)
    load_seconds = time.monotonic() - began
    made = plan_sequence(course, course.start, course.whole, deadline, recording or Silent())
    begin = time.monotonic()
    stretches = measurable(made)
    found = measure_clearances([(executed_in_time(stretch), stretch) for stretch in stretches])
    measured = None if found is None else [*zip(stretches, found, strict=True)]
    if measured is not None:
        free = {id(one) for one, verdict in zip(made.stretches, made.verdicts, strict=False) if verdict.free}
        judged = [one for one in measured if id(one[0]) in free]
        require_agreement(
            run_id,
            [
                Certified(found, stretch.min_clearance, functools.partial(_motions, request, made, [stretch]))
                for stretch, found in judged
            ],
        )
    if request.proof:
        certified = made.stretches if made.status is Status.SUCCESS else ()
        prove(_motions(request, made, certified), deadline)
    load_seconds += made.seconds.get("load", 0.0)
    seconds = {"queue": began - received, "load": load_seconds, "measure": time.monotonic() - begin}
    reply = reply_to(request, course, made, measured, run_id, received, seconds)
    if recording is not None:
        recording.finish(reply, SequenceMotion.of(course, made, measured or []))
    return reply


def _motions(request: PlanRequest, made: SequencePlan[Standing], stretches: Sequence[Stretch]) -> list[Motion]:
    motions = []
    for one in stretches:
        held = [held.attached for held in made.legs[one.index].at.objects]
        untold = None if one.way is None else f"{one.way.frame} keeps to its straight way"
        motions.append(declare(request, one, one.executed, held, untold=untold))
    return motions


def restore_steps(request: PlanRequest, robot: RobotModel, scene: Scene, packed: PackedMotion) -> SequenceMotion:
    """The motion of a sequence that was packed; arguments as those of `answer_steps`."""
    return SequenceMotion.unpack(Steps(request, robot, scene, UNLIMITED, lambda _: None), packed)


def measurable(made: SequencePlan[Standing]) -> list[Stretch]:
    """The stretches of a sequence on which something moves."""
    return [stretch for stretch in made.stretches if stretch.executed.duration > 0.0]


Measured = Sequence[tuple[Stretch, Clearance]]  # stretches with how far they keep from everything


def reply_to(
    request: PlanRequest,
    course: Steps,
    made: SequencePlan[Standing],
    measured: Measured | None,
    run_id: str,
    received: float,
    seconds: dict[str, float],
) -> PlanReply:
    """Put a sequence into the wire's words.

    `measured` has the stretches on which something moves, None where time was up before; `received` is as in
    `answer_plan`; `seconds` is the time of waiting, loading and measuring [s].
    """
    group, begin = course.whole, time.monotonic()
    metrics = motion_metrics(made.trajectory, Kinematics(group))
    path, trajectory = group.wire_path(made.path), wire_trajectory(made.trajectory, request.sample_rate, group)
    spent = {stage: made.seconds.get(stage, 0.0) for stage in STAGES} | seconds
    spent["measure"] += time.monotonic() - begin
    robot = course.start.robot
    problems = [leg.problem for leg in made.legs if leg.problem is not None]
    planes = [plane for problem in problems for plane in problem.guide_planes]
    warnings = [*robot.warnings, *course.start.scene.warnings, *course.warnings, *made.warnings]
    if measured is None:
        measured, warnings = [], [*warnings, UNMEASURED]
    return PlanReply(
        run_id=run_id,
        status=outcome(made.status, made.message, made.details),
        warnings=[*warnings, *dict.fromkeys(text for _, one in measured for text in unmeasured(one))],
        position_names=group.position_names,
        velocity_names=group.velocity_names,
        path=path,
        trajectory=trajectory,
        guide_planes=[plane for plane, _ in groupby(wire_planes(planes))],  # each once
        stages=[replies.Stage(name=one.name, outcome=one.outcome, seconds=one.seconds) for one in made.stages],
        clearance=_least_clearance([_figures(stretch, one, made) for stretch, one in measured], measured),
        self_clearance=_least_self([self_figures(one, _certified(stretch, made, 0.0)) for stretch, one in measured]),
        certificate=replies.CertificateFigures(
            collision_free=made.free,
            method=CERTIFICATE,
            covers=covered(made.trajectory, made.drawn),
            evaluations=sum(verdict.evaluations for verdict in made.verdicts),
        ),
        metrics=metrics,
        timing=replies.Timing(total=time.monotonic() - received, **spent),
        counters=replies.Counters(
            iterations=course.counters.iterations,
            potential_evaluations=sum(one.robot_field.evaluations for one in problems),
            collision_checks=course.counters.collision_checks,
        ),
        seed=request.seed,
        planner=request.planner,
        objective=request.objective,
        recording=None,
        execution=wire_execution(course.whole, made.trajectory, made.drawn, course.execution) if made.free else None,
        steps=[_step(leg, course, made, measured) for leg in made.legs if made.trajectory is not None],
    )


def _step(
    leg: StepResult[Standing], course: Steps, made: SequencePlan[Standing], measured: Measured
) -> replies.StepFigures:
    own = [(stretch, one) for stretch, one in measured if stretch.index == leg.index and course.moves(leg.index)]
    judged = [
        verdict for stretch, verdict in zip(made.stretches, made.verdicts, strict=False) if stretch.index == leg.index
    ]
    count = sum(stretch.index == leg.index for stretch in made.stretches)
    begin, end = leg.span
    return replies.StepFigures(
        begin=begin,
        end=end,
        held=list(leg.at.held),
        attached=course.attached(leg.index),
        detached=course.detached(leg.index),
        clearance=_least_clearance([_figures(stretch, one, made) for stretch, one in own], own),
        self_clearance=_least_self([self_figures(one, _certified(stretch, made, 0.0)) for stretch, one in own]),
        certificate=replies.CertificateFigures(
            collision_free=bool(judged) and len(judged) == count and all(verdict.free for verdict in judged),
            method=CERTIFICATE,
            covers=f"trajectory from {begin:.6f} s to {end:.6f} s",
            evaluations=sum(verdict.evaluations for verdict in judged),
        ),
        permissions=[
            replies.Permission(object=one.touch[0], obstacle=one.touch[1], begin=since, end=until)
            for one in made.permissions
            if (since := max(one.begin, begin)) < (until := min(one.end, end))
        ],
        passed=leg.passed,
        cartesian=_fastest([cartesian_uses(stretch.cartesian_limits, stretch.executed) for stretch, _ in own]),
        effort=_strongest([effort_figures(stretch, stretch.executed) for stretch, _ in own]),
    )


def _certified(stretch: Stretch, made: SequencePlan[Standing], kept: float) -> float:
    """Return the certified clearance on a stretch [m]; minus infinity if it isn't certified."""
    verdicts = [verdict for one, verdict in zip(made.stretches, made.verdicts, strict=False) if one is stretch]
    return kept if verdicts and all(verdict.free for verdict in verdicts) else -np.inf


def _figures(stretch: Stretch, one: Clearance, made: SequencePlan[Standing]) -> replies.ClearanceFigures:
    return clearance_figures(one, _certified(stretch, made, stretch.min_clearance))


def _least_clearance(
    figures: Sequence[replies.ClearanceFigures], measured: Measured
) -> replies.ClearanceFigures | None:
    """The smallest distances of some stretches, and the mean over all of their samples."""
    if not figures:
        return None
    with_pairs = [one for one in figures if one.pair is not None]
    if not with_pairs:
        return figures[0]
    least = min(with_pairs, key=lambda one: -np.inf if one.minimum is None else one.minimum)
    means = [
        (one.mean, len(two.times)) for one, (_, two) in zip(figures, measured, strict=True) if one.mean is not None
    ]
    return replies.ClearanceFigures(
        minimum=least.minimum,
        mean=float(np.average([mean for mean, _ in means], weights=[count for _, count in means])),
        inner=min((one.inner for one in with_pairs if one.inner is not None), default=None),
        ends=min((one.ends for one in with_pairs if one.ends is not None), default=None),
        pair=least.pair,
        time=least.time,
    )


def _fastest(uses: Sequence[Sequence[replies.CartesianUse]]) -> list[replies.CartesianUse]:
    return [max(each, key=lambda use: use.speed) for each in zip(*uses, strict=True)]


def _strongest(figures: Sequence[replies.EffortFigures | None]) -> replies.EffortFigures | None:
    """The largest torques on some stretches, and the work on all of them."""
    told = [one for one in figures if one is not None]
    if not told or told[0].energy is None:
        return told[0] if told else None
    joints = [max(each, key=lambda use: use.effort) for each in zip(*(one.joints for one in told), strict=True)]
    return replies.EffortFigures(joints=joints, energy=sum(one.energy or 0.0 for one in told))


def _least_self(figures: Sequence[replies.SelfClearance]) -> replies.SelfClearance | None:
    if not figures:
        return None
    with_pairs = [one for one in figures if one.pair is not None]
    return min(with_pairs, key=lambda one: -np.inf if one.minimum is None else one.minimum, default=figures[0])
