"""The robot in a recording: its links over time, its tip's trace, and ghosts of where it was on the way."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.recorder import bodies, surface
from guidefield.recorder.bodies import RobotBodies, link_entity
from guidefield.recorder.chunks import entity, implicit_frame, still, timed
from guidefield.recorder.motion import Motion, Poses, link_placements
from guidefield.robot.frames import frame_index
from guidefield.robot.group import PlanningGroup

GHOSTS = 7
"""Configurations shown along the motion, both ends included."""

GHOST_ENTITY = "/ghosts"

GHOST_STEP = 0.02
"""How far some point of a part has to move before the part is drawn again [m]."""

TRACE_COLOR = (255, 196, 61, 255)
WAYPOINT_COLOR = (120, 220, 160, 255)


def link_frames(group: PlanningGroup, drawn: RobotBodies) -> Iterator[Chunk]:
    """The frames of the links that carry something, and of the tip, each fixed to the joint that moves it."""
    for link in dict.fromkeys((*drawn.links, group.tip)):
        frame = group.model.frames[frame_index(group.model, link)]
        parent = _joint_entity(group, frame.parentJoint) if frame.parentJoint else "/"
        rotation, translation = frame.placement.rotation, frame.placement.translation
        placement = rr.Transform3D(translation=translation, mat3x3=rotation, parent_frame=implicit_frame(parent))
        yield still(link_entity(link), placement)
    tip = rr.CoordinateFrame(implicit_frame(link_entity(group.tip)))
    yield still("/robot/tip", tip, rr.TransformAxes3D(0.08))


def joint_motion(group: PlanningGroup, at: Poses, times: rr.TimeColumn) -> Iterator[Chunk]:
    """Placements in the world of each joint over time; its links follow.

    Args:
        group: The joints that were planned for.
        at: Forward kinematics at n times.
        times: Column of the n times.
    """
    for column, joint in enumerate(at.joints):
        placements = at.placements[:, column]
        columns = rr.Transform3D.columns(translation=placements[:, :3], quaternion=placements[:, 3:])
        yield timed(_joint_entity(group, joint), [times], columns)


def tip_trace(tip: np.ndarray) -> Chunk:
    """The tip's whole way (n, 3) [m, world] as a line."""
    return still("/path/tip", rr.LineStrips3D([tip], colors=[TRACE_COLOR], radii=[0.004]))


def planned_path(waypoints: np.ndarray) -> Iterator[Chunk]:
    """What the planner itself found, before it became a trajectory: the tip at its waypoints (n, 3) [m, world]."""
    yield still("/path/planned/line", rr.LineStrips3D([waypoints], colors=[WAYPOINT_COLOR], radii=[0.0015]))
    yield still("/path/planned/waypoints", rr.Points3D(waypoints, colors=[WAYPOINT_COLOR], radii=[0.005]))


def ghosts(group: PlanningGroup, drawn: RobotBodies, motion: Motion) -> Chunk | None:
    """Sketches of the robot evenly along its way in joint space, bright at the start, dark at the end.

    A part that has hardly moved since it was last drawn isn't drawn again: it would only flicker. None if there is
    nothing to draw.
    """
    chosen = spread_along(motion.configurations, GHOSTS)
    before: dict[int, np.ndarray] = {}
    parts = []
    for number, index in enumerate(chosen):
        placements = link_placements(group, motion.configurations[index], drawn.links)
        grey = round(240 - 215 * number / max(1, len(chosen) - 1))
        for key, (link, sketch) in enumerate(drawn.sketch):
            part = sketch.moved(placements[link])
            if key not in before or np.abs(part.vertices - before[key]).max() > GHOST_STEP:
                before[key] = part.vertices
                parts.append(part.colored((grey, grey, grey, 255)))
    return still(GHOST_ENTITY, bodies.mesh(surface.joined(parts))) if parts else None


def spread_along(configurations: np.ndarray, count: int) -> list[int]:
    """Rows of configurations (n, nq), first and last included, about evenly far along the way."""
    steps = np.linalg.norm(np.diff(configurations, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    if arc[-1] == 0.0:
        return [0]
    return sorted({int(np.argmin(np.abs(arc - at))) for at in np.linspace(0.0, arc[-1], count)})


def _joint_entity(group: PlanningGroup, joint: int) -> str:
    return entity("robot", "joints", group.model.names[joint])
