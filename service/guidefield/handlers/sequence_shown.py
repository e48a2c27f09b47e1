"""The motion of a sequence as a recording shows it: objects as they are carried, and distances along all steps."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import msgspec
import numpy as np

from guidefield.collision.world import World
from guidefield.handlers.recording import PackedClearance, PackedKnots, PackedLeg, PackedMotion, PackedStretch
from guidefield.handlers.situation import CARRIED, Standing
from guidefield.handlers.steps import Steps
from guidefield.messages import scene as messages
from guidefield.messages.values import IDENTITY, Placement
from guidefield.planner.motion.drawn_motion import draw_plan
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.quality import Clearance, ClearanceProfile, TimedMotion, measure_clearance_profile
from guidefield.planner.sequence.sequence import SequencePlan
from guidefield.planner.sequence.stretches import Stretch, cut_trajectory, whole_configuration
from guidefield.planner.task.problem import Conditions
from guidefield.planner.task.trace import PackedArray
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.spaces import RobotConfiguration
from guidefield.scene import scene as scenes
from guidefield.scene.scene import Scene

RATE = 30.0  # rate at which a carried object's placement is given [Hz]
MAX_SAMPLES = 400
"""Most samples of distances, over all steps, but for the ends of each and where its distances are smallest."""
MOST = 3000  # largest number of such times, over all steps


@dataclass(frozen=True, eq=False)
class SequenceMotion:
    """The motion of a sequence."""

    course: Steps  # the steps
    standings: Sequence[Standing]  # of the steps that were planned: the situation when each begins
    spans: Sequence[tuple[float, float]]  # when each begins and ends [s]
    trajectory: Trajectory | None  # the motion; None where a step failed before it was certified
    failed_at: Standing | None  # the situation when the step began that failed; None where none did
    measured: Sequence[tuple[Stretch, Clearance]]  # its parts with distances along them
    parts: int = 1  # into which the span between two rows that a controller is sent is divided

    @classmethod
    def of(
        cls, course: Steps, made: SequencePlan[Standing], measured: Sequence[tuple[Stretch, Clearance]]
    ) -> SequenceMotion:
        """The motion of a plan, with distances along its parts."""
        standings, spans = [leg.at for leg in made.legs], [leg.span for leg in made.legs]
        parts = 1 if made.drawn is None else made.drawn.parts
        return cls(course, standings, spans, made.trajectory, made.failed_at, measured, parts)

    @classmethod
    def unpack(cls, course: Steps, packed: PackedMotion) -> SequenceMotion:
        """The motion of a sequence, from its steps and what was packed."""
        standings, at = list[Standing](), course.start
        for index, leg in enumerate(packed.legs):
            at = course.after(index - 1, at, _configuration(leg.q), leg.begin) if index else at
            standings.append(at)
        failed_at = None
        if packed.failed_at is not None:
            q = _configuration(packed.failed_at)
            failed_at = course.after(len(standings) - 1, at, q, packed.legs[-1].end) if standings else at
        trajectory = None if packed.knots is None else packed.knots.trajectory()
        drawn = None
        if trajectory is not None and course.execution is not None:
            drawn = draw_plan(trajectory, course.execution, packed.parts).motion
        measured, conditions, last = [], dict[int, Conditions](), None
        for one in packed.stretches:
            assert trajectory is not None, "its parts were measured"
            if one.index not in conditions:
                now = course.conditions(one.index, standings[one.index])
                if last is not None and last.group.alike is now.group.alike and last.scene is now.scene:
                    now = dataclasses.replace(now, world=last.world)  # its tables are made already
                conditions[one.index] = last = now
            stretch = _stretch(one, conditions[one.index], trajectory)
            if drawn is not None:
                stretch = stretch.drawn_of(drawn, is_last=one.is_last)
            measured.append((stretch, one.found.clearance(executed_in_time(stretch), stretch)))
        spans = [(leg.begin, leg.end) for leg in packed.legs]
        return cls(course, standings, spans, trajectory, failed_at, measured, packed.parts)

    def shown(self) -> tuple[PlanningGroup, Scene]:
        """All steps with what is carried, or the one that failed with what was held."""
        if self.failed_at is None:
            return self.course.whole, self._carried_scene()
        conditions = self.course.conditions(len(self.standings), self.failed_at)
        return conditions.group, conditions.scene

    def profile(self) -> ClearanceProfile | None:
        """Distances along all steps."""
        if not self.measured:
            return None
        every = math.ceil(sum(len(one.times) for _, one in self.measured) / MAX_SAMPLES)
        return measure_clearance_profile(
            *((one, stretch, stretch.scene) for stretch, one in self.measured), every=every
        )

    def pack(self) -> PackedMotion:
        """As in `RecordedMotion`."""
        return PackedMotion(
            knots=None if self.trajectory is None else PackedKnots.of(self.trajectory),
            legs=[PackedLeg(*span, PackedArray.of(at.q)) for at, span in zip(self.standings, self.spans, strict=True)],
            failed_at=None if self.failed_at is None else PackedArray.of(self.failed_at.q),
            stretches=[
                PackedStretch(
                    index=stretch.index,
                    begin=float(stretch.motion.times[0]),
                    end=float(stretch.motion.times[-1]),
                    allowed=sorted(stretch.allowed_collisions),
                    found=PackedClearance.of(found),
                    is_last=(stretch, found) == self.measured[-1],
                )
                for stretch, found in self.measured
            ],
            parts=self.parts,
        )

    def _carried_scene(self) -> Scene:
        """The obstacles at first, and what is held at first, each object that is carried moving as it is."""
        start, whole = self.course.start, self.course.whole
        if self.trajectory is None:
            return start.scene
        most = max(MOST // len(self.spans), 1)
        ways: dict[str, list[tuple[float, Placement]]] = {}
        for at, (begin, end) in zip(self.standings, self.spans, strict=True):
            times = np.linspace(begin, end, int(np.clip(np.ceil((end - begin) * RATE), 1, most)) + 1)
            zs = self.trajectory.evaluate(times)[0]
            for time, z in zip(times.tolist(), zs, strict=True) if at.objects else ():
                q = whole_configuration(whole, whole.from_chart(z))
                there = dataclasses.replace(at, q=q)
                for held in there.objects:
                    ways.setdefault(held.name, []).append((time, _placement(there.place(held))))
        return _with_carried(start, ways)


def executed_in_time(stretch: Stretch) -> TimedMotion:
    """What a robot executes of a stretch, to be measured."""
    executed = stretch.executed
    return executed if isinstance(executed, Trajectory) else executed.measured_among(stretch.scene)


def _configuration(packed: PackedArray) -> RobotConfiguration:
    return cast(RobotConfiguration, packed.array())


def _stretch(packed: PackedStretch, conditions: Conditions, trajectory: Trajectory) -> Stretch:
    fields = {field.name: getattr(conditions, field.name) for field in dataclasses.fields(Conditions)}
    allowed = frozenset(packed.allowed)
    if allowed != conditions.allowed_collisions:
        fields |= {"allowed_collisions": allowed, "world": World.build(conditions.group, conditions.scene, allowed)}
    return Stretch(**fields, index=packed.index, motion=cut_trajectory(trajectory, packed.begin, packed.end))


def _with_carried(start: Standing, ways: dict[str, list[tuple[float, Placement]]]) -> Scene:
    """The obstacles at first, and what is held at first, each object with a way moving along it."""
    at_first = [
        *start.scene.message.obstacles,
        *(start.place(one) for one in start.objects if _is_shown(one.attached.obstacle)),
    ]
    moving = [_moving(one, ways[one.name]) if one.name in ways else one for one in at_first]
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
