"""What a motion is judged by: the robot among obstacles, what it has to keep, and the time there is to tell."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

from guidefield.collision.certify.timed_world import TimedWorld
from guidefield.collision.world import World
from guidefield.errors import Status
from guidefield.planner.task.trace import Event, Observer, Silent
from guidefield.read_only import ReadOnly
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.path_constraints import ConstrainedFrames, PathConstraint
from guidefield.robot.model.spaces import ChartRate
from guidefield.scene.scene import Scene


@dataclass
class Budget:
    """How long planning, or a judgement, may go on.

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

    def with_at_least(self, seconds: float) -> Callable[[], Status | None]:
        """Whether it is spent, asked by what begins now and may go on for so long [s] wherever the deadline is."""
        until = time.monotonic() + seconds
        return lambda: self.spent() if time.monotonic() >= until else None


@dataclass
class Counters:
    """How often the expensive things were done."""

    iterations: int = 0
    collision_checks: int = 0


@dataclass(frozen=True, eq=False, kw_only=True)
class Conditions(ReadOnly):
    """What a motion is judged by.

    Attributes:
        group: The robot, reduced to the joints that move.
        scene: Obstacles.
        world: Robot and obstacles as one Coal model.
        min_clearance: Distance to keep from obstacles everywhere [m].
        allowed_collisions: Pairs of names that may touch.
        leave_start_contact: Whether the start may be in slight contact, which is left first.
        jerk_limits: Of every coordinate, shape (nv,), infinite where there is none; None: jerk doesn't matter.
        path_constraints: What frames have to keep all along the motion.
        budget: How long it may take.
        observer: Who watches.
        counters: What is counted on the way.
    """

    group: PlanningGroup
    scene: Scene
    world: World
    min_clearance: float = 0.0
    allowed_collisions: frozenset[tuple[str, str]] = frozenset()
    leave_start_contact: bool = False
    jerk_limits: ChartRate | None = None
    path_constraints: tuple[PathConstraint, ...] = ()
    budget: Budget = field(default_factory=Budget)
    observer: Observer = field(default_factory=Silent)
    counters: Counters = field(default_factory=Counters)

    @cached_property
    def timed_world(self) -> TimedWorld:
        """For the certificate of motions in time; where nothing moves both worlds in it are the problem's."""
        if not self.scene.moves:
            return TimedWorld.of(self.world, self.world)
        resting = World.build(self.group, self.scene.resting, self._allowed_at_rest())
        return TimedWorld.of(resting, self.world)

    def _allowed_at_rest(self) -> frozenset[tuple[str, str]]:
        moving = {one.name for one in self.scene.obstacles if one.motion is not None}
        return frozenset(pair for pair in self.allowed_collisions if not moving.intersection(pair))

    @cached_property
    def constrained_frames(self) -> ConstrainedFrames:
        """The path constraints on the group."""
        return ConstrainedFrames(self.group, self.path_constraints)

    def tell(self, event: Event) -> None:
        """Tell the observer."""
        self.observer.observe(event)
