"""Contacts of held objects with links that the planned joints can't move against them.

Such a pair is the same at every configuration of the group: where it touches, every configuration is in collision.
"""

from __future__ import annotations

from typing import NamedTuple

import coal
import pinocchio as pin

from guidefield.collision.narrow_phase import NarrowPhase
from guidefield.collision.pairs import PairNames
from guidefield.collision.solids import Solid, is_around, solids_of_group
from guidefield.robot.group.alike import memoized_for_alike
from guidefield.robot.group.group import PlanningGroup


class HeldContact(NamedTuple):
    """A held object and a link, or another held object, in contact at every configuration of a group.

    One wholly inside the other's closed mesh is in contact with it.

    Attributes:
        pair: Their names.
        depth: How far they must move apart to be free [m]; None where a body is a surface without an inside.
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
