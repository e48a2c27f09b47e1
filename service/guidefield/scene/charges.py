"""What an obstacle contributes to the field."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, eq=False)
class Charges:
    """What an obstacle contributes to the field; rows, in the world [m].

    Attributes:
        triangles: Charged triangles, shape (n, 3, 3).
        spheres: Centre and radius, shape (n, 4).
        capsules: Both ends of the axis and the radius, shape (n, 7).
        planes: Unit normal and offset, shape (n, 4).
        quads: Flat convex quadrilaterals, shape (n, 4, 3).
        boxes: Centre, unit axes and full sizes, shape (n, 15).
        cloud: Points, the area that each stands for [m^2] and its softening length, shape (n, 5).
    """

    triangles: np.ndarray = field(default_factory=lambda: np.empty((0, 3, 3)))
    spheres: np.ndarray = field(default_factory=lambda: np.empty((0, 4)))
    capsules: np.ndarray = field(default_factory=lambda: np.empty((0, 7)))
    planes: np.ndarray = field(default_factory=lambda: np.empty((0, 4)))
    quads: np.ndarray = field(default_factory=lambda: np.empty((0, 4, 3)))
    boxes: np.ndarray = field(default_factory=lambda: np.empty((0, 15)))
    cloud: np.ndarray = field(default_factory=lambda: np.empty((0, 5)))
