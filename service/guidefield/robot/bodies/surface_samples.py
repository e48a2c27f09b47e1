"""Points on a robot's links at which its distance to obstacles is taken: the denser the slimmer a link is."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.charges import surface_points
from guidefield.memo import memoized
from guidefield.robot.bodies.charges import robot_charges, surface, surface_areas
from guidefield.robot.model.model import RobotModel

SPACING = 0.036
"""Largest spacing of the points [m], at size 1."""

SPACING_OF_RADIUS = 0.3
"""Largest spacing as a share of the radius of the capsule about a shape: what is slim goes where it is narrow."""

SMALLEST_SPACING = 0.008
"""No finer than this [m], at size 1."""

MOST = 1500
"""About how many points a robot gets at most; beyond, all spacings grow alike."""

_POINTS_PER_SQUARE = 0.6
"""About how many points of a spacing there are on an area of its square."""


@memoized
def surface_samples(robot: RobotModel) -> tuple[np.ndarray, ...]:
    """Points of every collision shape, in the geometry's order, each (n, 3) in the shape's own frame [m].

    Computed once for each robot; read-only.
    """
    meshes = [surface(shape.geometry) for shape in robot.geometry.geometryObjects]
    spacings = np.array(
        [
            np.clip(SPACING_OF_RADIUS * charged.capsule.radius, SMALLEST_SPACING * robot.size, SPACING * robot.size)
            for charged in robot_charges(robot).shapes
        ]
    )
    squares = sum(area / spacing**2 for area, spacing in zip(surface_areas(robot), spacings, strict=True))
    spacings *= np.sqrt(max(1.0, _POINTS_PER_SQUARE * squares / MOST))
    return tuple(surface_points(*mesh, float(spacing)).points for mesh, spacing in zip(meshes, spacings, strict=True))
