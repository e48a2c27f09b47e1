"""What the planner said while it worked, kept as it came and written down at the end."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.errors import Status
from guidefield.messages.replies import PlanReply
from guidefield.planner.task.trace import Event, Note, PathRelaxed, StageEntered, StageLeft, Step, StepKind, TreeGrown
from guidefield.recorder.chunks import PATH_TIME, STEP, timed
from guidefield.recorder.search import GROWTH

MOST_EVENTS = 20_000
"""Events that are kept; what comes after is counted only."""

MOST_FRAMES = 60
"""Steps at which the robot is shown: of more, as many, evenly chosen."""

STEP_COLORS = {
    StepKind.START: (240, 240, 240, 255),
    StepKind.ADVANCE: (94, 184, 255, 255),
    StepKind.DESCEND: (255, 176, 84, 255),
    StepKind.SLIDE: (120, 220, 160, 255),
    StepKind.REORIENT: (235, 150, 220, 255),
    StepKind.TREE: (150, 150, 150, 255),
}
"""Colour by kind of step (RGBA)."""

RELAX_COLOR = (190, 160, 250, 255)
"""Of a step of the optimisation (RGBA)."""

POINT_RADIUS = 0.006
"""Radius of the point that stands for a step [m]."""

OTHER_COLOR = (200, 200, 200, 255)


@dataclass(eq=False)
class EventLog:
    """Events in the order in which they came.

    Attributes:
        events: Those that are kept.
        seconds: When each came, since the log began [s].
        dropped: How many came after the log was full.
    """

    events: list[Event] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    dropped: int = 0
    began: float = field(default_factory=time.perf_counter)

    def add(self, event: Event) -> None:
        """Keep an event; costs next to nothing, trees some microseconds."""
        if len(self.events) < MOST_EVENTS:
            self.events.append(_kept(event))
            self.seconds.append(time.perf_counter() - self.began)
        else:
            self.dropped += 1

    def steps(self) -> list[tuple[int, Step]]:
        """The accepted steps, each with its number on the timeline `STEP`."""
        return [(number, event) for number, event in self.numbered() if isinstance(event, Step)]

    def numbered(self) -> Iterator[tuple[int, Event]]:
        """Each event with its number on the timeline: that of the last step before it, its own if it is one."""
        number = -1
        for event in self.events:
            before, number = number, number + _STEPS.get(type(event), 0)
            yield max(before + 1 if number > before else number, 0), event


def _kept(event: Event) -> Event:
    """An event that stays as it is: trees lie in memory that is used again."""
    if not isinstance(event, TreeGrown):
        return event
    trees = event.trees()
    return TreeGrown(lambda: trees)


_STEPS: dict[type, int] = {Step: 1, PathRelaxed: 1, TreeGrown: GROWTH}
"""How many numbers of the timeline an event takes."""


def text_log(log: EventLog, reply: PlanReply) -> Iterator[Chunk]:
    """One line per event, with the milliseconds since the planning began, and one for how it ended."""
    planes = [plane.name for plane in reply.guide_planes]
    lines = [_line(event, 1e3 * seconds, planes) for event, seconds in zip(log.events, log.seconds, strict=True)]
    numbers = [number for number, _ in log.numbered()]
    if log.dropped:
        lines.append(("WARN", f"{log.dropped} more events were not kept", (230, 160, 60, 255)))
    good = reply.status.code == Status.SUCCESS
    lines.append(("INFO" if good else "ERROR", f"{reply.status.name}: {reply.status.message}", OTHER_COLOR))
    times = [
        # The planning is over before the motion begins: on the motion's timeline all of it stands at the start.
        rr.TimeColumn(PATH_TIME, duration=np.zeros(len(lines))),
        rr.TimeColumn(STEP, sequence=numbers + [max(numbers, default=0)] * (len(lines) - len(numbers))),
    ]
    levels, texts, colors = zip(*lines, strict=True)
    yield timed("/planner/log", times, rr.TextLog.columns(level=levels, text=texts, color=colors))


def step_points(log: EventLog, tip: np.ndarray) -> Iterator[Chunk]:
    """Where the steps brought the tip (n, 3) [m, world], coloured by kind of step."""
    steps = log.steps()
    colors = [STEP_COLORS.get(step.kind, OTHER_COLOR) for _, step in steps]
    if colors:
        times = [rr.TimeColumn(STEP, sequence=[number for number, _ in steps])]
        radii = np.full(len(tip), POINT_RADIUS)
        yield timed("/planner/tip", times, rr.Points3D.columns(positions=tip, colors=colors, radii=radii))


def _line(event: Event, milliseconds: float, planes: Sequence[str]) -> tuple[str, str, tuple[int, int, int, int]]:
    """Level, text and colour of an event; `planes` are the guide planes' names."""
    level, text, color = _told(event, planes)
    return level, f"{milliseconds:8.1f} ms  {text}", color


def _told(event: Event, planes: Sequence[str]) -> tuple[str, str, tuple[int, int, int, int]]:
    if isinstance(event, StageEntered):
        return "INFO", f"{event.name}: {event.message}", OTHER_COLOR
    if isinstance(event, StageLeft):
        about = f" to {planes[event.plane]}" if event.plane is not None and event.plane < len(planes) else ""
        return "INFO", f"{event.name}{about}: {event.outcome}, {1e3 * event.seconds:.1f} ms", OTHER_COLOR
    if isinstance(event, Note):
        return "WARN" if event.warning else "INFO", event.text, OTHER_COLOR
    if isinstance(event, TreeGrown):
        sizes = " and ".join(f"{len(points)}" for points, _ in event.trees())
        return "INFO", f"trees of {sizes} nodes", STEP_COLORS[StepKind.TREE]
    if isinstance(event, PathRelaxed):
        return "DEBUG", f"relax: objective {event.objective:.4g}", RELAX_COLOR
    return "DEBUG", f"{event.kind.value}: {event.message}", STEP_COLORS.get(event.kind, OTHER_COLOR)
