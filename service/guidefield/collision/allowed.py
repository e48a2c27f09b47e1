"""Pairs of names that may touch, as a world of a robot and obstacles knows them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from guidefield.collision.pairs import PairNames
from guidefield.errors import UnknownObject
from guidefield.memo import memoized
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.scene import Scene


class Allowed(NamedTuple):
    """What may touch.

    Attributes:
        links: Pairs of links, each in both orders.
        obstacles: By link the obstacles that it may touch, by their indices.
    """

    links: set[PairNames]
    obstacles: dict[str, list[int]]


def allowed_among(group: PlanningGroup, scene: Scene, allowed_collisions: Iterable[PairNames]) -> Allowed | None:
    """What may touch; None where nothing may.

    Args:
        group: The robot.
        scene: The obstacles.
        allowed_collisions: Pairs of names, of links or obstacles.

    Raises:
        UnknownObject: if a name is neither a link nor an obstacle; lists those there are.
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
    """Refuse names that nobody has."""
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
    """Where each obstacle stands, by its name."""
    return {one.name: index for index, one in enumerate(scene.obstacles)}
