"""Slabs: directions across which two nodes of bodies keep a distance all along a segment, by their farthest points."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from guidefield.referee.containment import Shapes, standing_out
from guidefield.referee.motion_bounds import SegmentBounds
from guidefield.referee.proof import Proof

ENDS = (1.0, -1.0)
"""What two nodes keep across a direction is concave in the share of their twists, and least at one of both ends."""


class Slabs:
    """The slabs of a proof, and the shapes that they are between.

    Attributes:
        ends: The bodies of the case that each slab is between, shape (k, 2).
        standing_out: How far each body of the case stands out of its shapes at most, shape (b,) [m].
    """

    def __init__(self, proof: Proof, told: Sequence[int], bounds: SegmentBounds, obstacles: np.ndarray) -> None:
        """Read the shapes of a proof.

        Args:
            told: The case's body of each of the proof's.
            bounds: Where bodies are.
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
        """Return what nodes keep across the slabs while their bodies go by their twists (k, 2, 6), shape (k,) [m].

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
        """Whether nodes that some slabs (k,) are between hold all of both bodies.

        Of a node that is divided both parts together stand for it.
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
        """The shapes that each slab is between, -1 where there is none, shape (k, 2)."""
        by_spheres = ~self._proof.slab_axes.any(axis=1)
        found: np.ndarray = self._proof.node_shapes[self._proof.slab_nodes, np.where(by_spheres, 0, 1)[:, None]]
        return found

    def _directions(self) -> np.ndarray:
        """Unit directions of the slabs, shape (k, 3); not a number where there is none."""
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
        """The most of d.x over the points x of shapes (k,), along directions (k, 3); 0 without corners, shape (k,)."""
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
