"""A scene as it was when it was looked at: whether it still is so is known without a look at every number.

Obstacles are frozen, and numbers and tuples of them can't change. What can are lists: of these the references are kept,
and where they are the same nothing has changed.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from guidefield.messages.scene import Box, Capsule, Cylinder, HalfSpace, ObstacleTrajectory, Scene, Sphere
from guidefield.messages.triples import TOGETHER
from guidefield.messages.values import Float32Array, Look, Uint32Array, never

LOOKED_AT = 64
"""At so many places it is looked whether two lists hold the same objects."""


class SeenScene:
    """What a scene held.

    Args:
        scene: The scene.
        look: Called again and again while a large one is looked at.

    Raises:
        TypeError: if it holds anything that may change unnoticed, such as an array or a list within a list.
    """

    def __init__(self, scene: Scene, look: Look = never) -> None:
        self._fixed = scene.name, scene.schema, scene.frame
        self._bodies = [*scene.obstacles, *scene.guide_planes]
        self._obstacles = len(scene.obstacles)
        self._lists: dict[int, list[list[Any]]] = {}
        for index, body in enumerate(self._bodies):
            if index % TOGETHER == 0:
                look()
            try:
                hash(body)
            except TypeError:
                self._lists[index] = [list(one) for one in _lists_of(body)]
        for lists in self._lists.values():
            for one in lists:
                for begin in range(0, len(one), TOGETHER):
                    hash(tuple(one[begin : begin + TOGETHER]))
                    look()

    def is_like(self, scene: Scene, look: Look = never) -> bool:
        """Whether a scene holds the same; what isn't the same object is compared number by number.

        Args:
            scene: The scene.
            look: Called again and again while a large one is compared.
        """
        if self._fixed != (scene.name, scene.schema, scene.frame) or self._obstacles != len(scene.obstacles):
            return False
        bodies = [*scene.obstacles, *scene.guide_planes]
        if len(bodies) != len(self._bodies):
            return False
        try:
            for begin in range(0, len(bodies), TOGETHER):
                look()
                end = begin + TOGETHER
                if not self._lists:  # the same objects are told so in nanoseconds
                    if bodies[begin:end] != self._bodies[begin:end]:
                        return False
                elif not all(
                    self._is_like(index, bodies[index], look) for index in range(begin, min(end, len(bodies)))
                ):
                    return False
        except (TypeError, ValueError):  # there are arrays in it, which can't be compared so
            return False
        return True

    def _is_like(self, index: int, one: Any, look: Look) -> bool:
        """Whether an obstacle or guide plane is that with this index."""
        known = self._bodies[index]
        if index not in self._lists:
            return one is known or bool(one == known)
        return (one is known or _rest_of(one) == _rest_of(known)) and self._has_lists(index, one, look)

    def _has_lists(self, index: int, body: Any, look: Look) -> bool:
        """Whether the lists of an obstacle or guide plane hold what those did of the one with this index."""
        seen, lists = self._lists[index], _lists_of(body)
        if [*map(len, seen)] != [*map(len, lists)]:
            return False
        return all(_are_equal(one, known, look) for one, known in zip(lists, seen, strict=True))


def _are_equal(one: list[Any], other: list[Any], look: Look) -> bool:
    """Whether lists of the same length are equal.

    Those of the same objects are compared at one go, in a nanosecond for each; of others parts are, which have to be
    made.
    """
    if _are_same_objects(one, other):
        return one == other
    for begin in range(0, len(one), TOGETHER):
        look()
        if one[begin : begin + TOGETHER] != other[begin : begin + TOGETHER]:
            return False
    return True


def _are_same_objects(one: list[Any], other: list[Any]) -> bool:
    """Whether lists of the same length likely hold the same objects, not others that are equal."""
    return all(one[k] is other[k] for k in range(0, len(one), max(1, len(one) // LOOKED_AT)))


def parts_of(scene: Scene) -> int:
    """How many obstacles and guide planes a scene holds, with the corners, triangles and points of each."""
    bodies = [*scene.obstacles, *scene.guide_planes]
    many = (body for body in bodies if type(body) not in _SINGLE)
    return len(bodies) + sum(_count(getattr(body, field, None)) for body in many for field in _MANY)


_MANY = "vertices", "triangles", "points"

_SINGLE = {Box, Sphere, Cylinder, Capsule, HalfSpace}
"""Kinds of obstacles that have none of these."""


def _count(declared: Any) -> int:
    """How many points or triangles are declared, as a list or packed."""
    if isinstance(declared, Float32Array):
        return len(declared.float32) // 12
    if isinstance(declared, Uint32Array):
        return len(declared.uint32) // 12
    return len(declared) if isinstance(declared, list) else 0


def _rest_of(body: Any) -> tuple[Any, ...]:
    """The kind of an obstacle or guide plane, and what it declares otherwise than as a list."""
    return type(body), *(pair for pair in _fields_of(body) if not isinstance(pair[1], list))


def _lists_of(body: Any) -> list[list[Any]]:
    """The lists of an obstacle or guide plane, themselves.

    Raises:
        TypeError: if another field than a list may change.
    """
    values = [value for _, value in _fields_of(body)]
    for value in values:
        if not isinstance(value, list):
            hash(value)
    return [value for value in values if isinstance(value, list)]


def _fields_of(body: Any) -> Iterator[tuple[str, Any]]:
    """The fields of an obstacle or guide plane; those of its trajectory in the place of that."""
    for field in type(body).__struct_fields__:
        value = getattr(body, field)
        if isinstance(value, ObstacleTrajectory):
            yield from _fields_of(value)
        else:
            yield field, value
