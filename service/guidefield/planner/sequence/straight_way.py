"""The straight way of a tip from one pose to another: along a line, evenly turning about one axis."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

POINT = 1e-9
"""A way that is no longer than this is turned on the spot [m]."""


@dataclass(frozen=True, eq=False)
class StraightWay:
    """The way of a frame from one pose to another.

    Attributes:
        begin, end: Its placements at the ends, pinocchio.SE3 [m, world].
        line_tolerance: How far the frame's origin may be from the straight line between the two [m].
        turn_tolerance: How far the frame may be turned away from how the way has it there [rad].
    """

    frame: str
    begin: Any
    end: Any
    line_tolerance: float
    turn_tolerance: float

    @cached_property
    def shift(self) -> np.ndarray:
        """From one origin to the other, shape (3,) [m, world]."""
        shift: np.ndarray = self.end.translation - self.begin.translation
        return shift

    @cached_property
    def length(self) -> float:
        """[m]."""
        return float(np.linalg.norm(self.shift))

    @cached_property
    def is_point(self) -> bool:
        """True if the frame turns on the spot."""
        return self.length <= POINT

    @cached_property
    def direction(self) -> np.ndarray:
        """Of the line, shape (3,), of length 1; zero on the spot."""
        direction: np.ndarray = np.zeros(3) if self.is_point else self.shift / self.length
        return direction

    @cached_property
    def turn(self) -> np.ndarray:
        """Rotation vector from one orientation to the other in the world's axes, shape (3,) [rad]; at most pi long."""
        turn: np.ndarray = pin.log3(self.end.rotation @ self.begin.rotation.T)
        return turn

    @cached_property
    def angle(self) -> float:
        """By how much the frame turns [rad]."""
        return float(np.linalg.norm(self.turn))

    def at(self, share: float) -> Any:
        """Where the frame is at a share of the way, a pinocchio.SE3."""
        return pin.SE3(pin.exp3(share * self.turn) @ self.begin.rotation, self.begin.translation + share * self.shift)

    def share(self, placement: Any) -> float:
        """At which share of the way a placement (pinocchio.SE3) of the frame is: by its place; on the spot, as turned.

        Less than 0 before its beginning, more than 1 beyond its end.
        """
        if not self.is_point:
            return float(self.direction @ (placement.translation - self.begin.translation)) / self.length
        if self.angle <= POINT:
            return 0.0
        return float(self.turn @ pin.log3(placement.rotation @ self.begin.rotation.T)) / self.angle**2

    def aside(self, placement: Any) -> np.ndarray:
        """From the line's nearest point to the origin of a placement (pinocchio.SE3), shape (3,) [m]."""
        away: np.ndarray = placement.translation - self.begin.translation
        aside: np.ndarray = away - self.direction * (self.direction @ away)
        return aside

    def turned(self, placement: Any) -> float:
        """How far a placement (pinocchio.SE3) is turned away from the way's at its share [rad]."""
        return float(np.linalg.norm(pin.log3(placement.rotation @ self.at(self.share(placement)).rotation.T)))
