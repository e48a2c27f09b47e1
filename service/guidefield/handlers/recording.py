"""Interfaces between a handler and the recorder of its run: the recording, and the motion that is recorded.

Packed classes are stored in a run's log by the order of their fields, and perhaps read by a newer version: a change by
which older logs are read wrongly needs another `MAGIC` in run_log.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar, cast

import msgspec

from guidefield.case_file import Motion
from guidefield.deadline import Deadline
from guidefield.messages.replies import MotionReply
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.quality import (
    Clearance,
    ClearanceProfile,
    SmallestDistance,
    TimedMotion,
    measure_clearance_profile,
)
from guidefield.planner.task.problem import Conditions
from guidefield.planner.task.trace import Event, PackedArray
from guidefield.prove.curve import Curve
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.joints import LocalPoints, LocalRates
from guidefield.scene.scene import Scene

_R_contra = TypeVar("_R_contra", bound=MotionReply, contravariant=True)


class RecordedMotion(Protocol):
    """A motion as a recording shows it."""

    def view(self) -> tuple[PlanningGroup, Scene]:
        """Return the joints that move and the scene that they move in, with what is carried."""

    def profile(self) -> ClearanceProfile | None:
        """Measure the clearance along the motion; None if there is no motion, or it wasn't measured."""

    def pack(self) -> PackedMotion:
        """Return all that follows neither from the request nor from robot and scene."""


class Recording(Protocol[_R_contra]):
    """A recorder of a run: an observer of its events, and once of its end."""

    def observe(self, event: Event) -> None:
        """Record an event."""

    def finish(self, reply: _R_contra, motion: RecordedMotion) -> None:
        """Record the end, and store the recording."""


Prove = Callable[[Sequence[Motion], Deadline], None]
"""Proves the motions that a run is certified for, as far as the deadline allows, and keeps the proof with the run."""
Record = Callable[[PlanningGroup, Scene], Recording[_R_contra] | None]
"""Opens the recording of a run, once its group and scene are known."""


class PackedKnots(msgspec.Struct, array_like=True, frozen=True):
    """A trajectory's knots: times [s], local coordinates and velocities."""

    times: PackedArray
    positions: PackedArray
    velocities: PackedArray

    @classmethod
    def of(cls, trajectory: Trajectory) -> PackedKnots:
        """Pack a trajectory."""
        return cls(*(PackedArray.of(getattr(trajectory, name)) for name in cls.__struct_fields__))

    def trajectory(self) -> Trajectory:
        """Unpack the trajectory."""
        positions, velocities = self.positions.array(), self.velocities.array()
        return Trajectory(self.times.array(), cast(LocalPoints, positions), cast(LocalRates, velocities))


class PackedClearance(msgspec.Struct, array_like=True, frozen=True):
    """Distances along a motion as they were measured: a `Clearance` without its motion."""

    obstacle: SmallestDistance
    inner: SmallestDistance | None
    own: SmallestDistance
    times: PackedArray
    lengths: PackedArray
    mean: float
    ends: float

    @classmethod
    def of(cls, found: Clearance) -> PackedClearance:
        """Pack distances."""
        times, lengths = PackedArray.of(found.times), PackedArray.of(found.lengths)
        return cls(found.obstacle, found.inner, found.own, times, lengths, found.mean, found.ends)

    def clearance(self, motion: TimedMotion, conditions: Conditions) -> Clearance:
        """Unpack the distances of a motion under its conditions."""
        times = self.times.array()
        return Clearance(
            obstacle=self.obstacle,
            inner=self.inner,
            own=self.own,
            times=times,
            lengths=self.lengths.array(),
            mean=self.mean,
            ends=self.ends,
            curve=Curve(motion.bezier(), motion.piece_times()),
            world=conditions.world,
        )


class PackedSegment(msgspec.Struct, array_like=True, frozen=True):
    """A part of a sequence's trajectory that was measured."""

    index: int  # its step
    begin: float  # its times, both those of knots [s]
    end: float
    allowed: list[tuple[str, str]]  # pairs that may touch on it
    found: PackedClearance  # distances along it
    is_last: bool = False  # whether it is the last one measured: the drawn motion may end later than its knots


class PackedLeg(msgspec.Struct, array_like=True, frozen=True):
    """A step that was planned: its times [s], and the robot's configuration when it begins, shape (nq,)."""

    begin: float
    end: float
    q: PackedArray


class PackedMotion(msgspec.Struct, array_like=True, frozen=True):
    """A motion without what follows from its request, robot and scene."""

    knots: PackedKnots | None = None  # its trajectory; None if there is none, or the request gives the motion
    found: PackedClearance | None = None  # distances along it; None if they weren't measured
    legs: Sequence[PackedLeg] = ()  # the steps of a sequence that were planned
    failed_at: PackedArray | None = None  # configuration (nq,) of the robot when the step began that failed
    stretches: Sequence[PackedSegment] = ()  # the parts of a sequence that were measured
    parts: int = 1  # into which the span between two rows that a controller is sent is divided


@dataclass(frozen=True, eq=False)
class PlainMotion:
    """A motion of one group in one scene."""

    scene: Scene
    conditions: Conditions
    found: Clearance | None  # distances along it; None if they weren't measured
    trajectory: Trajectory | None = None  # None if there is none, or the request gives the motion
    parts: int = 1  # into which the span between two rows that a controller is sent is divided

    def view(self) -> tuple[PlanningGroup, Scene]:
        """As in `RecordedMotion`."""
        return self.conditions.group, self.scene

    def profile(self) -> ClearanceProfile | None:
        """As in `RecordedMotion`."""
        return None if self.found is None else measure_clearance_profile((self.found, self.conditions, self.scene))

    def pack(self) -> PackedMotion:
        """As in `RecordedMotion`."""
        knots = None if self.trajectory is None else PackedKnots.of(self.trajectory)
        return PackedMotion(knots, None if self.found is None else PackedClearance.of(self.found), parts=self.parts)
