"""Clearance and contact at many configurations: kernels find the closest pairs, and Coal measures those."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np

from guidefield.collision.clearance import ClearanceAt, clearance_at
from guidefield.collision.enclosure import enclosed_each
from guidefield.collision.world import World
from guidefield.kernels.prove.answers import NEARLY
from guidefield.kernels.prove.body_distance import SLACK
from guidefield.kernels.prove.closest import CANDIDATES, closest_pairs, first_contacts
from guidefield.kernels.prove.gjk_distance import ACCURACY
from guidefield.kernels.prove.tables import BezierCurve, MovingRobot
from guidefield.prove.tables import ROUNDED, body_pairs, is_served, resting_obstacles, robot_bodies
from guidefield.read_only import read_only
from guidefield.robot.model.spaces import ModelConfigurations

WITHIN = 2.0 * ROUNDED + SLACK + ACCURACY
"""A pair that kernels find farther than the closest one by more than this is farther [m]."""

MAX_PAIRS = 100_000
"""Above so many pairs configurations are measured one by one, among what is near them."""


class ClosestPairs:
    """Clearance and contact of a robot among obstacles at many configurations.

    Attributes:
        world: Robot and obstacles.
    """

    def __init__(self, world: World) -> None:
        self.world = world

    def clearances(self, configurations: ModelConfigurations) -> Iterator[ClearanceAt]:
        """Yield the clearance at each configuration (n, model.nq), as `clearance_at` has it."""
        if self._moving is None:
            yield from (clearance_at(self.world, q) for q in configurations)
            return
        count = len(configurations)
        distances, pairs = np.empty((count, 2)), np.empty((count, 2, CANDIDATES), np.int64)
        closest_pairs(self._moving, np.ascontiguousarray(configurations), WITHIN, distances, pairs)
        apart: np.ndarray = np.any(distances > 0.0, axis=1)  # where own bodies touch, obstacles' distance is told too
        alone: np.ndarray = np.any(pairs[:, :, 0] < -1, axis=1)
        enclosed = [pair is not None for pair in enclosed_each(self.world, [*configurations[apart]])]
        alone[np.flatnonzero(apart)[enclosed]] = True
        for q, alone_there, candidates in zip(configurations, alone.tolist(), pairs.tolist(), strict=True):
            yield clearance_at(self.world, q) if alone_there else self._measured(q, candidates)

    def free(self, configurations: ModelConfigurations, *, confirmed: bool = True) -> np.ndarray:
        """Return whether nothing touches, and nothing is wholly inside something else, at each configuration: (n,).

        Args:
            configurations: Shape (n, model.nq).
            confirmed: Whether Coal judges what kernels find closer than `NEARLY`; else that counts as contact.
        """
        world, count = self.world, len(configurations)
        if world.held_contacts:
            return np.zeros(count, bool)
        if self._moving is None:
            free = np.array([not touching for touching in world.in_collision_each([*configurations])])
        else:
            contacts = np.empty(count, np.int64)
            first_contacts(self._moving, np.ascontiguousarray(configurations), NEARLY, contacts)
            free = contacts < 0
            for index in np.flatnonzero(~free).tolist() if confirmed else ():
                world.place(configurations[index])
                free[index] = not world.touches(int(contacts[index])) and not world.in_collision(configurations[index])
        apart = np.flatnonzero(free)
        free[apart] = [pair is None for pair in enclosed_each(world, [*configurations[apart]])]
        return free

    @cached_property
    def _moving(self) -> MovingRobot | None:
        """The tables of the kernels; None where they don't know all bodies, or there are too many pairs."""
        if len(self.world.pairs) > MAX_PAIRS or not is_served(self.world):
            return None
        curve = BezierCurve(np.empty(0), np.empty((0, 0, 0)))
        read_only(*curve)
        return MovingRobot(robot_bodies(self.world), resting_obstacles(self.world), body_pairs(self.world), curve)

    def _measured(self, q: np.ndarray, candidates: list[list[int]]) -> ClearanceAt:
        """Coal's measure of the closest pairs at a configuration of the model, shape (model.nq,)."""
        world = self.world
        world.place(q)
        own, obstacle = (
            min((_measure(world, pair) for pair in kind if pair >= 0), key=lambda one: one[0], default=None)
            for kind in candidates
        )
        return ClearanceAt.of(world, own, obstacle)


def _measure(world: World, pair: int) -> tuple[float, int, Any]:
    """Distance [m], index and Coal's result of a pair."""
    distance, result = world.distance(pair)
    return distance, pair, result
