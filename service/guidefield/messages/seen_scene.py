"""A scene as it was when it was looked at: whether it still is so is known without a look at every number.

Obstacles are frozen, and numbers and tuples of them can't change. What can are lists: of these the references are kept,
and where they are the same nothing has changed.
"""

from __future__ import annotations

from typing import Any

from guidefield.messages.scene import Scene
from guidefield.messages.values import Float32Array, Uint32Array


class SeenScene:
    """What a scene held.

    Args:
        scene: The scene.

    Raises:
        TypeError: if it holds anything that may change unnoticed, such as an array or a list within a list.
    """

    def __init__(self, scene: Scene) -> None:
        self._fixed = scene.name, scene.schema, scene.frame
        self._bodies = [*scene.obstacles, *scene.guide_planes]
        self._obstacles = len(scene.obstacles)
        self._lists: dict[int, list[list[Any]]] = {}
        for index, body in enumerate(self._bodies):
            try:
                hash(body)
            except TypeError:
                self._lists[index] = [list(one) for one in _lists_of(body)]
        for lists in self._lists.values():
            for one in lists:
                hash(tuple(one))

    @property
    def parts(self) -> int:
        """How many obstacles it held, with the corners, triangles and points that they are declared by."""
        listed = sum(len(one) for lists in self._lists.values() for one in lists)
        return len(self._bodies) + listed + sum(map(_packed, self._bodies))

    def is_like(self, scene: Scene) -> bool:
        """Whether a scene holds the same; what isn't the same object is compared number by number."""
        if self._fixed != (scene.name, scene.schema, scene.frame) or self._obstacles != len(scene.obstacles):
            return False
        bodies = [*scene.obstacles, *scene.guide_planes]
        try:
            return bodies == self._bodies and all(
                lists == _lists_of(bodies[index]) for index, lists in self._lists.items()
            )
        except (TypeError, ValueError):  # there are arrays in it, which can't be compared so
            return False


def _packed(body: Any) -> int:
    """How many points and triangles of an obstacle are packed."""
    points = getattr(body, "points", None) or getattr(body, "vertices", None)
    triangles = getattr(body, "triangles", None)
    counted = len(points.float32) // 12 if isinstance(points, Float32Array) else 0
    return counted + (len(triangles.uint32) // 12 if isinstance(triangles, Uint32Array) else 0)


def _lists_of(body: Any) -> list[list[Any]]:
    """The lists of an obstacle or guide plane, themselves.

    Raises:
        TypeError: if another field than a list may change.
    """
    values = [getattr(body, field) for field in type(body).__struct_fields__]
    for value in values:
        if not isinstance(value, list):
            hash(value)
    return [value for value in values if isinstance(value, list)]
