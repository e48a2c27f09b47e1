"""The certificate: Coal's judgement of a whole motion, between its samples too.

A motion is a chain of Bezier curves in the group's chart. A curve lies in the box of its control points. If Coal says
that at the box's middle a pair keeps more than it can lose within the box (`MotionBound`), it is free all along the
curve; else the curve is halved, for the pairs that are left, down to a floor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from guidefield.collision.bodies import joint_placements
from guidefield.collision.world import PairNames, World

COAL_ACCURACY = 1e-6
"""Added to every margin: how far off Coal's answers may be [m]."""

WIDEST = 0.3
"""Curves that span more in any coordinate are halved before they are tested [rad or m]: a test there rarely decides."""

TOGETHER = 0.1
"""Consecutive pieces are tested together as long as they span no more than this in any coordinate [rad or m]."""

MESH_FROM = 0.01
"""A mesh is asked, where its hull does not tell, once its pair's possible motion is down to this [m]."""

BATCH = 64
"""At most so many stretches have their bounds computed together."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """What the certificate says about a motion.

    Attributes:
        free: Whether no pair touches, and robot and obstacles keep the clearance asked for, all along the motion.
        reason: free; contact: a pair touches; too close: robot and obstacle come closer than the clearance asked for;
            undecided: a pair comes so close that the floor was reached; stopped: there was no time to tell.
        piece: Index of the piece that was refused; None if free.
        parameter: Where on it, from 0 to 1: the place that was judged; None if free.
        free_until: Parameter of that piece up to which the motion is certified, as all pieces before are; None if free.
        pair: Names of the pair that was refused; None if free, or where all pairs are left.
        configuration: Chart coordinates (nv,) of the place that was judged; None if free.
        evaluations: Configurations at which Coal was asked.
    """

    free: bool
    reason: str
    piece: int | None
    parameter: float | None
    free_until: float | None
    pair: PairNames | None
    configuration: np.ndarray | None
    evaluations: int


@dataclass(frozen=True, eq=False)
class _Stretch:
    """A part of a piece, or several pieces, not judged yet.

    Attributes:
        piece: Index of the piece, or of the first of them.
        controls: Control points, shape (m, k, nv).
        start, end: Parameters on a single piece; 0 and 1 for several.
        pairs: Pairs left; None: all.
    """

    piece: int
    controls: np.ndarray
    start: float
    end: float
    pairs: list[int] | None

    def halves(self, pairs: list[int] | None) -> tuple[_Stretch, _Stretch]:
        """The two halves, for some pairs."""
        count = len(self.controls) // 2
        if count:
            return (
                _Stretch(self.piece, self.controls[:count], 0.0, 1.0, pairs),
                _Stretch(self.piece + count, self.controls[count:], 0.0, 1.0, pairs),
            )
        first, second = halved(self.controls)
        middle = 0.5 * (self.start + self.end)
        return (
            _Stretch(self.piece, first[None], self.start, middle, pairs),
            _Stretch(self.piece, second[None], middle, self.end, pairs),
        )


def certify(
    world: World,
    pieces: np.ndarray,
    min_clearance: float = 0.0,
    floor: float = 1e-4,
    stopped: Callable[[], object] = lambda: None,
) -> Verdict:
    """Judge a motion.

    All parts are judged coarsely before any is judged finely; what comes after a refusal is not looked at any more, so
    that everything before the refusal that is told is certified. Whether the robot is wholly inside a closed mesh at
    the start is another question: `World.enclosed`.

    Args:
        world: The robot among obstacles.
        pieces: Bezier control points of each piece in the group's chart, shape (m, k, nv) [rad or m]; any degree k - 1.
        min_clearance: What robot and obstacles must keep apart [m]; the robot and itself must only not touch.
        floor: A pair whose possible motion [m] is down to this and which still can't be told apart is undecided.
        stopped: Asked now and then; anything true ends the judgement.
    """
    judge = _Judge(world, min_clearance, floor)
    refusal = None
    level = list(_stretches(np.asarray(pieces, float)))
    while level:
        finer: list[_Stretch] = []
        for first in range(0, len(level), BATCH):
            if stopped():
                return _unfinished(world, min([*finer, level[first]], key=_place), judge.evaluations)
            halves, found = judge.halved(level[first : first + BATCH])
            finer += halves
            if found is not None:
                refusal = found
                break
        level = finer
    if refusal is not None:
        return replace(refusal, evaluations=judge.evaluations)
    return Verdict(True, "free", None, None, None, None, None, judge.evaluations)


def motion_free(
    world: World, z0: np.ndarray, z1: np.ndarray, min_clearance: float = 0.0, floor: float = 1e-4
) -> Verdict:
    """Judge the straight motion between two points, each of shape (nv,), of the group's chart; see `certify`."""
    return certify(world, np.array([[z0, z1]]), min_clearance, floor)


