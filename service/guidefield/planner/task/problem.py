"""The problem of a plan: the conditions of its motion, and start, goal and guide planes.

Handlers build it; stages make others by `dataclasses.replace`. `ROUNDING` decides a controller's rows and last tick.
With less of `DRAWN` (docs/motions.md) motions that it draws otherwise are slower, with more beyond limits more often.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, cast

import numpy as np

from guidefield.collision.batch.batch_collision import BatchCollision
from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.planner.task.effort import EffortLimit
from guidefield.planner.task.motion_limits import CartesianLimit, MotionLimit
from guidefield.planner.task.trace import Event, Observer, Silent
from guidefield.read_only import ReadOnly
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.inverse_kinematics import PoseTarget
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.group.path_constraints import ConstrainedFrames, PathConstraint
from guidefield.robot.model.joints import Configuration, LocalPoint, LocalRate
from guidefield.scene.guide_plane import GuidePlane
from guidefield.scene.scene import Scene

if TYPE_CHECKING:
    from guidefield.potential import RobotField


ROUNDING = 1e-9  # share of the span of a row, or of a tick, by which a motion may be longer, for rounding


@dataclass
class Counters:
    """Counts of expensive operations."""

    iterations: int = 0
    collision_checks: int = 0


class Interpolation(enum.Enum):
    """Curves that controllers draw, each with a branch in drawn_motion.py; the values are the words of requests."""

    LINEAR = "linear"
    CUBIC = "cubic"
    QUINTIC = "quintic"
    FIRST_ORDER_HOLD = "first_order_hold"
    ZERO_ORDER_HOLD = "zero_order_hold"

    @property
    def holds(self) -> bool:
        """True if commands are at the ticks of a clock."""
        return self in (Interpolation.FIRST_ORDER_HOLD, Interpolation.ZERO_ORDER_HOLD)


@dataclass(frozen=True, eq=False)
class ControllerModel(ReadOnly):
    """The curve that a controller draws of a motion, and its tolerance."""

    interpolation: Interpolation
    rate: float | None  # of rows, at least, or of ticks [1/s]; None: rows are the knots alone
    tolerance: np.ndarray  # largest deviation of each coordinate from the drawn curve, shape (nv,) [rad or m]

    @property
    def tube(self) -> np.ndarray | None:
        """Half widths (nv,) of the tube about what is drawn in which the robot is [rad or m]; None: there is none."""
        return self.tolerance if self.tolerance.any() else None

    @property
    def has_tube(self) -> bool:
        """True if the robot may be beside a curve."""
        return self.interpolation is Interpolation.ZERO_ORDER_HOLD or self.tube is not None

    def next_tick(self, time: float) -> float:
        """The first tick that isn't before a time [s]; without ticks the time itself."""
        if not self.interpolation.holds or self.rate is None:
            return time
        return math.ceil(time * self.rate * (1.0 - ROUNDING)) / self.rate

    def last_tick(self, time: float) -> float:
        """The last tick that isn't after a time [s]; without ticks the time itself."""
        if not self.interpolation.holds or self.rate is None:
            return time
        return math.floor(time * self.rate * (1.0 + ROUNDING)) / self.rate

    def find_arrival(self, time: float) -> float:
        """The tick at which what is drawn has come to where the motion is at a time [s]; without ticks that time."""
        if self.interpolation is not Interpolation.ZERO_ORDER_HOLD or self.rate is None:
            return self.next_tick(time)
        return (math.ceil(time * self.rate * (1.0 - ROUNDING)) + 1) / self.rate

    def count_rows(self, times: np.ndarray, parts: int = 1) -> float:
        """Return how many rows of a motion with knots (n,) [s] there are."""
        spans = np.diff(times)
        if self.rate is None:
            return 1.0 + parts * len(spans)
        if self.interpolation.holds:
            return 2.0 + float(spans.sum()) * self.rate
        return 1.0 + parts * float(np.maximum(np.ceil(spans * self.rate * (1.0 - ROUNDING)), 1.0).sum())


DRAWN = 0.99  # share of a limit of the whole that a motion uses if the controller draws another curve. A choice


