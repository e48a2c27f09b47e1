"""Clearance: exact smallest distances of a robot to obstacles and to itself, and where they are."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.collision.world import World
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ModelConfiguration

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
    pin.updateGeometryPlacements(world.model, world.data, world.geometry, world.geometry_data, q)
    if world.hulls is not world.geometry:
        pin.updateGeometryPlacements(world.model, world.data, world.hulls, world.hull_margin_data)
    centres = world.bodies.centres_in_world(world.joint_placements)
    bounds = world.bodies.separations(centres, world.pairs, world.n_self)
    own = _closest(world, bounds[: world.n_self], 0)
    obstacle = _closest(world, bounds[world.n_self :], world.n_self)
    witness = None
    if obstacle is not None:
        witness = np.array([obstacle[2].getNearestPoint1(), obstacle[2].getNearestPoint2()])
        between = witness[0] - witness[1]
        witness[1] += between * (world.roundings[obstacle[1]] / max(float(np.linalg.norm(between)), 1e-12))
    return ClearanceAt(
        obstacle_distance=np.inf if obstacle is None else obstacle[0],
        obstacle_pair=None if obstacle is None else world.pair_names(obstacle[1]),
        witness=witness,
        self_distance=np.inf if own is None else own[0],
        self_pair=None if own is None else world.pair_names(own[1]),
    )


def _closest(world: World, bounds: np.ndarray, first_pair: int) -> tuple[float, int, Any] | None:
    """Distance, index and Coal's result of the closest of some pairs."""
    closest = None
    waiting = [(bound, index, world.hulls is world.geometry) for index, bound in enumerate(bounds.tolist())]
    heapq.heapify(waiting)
    while waiting and (closest is None or waiting[0][0] <= closest[0]):
        bound, index, last = heapq.heappop(waiting)
        pair = first_pair + index
        if world.hulled[pair] and not last:
            hulls_apart = pin.computeDistance(world.hulls, world.hull_margin_data, pair).min_distance
            apart = float(hulls_apart) - float(world.roundings[pair]) - HULL_ACCURACY
            heapq.heappush(waiting, (max(bound, apart), index, True))
            continue
        distance, result = world.distance(pair)
        if closest is None or distance < closest[0]:
            closest = (distance, pair, result)
    return closest
