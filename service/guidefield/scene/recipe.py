"""The recipe of an obstacle: functions that make its parts from its declaration, on demand, such as its charges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from guidefield.scene.facets import Facets


@dataclass(frozen=True, eq=False)
class Charges:
    """The charges of an obstacle, in rows, in the world [m].

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


class Recipe(NamedTuple):
    """The makers of an obstacle's parts.

    Attributes:
        body: Of its message: Coal geometry in its own frame, and ``T_world_shape``, a pinocchio.SE3.
        surface: Of its message: a triangulation in its own frame, vertices (v, 3) [m] and triangles (t, 3).
        charged: Of its message and ``T_world_shape``: its share of the field.
        solid: True if it has an inside; else it is a thin surface.
        convex: True if Coal judges it as one convex body: distances are signed then.
        facets: The triangles that Coal judges; None for a convex body.
        placement: ``T_world_shape``, if it is known before the body is made.
        extent: Largest extent along an axis of its own frame [m], if it is declared by points.
        content: Hash of the geometry of a large mesh or cloud, whose results are kept on disk; else empty.
    """

    body: Callable[[Any], tuple[Any, Any]]
    surface: Callable[[Any], tuple[np.ndarray, np.ndarray]]
    charged: Callable[[Any, Any], Charges]
    solid: bool = True
    convex: bool = True
    facets: Facets | None = None
    placement: Any | None = None
    extent: float | None = None
    content: bytes = b""
