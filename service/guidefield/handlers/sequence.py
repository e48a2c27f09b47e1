"""Answer a plan request with steps: its `Steps`, the sequence, the reply, and the motion for a recording, in order.

`CARRIED_RATE`, `MAX_SAMPLES` (above 0) and `MAX_CARRIED_PLACEMENTS` change recordings alone.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import cast

import msgspec
import numpy as np

from guidefield.case_file import Motion
from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline, seconds_waited, working_time
from guidefield.errors import Status
from guidefield.handlers.agreement import Certified, declare, keep_contradictions, require_agreement
from guidefield.handlers.attached import CARRIED, StepSituation
from guidefield.handlers.plan_reply import (
    CERTIFICATE,
    STAGES,
    cartesian_uses,
    clearance_figures,
    describe_covered,
    effort_figures,
    motion_metrics,
    outcome,
    self_figures,
    warn_of_bounds,
    wire_execution,
    wire_planes,
    wire_trajectory,
)
from guidefield.handlers.preparation import Announce, prepare_plan
from guidefield.handlers.recording import (
    PackedClearance,
    PackedKnots,
    PackedLeg,
    PackedMotion,
    PackedSegment,
    Prove,
    Record,
)
from guidefield.handlers.steps import Steps
from guidefield.messages import replies, scene as messages
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import PlanRequest
from guidefield.messages.values import IDENTITY, Placement
from guidefield.planner.motion.drawn_motion import draw_plan
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.quality import (
    UNMEASURED,
    Clearance,
    ClearanceProfile,
    TimedMotion,
    measure_clearance_profile,
    measure_clearances,
)
from guidefield.planner.sequence.segments import SequenceSegment, cut_trajectory, whole_configuration
from guidefield.planner.sequence.sequence import SequencePlan, StepResult, plan_sequence
from guidefield.planner.task.problem import Conditions
from guidefield.planner.task.trace import PackedArray, Silent
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.model.joints import RobotConfiguration
from guidefield.robot.model.model import RobotModel
from guidefield.scene import scene as scenes
from guidefield.scene.scene import Scene

CARRIED_RATE = 30.0  # placements of a carried object in a recording [Hz]
MAX_SAMPLES = 400
"""Most samples of distances, over all steps, but for the ends of each and where its distances are smallest."""
MAX_CARRIED_PLACEMENTS = 3000  # over all steps: with more, the rate is lower


@dataclass(frozen=True, eq=False)
class SequenceMotion:
    """The motion of a sequence."""

    steps: Steps
    standings: Sequence[StepSituation]  # of the steps that were planned: the situation when each begins
    spans: Sequence[tuple[float, float]]  # when each begins and ends [s]
    trajectory: Trajectory | None  # the motion; None where a step failed before it was certified
    failed_at: StepSituation | None  # the situation when the step began that failed; None where none did
    measured: Sequence[tuple[SequenceSegment, Clearance]]  # its parts with distances along them
    parts: int = 1  # into which the span between two rows that a controller is sent is divided

    @classmethod
    def of(
        cls, steps: Steps, made: SequencePlan[StepSituation], measured: Sequence[tuple[SequenceSegment, Clearance]]
    ) -> SequenceMotion:
        """The motion of a plan, with distances along its parts."""
        standings, spans = [leg.at for leg in made.legs], [leg.span for leg in made.legs]
        parts = 1 if made.drawn is None else made.drawn.parts
        return cls(steps, standings, spans, made.trajectory, made.failed_at, measured, parts)

    @classmethod
    def unpack(cls, steps: Steps, packed: PackedMotion) -> SequenceMotion:
        """The motion of a sequence, from its steps and what was packed."""
        standings, at = list[StepSituation](), steps.start
        for index, leg in enumerate(packed.legs):
            at = steps.after(index - 1, at, _configuration(leg.q), leg.begin) if index else at
            standings.append(at)
        failed_at = None
        if packed.failed_at is not None:
            q = _configuration(packed.failed_at)
            failed_at = steps.after(len(standings) - 1, at, q, packed.legs[-1].end) if standings else at
        trajectory = None if packed.knots is None else packed.knots.trajectory()
        drawn = None
        if trajectory is not None and steps.execution is not None:
            drawn = draw_plan(trajectory, steps.execution, packed.parts).motion
        measured, conditions, last = [], dict[int, Conditions](), None
        for one in packed.stretches:
            assert trajectory is not None, "its parts were measured"
            if one.index not in conditions:
                now = steps.conditions(one.index, standings[one.index])
                if last is not None and last.group.alike is now.group.alike and last.scene is now.scene:
                    now = dataclasses.replace(now, world=last.world)  # its tables are made already
                conditions[one.index] = last = now
            segment = _unpack_segment(one, conditions[one.index], trajectory)
            if drawn is not None:
                segment = segment.drawn_of(drawn, is_last=one.is_last)
            measured.append((segment, one.found.clearance(executed_in_time(segment), segment)))
        spans = [(leg.begin, leg.end) for leg in packed.legs]
        return cls(steps, standings, spans, trajectory, failed_at, measured, packed.parts)

    def view(self) -> tuple[PlanningGroup, Scene]:
        """All steps with what is carried, or the one that failed with what was held."""
        if self.failed_at is None:
            return self.steps.whole, self._carried_scene()
        conditions = self.steps.conditions(len(self.standings), self.failed_at)
        return conditions.group, conditions.scene

    def profile(self) -> ClearanceProfile | None:
        """Distances along all steps."""
        if not self.measured:
            return None
        every = math.ceil(sum(len(one.times) for _, one in self.measured) / MAX_SAMPLES)
        return measure_clearance_profile(
            *((one, segment, segment.scene) for segment, one in self.measured), every=every
        )

    def pack(self) -> PackedMotion:
        """As in `RecordedMotion`."""
        return PackedMotion(
            knots=None if self.trajectory is None else PackedKnots.of(self.trajectory),
            legs=[PackedLeg(*span, PackedArray.of(at.q)) for at, span in zip(self.standings, self.spans, strict=True)],
            failed_at=None if self.failed_at is None else PackedArray.of(self.failed_at.q),
            stretches=[
                PackedSegment(
                    index=segment.index,
                    begin=float(segment.motion.times[0]),
                    end=float(segment.motion.times[-1]),
                    allowed=sorted(segment.allowed_collisions),
                    found=PackedClearance.of(found),
                    is_last=(segment, found) == self.measured[-1],
                )
                for segment, found in self.measured
            ],
            parts=self.parts,
        )

    def _carried_scene(self) -> Scene:
        start, whole = self.steps.start, self.steps.whole
        if self.trajectory is None:
            return start.scene
        most = max(MAX_CARRIED_PLACEMENTS // len(self.spans), 1)
        placements: dict[str, list[tuple[float, Placement]]] = {}
        for at, (begin, end) in zip(self.standings, self.spans, strict=True):
            times = np.linspace(begin, end, int(np.clip(np.ceil((end - begin) * CARRIED_RATE), 1, most)) + 1)
            zs = self.trajectory.evaluate(times)[0]
            for moment, z in zip(times.tolist(), zs, strict=True) if at.objects else ():
                q = whole_configuration(whole, whole.from_local(z))
                there = dataclasses.replace(at, q=q)
                for held in there.objects:
                    placements.setdefault(held.name, []).append((moment, _placement(there.place(held))))
        return _with_carried(start, placements)


def executed_in_time(segment: SequenceSegment) -> TimedMotion:
    """The motion that a robot executes on a segment, on the scene's clock, to be measured."""
    executed = segment.executed
    return executed if isinstance(executed, Trajectory) else executed.measured_among(segment.scene)


