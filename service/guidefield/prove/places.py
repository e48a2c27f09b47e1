"""A robot placed at times of a motion, and how far apart its pairs are there: at least, and exactly where asked.

Every distance is known from below first, by balls and boxes, and comes closer in stages: balls about parts of bodies,
hulls, Coal's distance of the bodies themselves.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.collision.clearance import HULL_ACCURACY
from guidefield.collision.robot_ball import robot_ball
from guidefield.prove.curve import Curve
from guidefield.prove.timed_world import TimedWorld
from guidefield.robot.group.tangents import tangents
from guidefield.robot.model.spaces import ModelConfiguration, ModelConfigurations
from guidefield.scene.swept import MovingBall

BALLS, PARTS, HULLS, EXACT = range(4)
"""Stages of a distance: what it is known by."""

TOGETHER = 30_000
"""So many pairs are compared at once: some megabytes."""


@dataclass(frozen=True, eq=False)
class Places:
    """The robot at m times; of n pairs, r bodies and the movers of `Closing`.

    Attributes:
        times: Shape (m,) [s].
        configurations: Of the group's model, shape (m, model.nq).
        placements: ``T_world_joint``, shape (m, njoints, 3, 4) [m].
        reach: See `MotionBound.reach`, shape (m, r, nv of the model).
        speeds: See `Closing.speeds`, shape (m, movers) [m/s]; infinite where the rates jump.
        distances: Of each pair, at least, shape (m, n) [m]; written as more is known.
        stages: By what each is known, shape (m, n).
    """

    times: np.ndarray
    configurations: ModelConfigurations
    placements: np.ndarray
    reach: np.ndarray
    speeds: np.ndarray
    distances: np.ndarray
    stages: np.ndarray

    def rows(self, chosen: np.ndarray) -> Places:
        """Some of them (k,)."""
        return Places(*(array[chosen] for array in vars(self).values()))

    def with_more(self, more: Places) -> Places:
        """These, and others behind them."""
        return Places(
            *(np.concatenate(arrays) for arrays in zip(vars(self).values(), vars(more).values(), strict=True))
        )


@dataclass(frozen=True, eq=False)
class Surveyor:
    """Places a robot along a motion and measures.

    Like the world itself it answers one question at a time.

    Attributes:
        worlds: The robot among all obstacles, and which of them move.
        curve: The motion.
    """

    worlds: TimedWorld
    curve: Curve

    @cached_property
    def movers(self) -> np.ndarray:
        """Which mover of `Closing` each pair of the world has, shape (n,)."""
        world = self.worlds.moving
        n_self, bodies = world.pairs.n_self, len(world.bodies.radii)
        before_obstacles = world.pairs.bodies(np.arange(n_self, len(world.pairs)))[:, 0]
        return np.concatenate([bodies + np.arange(n_self), before_obstacles])

    def places(self, times: np.ndarray) -> Places:
        """The robot at times, shape (m,); every distance is known by balls and boxes."""
        world, group = self.worlds.moving, self.worlds.moving.group
        zs, rates = self.curve.at(times)
        qs = group.expand_each(zs)
        jacobians = np.empty((len(qs), 6, world.model.nv))
        placements, there = np.empty((len(qs), world.model.njoints, 3, 4)), world.joint_placements
        for row, q in enumerate(qs):
            jacobians[row] = pin.computeJointJacobians(world.model, world.data, q).reshape(6, -1)
            placements[row] = there
        centres = world.bodies.centres_in_world(placements)
        speeds = world.closing.speeds(jacobians, centres, tangents(group, zs, rates) @ group.expand_velocity.T)
        speeds[np.isin(times, self.curve.breaks)] = np.inf
        distances = self._by_balls(centres)
        self._among_what_moves(times, centres, distances)
        np.maximum(distances, self.never_below, out=distances)
        reach = world.motion_bound.reach(jacobians, centres)
        stages = np.full(distances.shape, BALLS, np.int8)
        return Places(times, qs, placements, reach, speeds, distances, stages)

    def come_closer(self, places: Places, rows: np.ndarray, pairs: np.ndarray) -> None:
        """Take some distances to their next stage; those that are exact stay.

        Args:
            places: The places.
            rows: Rows of them, shape (k,).
            pairs: A pair at each, shape (k,); no two entries are the same.
        """
        world, stage = self.worlds.moving, places.stages[rows, pairs]
        coarse, hulled = (stage == BALLS) & ~self._moves[pairs], self._hulled[pairs] & (stage < HULLS)
        if coarse.any():
            at, of = rows[coarse], pairs[coarse]
            apart = world.near_pairs.closer_separations(places.placements, at, of)
            places.distances[at, of] = np.maximum(places.distances[at, of], apart)
            places.stages[at, of] = PARTS
        by_hulls = hulled & ~coarse
        if by_hulls.any():
            at, of = rows[by_hulls], pairs[by_hulls]
            for row, pair in self._each(places, at, of):
                places.distances[row, pair] = max(
                    places.distances[row, pair], world.hull_distance(pair) - HULL_ACCURACY
                )
            places.stages[at, of] = HULLS
        exact = (stage < EXACT) & ~coarse & ~hulled
        if exact.any():
            at, of = rows[exact], pairs[exact]
            for row, pair in self._each(places, at, of):
                places.distances[row, pair], result = world.distance(pair)
                self._witnesses[float(places.times[row]), pair] = result.first, result.second
            places.stages[at, of] = EXACT

    def closest(self, places: Places, rows: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Which of some pairs is the closest one at each of some places, as exact as Coal tells.

        Args:
            places: The places.
            rows: Rows of them, all different, shape (k,).
            pairs: Indices of pairs, at least one, shape (p,).

        Returns:
            Index of the pair at each, shape (k,).
        """
        nearest, open_rows = np.empty(len(rows), int), np.arange(len(rows))
        while len(open_rows):
            nearest[open_rows] = pairs[np.argmin(places.distances[np.ix_(rows[open_rows], pairs)], axis=1)]
            asked = places.stages[rows[open_rows], nearest[open_rows]] < EXACT
            open_rows = open_rows[asked]
            self.come_closer(places, rows[open_rows], nearest[open_rows])
        return nearest

    def witness(self, time: float, pair: int) -> np.ndarray:
        """The closest points of a pair at a time [s], the link's first, shape (2, 3) [m, world].

        Args:
            time: Of a place where the distance of the pair is exact.
            pair: Index of the pair.
        """
        points = np.array(self._witnesses[time, pair])
        between = points[0] - points[1]
        world = self.worlds.moving
        rounding = sum(map(world.rounding, world.pairs.of(pair)))
        points[1] += between * (rounding / max(float(np.linalg.norm(between)), 1e-12))
        return points

    @cached_property
    def _witnesses(self) -> dict[tuple[float, int], tuple[np.ndarray, np.ndarray]]:
        """Coal's closest points, by time and pair, of all exact distances."""
        return {}

    def rates_of_obstacles(self, since: np.ndarray, until: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Largest speeds and accelerations of what moves between two times, both of shape (s, 1 + obstacles).

        The first column, of what rests, is 0. No obstacle's own times are between the two. Of a half-space the speed
        is that at which it passes where the robot is; no acceleration bounds how it does, which is told as infinite.

        Args:
            since: From when, shape (s,) [s].
            until: Until when, shape (s,) [s].
        """
        speeds, accelerations = (np.zeros((len(since), 1 + len(self._movers))) for _ in range(2))
        for column, (_, obstacle, ball) in enumerate(self._movers, 1):
            step = np.searchsorted(obstacle.motion.times, 0.5 * (since + until), side="right")
            if ball is None:
                fastest = obstacle.motion.passing(*self._about_robot)
                changing = np.full_like(fastest, np.inf)
            else:
                fastest, changing = obstacle.motion.rates(*ball)
            speeds[:, column], accelerations[:, column] = fastest[step], changing[step]
        return speeds, accelerations

    @cached_property
    def breaks(self) -> np.ndarray:
        """When a rate jumps, of the robot or of an obstacle, shape (b,) [s]."""
        return np.concatenate([self.curve.breaks, *(obstacle.motion.times for _, obstacle, _ in self._movers)])

    @cached_property
    def mover_of_pair(self) -> np.ndarray:
        """The column in `rates_of_obstacles` of each pair, shape (n,)."""
        pairs = self.worlds.moving.pairs
        columns = np.zeros(len(pairs), int)
        for column, (body, _, _) in enumerate(self._movers, 1):
            columns[pairs.of_obstacles(np.array([body - pairs.links]))] = column
        return columns

    @cached_property
    def never_below(self) -> np.ndarray:
        """What the distance of each pair never is below, shape (n,) [m]: 0 in contact where a body is a surface."""
        world = self.worlds.moving
        surfaces = np.array([world.is_surface(body) for body in range(world.pairs.links + world.pairs.obstacles)], bool)
        return np.where(surfaces[world.pairs.bodies(np.arange(len(world.pairs)))].any(axis=1), 0.0, -np.inf)

    @cached_property
    def _hulled(self) -> np.ndarray:
        """Whether a hull stands for a body of a pair, shape (n,)."""
        world = self.worlds.moving
        return np.array([world.is_hulled(pair) for pair in range(len(world.pairs))], bool)

    def _by_balls(self, centres: np.ndarray) -> np.ndarray:
        """Distances of all pairs by balls and boxes, shape (m, n) [m]; centres of shape (m, r, 3) [m, world]."""
        near = self.worlds.moving.near_pairs
        pairs = np.arange(len(near.pairs))
        found, few = np.empty((len(centres), len(pairs))), max(1, TOGETHER // max(1, len(pairs)))
        for k in range(0, len(centres), few):
            which = np.repeat(np.arange(k, min(k + few, len(centres))), len(pairs))
            apart = near.separations(centres, which, np.tile(pairs, len(which) // max(1, len(pairs))))
            found[k : k + few] = apart.reshape(found[k : k + few].shape)
        return found

    @cached_property
    def _moves(self) -> np.ndarray:
        """Whether the obstacle of a pair moves, shape (n,)."""
        return self.mover_of_pair > 0

    @cached_property
    def _about_robot(self) -> tuple[np.ndarray, float]:
        """A ball that the robot stays in along the motion; see `robot_ball`."""
        return robot_ball(self.worlds.moving, *self.curve.box)

    @cached_property
    def _movers(self) -> list[tuple[int, Any, MovingBall | None]]:
        """Body, obstacle and ball of each obstacle that moves; a half-space has none."""
        known, links = self.worlds.movers, self.worlds.moving.pairs.links
        return [
            (links + int(known.indices[k]), known.obstacles[k], known.balls[k])
            for k in np.unique(self.worlds.mover_of).tolist()
        ]

    def _among_what_moves(self, times: np.ndarray, centres: np.ndarray, distances: np.ndarray) -> None:
        """Write the distances of balls for pairs with obstacles that move: the world has these where they are first.

        Args:
            times: Shape (m,) [s].
            centres: Of the balls about the robot's bodies, shape (m, r, 3) [m, world].
            distances: Of all pairs, shape (m, n) [m]; written.
        """
        world = self.worlds.moving
        for column, (_, obstacle, ball) in enumerate(self._movers, 1):
            pairs = np.flatnonzero(self.mover_of_pair == column)
            if ball is None:
                distances[:, pairs] = -np.inf
                continue
            centre, radius = ball
            there = np.array([obstacle.motion.at(time).act(centre) for time in times])
            body = world.pairs.bodies(pairs)[:, 0]
            apart = np.linalg.norm(centres[:, body] - there[:, None], axis=2) - world.bodies.radii[body] - radius
            distances[:, pairs] = np.where(apart > 0.0, apart, -np.inf)

    def _each(self, places: Places, rows: np.ndarray, pairs: np.ndarray) -> Iterator[tuple[int, int]]:
        """Rows and pairs in the order of rows, the bodies placed as they are at each."""
        placed = -1
        order = np.argsort(rows, kind="stable")
        for row, pair in zip(rows[order].tolist(), pairs[order].tolist(), strict=True):
            if row != placed:
                self._place(places.configurations[row], float(places.times[row]))
                placed = row
            yield row, pair

    def place(self, time: float) -> None:
        """Put the robot and what moves where they are at a time [s]."""
        self._place(self.worlds.moving.group.expand_from_chart(self.curve.at(np.array([time]))[0][0]), time)

    def _place(self, q: ModelConfiguration, time: float) -> None:
        self.worlds.moving.place(q)
        for body, obstacle, _ in self._movers:
            self.worlds.moving.move(body, obstacle.placement_at(time))
