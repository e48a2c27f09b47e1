"""Contacts and clearance at configurations, and bodies wholly inside closed meshes, which Coal judges as surfaces.

Coal decides on exact shapes; balls, boxes and hulls only leave out pairs that can't be the closest, so they may be
coarser, never wrong: more of `BOX_MARGIN` is time, of `HULL_ACCURACY` too, but may name another of equally near pairs.
`FIRST_REACH`, above 0, is time alone. Names, order and depths of pairs are what users read in replies.

Planner, certificate and distances count bodies inside as contacts. It is enough to check a motion's start, because a
motion without contact leads neither in nor out.
"""

from __future__ import annotations

import heapq
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from guidefield.collision.narrow_phase import ClosestPoints
from guidefield.collision.pairs import PairNames
from guidefield.collision.solids import Solid, is_around, solid_of_obstacle, solids_of_group
from guidefield.collision.world import World
from guidefield.memo import MISSING, Answers
from guidefield.read_only import ReadOnly
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.model.joints import ModelConfiguration


def find_enclosed_pair(world: World, q: ModelConfiguration) -> PairNames | None:
    """Return the names of the first pair with one body wholly inside the other's closed mesh; None if there is none.

    Without contact a connected body is inside with all of its points or with none, so one point of each connected piece
    tells. A body that touches may be reported too: it is partly inside. A motion without contact can't change the
    answer: one query, at the start, is enough. The configuration is the model's, shape (model.nq,).
    """
    answer = _ENCLOSURES.of(world, key := q.tobytes())  # queries about starts repeat
    return _ENCLOSURES.keep(world, key, _find_enclosed_each(world, [q])[0]) if answer is MISSING else answer


_ENCLOSURES = Answers[PairNames | None]()


def find_enclosed_each(world: World, qs: Sequence[ModelConfiguration]) -> list[PairNames | None]:
    """Return `find_enclosed_pair` at each configuration, together in less time; the robot is left anywhere."""
    return [find_enclosed_pair(world, q) for q in qs] if len(qs) == 1 else _find_enclosed_each(world, qs)


def find_enclosed_pairs(world: World, qs: Sequence[ModelConfiguration], since: int = 0) -> Iterator[list[int]]:
    """Yield for each configuration all pairs with one body wholly inside the other's closed mesh.

    Pairs are given by ascending indices, from `since` on, and searched for lazily.
    """
    return map(list, _enclosures(world, qs, since))


def _find_enclosed_each(world: World, qs: Sequence[ModelConfiguration]) -> list[PairNames | None]:
    first = (next(pairs, None) for pairs in _enclosures(world, qs))
    return [None if pair is None else world.pair_names(pair) for pair in first]


def _enclosures(world: World, qs: Sequence[ModelConfiguration], since: int = 0) -> Iterator[Iterator[int]]:
    """Yield an iterator over the enclosed pairs from `since` on for each configuration; to be used up in order."""
    closed = find_closed_bodies(world.group)
    if not len(qs) or (world.scene.convex and not closed.any()):
        yield from (iter(()) for _ in qs)
        return
    links = solids_of_group(world.group)
    for q, pairs in zip(qs, world.near_each(qs, closed), strict=True):
        world.place(q)
        yield (pair for pair in pairs if pair >= since and _is_one_around_other(world, links, *world.pairs.of(pair)))


def _is_one_around_other(world: World, links: Sequence[Solid], first: int, second: int) -> bool:
    return _is_around(world, links, first, second) or _is_around(world, links, second, first)


def _is_around(world: World, links: Sequence[Solid], outer: int, inner: int) -> bool:
    """Check whether a body, where it stands now, is a closed mesh around another, or around a point of a cloud."""
    if not world.is_surface(outer) or not (solid := _solid_of(world, links, outer)).surfaces:
        return False
    cloud = None if inner < world.pairs.links else world.scene.obstacles[inner - world.pairs.links].cloud
    if cloud is not None:
        return _is_around_a_point(world, outer, solid, cloud.points)
    return is_around(solid, _solid_of(world, links, inner), world.placement(outer), world.placement(inner))


def _is_around_a_point(world: World, outer: int, solid: Solid, points: np.ndarray) -> bool:
    there = world.placement(outer)
    low, high = solid.boxes[:, 0].min(axis=0), solid.boxes[:, 1].max(axis=0)
    middle, reach, near = there.act(0.5 * (low + high)), 0.5 * float(np.linalg.norm(high - low)), points
    for axis in range(3):  # one after another: few are left after the first
        near = near[np.abs(near[:, axis] - middle[axis]) < reach]
    return solid.contains_any((near - there.translation) @ there.rotation)