def _configuration(packed: PackedArray) -> RobotConfiguration:
    return cast(RobotConfiguration, packed.array())


def _unpack_segment(packed: PackedSegment, conditions: Conditions, trajectory: Trajectory) -> SequenceSegment:
    fields = {field.name: getattr(conditions, field.name) for field in dataclasses.fields(Conditions)}
    allowed = frozenset(packed.allowed)
    if allowed != conditions.allowed_collisions:
        fields |= {"allowed_collisions": allowed, "world": World.build(conditions.group, conditions.scene, allowed)}
    return SequenceSegment(**fields, index=packed.index, motion=cut_trajectory(trajectory, packed.begin, packed.end))


def _with_carried(start: StepSituation, placements: dict[str, list[tuple[float, Placement]]]) -> Scene:
    """The obstacles and held objects of the start; those in `placements` move along them."""
    at_first = [
        *start.scene.message.obstacles,
        *(start.place(one) for one in start.objects if _is_shown(one.attached.obstacle)),
    ]
    moving = [_moving(one, placements[one.name]) if one.name in placements else one for one in at_first]
    return scenes.build(msgspec.structs.replace(start.scene.message, obstacles=moving))


def _is_shown(one: messages.Obstacle) -> bool:
    return isinstance(one, CARRIED)


def _placement(one: messages.Obstacle) -> Placement:
    assert isinstance(one, CARRIED), "only these are carried"
    return Placement(one.position, getattr(one, "quaternion_xyzw", IDENTITY))


