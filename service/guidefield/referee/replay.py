"""Check a proof of a motion again, without searching: by NumPy and Pinocchio, and by what certificate.md says.

A segment of the motion is examined about its middle, where Pinocchio places the robot. Pairs that spheres and boxes
tell to be farther apart than both bodies move are done with; others by slabs between nodes that hold all of both. What
is left has to be done with in the segments that it is divided into. Nothing may be left.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from guidefield.referee.case import Case
from guidefield.referee.containment import box_about
from guidefield.referee.curve import beyond_limit, pieces
from guidefield.referee.judge import Along, false_part
from guidefield.referee.loading import Meshes, case_of
from guidefield.referee.motion_bounds import BodyBounds, SegmentBounds
from guidefield.referee.proof import Proof, load_proofs
from guidefield.referee.slabs import Slabs
from guidefield.referee.verdict import Answer, Finding, Verdict


class Refused(Exception):
    """The proof doesn't hold, in words."""


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

    Limits are judged as well, and whether a body is inside another one at the start. Path constraints are in no proof:
    they are judged by halving.

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
        """Middles of spheres about the proof's bodies, in the frames of their shapes [m]."""
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
        """Boxes about bodies along the axes of their shapes, and along the world's at first, (2, b, 3)."""
        corners = np.array([body.corners for body in self._case.bodies])
        own = np.stack([corners.min(axis=1), corners.max(axis=1)])
        there = np.stack([np.full_like(own[0], -np.inf), np.full_like(own[1], np.inf)])
        for k, body in enumerate(self._case.bodies):
            if body.obstacle and self._bounds.has_end(k):
                there[:, k] = box_about(self._bounds.declared(k), *(some[k] for some in self._bounds.begins))
        return own, there

    def _divide(self) -> tuple[list[int], list[list[int]]]:
        """The segments that together are the whole motion, and those that each is divided into, without a gap.

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
        """What pairs have to keep in segments, shape (k,) [m]: what is required, and what the proof claims."""
        need: np.ndarray = self._required[pair]
        (begin, end), is_own = self._proof.segments[segment].T, self._is_own[pair]
        for since, until, own, distance in self._proof.claims.tolist():
            meant = (begin < until) & (end > since) & (is_own == (own != 0.0))
            need = np.where(meant, np.maximum(need, distance), need)
        return need

    def _apart(self, segment: np.ndarray, pair: np.ndarray) -> np.ndarray:
        """What pairs keep at least all along segments by spheres, or a sphere and a box, shape (k,) [m]."""
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
        """By segment and pair, in their joint numbering, what slabs keep that hold all of both bodies [m].

        Raises:
            Refused: if one isn't true.
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
    """Distances of points from boxes, all of shape (k, 3)."""
    found: np.ndarray = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)
    return found


def _groups(keys: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Each of some keys (k,), and where it stands among them."""
    order = np.argsort(keys, kind="stable")
    cuts = np.flatnonzero(np.diff(keys[order])) + 1
    return [(int(keys[some[0]]), some) for some in np.split(order, cuts) if len(some)]