@dataclass(frozen=True, eq=False, kw_only=True)
class Conditions(ReadOnly):
    """The conditions that a motion has to meet."""

    group: PlanningGroup
    scene: Scene
    world: World
    min_clearance: float = 0.0  # distance to keep from obstacles everywhere [m]
    allowed_collisions: frozenset[tuple[str, str]] = frozenset()
    leave_start_contact: bool = False  # whether the start may be in slight contact, which is left first
    # of every coordinate, shape (nv,), infinite where there is none; None: jerk doesn't matter
    jerk_limits: LocalRate | None = None
    path_constraints: tuple[PathConstraint, ...] = ()
    execution: ControllerModel | None = None  # its drawn motion is certified instead of the plan; None: the plan itself
    cartesian_limits: tuple[CartesianLimit, ...] = ()
    effort_limit: EffortLimit | None = None
    deadline: Deadline = UNLIMITED
    observer: Observer = field(default_factory=Silent)
    counters: Counters = field(default_factory=Counters)

    @cached_property
    def constrained_frames(self) -> ConstrainedFrames:
        """The path constraints on the group."""
        return ConstrainedFrames(self.group, self.path_constraints)

    def world_at(self, time: float) -> World:
        """The world with every obstacle at rest where it is at a time [s]."""
        if not self.scene.moves:
            return self.world
        return World.build(self.group, self.scene.at(time), self.allowed_collisions)

    @property
    def motion_limits(self) -> tuple[MotionLimit, ...]:
        """The limits of what a motion does as a whole, beside those of each coordinate's rates.

        They have room for what a controller draws that isn't the very motion.
        """
        limits: list[MotionLimit] = [*self.cartesian_limits, *([self.effort_limit] if self.effort_limit else [])]
        if self.execution is None or self.execution.interpolation is Interpolation.CUBIC:
            return tuple(limits)
        return tuple(one.scale(DRAWN) for one in limits)

    @property
    def outside_proof(self) -> str:
        """The certified properties that no proof of the motion contains, in words."""
        kept = [f"{one.name} keeps its speed" for one in self.cartesian_limits]
        return " and ".join([*kept, *(["joints keep their torques"] if self.effort_limit is not None else [])])

    @property
    def is_observed(self) -> bool:
        """True if there is an observer: only then events that take time are made."""
        return not isinstance(self.observer, Silent)

    def tell(self, event: Event) -> None:
        """Tell the observer."""
        self.observer.observe(event)


@dataclass(frozen=True, eq=False)
class ConfigurationGoal(ReadOnly):
    """Reach any one of some configurations of the group, shape (k, nq)."""

    configurations: tuple[Configuration, ...]


@dataclass(frozen=True)
class TipGoal:
    """Bring the tip to a pose, within tolerances."""

    target: PoseTarget


@dataclass(frozen=True)
class LastPlaneGoal:
    """Reach the last guide plane."""


class Objective(enum.Enum):
    """The objective of an optimisation; the values are those of requests."""

    BALANCED = "balanced"
    TIME = "time"
    CLEARANCE = "clearance"


Goal = ConfigurationGoal | TipGoal | LastPlaneGoal


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem(Conditions):
    """Everything that the stages of a plan share."""

    robot_field: RobotField
    kinematics: Kinematics
    q_start: Configuration  # start, shape (nq,)
    goal: Goal
    guide_planes: tuple[GuidePlane, ...] = ()
    derived_planes: int = 0  # how many of them, the first ones, nobody gave: they may be passed by
    # rounds in which a connection is made shorter, and most steps of the optimisation; None: no rounds, and what the
    # optimisation takes; 0: the path that was found is only timed
    optimization_iterations: int | None = None
    start_velocity: LocalRate | None = None  # with which the motion begins, shape (nv,); None: at rest, without one
    start_acceleration: LocalRate | None = None
    end_velocity: LocalRate | None = None  # with which it ends, shape (nv,); None: at rest
    objective: Objective = Objective.BALANCED
    seed: int = 0
    began: float = 0.0  # when its time 0 is, in the time of the request [s]

    @cached_property
    def z_start(self) -> LocalPoint:
        """The start as local coordinates, shape (nv,) [rad or m]."""
        return self.group.to_local(self.q_start)

    @property
    def in_motion(self) -> bool:
        """True if the motion begins or ends in motion."""
        return any(one is not None for one in (self.start_velocity, self.start_acceleration, self.end_velocity))

    @property
    def start_rates(self) -> LocalRate:
        """The velocities at the start, shape (nv,)."""
        return self._or_still(self.start_velocity)

    @property
    def end_rates(self) -> LocalRate:
        """The velocities at the end, shape (nv,)."""
        return self._or_still(self.end_velocity)

    def _or_still(self, rates: LocalRate | None) -> LocalRate:
        return cast(LocalRate, np.zeros(self.group.nv)) if rates is None else rates

    @cached_property
    def batch(self) -> BatchCollision:
        """The world for collision checks of SIMD batches."""
        return BatchCollision.build(self.world)

    def at(self, time: float) -> Problem:
        """The same with every obstacle at rest where it is at a time [s]."""
        if not self.scene.moves:
            return self
        world = self.world_at(time)
        return dataclasses.replace(
            self, scene=world.scene, world=world, robot_field=self.robot_field.among(world.scene)
        )

    def since(self, time: float, q: Configuration) -> Problem:
        """The same, from rest to rest, from a time on [s], which is its time 0, and a configuration (nq,) on."""
        resting = dataclasses.replace(
            self, began=self.began + time, q_start=q, start_velocity=None, start_acceleration=None, end_velocity=None
        )
        if not self.scene.moves:
            return resting
        scene = self.scene.since(time)
        return dataclasses.replace(
            resting,
            scene=scene,
            world=World.build(self.group, scene, self.allowed_collisions),
            robot_field=self.robot_field.among(scene),
        )
