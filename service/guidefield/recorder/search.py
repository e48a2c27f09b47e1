"""How the planner searched: its trees as they grew, and the motion as it was optimised, over the timeline of steps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.planner.task.event_log import GROWTH_STEPS, MAX_ITERATIONS, MAX_NODES, LoggedTrees, evenly
from guidefield.planner.task.trace import PathRelaxed
from guidefield.recorder.chunks import STEP, timed
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.model.spaces import ChartPoints

MOST_WAYPOINTS = 24
"""Points by which a motion that is being optimised is shown."""

TREE_COLOR = (150, 170, 200, 140)
RELAXED_COLOR = (190, 160, 250, 255)


def trees(group: PlanningGroup, grown: Sequence[tuple[int, LoggedTrees]]) -> Iterator[Chunk]:
    """The tip's motion along each edge of the trees, in the order in which they grew.

    Args:
        group: The joints that were planned for.
        grown: Trees, each with the first of its `GROWTH_STEPS` numbers on the timeline.
    """
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
        columns = rr.LineStrips3D.columns(
            strips=strips, colors=[TREE_COLOR] * len(strips), radii=np.full(len(strips), 0.001)
        )
        yield timed("/planner/connect/tree", [rr.TimeColumn(STEP, sequence=steps)], columns.partition(counts))


def tree_edges(group: PlanningGroup, points: ChartPoints, parents: np.ndarray) -> np.ndarray:
    """The tip at both ends of the edges to the first `MAX_NODES` nodes of a tree, shape (edges, 2, 3) [m, world]."""
    tips = _tips(group, points[:MAX_NODES])  # a parent comes before its children
    children = np.flatnonzero(parents[:MAX_NODES] >= 0)
    return np.stack([tips[parents[children]], tips[children]], axis=1)


def relaxed(group: PlanningGroup, paths: Sequence[tuple[int, PathRelaxed]]) -> Iterator[Chunk]:
    """The tip's way along a motion after steps of its optimisation, each with its number on the timeline."""
    if not paths:
        return
    chosen = evenly(len(paths), MAX_ITERATIONS)
    strips = []
    for index in chosen:
        path = paths[index][1].path
        strips.append(_tips(group, path[evenly(len(path), MOST_WAYPOINTS)]))
    times = rr.TimeColumn(STEP, sequence=[paths[index][0] for index in chosen])
    columns = rr.LineStrips3D.columns(
        strips=strips, colors=[RELAXED_COLOR] * len(strips), radii=np.full(len(strips), 0.003)
    )
    yield timed("/planner/relaxed", [times], columns)


def _tips(group: PlanningGroup, points: ChartPoints) -> np.ndarray:
    """The tip's position at chart points (n, nv), shape (n, 3) [m, world]."""
    kinematics = Kinematics(group)
    return np.array([kinematics.tip_position(group.expand_from_chart(point)) for point in points])