def _solid_of(world: World, links: Sequence[Solid], body: int) -> Solid:
    if body >= world.pairs.links:
        return solid_of_obstacle(world.scene.obstacles[body - world.pairs.links])
    return links[body]


@memoized_for_alike
def find_closed_bodies(group: PlanningGroup) -> np.ndarray:
    """Return which of a group's bodies are closed meshes that Coal judges as surfaces, (r,): no other is around any."""
    return np.array([bool(solid.surfaces) for solid in solids_of_group(group)], bool)


@dataclass(frozen=True)
class Contact:
    """Names of a link and a link or obstacle that touch, and their depth.

    The depth is how far they must part to be free [m]; None if one counts as a surface.
    """

    pair: tuple[str, str]
    depth: float | None


def contacts_at(world: World, q: ModelConfiguration) -> list[Contact]:
    """Every pair that touches at a configuration of the model, shape (model.nq,), in the order of the world's pairs.

    What a held object touches wherever the planned joints are comes first.
    """
    return [*(Contact(*one) for one in world.held_contacts), *contacts_among(world, world.near(q))]


def contacts_among(world: World, pairs: list[int]) -> list[Contact]:
    """Return the contacts among some pairs where the robot is placed."""
    return [Contact(world.pair_names(pair), depth_of(world, pair)) for pair in pairs if world.touches(pair)]


def depth_of(world: World, pair: int) -> float | None:
    """Return the `Contact.depth` of a pair that touches where the robot is placed."""
    if not world.is_signed(pair):
        return None
    return max(0.0, -world.distance(pair)[0])


MOST_EXAMINED = 16  # configurations, 1 at least, by which refused goals have pairs and status: the commonest is known


@dataclass(frozen=True)
class BlockingPairs:
    """The number of examined configurations at which each pair touched, the most frequent first."""

    looked_at: int
    counts: dict[PairNames, int]
    deepest: float | None  # the greatest depth of the first pair [m]; None where it has none
    # the greatest distance of a configuration from the obstacles [m], if one was to be kept
    clearest: float | None = None

    def describe(self) -> str:
        """Say in words which pair touches most often; empty if none does."""
        if not self.counts:
            return ""
        (first, second), count = next(iter(self.counts.items()))
        more = len(self.counts) - 1
        others = f" (and {more} more pair{'s' if more > 1 else ''})" if more else ""
        often = "" if self.looked_at == 1 else "most often "
        times = "" if self.looked_at == 1 else f", {count} of {self.looked_at} times"
        kept = "" if self.clearest is None else f"; the most that one keeps is {1000.0 * self.clearest:.1f} mm"
        return f"{often}{first} and {second}{times}{others}{kept}"

    def details(self) -> dict[str, object]:
        """Return the same as values for an error's details."""
        if not self.counts:
            return {}
        details: dict[str, object] = {
            "pair": list(next(iter(self.counts))),
            "depth": self.deepest,
            "pairs": [list(pair) for pair in self.counts],
            "counts": list(self.counts.values()),
            "looked_at": self.looked_at,
        }
        return details if self.clearest is None else {**details, "clearance": self.clearest}


class Touching(NamedTuple):
    """Where the robot's bodies stand at a configuration (r, 3, 4) [m], and the pairs that touch."""

    bodies: np.ndarray
    pairs: list[int]


def find_touching_each(world: World, qs: Sequence[ModelConfiguration]) -> tuple[list[Touching], list[bool]]:
    """Find what touches at the configurations that `blocking_pairs` examines, and at which of all something does."""
    near, looked_at = world.near_each(qs), len(qs[:MOST_EXAMINED])
    met = _find_touching(world, qs[:looked_at], near)
    touches = [bool(one.pairs or world.held_contacts) for one in met]
    return met, touches + world.in_collision_each(qs[looked_at:], near[looked_at:])


def _find_touching(world: World, qs: Sequence[ModelConfiguration], near: Sequence[list[int]]) -> list[Touching]:
    found = []
    for q, pairs in zip(qs, near, strict=False):
        world.place(q)
        found.append(Touching(world.body_placements.copy(), [pair for pair in pairs if world.touches(pair)]))
    return found


