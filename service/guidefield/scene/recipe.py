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

    Triangles (n, 3, 3) and flat convex quads (n, 4, 3); spheres: centre, radius; capsules: both ends of the axis,
    radius; planes: unit normal, offset; boxes: centre, unit axes, full sizes; cloud: points, the area that each stands
    for [m^2], its softening length.
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
