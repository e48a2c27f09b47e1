"""The robot in a recording: its links over time, its tip's trace, and ghosts of where it was on the way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin
import rerun as rr
from rerun.chunk import Chunk

from guidefield.memo import memoized_by_value
from guidefield.recorder import bodies, surface
from guidefield.recorder.bodies import Drawn
from guidefield.recorder.chunks import GHOST_ENTITY, PATH_TIME, WORLD, joint_frame, link_frame, path_times, still, timed
from guidefield.recorder.motion import Motion, Poses, link_placements
from guidefield.recorder.surface import Surface
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.model.frames import frame_index
from guidefield.robot.model.spaces import Configurations

GHOSTS = 6
"""Configurations shown along the motion, both ends included."""
GHOST_STEP = 0.02
"""Distance that some point of a part has to move before the part is drawn again, at size 1 [m]."""
AXES = 0.08
"""Length of the axes of the tip's frame, at size 1 [m]."""
TRACE_COLOR = (255, 196, 61, 255)
WAYPOINT_COLOR = (120, 220, 160, 255)


def tip_axes(group: PlanningGroup) -> Chunk:
    """The axes of the tip's frame."""
    return _axes_of(group.tip, AXES * group.size)


@memoized_by_value(64)
def _axes_of(link: str, length: float) -> Chunk:
    return still("/robot/tip", rr.CoordinateFrame(link_frame(link)), rr.TransformAxes3D(length))


def link_motion(group: PlanningGroup, links: Sequence[str], at: Poses, times: np.ndarray, timeline: str) -> Chunk:
    """The frames of links: one entity with the frame that each joint moves, over time, and with the frames fixed to it.

    Args:
        group: The joints that were planned for.
        links: Those whose frames are wanted, beside the tip's.
        at: Forward kinematics at n times.
        times: Shape (n,), rising: seconds, or the planner's steps.
        timeline: `PATH_TIME` or `STEP`.
    """
    names, parents, fixed = _fixed_frames(group, tuple(dict.fromkeys((*links, group.tip))))
    moved = [joint_frame(group.model.names[joint]) for joint in at.joints]
    placements = np.concatenate([fixed, at.placements.reshape(-1, 7)])
    columns = rr.Transform3D.columns(
        translation=placements[:, :3],
        quaternion=placements[:, 3:],
        child_frame=[*names, *moved * len(times)],
        parent_frame=[*parents, *[WORLD] * (len(moved) * len(times))],
    )
    rows = np.concatenate([np.repeat(times[:1], len(fixed)), np.repeat(times, len(moved))])
    column = path_times(rows) if timeline == PATH_TIME else rr.TimeColumn(timeline, sequence=rows)
    return timed("/robot/model/frames", [column], columns)


@memoized_for_alike
def _fixed_frames(group: PlanningGroup, links: tuple[str, ...]) -> tuple[list[str], list[str], np.ndarray]:
    """Names of the frames of links and of those that they are fixed to, and how they lie there, shape (links, 7)."""
    frames = [group.model.frames[frame_index(group.model, link)] for link in links]
    fixed = np.array([pin.SE3ToXYZQUAT(frame.placement) for frame in frames]).reshape(-1, 7)
    return [link_frame(link) for link in links], [moved_frame(group, frame.parentJoint) for frame in frames], fixed


def tip_trace(tip: np.ndarray, size: float) -> Chunk:
    """The tip's whole way (n, 3) [m, world] as a line, of a robot of a size."""
    return still("/path/tip", rr.LineStrips3D([tip], colors=[TRACE_COLOR], radii=[0.004 * size]))


def planned_path(waypoints: np.ndarray, size: float) -> Iterator[Chunk]:
    """The path that the planner found, before it became a trajectory: the tip at its waypoints (n, 3) [m, world]."""
    line = rr.LineStrips3D([waypoints], colors=[WAYPOINT_COLOR], radii=[0.0015 * size])
    yield still("/path/planned", line, rr.Points3D(waypoints, colors=[WAYPOINT_COLOR], radii=[0.005 * size]))


def ghosts(group: PlanningGroup, drawn: Drawn, motion: Motion) -> Chunk | None:
    """Sketches of the robot evenly along its way in joint space, bright at the start, dark at the end.

    A part that has hardly moved since it was last drawn isn't drawn again: it would only flicker. None if there is
    nothing to draw.
    """
    chosen = spread_along(motion.configurations, GHOSTS)
    placed = link_placements(group, motion.configurations[chosen], drawn.links).astype(np.float32)
    greys = np.linspace(240.0, 25.0, len(chosen)).round().astype(np.uint8)
    parts = []
    for link, sketch in drawn.sketch:
        there = placed[:, drawn.links.index(link)]
        vertices = sketch.vertices @ there[:, :, :3].swapaxes(1, 2) + there[:, None, :, 3]
        shown = [0]
        for number in range(1, len(chosen)):
            if np.abs(vertices[number] - vertices[shown[-1]]).max() > GHOST_STEP * group.size:
                shown.append(number)
        for number in shown:
            colors = np.full((len(sketch.vertices), 4), greys[number])
            colors[:, 3] = 255
            normals = sketch.normals @ there[number, :, :3].T
            parts.append(Surface(vertices[number], sketch.triangles, normals, colors))
    return still(GHOST_ENTITY, bodies.mesh(surface.joined(parts))) if parts else None


def extent(group: PlanningGroup, drawn: Drawn, configurations: Configurations) -> np.ndarray:
    """Corners (m, 3) [m, world] of the boxes about the links that move, at configurations (n, nq)."""
    placed = link_placements(group, configurations, drawn.links)
    corners = [np.empty((0, 3))]
    for link, sketch in drawn.sketch:
        if group.model.frames[frame_index(group.model, link)].parentJoint:
            there = placed[:, drawn.links.index(link)]
            vertices = sketch.vertices @ there[:, :, :3].swapaxes(1, 2) + there[:, None, :, 3]
            corners += [vertices.min(axis=1), vertices.max(axis=1)]
    return np.concatenate(corners)


def spread_along(configurations: Configurations, count: int) -> list[int]:
    """Rows of configurations (n, nq), first and last included, about evenly far along the way."""
    steps = np.linalg.norm(np.diff(configurations, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    if arc[-1] == 0.0:
        return [0]
    return sorted({int(np.argmin(np.abs(arc - at))) for at in np.linspace(0.0, arc[-1], count)})


def moved_frame(group: PlanningGroup, joint: int) -> str:
    """Name of the frame that a joint moves, by Pinocchio's index; 0 is the world's."""
    return joint_frame(group.model.names[joint]) if joint else WORLD
