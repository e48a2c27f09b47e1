"""Check a proof of a motion again, without searching: by NumPy and Pinocchio, and by what docs/certificate.md says.

A segment of the motion is examined about its middle, where Pinocchio places the robot. Pairs are closed if spheres and
boxes are farther apart than both bodies move, or by slabs: directions across which nodes that contain all of both keep
a distance along the segment, by their support functions. Pairs that are left have to be closed in the segments that it
is divided into. None may be left at the end. Nothing of a proof is believed: each distance is computed here.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from guidefield.referee.case import Answer, Case, Finding, Verdict, beyond_limit, pieces
from guidefield.referee.judge import Along, false_part
from guidefield.referee.loading import Meshes, case_of
from guidefield.referee.motion_bounds import BodyBounds, SegmentBounds
from guidefield.referee.proof import Proof, Shapes, box_about, load_proofs, standing_out

ENDS = (1.0, -1.0)
"""Shares of the twists at which nodes are tested, both: their distance across a direction is concave in between."""


class Slabs:
    """The slabs of a proof, and the shapes that they are between.

    Attributes:
        ends: The bodies of the case that each slab is between, shape (k, 2).
        standing_out: How far each body of the case stands out of its shapes at most, shape (b,) [m].
    """

    def __init__(self, proof: Proof, told: Sequence[int], bounds: SegmentBounds, obstacles: np.ndarray) -> None:
        """Read the shapes of a proof.

        Args:
            told: The index in the case of each of the proof's bodies.
            bounds: Placements and motion bounds of bodies.
            obstacles: Whether each of the case's bodies is an obstacle, shape (b,).
        """
        self._proof, self._bounds = proof, bounds
        self.ends = np.array(told, int)[proof.node_bodies][proof.slab_nodes]
        corners, axes, of = proof.corners.astype(float), proof.shape_numbers[:, 2:].copy(), proof.node_shapes
        owner = np.full(len(axes), -1)
        for column in range(2):
            owner[of[of[:, column] >= 0, column]] = proof.node_bodies[of[:, column] >= 0]
        of_corner = np.repeat(owner, np.diff(proof.shape_begins))
        for index, k in enumerate(told):
            corners[of_corner == index] += proof.origins[index]
            if obstacles[k]:
                rotation, translation = bounds.begins[0][k], bounds.begins[1][k]
                corners[of_corner == index] = (corners[of_corner == index] - translation) @ rotation
                axes[owner == index] = axes[owner == index] @ rotation
        lengths = np.linalg.norm(axes, axis=1, keepdims=True)
        axes = np.divide(axes, lengths, out=np.zeros_like(axes), where=lengths > 0.0)
        self._shapes = Shapes(proof.shape_begins, proof.shape_numbers[:, 0], proof.shape_numbers[:, 1], axes, corners)
        self.standing_out = np.zeros(len(obstacles))
        for index, k in enumerate(told):
            mine = np.flatnonzero(proof.node_bodies == index)
            if (of[mine] >= 0).any():
                below = proof.node_children[mine]
                children = np.where(below >= 0, np.searchsorted(mine, below), -1)
                self.standing_out[k] = standing_out(bounds.declared(k), self._shapes, children, of[mine])

    def find_distances(self, twists: np.ndarray) -> np.ndarray:
        """Return distances of nodes across the slabs while their bodies go by twists (k, 2, 6), shape (k,) [m].

        It is minus infinity where a slab has no direction, or a node no shape.
        """
        segment, shape, n = self._proof.slab_segments, self._shape(), self._directions()
        poses = [self._bounds.poses(segment, self.ends[:, side]) for side in range(2)]
        endless = np.flatnonzero([not self._bounds.has_end(k) for k in self.ends[:, 1].tolist()])
        over = np.zeros(len(n))
        for k in endless.tolist():
            plane, (rotations, translations) = self._bounds.declared(int(self.ends[k, 1])).plane, poses[1]
            n[k] = rotations[k] @ plane[:3]
            over[k] = n[k] @ translations[k] + plane[3]
        share, kept = self._bounds.chords.shares[segment][:, None], np.full(len(n), np.inf)
        for s in (end * share for end in ENDS):
            far = []
            for side, sign in ((0, -1.0), (1, 1.0)):
                v, w = np.split(twists[:, side], 2, axis=1)
                d, (rotations, translations) = sign * (n + s * np.cross(n, w)), poses[side]
                moved = sign * s[:, 0] * (n * v).sum(axis=1) + (d * translations).sum(axis=1)
                far.append(self._support(shape[:, side], np.einsum("kij,ki->kj", rotations, d)) + moved)
            far[1][endless] = over[endless]
            kept = np.minimum(kept, -far[0] - far[1])
        shape[endless, 1] = 0
        return np.where(np.isfinite(kept) & (shape >= 0).all(axis=1), kept, -np.inf)

    def hold_all(self, some: np.ndarray) -> bool:
        """Return whether the nodes of some slabs (k,) together contain all of both bodies.

        Both children of a node that is divided stand for it together.
        """
        children, known = self._proof.node_children, set(map(tuple, self._proof.slab_nodes[some].tolist()))
        waiting = list(known)
        while waiting:
            pair = waiting.pop()
            above = [self._parents[node] for node in pair]
            if above == [-1, -1]:
                return True
            for side in range(2):
                if above[side] < 0:
                    continue
                halves = [(int(one), pair[1]) if side == 0 else (pair[0], int(one)) for one in children[above[side]]]
                whole = (above[0], pair[1]) if side == 0 else (pair[0], above[1])
                if whole not in known and known.issuperset(halves):
                    known.add(whole)
                    waiting.append(whole)
        return False

    @cached_property
    def _parents(self) -> list[int]:
        parents, children = np.full(len(self._proof.node_bodies), -1), self._proof.node_children
        for side in range(2):
            inner = np.flatnonzero(children[:, side] >= 0)
            parents[children[inner, side]] = inner
        return [int(node) for node in parents]

    def _shape(self) -> np.ndarray:
        """Return the shapes that each slab is between, -1 where there is none, shape (k, 2)."""
        by_spheres = ~self._proof.slab_axes.any(axis=1)
        found: np.ndarray = self._proof.node_shapes[self._proof.slab_nodes, np.where(by_spheres, 0, 1)[:, None]]
        return found

    def _directions(self) -> np.ndarray:
        """Return unit directions of the slabs, shape (k, 3); not a number where there is none."""
        axes, shape, corners = self._proof.slab_axes.astype(float), self._shape(), self._shapes.corners
        first, middles = np.minimum(self._shapes.begins[np.maximum(shape, 0)], len(corners) - 1), []
        for side in range(2):
            rotations, translations = self._bounds.poses(self._proof.slab_segments, self.ends[:, side])
            middles.append(np.einsum("kij,kj->ki", rotations, corners[first[:, side]]) + translations)
        by_spheres = ~axes.any(axis=1)
        axes[by_spheres] = (middles[0] - middles[1])[by_spheres]
        lengths = np.linalg.norm(axes, axis=1, keepdims=True)
        found: np.ndarray = np.divide(axes, lengths, out=np.full_like(axes, np.nan), where=lengths > 0.0)
        return found

    def _support(self, shape: np.ndarray, d: np.ndarray) -> np.ndarray:
        """Return the support of shapes (k,) along directions d (k, 3), max d.x; 0 without corners, shape (k,)."""
        shapes = self._shapes
        counts = np.where(shape < 0, 0, shapes.begins[shape + 1] - shapes.begins[shape])
        row, of = np.repeat(np.arange(len(shape)), counts), np.cumsum(counts) - counts
        along = np.einsum("ki,ki->k", shapes.corners[np.arange(len(row)) - of[row] + shapes.begins[shape[row]]], d[row])
        axis, found, has = shapes.axes[shape], np.zeros(len(shape)), counts > 0
        across = np.linalg.norm(d - (d * axis).sum(axis=1, keepdims=True) * axis, axis=1)
        added = shapes.balls[shape] * np.linalg.norm(d, axis=1) + shapes.discs[shape] * across
        if has.any():
            found[has] = np.maximum.reduceat(along, of[has]) + added[has]
        return found


class Refused(Exception):
    """The proof doesn't hold; says why."""


