"""Placements of bodies as Coal's transforms, each made on first use."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import coal
import numpy as np


class CoalTransforms:
    """Transforms of a world's bodies; those of the robot's follow an array (r, 3, 4) [m] in which others write.

    `still` tells where one of the other bodies stands, by its index, a pinocchio.SE3.
    """

    def __init__(self, robot: np.ndarray, still: Callable[[int], Any]) -> None:
        self._rotations, self._translations, self._still = robot[:, :, :3], robot[:, :, 3], still
        self._made = [coal.Transform3s() for _ in robot]
        self._written, self._now = [-1] * len(robot), 0
        self._known: dict[int, Any] = {}
        self._moved: dict[int, Any] = {}

    def forget(self) -> None:
        """The robot's bodies stand elsewhere; those that were moved stand where they did."""
        self._now += 1
        if self._moved:
            self._moved.clear()

    def move(self, body: int, placement: Any) -> None:
        """Put one of the other bodies elsewhere, at a pinocchio.SE3, until `forget`."""
        self._moved[body] = transform(placement)

    def of(self, body: int) -> Any:
        """Where a body stands, a coal.Transform3s: of the robot's until `forget`, no longer."""
        if body < len(self._made):
            made = self._made[body]
            if self._written[body] != self._now:
                made.setTransform(self._rotations[body], self._translations[body])
                self._written[body] = self._now
            return made
        if body in self._moved:
            return self._moved[body]
        if body not in self._known:
            self._known[body] = transform(self._still(body))
        return self._known[body]


def transform(placement: Any) -> Any:
    """A placement (pinocchio.SE3) as Coal takes it."""
    return coal.Transform3s(np.array(placement.rotation), np.array(placement.translation))
