"""Contacts of held objects with links that the planned joints can't move against them.

Such a pair is the same at every configuration of the group: where it touches, every configuration is in collision.
"""

from __future__ import annotations

from typing import NamedTuple

import coal

from guidefield.collision.narrow_phase import NarrowPhase
from guidefield.collision.pairs import PairNames
from guidefield.robot.group.alike import kept_with_alike
from guidefield.robot.group.group import PlanningGroup


class HeldContact(NamedTuple):
    """A held object and a link, or another held object, that touch at every configuration of a group.

    Attributes:
        pair: Their names.
        depth: How far they must move apart to be free [m]; None where a body is a surface without an inside.
    """

    pair: PairNames
    depth: float | None


@kept_with_alike
def held_contacts(group: PlanningGroup) -> tuple[HeldContact, ...]:
    """The contacts of what a group's robot holds among the pairs that count and that the group can't move apart."""
    held = set(group.robot.held)
    if not held:
        return ()
    shapes = list(group.geometry.geometryObjects)
    links = [group.robot.link_of_geometry(index) for index in range(len(shapes))]
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
        if exact.penetration(first, second) is None:
            continue
        surfaces = any(isinstance(shapes[body].geometry, coal.BVHModelBase) for body in (first, second))
        depth = None if surfaces else max(0.0, -exact.distance(first, second).distance)
        found.append(HeldContact(names, depth))
    return tuple(found)