def _stretches(pieces: np.ndarray) -> Iterator[_Stretch]:
    """The pieces in order: short ones together, long ones halved until no coordinate spans more than `WIDEST`."""
    lows, highs = pieces.min(axis=1), pieces.max(axis=1)
    first = 0
    while first < len(pieces):
        low, high, last = lows[first], highs[first], first + 1
        while last < len(pieces):
            low, high = np.minimum(low, lows[last]), np.maximum(high, highs[last])
            if (high - low).max() > TOGETHER:
                break
            last += 1
        parts = pieces[first:last]
        if last > first + 1:
            yield _Stretch(first, parts, 0.0, 1.0, None)
        else:
            while (parts.max(axis=1) - parts.min(axis=1)).max() > WIDEST:
                parts = halved(parts)
            for number, part in enumerate(parts):
                yield _Stretch(first, part[None], number / len(parts), (number + 1) / len(parts), None)
        first = last


def _place(stretch: _Stretch) -> tuple[int, float]:
    """Where a stretch begins along the motion."""
    return stretch.piece, stretch.start


def _unfinished(world: World, first: _Stretch, evaluations: int) -> Verdict:
    """The verdict of a judgement that was stopped, the first stretch that is left in it."""
    pair = world.pair_names(first.pairs[0]) if first.pairs else None
    at = first.start
    return Verdict(False, "stopped", first.piece, at, at, pair, first.controls[0, 0], evaluations)


def halved(controls: np.ndarray) -> np.ndarray:
    """Both halves of each Bezier curve, in order, by de Casteljau's scheme.

    Args:
        controls: Control points, shape (n, k, nv).

    Returns:
        Shape (2 n, k, nv).
    """
    order = controls.shape[1]
    halves = np.empty((2 * len(controls), *controls.shape[1:]))
    row = controls
    for step in range(order):
        halves[0::2, step] = row[:, 0]
        halves[1::2, order - 1 - step] = row[:, -1]
        row = 0.5 * (row[:, :-1] + row[:, 1:])
    return halves