def replay_file(path: Path, seconds: float = math.inf) -> list[Verdict]:
    """Check all proofs of a file; arguments as those of `replay`.

    Raises:
        UnusableFile: if it can't be used.
        OSError: if it can't be read.
    """
    meshes: Meshes = {}
    return [replay(case_of(told, meshes), proof, seconds) for told, proof in load_proofs(path)]


def replay(case: Case, proof: Proof, seconds: float = math.inf) -> Verdict:
    """Check a proof of a motion.

    Limits are tested as well, and whether a body is inside another one at the start. Path constraints are in no proof:
    they are judged by bisection (`judge.py`).

    Args:
        seconds: Time after which path constraints are undecided.
    """
    if case.unknown:
        return Verdict(Finding(Answer.NOT_JUDGED, tuple(case.unknown)))
    along = Along(replace(case, constraints=()), 0.0, 0.0, math.inf)
    shells = replace(case, bodies=[replace(body, parts=()) for body in case.bodies])
    found = false_part(shells) or beyond_limit(case) or along.inside() or _broken_constraint(case, seconds)
    kept = math.inf
    if found is None:
        try:
            found, kept = Finding(Answer.FREE), _Replay(case, proof, along).check()
        except Refused as refused:
            found = Finding(Answer.NOT_PROVED, (str(refused),))
    return Verdict(found, kept, len(along.pairs), tuple(along.left_out), len(proof.slab_segments))