def _moving(one: messages.Obstacle, way: Sequence[tuple[float, Placement]]) -> messages.Obstacle:
    """An obstacle that is carried: at rest where it is until the first of some times, and after the last."""
    later = {round(time, 9): placement for time, placement in way}
    trajectory = messages.ObstacleTrajectory(list(later), list(later.values()))
    moving: messages.Obstacle = msgspec.structs.replace(one, trajectory=trajectory)
    return moving


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
    preparing: Announce = lambda _: None,
    prove: Prove = lambda *_: None,
    deadline: Deadline | None = None,
) -> PlanReply:
    """Plan a sequence, and reply with the outcome; arguments and errors as those of `answer_plan`."""
    began = time.monotonic() if began is None else began
    deadline = Deadline(received + request.allowed_planning_time) if deadline is None else deadline
    steps = Steps(request, robot, scene, deadline, preparing)
    steps.require_posed()
    prepare_plan(robot, scene, deadline, preparing)
    recording = record(steps.whole, scene)
    load_seconds, waited = time.monotonic() - began, seconds_waited()
    made = plan_sequence(steps, steps.start, steps.whole, deadline, recording or Silent())
    begin = working_time()
    segments = select_moving_segments(made)
    found = measure_clearances([(executed_in_time(segment), segment) for segment in segments])
    measured = None if found is None else [*zip(segments, found, strict=True)]
    if measured is not None:
        free = {id(one) for one, verdict in zip(made.segments, made.verdicts, strict=False) if verdict.free}
        collision_free = [one for one in measured if id(one[0]) in free]
        require_agreement(
            run_id,
            [
                Certified(found, segment.min_clearance, functools.partial(_motions, request, made, [segment]))
                for segment, found in collision_free
            ],
        )
    if request.proof:
        certified = made.segments if made.status is Status.SUCCESS else ()
        prove(_motions(request, made, certified), deadline)
    load_seconds += made.seconds.get("load", 0.0) + seconds_waited() - waited
    seconds = {"queue": began - received, "load": load_seconds, "measure": working_time() - begin}
    reply = reply_to(request, steps, made, measured, run_id, received, seconds)
    if recording is not None:
        recording.finish(reply, SequenceMotion.of(steps, made, measured or []))
    return reply


def _motions(
    request: PlanRequest, made: SequencePlan[StepSituation], segments: Sequence[SequenceSegment]
) -> list[Motion]:
    motions = []
    for one in segments:
        held = [held.attached for held in made.legs[one.index].at.objects]
        outside_proof = None if one.line is None else f"{one.line.frame} keeps to its straight way"
        motions.append(declare(request, one, one.executed, held, outside_proof=outside_proof))
    return motions


def restore_steps(request: PlanRequest, robot: RobotModel, scene: Scene, packed: PackedMotion) -> SequenceMotion:
    """Restore the motion of a sequence from its log, for the recording; arguments as those of `answer_steps`."""
    return SequenceMotion.unpack(Steps(request, robot, scene, UNLIMITED, lambda _: None), packed)


def select_moving_segments(made: SequencePlan[StepSituation]) -> list[SequenceSegment]:
    """The segments of a sequence on which something moves."""
    return [segment for segment in made.segments if segment.executed.duration > 0.0]


Measured = Sequence[tuple[SequenceSegment, Clearance]]  # segments with distances along them