class _Judge:
    """One judgement: what is asked for, and how often Coal was asked."""

    def __init__(self, world: World, min_clearance: float, floor: float) -> None:
        self.world = world
        self.floor = floor
        self.evaluations = 0
        self._kept = np.where(world.is_obstacle_pair, min_clearance, 0.0)
        self._hulled = world.hulled.tolist()

    def halved(self, stretches: Sequence[_Stretch]) -> tuple[list[_Stretch], Verdict | None]:
        """Judge some stretches in order, up to the first that is refused.

        Returns:
            The halves of those that can't be told yet; why the last one that was looked at is refused, or None.
        """
        qs, centres, bounds = self._measure(stretches)
        finer: list[_Stretch] = []
        for stretch, *at_middle in zip(stretches, qs, centres, bounds, strict=True):
            left = self._left(stretch, *at_middle)
            if not left:
                continue
            halves = stretch.halves(left if 2 * len(left) < len(self._kept) else None)
            refusal = self._refusal_at(halves[1], stretch.start, left, at_middle[-1])
            if refusal is not None:
                return finer, refusal
            finer += halves
        return finer, None

    def _measure(self, stretches: Sequence[_Stretch]) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
        """At each stretch's middle: configuration, centres (s, r, 3) of balls, bounds (s, n) within the box."""
        world, group = self.world, self.world.group
        low = np.array([stretch.controls.min(axis=(0, 1)) for stretch in stretches])
        high = np.array([stretch.controls.max(axis=(0, 1)) for stretch in stretches])
        qs = [group.expand(group.from_chart(middle)) for middle in 0.5 * (low + high)]
        jacobians = np.empty((len(qs), 6, world.model.nv))
        placements = np.empty((len(qs), world.model.njoints, 4, 4))
        for row, q in enumerate(qs):
            jacobian = pin.computeJointJacobians(world.model, world.data, q)
            jacobians[row] = jacobian.reshape(6, -1)  # of a single joint Pinocchio hands out a vector
            placements[row] = joint_placements(world.data)
        centres = world.bodies.centres_in_world(placements)
        return qs, centres, world.motion_bound.at(jacobians, centres, 0.5 * (high - low))

    def _left(self, stretch: _Stretch, q: np.ndarray, centres: np.ndarray, bounds: np.ndarray) -> list[int]:
        """Pairs of a stretch that are within their bounds, and what they have to keep, at the middle of its box.

        Hulls are asked first, the meshes in them only where that does not tell.
        """
        world = self.world
        self.evaluations += 1
        margins = bounds + self._kept + COAL_ACCURACY
        world.set_margins(world.hulls, world.hull_margin_data, margins)
        if stretch.pairs is None:
            if not pin.computeCollisions(world.model, world.data, world.hull_broad_phase, q, True):
                return []
            apart = world.bodies.separations(centres, world.pairs, world.n_self)
            pairs = np.flatnonzero(apart <= margins).tolist()
        else:
            pin.updateGeometryPlacements(world.model, world.data, world.hulls, world.hull_margin_data, q)
            pairs = stretch.pairs
        left = [pair for pair in pairs if pin.computeCollision(world.hulls, world.hull_margin_data, pair)]
        asked = [pair for pair in left if self._hulled[pair] and bounds[pair] <= MESH_FROM]
        if not asked:
            return left
        world.set_margins(world.geometry, world.margin_data, margins)
        pin.updateGeometryPlacements(world.model, world.data, world.geometry, world.margin_data, q)
        free = {pair for pair in asked if not pin.computeCollision(world.geometry, world.margin_data, pair)}
        return [pair for pair in left if pair not in free]

    def _refusal_at(self, rest: _Stretch, free_until: float, left: list[int], bounds: np.ndarray) -> Verdict | None:
        """Why the curve is refused where its rest begins: it touches there, or the pairs left can't move any less."""
        z = rest.controls[0, 0]
        found = self._touching(z, left)
        if found is None:
            undecided = [pair for pair in left if bounds[pair] <= self.floor]
            if not undecided:
                return None
            found = ("undecided", undecided[0])
        names = self.world.pair_names(found[1])
        return Verdict(False, found[0], rest.piece, rest.start, free_until, names, z, self.evaluations)

    def _touching(self, z: np.ndarray, pairs: list[int]) -> tuple[str, int] | None:
        """What is wrong at a point (nv,) of the curve, contact or too close, and with which of some pairs; or None."""
        world, group = self.world, self.world.group
        self.evaluations += 1
        q = group.expand(group.from_chart(z))
        pin.updateGeometryPlacements(world.model, world.data, world.geometry, world.geometry_data, q)
        for pair in pairs:
            if pin.computeCollision(world.geometry, world.geometry_data, pair):
                return "contact", pair
        wanting = [pair for pair in pairs if self._kept[pair] > 0.0]
        if wanting:
            world.set_margins(world.geometry, world.margin_data, self._kept)
            pin.updateGeometryPlacements(world.model, world.data, world.geometry, world.margin_data, q)
        for pair in wanting:
            if pin.computeCollision(world.geometry, world.margin_data, pair):
                return "too close", pair
        return None
