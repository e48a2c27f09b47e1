"""The balls that contain a robot's links, by which its distances are first judged; drawn as far as they are known."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.recorder.chunks import entity, link_frame, still
from guidefield.robot.bodies.sphere_cover import known_coverage
from guidefield.robot.model.model import RobotModel

COLOR = (125, 175, 240, 255)
"""Colour of the balls (RGBA)."""


def known(robot: RobotModel) -> str:
    """Which shapes' covers are known, and how many balls each has."""
    return " ".join("-" if one is None else f"{len(one.cover.spheres)}" for one in known_coverage(robot))


def cover_spheres(robot: RobotModel) -> Iterator[Chunk]:
    """`/robot/spheres/<link>`: the balls that contain the collision shapes of a link, in its frame."""
    by_link: dict[str, list[np.ndarray]] = {}
    for index, (shape, one) in enumerate(zip(robot.geometry.geometryObjects, known_coverage(robot), strict=True)):
        if one is None:
            continue
        link = robot.link_of_geometry(index)
        in_link = robot.model.frames[robot.frame_id(link)].placement.inverse() * shape.placement
        balls = one.cover.spheres
        centers = balls[:, :3] @ in_link.rotation.T + in_link.translation
        by_link.setdefault(link, []).append(np.column_stack([centers, balls[:, 3]]))
    for link, parts in by_link.items():
        balls = np.concatenate(parts)
        drawn = rr.Points3D(balls[:, :3], radii=balls[:, 3], colors=[COLOR])
        yield still(entity("robot", "spheres", link), rr.CoordinateFrame(link_frame(link)), drawn)
