"""The conditions that a motion is judged by: the robot among obstacles, what it has to keep, and the deadline."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.planner.task.trace import Event, Observer, Silent
from guidefield.read_only import ReadOnly
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.path_constraints import ConstrainedFrames, PathConstraint
from guidefield.robot.model.spaces import ChartRate
from guidefield.scene.scene import Scene


@dataclass
class Counters:
    """How often the expensive things were done."""

    iterations: int = 0
    collision_checks: int = 0


@dataclass(frozen=True, eq=False, kw_only=True)
class Conditions(ReadOnly):
    """What a motion is judged by.

    Attributes:
        min_clearance: Distance to keep from obstacles everywhere [m].
        leave_start_contact: Whether the start may be in slight contact, which is left first.
        jerk_limits: Of every coordinate, shape (nv,), infinite where there is none; None: jerk doesn't matter.
    """

    group: PlanningGroup
    scene: Scene
    world: World
    min_clearance: float = 0.0
    allowed_collisions: frozenset[tuple[str, str]] = frozenset()
    leave_start_contact: bool = False
    jerk_limits: ChartRate | None = None
    path_constraints: tuple[PathConstraint, ...] = ()
    deadline: Deadline = UNLIMITED
    observer: Observer = field(default_factory=Silent)
    counters: Counters = field(default_factory=Counters)

    @cached_property
    def constrained_frames(self) -> ConstrainedFrames:
        """The path constraints on the group."""
        return ConstrainedFrames(self.group, self.path_constraints)

    @property
    def is_observed(self) -> bool:
        """True if somebody watches: events that cost something are made then."""
        return not isinstance(self.observer, Silent)

    def tell(self, event: Event) -> None:
        """Tell the observer."""
        self.observer.observe(event)
