"""A robot among obstacles of which some move."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from guidefield.collision.world import World
from guidefield.read_only import ReadOnly
from guidefield.scene.movers import Movers, movers


@dataclass(frozen=True, eq=False)
class TimedWorld(ReadOnly):
    """A robot among obstacles of which some move.

    Attributes:
        resting: The robot among those that rest.
        moving: The robot among all, those that move where they are at first.
        pairs: Indices of `moving.pairs` that are of a robot body and an obstacle that moves, ascending, shape (n,).
        body_of: The robot body of each, shape (n,).
        mover_of: Which of `movers` each is of, shape (n,).
    """

    resting: World
    moving: World
    pairs: np.ndarray
    body_of: np.ndarray
    mover_of: np.ndarray

    @classmethod
    def of(cls, resting: World, moving: World) -> TimedWorld:
        """From the two worlds."""
        if not moving.scene.moves:
            none = np.empty(0, np.int64)
            return cls(resting, moving, none, none, none)
        indices = movers(moving.scene).indices
        pairs = moving.pairs.of_obstacles(indices)
        bodies, obstacles = moving.pairs.bodies(pairs).T
        return cls(resting, moving, pairs, bodies, np.searchsorted(indices, obstacles - moving.pairs.links))

    @cached_property
    def movers(self) -> Movers:
        """The obstacles that move, those without pairs too."""
        return movers(self.moving.scene)