def reply_to(
    request: PlanRequest,
    steps: Steps,
    made: SequencePlan[StepSituation],
    measured: Measured | None,
    run_id: str,
    received: float,
    seconds: dict[str, float],
) -> PlanReply:
    """Build the reply.

    `measured` has the segments on which something moves, None where time was up before; `received` is as in
    `answer_plan`; `seconds` is the time of waiting, loading and measuring [s].
    """
    group, begin = steps.whole, working_time()
    metrics = motion_metrics(made.trajectory, Kinematics(group))
    path, trajectory = group.wire_path(made.path), wire_trajectory(made.trajectory, request.sample_rate, group)
    spent = {stage: made.seconds.get(stage, 0.0) for stage in STAGES} | seconds
    spent["measure"] += working_time() - begin
    robot = steps.start.robot
    problems = [leg.problem for leg in made.legs if leg.problem is not None]
    planes = [plane for problem in problems for plane in problem.guide_planes]
    warnings = [*robot.warnings, *steps.start.scene.warnings, *steps.warnings, *made.warnings]
    if measured is None:
        measured, warnings = [], [*warnings, UNMEASURED]
    return PlanReply(
        run_id=run_id,
        status=outcome(made.status, made.message, made.details),
        warnings=[*warnings, *dict.fromkeys(text for _, one in measured for text in warn_of_bounds(one))],
        position_names=group.position_names,
        velocity_names=group.velocity_names,
        path=path,
        trajectory=trajectory,
        guide_planes=[plane for plane, _ in groupby(wire_planes(planes))],  # each once
        stages=[replies.Stage(name=one.name, outcome=one.outcome, seconds=one.seconds) for one in made.stages],
        clearance=_least_clearance([_figures(segment, one, made) for segment, one in measured], measured),
        self_clearance=_least_self(
            [self_figures(one, _certified_clearance(segment, made, 0.0)) for segment, one in measured]
        ),
        certificate=replies.CertificateFigures(
            collision_free=made.free,
            method=CERTIFICATE,
            covers=describe_covered(made.trajectory, made.drawn),
            evaluations=sum(verdict.evaluations for verdict in made.verdicts),
        ),
        metrics=metrics,
        timing=replies.Timing(total=time.monotonic() - received, **spent),
        counters=replies.Counters(
            iterations=steps.counters.iterations,
            potential_evaluations=sum(one.robot_field.evaluations for one in problems),
            collision_checks=steps.counters.collision_checks,
        ),
        seed=request.seed,
        planner=request.planner,
        objective=request.objective,
        recording=None,
        execution=wire_execution(steps.whole, made.trajectory, made.drawn, steps.execution) if made.free else None,
        steps=[_step(leg, steps, made, measured) for leg in made.legs if made.trajectory is not None],
    )


def _step(
    leg: StepResult[StepSituation], steps: Steps, made: SequencePlan[StepSituation], measured: Measured
) -> replies.StepFigures:
    own = [(segment, one) for segment, one in measured if segment.index == leg.index and steps.moves(leg.index)]
    verdicts = [
        verdict for segment, verdict in zip(made.segments, made.verdicts, strict=False) if segment.index == leg.index
    ]
    count = sum(segment.index == leg.index for segment in made.segments)
    begin, end = leg.span
    return replies.StepFigures(
        begin=begin,
        end=end,
        held=list(leg.at.held_names),
        attached=steps.attached(leg.index),
        detached=steps.detached(leg.index),
        clearance=_least_clearance([_figures(segment, one, made) for segment, one in own], own),
        self_clearance=_least_self(
            [self_figures(one, _certified_clearance(segment, made, 0.0)) for segment, one in own]
        ),
        certificate=replies.CertificateFigures(
            collision_free=bool(verdicts) and len(verdicts) == count and all(verdict.free for verdict in verdicts),
            method=CERTIFICATE,
            covers=f"trajectory from {begin:.6f} s to {end:.6f} s",
            evaluations=sum(verdict.evaluations for verdict in verdicts),
        ),
        permissions=[
            replies.Permission(object=one.touch[0], obstacle=one.touch[1], begin=since, end=until)
            for one in made.permissions
            if (since := max(one.begin, begin)) < (until := min(one.end, end))
        ],
        passed=leg.passed,
        cartesian=_fastest([cartesian_uses(segment.cartesian_limits, segment.executed) for segment, _ in own]),
        effort=_strongest([effort_figures(segment, segment.executed) for segment, _ in own]),
    )


def _certified_clearance(segment: SequenceSegment, made: SequencePlan[StepSituation], kept: float) -> float:
    """Return the certified clearance on a segment [m]; minus infinity if it isn't certified."""
    verdicts = [verdict for one, verdict in zip(made.segments, made.verdicts, strict=False) if one is segment]
    return kept if verdicts and all(verdict.free for verdict in verdicts) else -np.inf


def _figures(segment: SequenceSegment, one: Clearance, made: SequencePlan[StepSituation]) -> replies.ClearanceFigures:
    return clearance_figures(one, _certified_clearance(segment, made, segment.min_clearance))


def _least_clearance(
    figures: Sequence[replies.ClearanceFigures], measured: Measured
) -> replies.ClearanceFigures | None:
    """The smallest distances of some segments, and the mean over all of their samples."""
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
    present = [one for one in figures if one is not None]
    if not present or present[0].energy is None:
        return present[0] if present else None
    joints = [max(each, key=lambda use: use.effort) for each in zip(*(one.joints for one in present), strict=True)]
    return replies.EffortFigures(joints=joints, energy=sum(one.energy or 0.0 for one in present))


def _least_self(figures: Sequence[replies.SelfClearance]) -> replies.SelfClearance | None:
    if not figures:
        return None
    with_pairs = [one for one in figures if one.pair is not None]
    return min(with_pairs, key=lambda one: -np.inf if one.minimum is None else one.minimum, default=figures[0])
