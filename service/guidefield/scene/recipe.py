"""How an obstacle is made of its declaration, part by part: each when something asks for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from guidefield.scene.charges import Charges
from guidefield.scene.facets import Facets


class Recipe(NamedTuple):
    """How what belongs to an obstacle is made.

    Attributes:
        body: Of its message: Coal geometry in its own frame, and ``T_world_shape``, a pinocchio.SE3.
        surface: Of its message: a triangulation in its own frame, vertices (v, 3) [m] and triangles (t, 3).
        charged: Of its message and ``T_world_shape``: its share of the field.
        solid: Whether it has an inside; else it is a thin surface.
        convex: Whether Coal judges it as one convex body: distances are signed then.
        facets: The triangles that Coal judges, of what isn't convex; None of what is.
        placement: ``T_world_shape`` where it is known before the body is made.
        extent: Largest extent along an axis of its own frame [m] of what is declared by points.
        content: What the geometry of a large mesh or cloud is known by: what is found for it is kept on disk; else
            nothing.
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
