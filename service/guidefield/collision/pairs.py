"""The pairs of bodies that must stay apart, numbered but never listed, and the allowed pairs that may touch.

The order (the robot's own pairs, then every moving body with every obstacle, but allowed pairs) numbers pairs for
planner, kernels (`PairTable`), prove/ and stream/ alike, which makes numbers itself; files name bodies instead.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from guidefield.collision.narrow_phase import NarrowPhase
from guidefield.collision.solids import Solid, is_around, solids_of_group
from guidefield.errors import UnknownObject
from guidefield.kernels.collide.near_pairs import PairTable
from guidefield.memo import memoized
from guidefield.read_only import ReadOnly
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.scene.scene import Scene


class Allowed(NamedTuple):
    """Allowed pairs, which may touch: pairs of links, each in both orders; of each link the obstacles' indices."""

    links: set[PairNames]
    obstacles: dict[str, list[int]]


def find_allowed(group: PlanningGroup, scene: Scene, allowed_collisions: Iterable[PairNames]) -> Allowed | None:
    """Resolve pairs of names of links or obstacles that may touch; None if there are none.

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
    """Find the contacts of held objects in pairs that count and that the group's joints can't move apart."""
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


PairNames = tuple[str, str]  # names of the bodies of a pair: a link, and a link or an obstacle


@dataclass(frozen=True, eq=False)
class Pairs(ReadOnly):
    """The robot's own pairs, then every body on a moving link with every obstacle, but those left out; by index."""

    own: np.ndarray  # bodies of the robot's own pairs, shape (n_self, 2), the lower index first
    links: int  # how many bodies are the robot's, which come before the obstacles
    moving: np.ndarray  # those of them that are tested against obstacles, ascending, shape (m,)
    obstacles: int  # how many obstacles there are
    left_out: np.ndarray  # allowed pairs, as row of `moving` * obstacles + obstacle; ascending, shape (k,)

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self.own) + len(self.moving) * self.obstacles - len(self.left_out)

    @cached_property
    def table(self) -> PairTable:
        """The pairs as kernels read them."""
        return PairTable(self.own, self.moving, self.left_out)

    @cached_property
    def n_self(self) -> int:
        """How many are the robot's own."""
        return len(self.own)

    def bodies(self, pairs: np.ndarray) -> np.ndarray:
        """Bodies (k, 2) of pairs (k,), the lower index first."""
        count, found = max(1, self.obstacles), np.empty((len(pairs), 2), np.int64)
        own = pairs < self.n_self
        found[own] = self.own[pairs[own]]
        mixed = pairs[~own] - self.n_self
        if len(self.left_out):
            mixed = mixed + np.searchsorted(self.left_out - np.arange(len(self.left_out)), mixed, side="right")
        found[~own, 0], found[~own, 1] = self.moving[mixed // count], self.links + mixed % count
        return found

    def mixed(self) -> tuple[np.ndarray, np.ndarray]:
        """The body and the obstacle of each pair with obstacles, each of shape (len - n_self,)."""
        pairs = np.arange(len(self.moving) * self.obstacles)
        if len(self.left_out):
            pairs = np.delete(pairs, self.left_out)
        rows, obstacles = np.divmod(pairs, max(1, self.obstacles))
        return self.moving[rows], obstacles

    def of(self, pair: int) -> tuple[int, int]:
        """Return the bodies of one pair; it takes less time than `bodies`."""
        if pair < self.n_self:
            return self._own[pair]
        mixed = pair - self.n_self
        if len(self.left_out):
            mixed += int(np.searchsorted(self.left_out - np.arange(len(self.left_out)), mixed, side="right"))
        row, obstacle = divmod(mixed, self.obstacles)
        return self._moving[row], self.links + obstacle

    @cached_property
    def _own(self) -> list[tuple[int, int]]:
        return [(first, second) for first, second in self.own.tolist()]

    @cached_property
    def _moving(self) -> list[int]:
        return [int(body) for body in self.moving]

    def with_obstacles(self, rows: np.ndarray, obstacles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tell which rows of `moving` and obstacles, both (k,), are pairs, and the indices of those that are."""
        mixed = rows * self.obstacles + obstacles
        if not len(self.left_out):
            return np.ones(len(mixed), bool), self.n_self + mixed
        place = np.searchsorted(self.left_out, mixed)
        are = self.left_out[np.minimum(place, len(self.left_out) - 1)] != mixed
        return are, self.n_self + mixed[are] - place[are]

    def bodies_left_out(self) -> np.ndarray:
        """Body and obstacle of each pair that is left out, shape (k, 2)."""
        if not len(self.left_out):
            return np.empty((0, 2), np.int64)
        row, obstacle = np.divmod(self.left_out, max(1, self.obstacles))
        return np.column_stack([self.moving[row], obstacle])

    def among(self, chosen: np.ndarray) -> Pairs:
        """The pairs among some of the obstacles, ascending, shape (k,)."""
        row, obstacle = np.divmod(self.left_out, max(1, self.obstacles))
        kept = np.isin(obstacle, chosen)
        left_out = row[kept] * len(chosen) + np.searchsorted(chosen, obstacle[kept])
        return Pairs(self.own, self.links, self.moving, len(chosen), left_out)

    def of_obstacles(self, chosen: np.ndarray) -> np.ndarray:
        """All pairs with some obstacles, shape (k,), in ascending order."""
        rows = np.repeat(np.arange(len(self.moving)), len(chosen))
        return np.sort(self.with_obstacles(rows, np.tile(chosen, len(self.moving)))[1])
