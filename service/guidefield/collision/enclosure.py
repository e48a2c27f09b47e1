"""Find bodies wholly inside a closed mesh: they touch nothing, because Coal judges such a mesh as a surface.

Planner, certificate and distances count them as contacts. It is enough to look at a motion's start, because a motion
without contact leads neither in nor out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from guidefield.collision.pairs import PairNames
from guidefield.collision.solids import Solid, is_around, solid_of_obstacle, solids_of_group
from guidefield.collision.world import World
from guidefield.memo import MISSING, Answers
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.model.spaces import ModelConfiguration


def enclosed(world: World, q: ModelConfiguration) -> PairNames | None:
    """Return the names of the first pair with one body wholly inside the other's closed mesh; None if there is none.

    Without contact a connected body is inside with all of its points or with none, so one point of each connected piece
    tells. A body that touches may be reported too: it is partly inside. A motion without contact can't change the
    answer: it is asked for once, at the start. The configuration is the model's, shape (model.nq,).
    """
    answer = _ENCLOSURES.of(world, key := q.tobytes())  # starts are asked about again and again
    return _ENCLOSURES.keep(world, key, _find_enclosed_each(world, [q])[0]) if answer is MISSING else answer


_ENCLOSURES = Answers[PairNames | None]()


def find_enclosed_each(world: World, qs: Sequence[ModelConfiguration]) -> list[PairNames | None]:
    """Return `enclosed` at each of some configurations, together in less time; the robot is left anywhere."""
    return [enclosed(world, q) for q in qs] if len(qs) == 1 else _find_enclosed_each(world, qs)


def find_enclosed_pairs(world: World, qs: Sequence[ModelConfiguration], since: int = 0) -> Iterator[list[int]]:
    """Yield for each configuration all pairs with one body wholly inside the other's closed mesh, as `enclosed`.

    Pairs are given by ascending indices, from `since` on, and searched for when they are asked for.
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
    for q, pairs in zip(qs, world.near_each(qs, closed), strict=True):
        world.place(q)
        yield (pair for pair in pairs if pair >= since and _is_one_around_the_other(world, *world.pairs.of(pair)))


def _is_one_around_the_other(world: World, first: int, second: int) -> bool:
    return _is_around(world, first, second) or _is_around(world, second, first)


def _is_around(world: World, outer: int, inner: int) -> bool:
    """Check whether a body, where it stands now, is a closed mesh around another, or around a point of a cloud."""
    if not world.is_surface(outer) or not (solid := _solid_of(world, outer)).surfaces:
        return False
    cloud = None if inner < world.pairs.links else world.scene.obstacles[inner - world.pairs.links].cloud
    if cloud is not None:
        return _is_around_a_point(world, outer, solid, cloud.points)
    return is_around(solid, _solid_of(world, inner), world.placement(outer), world.placement(inner))


def _is_around_a_point(world: World, outer: int, solid: Solid, points: np.ndarray) -> bool:
    there = world.placement(outer)
    low, high = solid.boxes[:, 0].min(axis=0), solid.boxes[:, 1].max(axis=0)
    middle, reach, near = there.act(0.5 * (low + high)), 0.5 * float(np.linalg.norm(high - low)), points
    for axis in range(3):  # one after another: few are left after the first
        near = near[np.abs(near[:, axis] - middle[axis]) < reach]
    return solid.contains_any((near - there.translation) @ there.rotation)


def _solid_of(world: World, body: int) -> Solid:
    if body >= world.pairs.links:
        return solid_of_obstacle(world.scene.obstacles[body - world.pairs.links])
    return solids_of_group(world.group)[body]


@memoized_for_alike
def find_closed_bodies(group: PlanningGroup) -> np.ndarray:
    """Return which of a group's bodies are closed meshes that Coal judges as surfaces, (r,): no other is around any."""
    return np.array([bool(solid.surfaces) for solid in solids_of_group(group)], bool)
