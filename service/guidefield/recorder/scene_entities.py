"""The scene in a recording: obstacles in colours that can be told apart, guide planes as panes with their names."""

from __future__ import annotations

import colorsys
from collections.abc import Collection, Iterator, Sequence

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.messages import scene as messages
from guidefield.recorder import bodies, surface
from guidefield.recorder.chunks import entity, still
from guidefield.scene.obstacle import Obstacle

GOLDEN_ANGLE = 0.381966
"""Share of the colour circle between one obstacle's hue and the next: never close to those before it."""

FLOOR_COLOR = (118, 122, 130, 255)
PLANE_HUES = (0.52, 0.60)
PANE_ALPHA = 40
SEE_THROUGH_ALPHA = 70
"""Opacity of an obstacle that stands between the eye and the path, of 255."""


def obstacles(
    all_of_them: Sequence[Obstacle], see_through: Collection[str], at_fault: Collection[str]
) -> Iterator[Chunk]:
    """Every obstacle as a solid body.

    Args:
        all_of_them: The scene's obstacles.
        see_through: Names of those that hide the path from the first view.
        at_fault: Names of those that are in collision: they are red.
    """
    for number, obstacle in enumerate(all_of_them):
        red, green, blue, alpha = bodies.FAULT_COLOR if obstacle.name in at_fault else obstacle_color(obstacle, number)
        color = (red, green, blue, SEE_THROUGH_ALPHA if obstacle.name in see_through else alpha)
        drawn = surface.shaded(obstacle.vertices, obstacle.triangles)
        yield still(entity("obstacles", obstacle.name), bodies.mesh(drawn, color))


def obstacle_color(obstacle: Obstacle, number: int) -> tuple[int, int, int, int]:
    """Colour of the scene's obstacle of that number (RGBA): muted, and unlike its neighbours'."""
    if isinstance(obstacle.message, messages.HalfSpace):
        return FLOOR_COLOR
    lightness, saturation = (0.60, 0.30) if number % 2 else (0.70, 0.28)
    return _rgba((0.08 + GOLDEN_ANGLE * number) % 1.0, lightness, saturation, 255)


def guide_planes(planes: Sequence[messages.GuidePlane]) -> Iterator[Chunk]:
    """Guide planes as translucent panes with an outline and a name."""
    for number, plane in enumerate(planes):
        share = number / max(1, len(planes) - 1)
        hue = PLANE_HUES[0] + share * (PLANE_HUES[1] - PLANE_HUES[0])
        corners = np.array(plane.vertices, float)
        fan = np.array([[0, i, i + 1] for i in range(1, len(corners) - 1)])
        outline = np.vstack([corners, corners[:1]])
        path = entity("guide_planes", plane.name)
        yield still(f"{path}/pane", bodies.mesh(surface.shaded(corners, fan), _rgba(hue, 0.55, 0.9, PANE_ALPHA)))
        yield still(f"{path}/outline", rr.LineStrips3D([outline], colors=[_rgba(hue, 0.6, 0.95, 255)], radii=[0.0025]))
        corner = corners[number % len(corners)]  # not always the same one: planes often stand close behind one another
        label = rr.Points3D(
            [corner], labels=[plane.name], colors=[_rgba(hue, 0.78, 0.95, 255)], radii=[0.004], show_labels=True
        )
        yield still(f"{path}/name", label)


def _rgba(hue: float, lightness: float, saturation: float, alpha: int) -> tuple[int, int, int, int]:
    red, green, blue = (round(255 * part) for part in colorsys.hls_to_rgb(hue, lightness, saturation))
    return red, green, blue, alpha
