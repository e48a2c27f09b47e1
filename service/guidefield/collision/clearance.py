"""Clearance: exact smallest distances of a robot to obstacles and to itself, and where they are."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from guidefield.collision.enclosure import find_enclosed_pairs
from guidefield.collision.penetration_depth import ClosestPoints
from guidefield.collision.world import World
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ModelConfiguration

FIRST_REACH = 0.1  # obstacles are looked for within this of the robot first, then within twice as much [m], at size 1
DIRECTED = 1e-9  # closest points nearer to each other than this tell no direction [m]
HULL_ACCURACY = 1e-6  # how far off Coal's distance of two hulls may be [m]


BOX_MARGIN = 1e-9
"""What boxes about balls are wider by, of a metre and of each metre that they are from the origin, for rounding [m]."""

_Closest = tuple[float, int, ClosestPoints]  # distance [m], index and closest points of a pair


@dataclass(frozen=True, eq=False)
class ClearanceAt(ReadOnly):
    """Smallest distances at one configuration: signed where both bodies are convex, else 0 in contact.

    A body wholly inside another's closed mesh is in contact with it. Without such a pair distances are infinite, the
    closest pair of names, link first, and its closest points (2, 3) [m, world] None, and indices in `pairs`, of the own
    pair and of that with an obstacle, -1.
    """

    obstacle_distance: float
    obstacle_pair: tuple[str, str] | None
    witness: np.ndarray | None
    self_distance: float
    self_pair: tuple[str, str] | None
    pairs: tuple[int, int]
    self_witness: np.ndarray | None

    @classmethod
    def of(cls, world: World, own: _Closest | None, obstacle: _Closest | None) -> ClearanceAt:
        """From the closest pairs of both kinds, measured where the robot stands."""
        return cls(
            obstacle_distance=np.inf if obstacle is None else obstacle[0],
            obstacle_pair=None if obstacle is None else world.pair_names(obstacle[1]),
            witness=None if obstacle is None else _witness(world, obstacle[1], obstacle[2]),
            self_distance=np.inf if own is None else own[0],
            self_pair=None if own is None else world.pair_names(own[1]),
            pairs=(-1 if own is None else own[1], -1 if obstacle is None else obstacle[1]),
            self_witness=None if own is None else _witness(world, own[1], own[2]),
        )


def clearance_at(world: World, q: ModelConfiguration) -> ClearanceAt:
    """Smallest distances at a configuration of the group's model, shape (model.nq,).

    Coal measures pairs in the order of a lower bound of their distance, until no pair left can be closer. The bound is
    that of balls and boxes about them first; where a mesh is in a pair, then the distance of hulls, sooner had.
    """
    inside = find_enclosed_pairs(world, q)
    world.place(q)
    centres = world.bodies.centres_in_world(world.joint_placements)
    own, obstacle = _closest(world, centres, np.arange(world.pairs.n_self)), _closest_obstacle(world, centres)
    for pair in inside:
        if pair < world.pairs.n_self:
            own = _closer(world, own, pair)
        else:
            obstacle = _closer(world, obstacle, pair)
    return ClearanceAt.of(world, own, obstacle)


def clearance_gradient(world: World, q: ModelConfiguration, one: ClearanceAt, *, own: bool) -> np.ndarray | None:
    """Gradient of a smallest distance at a configuration by the group's velocities, shape (group.nv,) [m per rad or m].

    The closest points move with their bodies, and the distance grows as they part along the line between them (the
    envelope theorem); so of distances without contact it is exact wherever the closest pair is a single one. `own` asks
    about the robot's distance to itself. None without such a pair, and where its bodies touch exactly, or one is a
    surface and they touch: no direction leads out then.
    """
    pair, witness = one.pairs[0 if own else 1], one.self_witness if own else one.witness
    distance = one.self_distance if own else one.obstacle_distance
    if pair < 0 or witness is None or abs(distance) < DIRECTED:
        return None
    normal = (witness[0] - witness[1]) / distance
    pin.computeJointJacobians(world.model, world.data, q)
    gradient = np.zeros(world.model.nv)
    for body, point, along in zip(world.pairs.of(pair), witness, (normal, -normal), strict=True):
        if body < world.pairs.links:
            joint = world.group.geometry.geometryObjects[body].parentJoint
            twist = pin.getJointJacobian(world.model, world.data, joint, pin.WORLD)
            gradient += along @ twist[:3] + np.cross(point, along) @ twist[3:]
    reduced: np.ndarray = gradient @ world.group.expand_velocity
    return reduced


def _witness(world: World, pair: int, closest: ClosestPoints) -> np.ndarray:
    """Closest points of a pair's bodies with what rounds them, the first body's first, shape (2, 3) [m, world]."""
    witness = np.array([closest.first, closest.second])
    if rounding := sum(map(world.rounding, world.pairs.of(pair))):
        between = witness[0] - witness[1]
        witness[1] += between * (rounding / max(float(np.linalg.norm(between)), 1e-12))
    return witness


def _closer(world: World, known: _Closest | None, pair: int) -> _Closest:
    """The closest pair, given one of which a body is wholly inside the other; its closest points are on the surface."""
    return known if known is not None and known[0] <= 0.0 else (0.0, pair, world.distance(pair)[1])


def _closest_obstacle(world: World, centres: np.ndarray) -> _Closest | None:
    """The closest pair of a placed robot with an obstacle, searched within ever more around its balls (r, 3)."""
    reach, count = FIRST_REACH * world.group.size, len(world.pairs) - world.pairs.n_self
    while True:
        pairs = _pairs_within(world, centres, reach)
        closest = _closest(world, centres, pairs)
        if len(pairs) == count or (closest is not None and closest[0] <= reach):
            return closest
        reach = 2.0 * reach if closest is None else closest[0]


def separations(world: World, centres: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Lower bounds of the signed distances of pairs (m,), by one ball about each of the robot's bodies, shape (m,) [m].

    Given the centres of the balls, shape (r, 3) [m, world]. A ball that overlaps another, or a box from outside, bounds
    the depth too; a centre inside a box bounds nothing: minus infinity.
    """
    first, second = world.pairs.bodies(pairs).T
    own, radii, found = pairs < world.pairs.n_self, world.bodies.radii, np.empty(len(pairs))
    a, b = first[own], second[own]
    between = centres[a] - centres[b]
    found[own] = np.sqrt(np.einsum("mi,mi->m", between, between)) - radii[a] - radii[b]
    body, obstacle = first[~own], second[~own] - world.pairs.links
    gaps = world.boxes.gaps(centres[body][:, None], obstacle)[:, 0]
    found[~own] = np.where(gaps > 0.0, gaps - radii[body], -np.inf)
    return found


def _pairs_within(world: World, centres: np.ndarray, margin: float) -> np.ndarray:
    """Find the pairs with obstacles whose boxes are within a margin of those about balls: no others are as near."""
    moving = world.pairs.moving
    middle = centres[moving]
    reach = (world.bodies.radii[moving] + margin)[:, None] + BOX_MARGIN * (1.0 + np.abs(middle))
    return world.pairs.with_obstacles(*world.boxes.overlapping(middle - reach, middle + reach))[1]


def _closest(world: World, centres: np.ndarray, pairs: np.ndarray) -> _Closest | None:
    """Distance, index and closest points of the closest of some pairs (k,)."""
    closest = None
    bounds = separations(world, centres, pairs)
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
