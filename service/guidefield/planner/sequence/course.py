"""The steps of a sequence as its planner sees them: motions and configurations, not what is picked up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

from guidefield.planner.plan import Plan
from guidefield.planner.sequence.straight_way import StraightWay
from guidefield.planner.task.conditions import Conditions
from guidefield.planner.task.problem import Problem
from guidefield.robot.model.spaces import RobotConfiguration

Touch = tuple[str, str]
"""Names of a held object and of an obstacle that it may touch where it is picked up and put down."""


@dataclass(frozen=True, eq=False)
class StepMotion:
    """The motion that a step asks for.

    Attributes:
        plan: Plans a problem as the step asks for it: this one, or the same with fewer goals.
    """

    problem: Problem
    plan: Callable[[Problem], Plan]
    way: StraightWay | None = None


class Situation(Protocol):
    """Where everything is when a step begins."""

    @property
    def q(self) -> RobotConfiguration:
        """Configuration of the whole robot, shape (nq,)."""
        ...

    @property
    def held(self) -> tuple[str, ...]:
        """Names of the objects that are held."""
        ...

    @property
    def touches(self) -> tuple[Touch, ...]:
        """What held objects may touch where they are picked up and put down."""
        ...


S = TypeVar("S", bound=Situation)


class Course(Protocol[S]):
    """The steps of a sequence."""

    def __len__(self) -> int:
        """How many there are."""
        ...

    def moves(self, index: int) -> bool:
        """Return whether anything moves in a step."""
        ...

    def motion(self, index: int, at: S, begin: float) -> StepMotion | None:
        """What a step asks for, begun in a situation at a time [s]; None where nothing moves.

        Time 0 of the problem is that time; at an infinite time all obstacles have come to rest.
        """
        ...

    def after(self, index: int, at: S, q: RobotConfiguration) -> S:
        """The situation after a step that began in one and led to a configuration of the whole robot, shape (nq,)."""
        ...

    def conditions(self, index: int, at: S) -> Conditions:
        """What the motion of all joints is judged by during a step that begins in a situation."""
        ...

    def pause(self, index: int) -> float:
        """For how long the robot waits after a step's motion [s]."""
        ...

    def passes(self, index: int) -> float | None:
        """How far from its goal the way of a step may be left that doesn't stop there [m, rad]; None where it stops.

        The step after it moves the same joints.
        """
        ...

    def attached(self, index: int) -> str | None:
        """Name of what is picked up at a step's end."""
        ...

    def detached(self, index: int) -> str | None:
        """Name of what is put down at a step's end."""
        ...
