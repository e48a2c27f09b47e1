"""The polygon of a guide plane, inset: the tip heads for it, and guards say where it may be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from guidefield.kernels.field.field_tables import frozen
from guidefield.kernels.guide.tip_constraint import TipGuard, closest_point
from guidefield.scene.guide_plane import SLACK, GuidePlane

ANYWHERE = TipGuard(
    origin=frozen(np.zeros(3)),
    axes=frozen(np.eye(2, 3)),
    inward=frozen(np.eye(2)),
    offsets=frozen(np.zeros(2)),
    corners=frozen(np.zeros((1, 2))),
    inset=0.0,
    farthest=np.inf,
    depth=-np.inf,
)
"""A guard that lets the tip be anywhere."""


@dataclass(frozen=True, eq=False)
class Aim:
    """A guide plane's polygon, inset.

    Attributes:
        inset: How far inside its edges the tip heads for [m].
    """

    plane: GuidePlane
    inset: float

    def closest_point(self, point: np.ndarray) -> np.ndarray:
        """The point (3,) of the inset polygon that is closest to a point (3,) [m, world]."""
        closest = np.empty(3)
        closest_point(self.table, point, closest)
        return closest

    def distance(self, point: np.ndarray) -> float:
        """Distance of a point (3,) to the inset polygon [m]."""
        return math.dist(point, self.closest_point(point))

    def within(self, farthest: float) -> TipGuard:
        """A guard: the tip may not be farther from the inset polygon than this [m]."""
        return self.table._replace(farthest=farthest)

    def inside(self, depth: float) -> TipGuard:
        """A guard: the tip's foot may not come nearer to the polygon's edges than this [m], whatever its height."""
        return self.table._replace(depth=min(depth, self.plane.inradius) - SLACK * self.plane.flat.size)

    @cached_property
    def table(self) -> TipGuard:
        """The polygon for the kernels: a guard that lets the tip be anywhere."""
        flat, inset = self.plane.flat, min(self.inset, self.plane.inradius)
        return TipGuard(
            origin=frozen(flat.origin),
            axes=frozen(flat.axes),
            inward=frozen(self.plane.inward),
            offsets=frozen(self.plane.offsets),
            corners=frozen((self.plane.inset_vertices(inset) - flat.origin) @ flat.axes.T),
            inset=inset,
            farthest=np.inf,
            depth=-np.inf,
        )
