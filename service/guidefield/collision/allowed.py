"""Pairs of bodies that may touch: those of the request, and held objects at their links."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import coal
import pinocchio as pin

from guidefield.collision.narrow_phase import NarrowPhase
from guidefield.collision.pairs import PairNames
from guidefield.collision.solids import Solid, is_around, solids_of_group
from guidefield.errors import UnknownObject
from guidefield.memo import memoized
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.scene.scene import Scene


class Allowed(NamedTuple):
    """What may touch: pairs of links, each in both orders, and by link the obstacles, by their indices."""

    links: set[PairNames]
    obstacles: dict[str, list[int]]


def find_allowed(group: PlanningGroup, scene: Scene, allowed_collisions: Iterable[PairNames]) -> Allowed | None:
    """What may touch, by pairs of names of links or obstacles; None where nothing may.

    Raises UnknownObject if a name is neither a link nor an obstacle; lists those there are.
    """
    pairs = list(allowed_collisions)
    if not pairs:
        return None
    links, known = set(group.robot.links), _indices(scene)
    found = Allowed(set(), {})
    for index, pair in enumerate(pairs):
        first, second = pair if pair[1] in known else pair[::-1]
        if first in links and second in known:
            found.obstacles.setdefault(first, []).append(known[second])
        elif first in links and second in links:
            found.links.update(((first, second), (second, first)))
        else:
            _require_known(group, scene, index, pair)
    return found


def _require_known(group: PlanningGroup, scene: Scene, index: int, pair: PairNames) -> None:
    for name in pair:
        if name not in group.robot.links and name not in scene.names:
            obstacles = [obstacle.name for obstacle in scene.obstacles]
            raise UnknownObject(
                f"`allowed_collisions[{index}]` names {name!r}, which is neither a link nor an obstacle;"
                f" links: {', '.join(group.robot.links)}; obstacles: {', '.join(obstacles) or 'none'}",
                object=name,
                links=list(group.robot.links),
                obstacles=obstacles,
            )


@memoized
def _indices(scene: Scene) -> dict[str, int]:
    return {one.name: index for index, one in enumerate(scene.obstacles)}


class HeldContact(NamedTuple):
    """A held object and a link, or another held object, in contact at every configuration of a group.

    One wholly inside the other's closed mesh is in contact with it. The depth is as of `Contact`.
    """

    pair: PairNames
    depth: float | None


@memoized_for_alike
def held_contacts(group: PlanningGroup) -> tuple[HeldContact, ...]:
    """The contacts of what a group's robot holds among the pairs that count and that the group can't move apart."""
    held = set(group.robot.held)
    if not held:
        return ()
    shapes = list(group.geometry.geometryObjects)
    links = [group.robot.link_of_geometry(index) for index in range(len(shapes))]
    solids = solids_of_group(group)
    exact = NarrowPhase(
        lambda body: shapes[body].geometry,
        lambda body: coal.Transform3s(shapes[body].placement.rotation, shapes[body].placement.translation),
    )
    found = []
    for pair in group.geometry.collisionPairs:
        first, second = sorted((pair.first, pair.second))
        names = links[first], links[second]
        if shapes[first].parentJoint != shapes[second].parentJoint or held.isdisjoint(names):
            continue
        placed = [(solids[body], shapes[body].placement) for body in (first, second)]
        if exact.penetration(first, second) is None and not _is_one_around_the_other(*placed):
            continue
        surfaces = any(isinstance(shapes[body].geometry, coal.BVHModelBase) for body in (first, second))
        depth = None if surfaces else max(0.0, -exact.distance(first, second).distance)
        found.append(HeldContact(names, depth))
    return tuple(found)


def _is_one_around_the_other(first: tuple[Solid, pin.SE3], second: tuple[Solid, pin.SE3]) -> bool:
    (a, there), (b, at) = first, second
    return is_around(a, b, there, at) or is_around(b, a, at, there)
