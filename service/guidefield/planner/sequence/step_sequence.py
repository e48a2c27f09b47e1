"""Interfaces of a sequence's steps, which handlers implement; the times at which held objects may touch obstacles.

At other times the certificate judges these pairs as all others. An object may touch until it is measured at `AWAY`, so
with fewer measurements it may longer, and all along where none finds it away.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from guidefield.collision.world import World
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.plan import Plan
from guidefield.planner.sequence.cartesian_line import CartesianLine
from guidefield.planner.task.problem import Conditions, Problem
from guidefield.prove.closest import measure
from guidefield.robot.model.joints import RobotConfiguration

Touch = tuple[str, str]
"""Names of a held object and of an obstacle that it may touch where it is picked up and put down."""


@dataclass(frozen=True, eq=False)
class StepMotion:
    """The motion that a step asks for."""

    problem: Problem
    plan: Callable[[Problem], Plan]  # plans a problem as the step asks for it: this one, or the same with fewer goals
    line: CartesianLine | None = None


class Situation(Protocol):
    """The situation when a step begins: the robot, the held objects, the obstacles."""

    @property
    def q(self) -> RobotConfiguration:
        """Configuration of the whole robot, shape (nq,)."""
        ...

    @property
    def held_names(self) -> tuple[str, ...]:
        """Names of the objects that are held."""
        ...

    @property
    def touches(self) -> tuple[Touch, ...]:
        """Pairs that may touch where held objects are picked up and put down."""
        ...


S = TypeVar("S", bound=Situation)


class StepSequence(Protocol[S]):
    """The steps of a sequence."""

    def __len__(self) -> int: ...

    def moves(self, index: int) -> bool:
        """Return whether anything moves in a step."""
        ...

    def motion(self, index: int, at: S, begin: float) -> StepMotion | None:
        """The motion of a step, begun in a situation at a time [s]; None where nothing moves.

        Time 0 of the problem is that time; at an infinite time all obstacles have come to rest.
        """
        ...

    def after(self, index: int, at: S, q: RobotConfiguration, time: float) -> S:
        """The situation after a step that began in one and led to a configuration of the whole robot, shape (nq,).

        It ended at a time [s]; at an infinite time all obstacles have come to rest.
        """
        ...

    def conditions(self, index: int, at: S) -> Conditions:
        """The conditions on the motion of all joints during a step that begins in a situation."""
        ...

    def leaves_at(self, index: int, at: S, arrival: float) -> float:
        """The end of a step that began in a situation, whose motion ends at a time [s].

        The robot waits there for the step's pause, and until what it picks up has come to rest.
        """
        ...

    def passes(self, index: int) -> float | None:
        """Largest deviation from the goal of a step that doesn't stop there [m, rad]; None where it stops.

        The step after it moves the same joints.
        """
        ...

    def attached(self, index: int) -> str | None:
        """Name of what is picked up at a step's end."""
        ...

    def detached(self, index: int) -> str | None:
        """Name of what is put down at a step's end."""
        ...


AWAY = 5e-3  # an object at this distance from an obstacle has left it [m]: `Attach` and docs/steps.md promise it
MEASURING_RATE = 200.0  # rate at which distances of an object from an obstacle that it may touch are measured [Hz]
MAX_MEASUREMENTS = 2000  # of these at most, over the whole time that it is held


@dataclass(frozen=True)
class AllowedContact:
    """The times between which a held object may touch an obstacle."""

    touch: Touch
    begin: float  # [s]
    end: float

    def covers(self, begin: float, end: float) -> bool:
        """Return whether it holds all along between two times [s]."""
        return self.begin <= begin and end <= self.end


@dataclass(frozen=True, eq=False)
class HeldSpan:
    """Consecutive steps in which an object is held that may touch something at its ends."""

    touch: Touch
    spans: Sequence[tuple[float, float]]  # times at which each step begins and ends [s]
    worlds: Sequence[World]
    put_down: bool


def find_held_spans(
    touches: Sequence[Sequence[Touch]],
    detached: Sequence[str | None],
    spans: Sequence[tuple[float, float]],
    conditions: Sequence[Conditions],
) -> Iterator[HeldSpan]:
    """The spans of steps, from what may be touched, what is put down, the time and the conditions of each step."""
    for touch in dict.fromkeys(touch for some in touches for touch in some):
        steps: list[int] = []
        for index, some in enumerate(touches):
            if touch in some:
                steps.append(index)
            ends = index == len(touches) - 1 or touch not in touches[index + 1] or detached[index] == touch[0]
            if steps and ends:
                put_down = detached[steps[-1]] == touch[0]
                yield HeldSpan(touch, [spans[i] for i in steps], [conditions[i].world for i in steps], put_down)
                steps = []


def find_allowed_times(holding: HeldSpan, trajectory: Trajectory, min_clearance: float) -> list[AllowedContact]:
    """Find when a held object may touch an obstacle: until it is `AWAY`, or at `min_clearance` [m] if that is more."""
    begin, end = holding.spans[0][0], holding.spans[-1][1]
    away = [time for time, gap in _measure_gaps(holding, trajectory) if gap >= max(AWAY, min_clearance)]
    if not away:
        return [AllowedContact(holding.touch, begin, end)]
    found = [AllowedContact(holding.touch, begin, away[0])]
    if holding.put_down:
        found.append(AllowedContact(holding.touch, away[-1], end))
    return [one for one in found if one.end > one.begin]


def _measure_gaps(holding: HeldSpan, trajectory: Trajectory) -> Iterator[tuple[float, float]]:
    """Times while it is held, in order, and the distance of the object from the obstacle then [m]."""
    whole = holding.spans[-1][1] - holding.spans[0][0]
    rate = min(MEASURING_RATE, MAX_MEASUREMENTS / max(whole, 1e-9))
    for (begin, end), world in zip(holding.spans, holding.worlds, strict=True):
        pairs = _find_pairs(world, holding.touch)
        if not pairs:
            continue
        times = np.linspace(begin, end, max(2, int(np.ceil((end - begin) * rate)) + 1))
        for time, z in zip(times.tolist(), trajectory.evaluate(times)[0], strict=True):
            q = world.group.expand_from_local(z)
            world.place(q)
            yield time, min(measure(world, pair, time)[0] for pair in pairs)


def _find_pairs(world: World, touch: Touch) -> list[int]:
    held, obstacle = (np.flatnonzero([body == name for body in world.body_names]) for name in touch)
    bodies = world.pairs.bodies(np.arange(len(world.pairs)))
    found: list[int] = np.flatnonzero(np.isin(bodies[:, 0], held) & np.isin(bodies[:, 1], obstacle)).tolist()
    return found
