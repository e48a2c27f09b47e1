"""Events that the planner tells an observer while it works; the observer is silent by default."""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoints, Configuration


@dataclass(frozen=True)
class StageEntered:
    """A stage of the plan begins."""

    name: str
    message: str


@dataclass(frozen=True)
class StageLeft:
    """A stage of the plan has ended; `plane` is the index of the guide plane it was about, if any."""

    name: str
    outcome: str
    seconds: float
    plane: int | None = None


class StepKind(enum.Enum):
    """What was done in a step; the values are the words of a recording."""

    START = "start"
    ADVANCE = "advance"
    DESCEND = "descend"
    SLIDE = "slide"
    REORIENT = "reorient"
    SWEEP = "sweep"
    TREE = "tree"


@dataclass(frozen=True, eq=False)
class Step(ReadOnly):
    """One accepted change of configuration.

    Attributes:
        q: Configuration after it, shape (nq,), of the planning group.
        potential: Potential of the robot there, if it was evaluated [m].
    """

    kind: StepKind
    q: Configuration
    message: str
    potential: float | None = None
    plane: int | None = None


@dataclass(frozen=True)
class Note:
    """Something worth telling a person; `warning` is True where something went wrong."""

    text: str
    warning: bool = False


@dataclass(frozen=True, eq=False)
class TreeGrown:
    """The trees of a search when it ended, met or not.

    Attributes:
        trees: Gives, for each tree, its nodes in the order in which it grew, chart points, shape (n, nv), and the index
            of each one's parent, shape (n,); -1 for a root. A search takes microseconds: who looks pays, and looks
            while it is told, as the next search begins in the same memory.
    """

    trees: Callable[[], tuple[tuple[ChartPoints, np.ndarray], ...]]


@dataclass(frozen=True, eq=False)
class PathRelaxed(ReadOnly):
    """One accepted step of the optimisation.

    Attributes:
        path: The whole path after it, chart points, shape (n, nv).
        objective: What is descended (planner/optimize/optimization.py), dimensionless.
    """

    path: ChartPoints
    objective: float


Event = StageEntered | StageLeft | Step | Note | TreeGrown | PathRelaxed


class Observer(Protocol):
    """Somebody who watches a plan being made."""

    def observe(self, event: Event) -> None:
        """Be told of an event; must not fail and must not be slow."""


class Silent:
    """Watches nothing."""

    def observe(self, event: Event) -> None:
        """Forget the event."""