def blocking_pairs(
    world: World, qs: Sequence[ModelConfiguration], clearance: float = 0.0, met: Sequence[Touching] | None = None
) -> BlockingPairs:
    """Count the pairs that touch, or of which one is wholly inside the other, at configurations of the group's model.

    Where nothing touches, the nearest pair counts that doesn't keep a clearance from obstacles [m]. `met` is what
    touches at the first `MOST_EXAMINED`, if `find_touching_each` has found it.
    """
    clearest: float | None = None
    counts: Counter[PairNames] = Counter()
    names: dict[int, PairNames] = {}
    touching: defaultdict[PairNames, list[tuple[np.ndarray, int]]] = defaultdict(list)
    looked_at = qs[:MOST_EXAMINED]
    for q, (there, pairs) in zip(
        looked_at, met or _find_touching(world, looked_at, world.near_each(looked_at)), strict=True
    ):
        names |= {pair: world.pair_names(pair) for pair in pairs if pair not in names}
        counts.update({names[pair] for pair in pairs} | {one.pair for one in world.held_contacts})
        for pair in pairs:
            touching[names[pair]].append((there, pair))
        if pairs or world.held_contacts:
            continue
        if (inside := find_enclosed_pair(world, q)) is not None:
            counts[inside] += 1
        elif clearance > 0.0 and (near := clearance_at(world, q)).obstacle_pair is not None:
            counts[near.obstacle_pair] += 1
            clearest = max(near.obstacle_distance, clearest or 0.0)
    ordered = dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))
    first = next(iter(ordered), ("", ""))
    held = {one.pair: one.depth for one in world.held_contacts}
    return BlockingPairs(len(looked_at), ordered, held.get(first) or _deepest(world, touching[first]), clearest)


def _deepest(world: World, touching: Sequence[tuple[np.ndarray, int]]) -> float | None:
    """Return the greatest depth of touching pairs, each with the bodies' placements (r, 3, 4) [m]; None if none has."""
    depths = []
    for placements, pair in touching:
        world.put_bodies(placements)
        depths.append(depth_of(world, pair))
    return max((depth for depth in depths if depth is not None), default=None)


FIRST_REACH = 0.1  # the search for obstacles begins within this distance of the robot, then doubles it [m], at size 1
DIRECTED = 1e-9  # closest points nearer to each other than this, above 0, tell no direction: no gradient [m]
HULL_ACCURACY = 1e-6  # how far off Coal's distance of two hulls may be [m]


BOX_MARGIN = 1e-9
"""Boxes about balls are wider by this times 1 m plus their distance from the origin, so that rounding loses none."""

_Closest = tuple[float, int, ClosestPoints]  # distance [m], index and closest points of a pair


@dataclass(frozen=True, eq=False)
class ClearanceAt(ReadOnly):
    """Smallest distances at one configuration: signed where both bodies are convex, else 0 in contact.

    A body wholly inside another's closed mesh is in contact with it. Each distance comes with the closest pair of
    names, link first, and its closest points (2, 3) [m, world]; `pairs` are the indices of the own pair and of that
    with an obstacle. Where there is no pair of a kind, its distance is infinite, names and points None, the index -1.
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
        """Build it from the closest pairs of both kinds, measured where the robot stands."""
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
    """Measure the smallest distances at a configuration of the group's model, shape (model.nq,).

    Coal measures pairs in the order of a lower bound of their distance, until no pair left can be closer. The bound is
    that of balls and boxes first; if a mesh is in the pair, then the distance of hulls, which takes less time.
    """
    inside = next(find_enclosed_pairs(world, [q]))
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
    """Return the gradient of a smallest distance by the group's velocities, shape (group.nv,) [m per rad or m].

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
    """Return the closest points of a pair's rounded bodies, the first body's first, shape (2, 3) [m, world]."""
    witness = np.array([closest.first, closest.second])
    if rounding := sum(map(world.rounding, world.pairs.of(pair))):
        between = witness[0] - witness[1]
        witness[1] += between * (rounding / max(float(np.linalg.norm(between)), 1e-12))
    return witness


def _closer(world: World, known: _Closest | None, pair: int) -> _Closest:
    """Return the closer of the known pair and one with a body wholly inside the other, whose distance is 0."""
    return known if known is not None and known[0] <= 0.0 else (0.0, pair, world.distance(pair)[1])


def _closest_obstacle(world: World, centres: np.ndarray) -> _Closest | None:
    """Find the closest pair of a placed robot with an obstacle, within an ever larger reach of its balls (r, 3)."""
    reach, count = FIRST_REACH * world.group.size, len(world.pairs) - world.pairs.n_self
    while True:
        pairs = _pairs_within(world, centres, reach)
        closest = _closest(world, centres, pairs)
        if len(pairs) == count or (closest is not None and closest[0] <= reach):
            return closest
        reach = 2.0 * reach if closest is None else closest[0]


def separations(world: World, centres: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Return lower bounds of the signed distances of pairs (m,), by one ball about each robot body, shape (m,) [m].

    `centres` are those of the balls, shape (r, 3) [m, world]. A ball that overlaps another, or a box from outside,
    bounds the depth too; a centre inside a box bounds nothing: minus infinity.
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
    """Find distance, index and closest points of the closest of some pairs (k,)."""
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
