"""Draw the planner's work over the timeline of steps: its log, steps, trees, and the motion as it was optimised."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.errors import Status
from guidefield.messages.replies import PlanReply
from guidefield.planner.task.trace import (
    GROWTH_STEPS,
    MAX_ITERATIONS,
    MAX_NODES,
    EventLog,
    LoggedEvent,
    LoggedTrees,
    Note,
    PathRelaxed,
    StageEntered,
    StageLeft,
    StepKind,
    evenly,
)
from guidefield.recorder.chunks import PATH_TIME, STEP, make_columns, timed
from guidefield.recorder.motion import placed_links
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.spaces import ChartPoints

MOST_FRAMES = 60  # maximum number of steps at which the robot is shown, evenly chosen
STEP_COLORS = {
    StepKind.START: (240, 240, 240, 255),
    StepKind.ADVANCE: (94, 184, 255, 255),
    StepKind.DESCEND: (255, 176, 84, 255),
    StepKind.SLIDE: (120, 220, 160, 255),
    StepKind.REORIENT: (235, 150, 220, 255),
    StepKind.TREE: (150, 150, 150, 255),
}
"""Colour by kind of step (RGBA)."""
OPTIMIZE_COLOR = (190, 160, 250, 255)  # of the optimisation (RGBA)
POINT_RADIUS = 0.006  # radius of the point of a step, at size 1 [m]
OTHER_COLOR = (200, 200, 200, 255)


def text_log(log: EventLog, reply: PlanReply) -> Iterator[Chunk]:
    """Draw a line of the log per event, with the milliseconds since the planning began, and one with the outcome."""
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
    yield timed("/planner/log", times, make_columns(rr.TextLog, level=levels, text=texts, color=colors))


def step_points(log: EventLog, tip: np.ndarray, size: float) -> Iterator[Chunk]:
    """Draw the tip (n, 3) [m, world] after each step, coloured by kind of step."""
    steps = log.steps()
    colors = [STEP_COLORS.get(step.kind, OTHER_COLOR) for _, step in steps]
    if colors:
        times = [rr.TimeColumn(STEP, sequence=[number for number, _ in steps])]
        radii = np.full(len(tip), POINT_RADIUS * size)
        yield timed("/planner/tip", times, make_columns(rr.Points3D, positions=tip, colors=colors, radii=radii))


def _line(event: LoggedEvent, milliseconds: float, planes: Sequence[str]) -> tuple[str, str, tuple[int, int, int, int]]:
    level, text, color = _describe(event, planes)
    return level, f"{milliseconds:8.1f} ms  {text}", color


def _describe(event: LoggedEvent, planes: Sequence[str]) -> tuple[str, str, tuple[int, int, int, int]]:
    if isinstance(event, StageEntered):
        return "INFO", f"{event.name}: {event.message}", OTHER_COLOR
    if isinstance(event, StageLeft):
        about = f" to {planes[event.plane]}" if event.plane is not None and event.plane < len(planes) else ""
        return "INFO", f"{event.name}{about}: {event.outcome}, {1e3 * event.seconds:.1f} ms", OTHER_COLOR
    if isinstance(event, Note):
        return "WARN" if event.warning else "INFO", event.text, OTHER_COLOR
    if isinstance(event, LoggedTrees):
        sizes = " and ".join(map(str, event.sizes))
        return "INFO", f"trees of {sizes} nodes", STEP_COLORS[StepKind.TREE]
    if isinstance(event, PathRelaxed):
        return "DEBUG", f"relax: objective {event.objective:.4g}", OPTIMIZE_COLOR
    return "DEBUG", f"{event.kind.value}: {event.message}", STEP_COLORS.get(event.kind, OTHER_COLOR)


MOST_WAYPOINTS = 24  # points by which a motion that is being optimised is shown
TREE_COLOR = (150, 170, 200, 140)


def trees(group: PlanningGroup, grown: Sequence[tuple[int, LoggedTrees]]) -> Iterator[Chunk]:
    """Draw the tip's motion along the edges of trees as they grew, in `GROWTH_STEPS` steps from each one's first."""
    steps: list[int] = []
    strips: list[np.ndarray] = []
    counts: list[int] = []
    for first, event in grown:
        edges = [tree_edges(group, *tree) for tree in event.trees]
        for number in range(GROWTH_STEPS):
            batch = [edge for tree in edges for edge in np.array_split(tree, GROWTH_STEPS)[number]]
            steps.append(first + number)
            counts.append(len(batch))
            strips += batch
    if strips:
        columns = make_columns(
            rr.LineStrips3D,
            counts,
            strips=strips,
            colors=[TREE_COLOR] * len(strips),
            radii=np.full(len(strips), 0.001 * group.size),
        )
        yield timed("/planner/connect/tree", [rr.TimeColumn(STEP, sequence=steps)], columns)


def tree_edges(group: PlanningGroup, points: ChartPoints, parents: np.ndarray) -> np.ndarray:
    """Return the tip at both ends of the edges among a tree's first `MAX_NODES` nodes, (edges, 2, 3) [m, world]."""
    tips = _tips(group, points[:MAX_NODES])  # a parent comes before its children
    children = np.flatnonzero(parents[:MAX_NODES] >= 0)
    return np.stack([tips[parents[children]], tips[children]], axis=1)


def relaxed(group: PlanningGroup, paths: Sequence[tuple[int, PathRelaxed]]) -> Iterator[Chunk]:
    """Draw the tip's path along a motion after steps of its optimisation, each with its number on the timeline."""
    if not paths:
        return
    chosen = evenly(len(paths), MAX_ITERATIONS)
    strips = []
    for index in chosen:
        path = paths[index][1].path
        strips.append(_tips(group, path[evenly(len(path), MOST_WAYPOINTS)]))
    times = rr.TimeColumn(STEP, sequence=[paths[index][0] for index in chosen])
    columns = make_columns(
        rr.LineStrips3D,
        strips=strips,
        colors=[OPTIMIZE_COLOR] * len(strips),
        radii=np.full(len(strips), 0.003 * group.size),
    )
    yield timed("/planner/relaxed", [times], columns)


def _tips(group: PlanningGroup, points: ChartPoints) -> np.ndarray:
    tip: np.ndarray = placed_links(group, group.expand_each(points), (group.tip,))[:, 0, :3]
    return tip
