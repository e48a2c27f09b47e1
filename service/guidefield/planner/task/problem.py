"""What is to be planned: robot, scene, start, goal, and the budget; and the counters that a reply reports."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from guidefield.collision.certify.timed_certificate import TimedWorld
from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.collision.world import World
from guidefield.errors import Status
from guidefield.planner.task.trace import Event, Observer, Silent
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.group.path_constraints import ConstrainedFrames, PathConstraint
from guidefield.robot.ik.pose_target import PoseTarget
from guidefield.robot.model.spaces import ChartPoint, ChartRate, Configuration
from guidefield.scene.guide_plane import GuidePlane
from guidefield.scene.scene import Scene

if TYPE_CHECKING:  # its kernels take a sixth of the time until a first plan that doesn't use them
    from guidefield.potential import RobotField


@dataclass(frozen=True, eq=False)
class ConfigurationGoal:
    """Reach any one of some configurations of the group, shape (k, nq)."""

    configurations: tuple[Configuration, ...]


@dataclass(frozen=True)
class TipGoal:
    """Bring the tip to a pose, within tolerances."""

    target: PoseTarget


@dataclass(frozen=True)
class LastPlaneGoal:
    """Reach the last guide plane."""


Goal = ConfigurationGoal | TipGoal | LastPlaneGoal


@dataclass
class Budget:
    """How long planning may go on.

    Attributes:
        deadline: Time on the clock of `time.monotonic` [s].
        cancelled: Whether somebody asked to stop.
    """

    deadline: float = float("inf")
    cancelled: Callable[[], bool] = field(default=lambda: False)

    def spent(self) -> Status | None:
        """PREEMPTED, TIMED_OUT, or None while there is time."""
        if self.cancelled():
            return Status.PREEMPTED
        return Status.TIMED_OUT if time.monotonic() >= self.deadline else None


@dataclass
class Counters:
    """How often the expensive things were done."""

    iterations: int = 0
    collision_checks: int = 0


@dataclass(frozen=True, eq=False)
class Problem:
    """Everything that the stages of a plan share.

    Attributes:
        group: The robot, reduced to the joints that are planned for.
        scene: Obstacles.
        world: Robot and obstacles as one Coal model.
        robot_field: The scene's field on the robot.
        kinematics: Where the tip is.
        q_start: Start, shape (nq,).
        goal: What to reach.
        guide_planes: Planes to cross, in order.
        derived_planes: How many of them, the first ones, nobody gave: they may be passed by.
        min_clearance: Distance to keep from obstacles everywhere [m].
        allowed_collisions: Pairs of names that may touch.
        leave_start_contact: Whether the start may be in slight contact, which is left first.
        jerk_limits: Of every coordinate, shape (nv,), infinite where there is none; None: jerk doesn't matter.
        path_constraints: What frames have to keep all along the motion.
        optimization_iterations: Rounds in which a connection is made shorter, and most steps of the relaxation; None:
            no rounds, and what the relaxation takes.
        seed: Of all randomness.
        budget: How long it may take.
        observer: Who watches.
        counters: What is counted on the way.
    """

    group: PlanningGroup
    scene: Scene
    world: World
    robot_field: RobotField
    kinematics: Kinematics
    q_start: Configuration
    goal: Goal
    guide_planes: tuple[GuidePlane, ...] = ()
    derived_planes: int = 0
    min_clearance: float = 0.0
    allowed_collisions: tuple[tuple[str, str], ...] = ()
    leave_start_contact: bool = False
    jerk_limits: ChartRate | None = None
    path_constraints: tuple[PathConstraint, ...] = ()
    optimization_iterations: int | None = None
    seed: int = 0
    budget: Budget = field(default_factory=Budget)
    observer: Observer = field(default_factory=Silent)
    counters: Counters = field(default_factory=Counters)

    @cached_property
    def z_start(self) -> ChartPoint:
        """The start as a chart point, shape (nv,) [rad or m]."""
        return self.group.chart(self.q_start)

    @cached_property
    def lanes(self) -> BatchCollision:
        """The world for the lane kernels."""
        return BatchCollision.build(self.world)

    def at(self, time: float) -> Problem:
        """The same with every obstacle at rest where it is at a time [s]."""
        if not self.scene.moves:
            return self
        scene = self.scene.at(time)
        return dataclasses.replace(
            self,
            scene=scene,
            world=World.build(self.group, scene, self.allowed_collisions),
            robot_field=self.robot_field.among(scene),
        )

    @cached_property
    def timed_world(self) -> TimedWorld:
        """For the certificate of motions in time."""
        resting = World.build(self.group, self.scene.resting, self._allowed_at_rest())
        return TimedWorld.of(resting, self.world)

    def _allowed_at_rest(self) -> tuple[tuple[str, str], ...]:
        moving = {one.name for one in self.scene.obstacles if one.motion is not None}
        return tuple(pair for pair in self.allowed_collisions if not moving.intersection(pair))

    @cached_property
    def constrained_frames(self) -> ConstrainedFrames:
        """The path constraints on the group."""
        return ConstrainedFrames(self.group, self.path_constraints)

    def tell(self, event: Event) -> None:
        """Tell the observer."""
        self.observer.observe(event)