def _broken_constraint(case: Case, seconds: float) -> Finding | None:
    if not case.constraints:
        return None
    found = Along(replace(case, bodies=()), 0.0, 0.0, time.monotonic() + seconds).bisect()
    return None if found.answer is Answer.FREE else found


class _Replay:
    def __init__(self, case: Case, proof: Proof, along: Along) -> None:
        self._case, self._proof = case, proof
        pairs = np.array([(i, j) for i, j, _ in along.pairs], int).reshape(-1, 2)
        self._first, self._second = pairs.T
        self._required = np.array([required for *_, required in along.pairs])
        obstacles = np.array([body.obstacle for body in case.bodies], bool)
        self._is_own = ~obstacles[self._second]
        self._told = self._named()
        self._views = self._seen_from()
        self._bounds = SegmentBounds(case, proof.segments, self._middles())
        self._slabs = Slabs(proof, self._told, self._bounds, obstacles)
        self._boxes = self._boxes_about()

    def check(self) -> float:
        begins, children = self._divide()
        by_slabs, kept, count = self._by_slabs(), math.inf, len(self._required)
        segment, pair = np.repeat(begins, count), np.tile(np.arange(count), len(begins))
        while len(segment):
            need, room = self._need(segment, pair), self._apart(segment, pair)
            told = np.array([by_slabs.get(key, -math.inf) for key in (segment * count + pair).tolist()])
            done = (room >= need) | (told > -math.inf)
            best = np.where(room >= need, room, told) - self._required[pair]
            kept = min(kept, float(best[done].min(initial=math.inf)))
            segment, pair = segment[~done], pair[~done]
            left = [len(children[k]) for k in segment.tolist()]
            if 0 in left:
                k = left.index(0)
                raise Refused(f"nothing closes {self._names(int(pair[k]))} from {self._span(int(segment[k]))}")
            below = [child for k in segment.tolist() for child in children[k]]
            segment, pair = np.array(below, int), np.repeat(pair, left)
        return kept

    def _names(self, pair: int) -> str:
        return " and ".join(self._case.bodies[side[pair]].name for side in (self._first, self._second))

    def _span(self, segment: int) -> str:
        begin, end = self._proof.segments[segment].tolist()
        return f"{begin:.9g} to {end:.9g}"

    def _named(self) -> list[int]:
        of_name: dict[str, list[int]] = {}
        for k, body in enumerate(self._case.bodies):
            of_name.setdefault(body.name, []).append(k)
        told = []
        for name, number in zip(self._proof.bodies.tolist(), self._proof.numbers.tolist(), strict=True):
            some = of_name.get(name, [])
            if not 0 <= number < len(some) or some[number] in told:
                raise Refused(f"the case has no {name!r} like the proof's")
            told.append(some[number])
        return told

    def _middles(self) -> dict[int, np.ndarray]:
        """Return the centres of spheres about the proof's bodies, in the frames of their shapes [m]."""
        middles = {}
        for k, middle in zip(self._told, self._proof.centres + self._proof.origins, strict=True):
            body = self._case.bodies[k]
            first = body.placement if body.screw is None else body.screw.stops[0] * body.placement
            middles[k] = np.asarray(first.actInv(middle)) if body.obstacle else middle
        return middles

    def _seen_from(self) -> dict[frozenset[int], int]:
        names = list(self._case.model.names)
        # the first is the world, and a joint may have its name, too
        joints = [names.index(name, 1) if k and name in names[1:] else 0 for k, name in enumerate(self._proof.joints)]
        return {frozenset((self._told[a], self._told[b])): joints[k] for a, b, k in self._proof.views.tolist()}

    def _boxes_about(self) -> tuple[np.ndarray, np.ndarray]:
        """Return boxes about bodies along the axes of their shapes, and along the world's at first, (2, b, 3)."""
        corners = np.array([body.corners for body in self._case.bodies])
        own = np.stack([corners.min(axis=1), corners.max(axis=1)])
        there = np.stack([np.full_like(own[0], -np.inf), np.full_like(own[1], np.inf)])
        for k, body in enumerate(self._case.bodies):
            if body.obstacle and self._bounds.has_end(k):
                there[:, k] = box_about(self._bounds.declared(k), *(some[k] for some in self._bounds.begins))
        return own, there

    def _divide(self) -> tuple[list[int], list[list[int]]]:
        """Return the segments that together are the whole motion, and those that each is divided into, without a gap.

        Raises:
            Refused: if there is a gap.
        """
        spans = self._proof.segments
        top, children, around = list[int](), [list[int]() for _ in spans], list[int]()
        for k in np.lexsort((-spans[:, 1], spans[:, 0])).tolist():
            while around and spans[around[-1], 1] <= spans[k, 0]:
                around.pop()
            (children[around[-1]] if around else top).append(k)
            around.append(k)
        every = [*pieces(self._case)]
        whole = every[0].start, every[-1].start + every[-1].span
        for (begin, end), inner in ((whole, top), *((spans[k], some) for k, some in enumerate(children) if some)):
            parts = spans[inner].reshape(-1, 2)
            edges = [begin, *parts[:, 1].tolist()], [*parts[:, 0].tolist(), end]
            is_whole = (parts[:, 1] > parts[:, 0]).all() and all(a >= b for a, b in zip(*edges, strict=True))
            if not is_whole or (inner is not top and (parts[:, 1] > end).any()):
                raise Refused(f"segments leave a gap from {begin:.9g} to {end:.9g}")
        return top, children

    def _need(self, segment: np.ndarray, pair: np.ndarray) -> np.ndarray:
        """Return distances that pairs have to keep in segments, (k,) [m]: what is required, or more that is claimed."""
        need: np.ndarray = self._required[pair]
        (begin, end), is_own = self._proof.segments[segment].T, self._is_own[pair]
        for since, until, own, distance in self._proof.claims.tolist():
            meant = (begin < until) & (end > since) & (is_own == (own != 0.0))
            need = np.where(meant, np.maximum(need, distance), need)
        return need

    def _apart(self, segment: np.ndarray, pair: np.ndarray) -> np.ndarray:
        """Return distances that pairs keep all along segments by spheres, or a sphere and a box, shape (k,) [m]."""
        a, b, kept, bounds = self._first[pair], self._second[pair], np.empty(len(pair)), self._bounds
        own, c = self._is_own[pair], self._bounds.centres[segment, a]
        kept[own] = np.linalg.norm(c[own] - bounds.centres[segment[own], b[own]], axis=1) - bounds.radii[b[own]]
        rotations, translations = bounds.poses(segment[~own], b[~own])
        seen = np.einsum("kij,ki->kj", rotations, c[~own] - translations)
        at_first = np.einsum("kij,kj->ki", bounds.begins[0][b[~own]], seen) + bounds.begins[1][b[~own]]
        gaps = [_from_boxes(at, *boxes[:, b[~own]]) for at, boxes in zip((seen, at_first), self._boxes, strict=True)]
        kept[~own] = np.maximum(*gaps)
        for k, mine in _groups(pair):
            i, j = int(self._first[k]), int(self._second[k])
            travel = bounds.bound(i, 0).travel
            if self._is_own[k]:
                between = sum(one.travel for one in self._of_pair(k))
                travel = np.minimum(travel + bounds.bound(j, 0).travel, between)
            elif bounds.moves(j):
                travel = travel + bounds.bound_mover(j, i).travel
            kept[mine] -= travel[segment[mine]] if bounds.has_end(j) else math.inf
        kept -= bounds.radii[a]
        return kept

    def _of_pair(self, pair: int) -> list[BodyBounds]:
        i, j = int(self._first[pair]), int(self._second[pair])
        if self._is_own[pair]:
            view = self._views.get(frozenset((i, j)), 0)
            return [self._bounds.bound(i, view), self._bounds.bound(j, view)]
        return [self._bounds.bound(i, 0), *([self._bounds.bound_mover(j, i)] if self._bounds.moves(j) else [])]

    def _by_slabs(self) -> dict[int, float]:
        """Return by segment and pair (one number for both) the distance proved by slabs that hold all of both [m].

        Raises:
            Refused: if a slab isn't true.
        """
        segment, ends, count = self._proof.slab_segments.astype(int), self._slabs.ends, len(self._required)
        place = {both: k for k, both in enumerate(zip(self._first.tolist(), self._second.tolist(), strict=True))}
        pair = np.array([place.get((a, b), -1) for a, b in ends.tolist()], int)
        if (pair < 0).any():
            raise Refused("a slab is between bodies that aren't judged")
        twists, lost = np.zeros((len(pair), 2, 6)), self._slabs.standing_out[ends].sum(axis=1)
        for k, mine in _groups(pair):
            for side, bound in enumerate(self._of_pair(k)):
                twists[mine, side] = bound.twist[segment[mine]]
                lost[mine] += bound.bent[segment[mine]]
        kept, need = self._slabs.find_distances(twists) - lost, self._need(segment, pair)
        if (kept < need).any():
            k = int(np.argmin(kept - need))
            raise Refused(f"a slab between {self._names(int(pair[k]))} isn't true from {self._span(int(segment[k]))}")
        told = {key: mine for key, mine in _groups(segment * count + pair) if self._slabs.hold_all(mine)}
        return {key: float(kept[mine].min()) for key, mine in told.items()}


def _from_boxes(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return distances of points from boxes, all of shape (k, 3)."""
    found: np.ndarray = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)
    return found


def _groups(keys: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Return each of some keys (k,), and its indices among them."""
    order = np.argsort(keys, kind="stable")
    cuts = np.flatnonzero(np.diff(keys[order])) + 1
    return [(int(keys[some[0]]), some) for some in np.split(order, cuts) if len(some)]
