"""Clearance: exact smallest distances of a robot to obstacles and to itself, and where they are."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import Any

import numpy as np

from guidefield.collision.world import World
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ModelConfiguration

FIRST_REACH = 0.1
"""Obstacles are looked for within this of the robot first, then within twice as much [m]."""

HULL_ACCURACY = 1e-6
"""How far off Coal's distance of two hulls may be [m]."""


@dataclass(frozen=True, eq=False)
class ClearanceAt(ReadOnly):
    """Smallest distances at one configuration: signed where both bodies are convex, else 0 in contact.

    Attributes:
        obstacle_distance: Of moving links to obstacles [m]; infinite without such a pair.
        obstacle_pair: The closest link and obstacle; None without such a pair.
        witness: Their closest points, link first, shape (2, 3) [m, world]; None without such a pair.
        self_distance: Of the robot to itself [m]; infinite without such a pair.
        self_pair: The closest two links; None without such a pair.
    """

    obstacle_distance: float
    obstacle_pair: tuple[str, str] | None
    witness: np.ndarray | None
    self_distance: float
    self_pair: tuple[str, str] | None


def clearance_at(world: World, q: ModelConfiguration) -> ClearanceAt:
    """Smallest distances at a configuration.

    Coal measures pairs in the order of a lower bound of their distance, until no pair left can be closer. The bound is
    that of balls and boxes about them first; where a mesh is in a pair, then the distance of hulls, sooner had.

    Args:
        world: Robot and obstacles.
        q: Configuration of the group's model, shape (model.nq,).
    """
    world.place(q)
    centres = world.bodies.centres_in_world(world.joint_placements)[None]
    own = _closest(world, centres, np.arange(world.pairs.n_self))
    obstacle = _closest_obstacle(world, centres)
    witness = None
    if obstacle is not None:
        witness = np.array([obstacle[2].getNearestPoint1(), obstacle[2].getNearestPoint2()])
        between = witness[0] - witness[1]
        rounding = sum(map(world.rounding, world.pairs.of(obstacle[1])))
        witness[1] += between * (rounding / max(float(np.linalg.norm(between)), 1e-12))
    return ClearanceAt(
        obstacle_distance=np.inf if obstacle is None else obstacle[0],
        obstacle_pair=None if obstacle is None else world.pair_names(obstacle[1]),
        witness=witness,
        self_distance=np.inf if own is None else own[0],
        self_pair=None if own is None else world.pair_names(own[1]),
    )


def _closest_obstacle(world: World, centres: np.ndarray) -> tuple[float, int, Any] | None:
    """Distance, index and Coal's result of the closest pair with an obstacle: looked for within ever more around.

    Args:
        world: Robot and obstacles; the robot is placed.
        centres: Of the balls about its bodies, shape (1, r, 3) [m, world].
    """
    reach, count = FIRST_REACH, len(world.pairs) - world.pairs.n_self
    while True:
        pairs = world.near_pairs.by_place(centres, np.full((1, world.pairs.links), reach))[1]
        closest = _closest(world, centres, pairs)
        if len(pairs) == count or (closest is not None and closest[0] <= reach):
            return closest
        reach = 2.0 * reach if closest is None else closest[0]


def _closest(world: World, centres: np.ndarray, pairs: np.ndarray) -> tuple[float, int, Any] | None:
    """Distance, index and Coal's result of the closest of some pairs (k,)."""
    closest = None
    bounds = world.near_pairs.separations(centres, np.zeros(len(pairs), int), pairs)
    waiting = [(bound, pair, False) for bound, pair in zip(bounds.tolist(), pairs.tolist(), strict=True)]
    heapq.heapify(waiting)
    while waiting and (closest is None or waiting[0][0] <= closest[0]):
        bound, pair, last = heapq.heappop(waiting)
        if not last and world.is_hulled(pair):
            heapq.heappush(waiting, (max(bound, world.hull_distance(pair) - HULL_ACCURACY), pair, True))
            continue
        distance, result = world.distance(pair)
        if closest is None or distance < closest[0]:
            closest = (distance, pair, result)
    return closest
