"""Plan a sequence: each step from where the one before ended, joined as one motion, and certified as it is executed.

It fails as a whole. The goals of a step are chosen so that the later steps stay possible (lookahead.py). A step whose
goal is passed is planned to its end, too, and joined with the next one (rounding.py). Only what is certified as a
whole, each segment by its own conditions (segments.py), is a success; names of stages and details are those of
replies.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, cast

import numpy as np

from guidefield.collision.world import World
from guidefield.deadline import Deadline, DeadlineExpired, end_reason, working_time
from guidefield.errors import Status
from guidefield.planner.motion.drawn_motion import DrawnMotion
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion_certificate import CERTIFY_GRACE_S, find_excess
from guidefield.planner.plan import Plan
from guidefield.planner.sequence.cartesian_line import CartesianLine
from guidefield.planner.sequence.lookahead import StepRefusal, keep_possible_goals
from guidefield.planner.sequence.rounding import join_motions
from guidefield.planner.sequence.segments import (
    Composition,
    Embedding,
    PassedGoal,
    SequenceSegment,
    StepPart,
    certify_segment,
    choose_segment_rows,
    insert_knots,
    make_segments,
    whole_configuration,
)
from guidefield.planner.sequence.step_sequence import (
    AllowedContact,
    S,
    StepMotion,
    StepSequence,
    find_allowed_times,
    find_held_spans,
)
from guidefield.planner.task.problem import Conditions, ControllerModel, Problem
from guidefield.planner.task.stages import Ending, Stages, make_refusal
from guidefield.planner.task.trace import Event, Note, Observer, PathRelaxed, StageLeft, Step, TreeGrown
from guidefield.prove.verdict import Verdict
from guidefield.read_only import ReadOnly
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.joints import LocalPoint, LocalPoints, LocalRates

# times of permitted contacts become a knot's that is as close [s]: contacts may last so much longer; with much less,
# pieces get so short that their accelerations are rounding, and good plans fail
KNOT_TOLERANCE = 1e-6

STOPS = "to pass goals without stopping is no faster here, so the motion stops: `radius` is small for the limits"
"""Warning about steps that are not passed without stopping."""


@dataclass(frozen=True, eq=False)
class StepResult(ReadOnly, Generic[S]):
    """The result of one step."""

    index: int
    at: S
    span: tuple[float, float]  # when it begins and ends, its pause included [s]
    conditions: Conditions  # those of the motion of all joints, where nothing may touch
    # what the planner found, local coordinates of all joints, shape (n, nv); the start alone where nothing moves
    path: LocalPoints
    line: CartesianLine | None = None
    straight: tuple[float, float] = (0.0, 0.0)  # from when to when it does [s]: not while a goal is passed
    problem: Problem | None = None  # what was planned; None where nothing moves
    passed: float | None = None  # how near to the goal it ends, as `PassedGoal.distances` [m, rad], where it is passed


@dataclass(frozen=True, eq=False)
class _StepMotion:
    motion: StepMotion
    trajectory: Trajectory
    embedding: Embedding


@dataclass(frozen=True, eq=False)
class SequencePlan(ReadOnly, Generic[S]):
    """The result of planning a sequence."""

    status: Status
    message: str
    details: dict[str, Any]  # the values that it speaks about; `step` is the index of the step that failed
    legs: tuple[StepResult[S], ...]
    # local coordinates of all joints, shape (n, nv): of all steps, or of the one that failed as far as it went
    path: LocalPoints
    # the certificate's judgements of the segments; of a sequence that failed, of `path` alone
    verdicts: tuple[Verdict, ...]
    failed_at: S | None = None  # where everything was when the step began that failed; None where none did
    # what the robot would execute; None where a step failed before it was certified
    trajectory: Trajectory | None = None
    segments: tuple[SequenceSegment, ...] = ()
    drawn: DrawnMotion | None = None  # what a controller is sent of it; None without an execution
    permissions: tuple[AllowedContact, ...] = ()
    stages: tuple[StageLeft, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def free(self) -> bool:
        """True if every verdict is free."""
        return all(verdict.free for verdict in self.verdicts)


def plan_sequence(
    steps: StepSequence[S], start: S, whole: PlanningGroup, deadline: Deadline, observer: Observer
) -> SequencePlan[S]:
    """Plan a sequence."""
    return _SequencePlanning(steps, start, whole, deadline, observer).plan()


class _SequencePlanning(Generic[S]):
    def __init__(
        self, steps: StepSequence[S], start: S, whole: PlanningGroup, deadline: Deadline, observer: Observer
    ) -> None:
        self._steps, self._at, self._whole = steps, start, whole
        self._deadline, self._observer = deadline, observer
        self._composition = Composition(whole.to_local(whole.q_origin))
        self._legs: list[StepResult[S]] = []
        self._moved: list[_StepMotion] = []
        self._z = self._composition.z
        self._stages: list[StageLeft] = []
        self._seconds: dict[str, float] = {}
        self._warnings: list[str] = []

    def plan(self) -> SequencePlan[S]:
        for index in range(len(self._steps)):
            self._observer.observe(Note(f"step {index} begins"))
            try:
                failed = self._step(index)
            except DeadlineExpired as late:
                failed = self._make_refusal(_make_late_ending(index, late), index, self._at)
            if failed is not None:
                return failed
        return self._certify()

    def _step(self, index: int) -> SequencePlan[S] | None:
        steps, at = self._steps, self._at
        if index and (status := self._deadline.status()) is not None:
            ending = Ending(status, f"{end_reason(status)} before it was planned", {"stage": "ends"})
            return self._make_refusal(StepRefusal(index, ending), index, at)
        began = working_time()
        conditions, motion = steps.conditions(index, at), steps.motion(index, at, self._now)
        self._spend("load", began)
        path, q = self._z[None], at.q
        if motion is not None:
            group = motion.problem.group
            embedding = Embedding.of(group, motion.problem.z_start, self._whole, self._z)
            made = self._plan_step(index, motion, embedding)
            if isinstance(made, StepRefusal):
                return self._make_refusal(made, index, at)
            self._add(made.stages, made.seconds, made.warnings, index)
            path = embedding.points(made.path)
            if made.status is not Status.SUCCESS or made.trajectory is None:
                return self._make_failure(
                    index, Ending(made.status, made.message, made.details), at, path, made.verdict
                )
            self._moved.append(_StepMotion(motion, made.trajectory, embedding))
            self._z = cast(LocalPoint, embedding.points(made.trajectory.positions[-1:])[0])
            q = whole_configuration(group, group.from_local(made.trajectory.positions[-1]))
        line, problem = (None, None) if motion is None else (motion.line, motion.problem)
        now = self._composition.end
        self._legs.append(StepResult(index, at, (now, now), conditions, path, line, (now, now), problem))
        if steps.passes(index) is None:
            self._compose(index)
        began = working_time()
        self._at = steps.after(index, at, q, self._now)
        self._spend("load", began)
        return None

    @property
    def _now(self) -> float:
        """The begin of the next step [s]; passed ones are yet to be joined."""
        return self._composition.end + sum(one.trajectory.duration for one in self._moved)

    def _compose(self, index: int) -> None:
        begin, moved = self._composition.end, self._moved
        if len(moved) > 1:
            self._join_motions(index + 1 - len(moved))
        elif moved:
            self._composition.move(moved[0].trajectory, moved[0].embedding)
            self._legs[-1] = dataclasses.replace(self._legs[-1], straight=(begin, self._composition.end))
        arrived = self._composition.end
        self._composition.wait(self._steps.leaves_at(index, self._at, arrived))
        last = self._legs[-1]
        execution = last.conditions.execution
        if execution is not None and index + 1 < len(self._steps):  # ticks are those of each step by itself then
            self._composition.wait(max(execution.find_arrival(arrived), execution.next_tick(self._composition.end)))
        self._legs[-1] = dataclasses.replace(
            last, span=(begin if len(moved) < 2 else last.span[0], self._composition.end)
        )
        self._moved = []

    def _join_motions(self, first: int) -> None:
        moved, legs = self._moved, self._legs[first:]
        parts = [self._part(first + k, one) for k, one in enumerate(moved)]
        stages = Stages(dataclasses.replace(legs[0].conditions, observer=self._observer))
        joined = join_motions(parts, stages)
        self._add(tuple(stages.left), stages.seconds, (STOPS,) if joined.stops else (), first)
        times = self._composition.move(joined.motion, moved[0].embedding)
        marks = [0, *(one.nearest for one in joined.passages), -1]
        since = [0, *(one.left for one in joined.passages)]
        until = [*(one.entered for one in joined.passages), -1]
        distances = [*(one.distance for one in joined.passages), None]
        for k, leg in enumerate(legs):
            span, straight = (times[marks[k]], times[marks[k + 1]]), (times[since[k]], times[until[k]])
            self._legs[first + k] = dataclasses.replace(leg, span=span, straight=straight, passed=distances[k])

    def _part(self, index: int, moved: _StepMotion) -> StepPart:
        """The motion of a step in local coordinates of the first that it is joined with."""
        shift = moved.embedding.shift - self._moved[0].embedding.shift
        motion = moved.trajectory
        turned = Trajectory(motion.times, cast(LocalPoints, motion.positions + shift), motion.velocities)
        radius, problem, first = self._steps.passes(index), moved.motion.problem, self._moved[0].motion.problem
        if first.scene.moves:  # in the time of the whole
            world = World.build(problem.group, first.scene, problem.allowed_collisions)
            problem = dataclasses.replace(problem, scene=first.scene, world=world)
        goal = None if radius is None else PassedGoal(problem, turned.positions[-1], radius)
        return StepPart(problem, turned, moved.motion.line, goal)

    def _plan_step(self, index: int, motion: StepMotion, embedding: Embedding) -> Plan | StepRefusal:
        watched = StepObserver(self._observer, motion.problem.group, self._whole, embedding)
        began = working_time()
        problem = keep_possible_goals(self._steps, index, self._at, motion)
        self._spend("ends", began)
        if isinstance(problem, StepRefusal):
            return problem
        return motion.plan(dataclasses.replace(problem, observer=watched))

    def _certify(self) -> SequencePlan[S]:
        verdicts: list[Verdict] = []
        drawn: DrawnMotion | None = None
        ended = Ending(Status.SUCCESS, "found a motion through all steps and certified it free over its whole length")
        stages = Stages(self._legs[0].conditions)
        with stages.enter("certify", "all steps as one motion, each with what is held then") as stage:
            trajectory, segments, permissions = self._parts()
            deadline = self._deadline.at_least(CERTIFY_GRACE_S)
            segment_verdicts: Iterable[Verdict] = (certify_segment(segment, deadline)[0] for segment in segments)
            if (execution := self._legs[0].conditions.execution) is not None:
                drawn, segments, segment_verdicts = choose_segment_rows(trajectory, execution, segments, deadline)
            for segment, verdict in zip(segments, segment_verdicts, strict=False):
                verdicts.append(verdict)
                if not verdicts[-1].free:
                    ended = _name_step(segment.index, make_refusal(segment, verdicts[-1]))
                    break
                if (excess := find_excess(segment, segment.executed)) is not None:
                    ended = _name_step(segment.index, excess)
                    break
            stage.outcome = verdicts[-1].reason.value
        self._add(tuple(stages.left), stages.seconds, (), None)
        return SequencePlan(
            ended.status,
            ended.message,
            ended.details,
            legs=tuple(self._legs),
            path=np.concatenate([leg.path for leg in self._legs]),
            verdicts=tuple(verdicts),
            trajectory=trajectory,
            segments=tuple(segments[: len(verdicts)]) if ended.status is not Status.SUCCESS else tuple(segments),
            drawn=drawn,
            permissions=tuple(permissions),
            **self._describe(),
        )

    def _parts(self) -> tuple[Trajectory, list[SequenceSegment], list[AllowedContact]]:
        trajectory, legs = self._composition.trajectory(), self._legs
        execution = legs[0].conditions.execution
        if execution is not None and execution.interpolation.holds:
            legs = self._legs = [_at_ticks(leg, execution, trajectory.duration) for leg in legs]
        permissions = []
        for holding in find_held_spans(
            [leg.at.touches for leg in legs],
            [self._steps.detached(leg.index) for leg in legs],
            [leg.span for leg in legs],
            [leg.conditions for leg in legs],
        ):
            permissions += find_allowed_times(holding, trajectory, legs[0].conditions.min_clearance)
        if execution is not None and execution.interpolation.holds:
            last = trajectory.duration
            permissions = [
                AllowedContact(one.touch, execution.last_tick(one.begin), min(execution.find_arrival(one.end), last))
                for one in permissions
            ]
            cuts = [time for leg in legs for time in (*leg.span, *leg.straight)]
            trajectory = insert_knots(trajectory, cuts)
        permissions = [
            dataclasses.replace(
                one, begin=_snap_to_knots(one.begin, trajectory.times), end=_snap_to_knots(one.end, trajectory.times)
            )
            for one in permissions
        ]
        trajectory = insert_knots(trajectory, [time for one in permissions for time in (one.begin, one.end)])
        segments = [
            segment
            for leg in legs
            for segment in make_segments(
                leg.index, leg.conditions, trajectory, leg.span, permissions, leg.line, leg.straight
            )
        ]
        return trajectory, segments, permissions

    def _make_refusal(self, refused: StepRefusal, step: int, at: S) -> SequencePlan[S]:
        base = self._z
        stands = _make_standing_segment(self._steps.conditions(step, at), step, base, self._composition.end)
        verdict, _ = certify_segment(stands)
        ending = refused.ending
        if refused.index > step:
            message = f"{ending.message}, from any end of `steps[{step}]` that was tried"
            ending = Ending(ending.status, message, {**ending.details, "chosen_by": step})
        return self._make_failure(refused.index, ending, at, base[None], verdict)

    def _make_failure(self, index: int, ending: Ending, at: S, path: LocalPoints, verdict: Verdict) -> SequencePlan[S]:
        refusal = _name_step(index, ending)
        return SequencePlan(
            refusal.status,
            refusal.message,
            refusal.details,
            legs=tuple(self._legs),
            path=path,
            verdicts=(verdict,),
            failed_at=at,
            **self._describe(),
        )

    def _add(
        self, stages: Sequence[StageLeft], seconds: dict[str, float], warnings: Sequence[str], index: int | None
    ) -> None:
        where = "" if index is None else f"step {index}: "
        self._stages += [dataclasses.replace(one, outcome=f"{where}{one.outcome}", plane=None) for one in stages]
        for name, spent in seconds.items():
            self._seconds[name] = self._seconds.get(name, 0.0) + spent
        self._warnings += [f"{where}{warning}" for warning in warnings]

    def _spend(self, stage: str, began: float) -> None:
        self._seconds[stage] = self._seconds.get(stage, 0.0) + working_time() - began

    def _describe(self) -> dict[str, Any]:
        return {
            "stages": tuple(self._stages),
            "seconds": self._seconds,
            "warnings": tuple(dict.fromkeys(self._warnings)),
        }


def _make_late_ending(index: int, late: DeadlineExpired) -> StepRefusal:
    message = f"{end_reason(late.status)} before {late.step}; what is prepared is kept"
    return StepRefusal(index, Ending(late.status, message, {"stage": "load", "preparing": late.step}))


def _name_step(index: int, ending: Ending) -> Ending:
    details = {**ending.details, "step": index, "path": f"$.steps[{index}]"}
    return Ending(ending.status, f"`steps[{index}]`: {ending.message}", details)


def _at_ticks(leg: StepResult[S], execution: ControllerModel, end: float) -> StepResult[S]:
    """A step of a motion that ends at a time [s], which begins and ends at ticks, and so does its straight line."""
    begins, ends = leg.span
    span = min(execution.next_tick(begins), end), min(execution.next_tick(ends), end)
    first = span[0] if leg.straight[0] == begins else execution.find_arrival(leg.straight[0])
    last = span[1] if leg.straight[1] == ends else execution.last_tick(leg.straight[1])
    return dataclasses.replace(leg, span=span, straight=(first, last))


def _snap_to_knots(time: float, knots: np.ndarray) -> float:
    nearest = float(knots[np.argmin(np.abs(knots - time))])
    return nearest if abs(nearest - time) <= KNOT_TOLERANCE else time


def _make_standing_segment(conditions: Conditions, index: int, z: LocalPoint, time: float) -> SequenceSegment:
    still = Trajectory(np.array([time]), z[None], cast(LocalRates, np.zeros((1, len(z)))))
    (segment,) = make_segments(index, conditions, still, (time, time), (), None, (time, time))
    return segment


@dataclass(frozen=True)
class StepObserver:
    """An observer of a step who tells an observer of the sequence."""

    observer: Observer
    part: PlanningGroup
    whole: PlanningGroup
    embedding: Embedding

    def observe(self, event: Event) -> None:
        """Pass an event on, its configurations those of all joints."""
        self.observer.observe(self._of_all(event))

    def _of_all(self, event: Event) -> Event:
        match event:
            case Step(q=q):
                z = self.embedding.points(self.part.to_local(q)[None])[0]
                return dataclasses.replace(event, q=self.whole.from_local(z), plane=None)
            case PathRelaxed(path=path):
                return dataclasses.replace(event, path=self.embedding.points(path))
            case TreeGrown(trees=trees):
                return TreeGrown(lambda: tuple((self.embedding.points(nodes), parents) for nodes, parents in trees()))
            case _:
                return event
