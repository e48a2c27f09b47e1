"""Clearance and contact at many configurations: kernels find the candidates for the closest pair, Coal measures those.

Distances are Coal's: the kernels' margins (`NEARLY` of kernels/prove/tables.py; `within`) must cover their error, or
pairs are missed. Above `MAX_PAIRS` pairs Coal also decides what is within `NEARLY`, unconfirmed or not, and of pairs
equally near, as all in contact may be, another may be named, with its points.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from guidefield.collision.clearance import (
    ClearanceAt,
    clearance_at,
    find_closed_bodies,
    find_enclosed_each,
    find_enclosed_pairs,
)
from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.kernels.collide.gjk import ACCURACY, SLACK
from guidefield.kernels.prove.samples import CANDIDATES, closest_pairs, first_contacts
from guidefield.kernels.prove.tables import NEARLY, BezierCurve, MovingRobot
from guidefield.prove.curve import Curve
from guidefield.prove.tables import index_of_pair, world_tables
from guidefield.read_only import read_only
from guidefield.robot.model.joints import ModelConfiguration, ModelConfigurations


def world_at(world: World, time: float) -> World:
    """Return the robot among the obstacles where they are at a time [s]; the world itself if none moves."""
    return World(world.group, world.scene.at(time), world.pairs) if world.scene.moves else world


def _find_enclosed_pairs_at(
    world: World, qs: Sequence[ModelConfiguration], times: Iterable[float], since: int = 0
) -> Iterator[list[int]]:
    if not world.scene.moves or (world.scene.convex and not find_closed_bodies(world.group).any()):
        return find_enclosed_pairs(world, qs, since)
    each = zip(qs, times, strict=True)
    return (next(find_enclosed_pairs(world_at(world, time), [q], since)) for q, time in each)


def enclosures_at(
    world: World, curve: Curve, times: np.ndarray, deadline: Deadline = UNLIMITED, since: int = 0
) -> list[list[int]]:
    """Return for each time (k,) [s] of a motion the pairs with one body wholly inside the other.

    Moving obstacles are where they are then. Pairs before the index `since` are left out.

    Raises:
        DeadlineExpired: if the deadline passed before all are found.
    """
    qs, found = [world.group.expand_from_local(z) for z in curve.at(times)], list[list[int]]()
    inside = _find_enclosed_pairs_at(world, qs, times.tolist(), since)
    while len(found) < len(qs):
        deadline.check("the motion was measured")
        found.append(next(inside))
    return found


MAX_PAIRS = 100_000  # above this many pairs configurations are measured one by one, among what is near them


class ClosestPairs:
    """Clearance and contact of a robot among obstacles at many configurations."""

    def __init__(self, world: World) -> None:
        self.world = world

    def clearances(
        self,
        configurations: ModelConfigurations,
        times: np.ndarray | None = None,
        *,
        is_open: bool = False,
        counts_own: bool = True,
    ) -> Iterator[ClearanceAt]:
        """Yield the clearance at each configuration (n, model.nq), as `clearance_at` has it, and its time (n,) [s].

        With `is_open` it is known that no body is inside another, and enclosures aren't searched for. Without
        `counts_own` distances of the robot from itself aren't measured.
        """
        in_time = times is not None and self.world.scene.moves
        clock = times if times is not None and in_time else np.zeros(len(configurations))
        moving = self._tables(in_time=in_time)
        if moving is None:
            for q, time in zip(configurations, clock.tolist(), strict=True):
                yield clearance_at(world_at(self.world, time) if in_time else self.world, q)
            return
        count = len(configurations)
        distances, pairs = np.empty((count, 2)), np.empty((count, 2, CANDIDATES), np.int64)
        within = 2.0 * world_tables(self.world, in_time=in_time).error + SLACK + ACCURACY
        closest_pairs(
            moving, np.ascontiguousarray(configurations), np.ascontiguousarray(clock), within, distances, pairs
        )
        if not counts_own:
            pairs[:, 0] = -1
        # where own bodies touch, obstacles' distance counts too
        apart = np.flatnonzero(np.any(distances > 0.0, axis=1) & (not is_open))
        alone: np.ndarray = np.any(pairs[:, :, 0] < -1, axis=1)
        query = [*configurations[apart]], clock[apart].tolist(), 0 if counts_own else self.world.pairs.n_self
        alone[apart[[len(inside) > 0 for inside in _find_enclosed_pairs_at(self.world, *query)]]] = True
        for q, time, alone_there, candidates in zip(
            configurations, clock.tolist(), alone.tolist(), pairs.tolist(), strict=True
        ):
            if alone_there:
                yield clearance_at(world_at(self.world, time) if in_time else self.world, q)
            else:
                yield self._measure_candidates(q, candidates, time if in_time else None)

    def free(self, configurations: ModelConfigurations, *, confirmed: bool = True) -> np.ndarray:
        """Return whether nothing touches or is wholly inside something else, at configurations (n, model.nq); (n,).

        Pairs that kernels find closer than `NEARLY` are decided by Coal; if not `confirmed`, they count as contact.
        """
        world, count = self.world, len(configurations)
        if world.held_contacts:
            return np.zeros(count, bool)
        moving = self._tables(in_time=False)
        if moving is None:
            free = np.array([not touching for touching in world.in_collision_each([*configurations])])
        else:
            contacts = np.empty(count, np.int64)
            first_contacts(moving, np.ascontiguousarray(configurations), NEARLY, contacts)
            free = contacts < 0
            for index in np.flatnonzero(~free).tolist() if confirmed else ():
                world.place(configurations[index])
                pair = index_of_pair(world, int(contacts[index]))
                free[index] = not world.touches(pair) and not world.in_collision(configurations[index])
        apart = np.flatnonzero(free)
        free[apart] = [pair is None for pair in find_enclosed_each(world, [*configurations[apart]])]
        return free

    def _tables(self, *, in_time: bool) -> MovingRobot | None:
        if len(self.world.pairs) > MAX_PAIRS:
            return None
        robot, obstacles, movers, pairs, _ = world_tables(self.world, in_time=in_time)
        return MovingRobot(robot, obstacles, movers, pairs, _NO_MOTION)

    def _measure_candidates(self, q: np.ndarray, candidates: list[list[int]], time: float | None) -> ClearanceAt:
        world = self.world
        world.place(q)
        own, obstacle = (
            min(
                (measure(world, index_of_pair(world, pair), time) for pair in kind if pair >= 0),
                key=lambda one: one[0],
                default=None,
            )
            for kind in candidates
        )
        return ClearanceAt.of(world, own, obstacle)


def measure(world: World, pair: int, time: float | None) -> tuple[float, int, Any]:
    """Return distance [m], index and Coal's result of a pair; a moving obstacle is where it is at a time [s]."""
    if time is not None:
        put_obstacle(world, pair, time)
    distance, result = world.distance(pair)
    return distance, pair, result


def put_obstacle(world: World, pair: int, time: float) -> None:
    """Put the obstacle of a pair where it is at a time [s], if it moves; the robot has been placed before."""
    other = world.pairs.of(pair)[1] - world.pairs.links
    if other >= 0 and world.scene.obstacles[other].motion is not None:
        world.move(other + world.pairs.links, world.scene.obstacles[other].placement_at(time))


_NO_MOTION = BezierCurve(np.empty(0), np.empty(0), np.empty((0, 0, 0)), np.empty((0, 0)))
read_only(*_NO_MOTION)
