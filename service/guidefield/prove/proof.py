"""Record proofs of motions: the segments and slabs by which a search closed every pair, and the convex parts of bodies.

A proof is recorded on demand, by the same search. The referee checks it again without searching (`referee/replay.py`),
by bounds, supports and meshes of its own; nothing in a proof has to be believed. Names and shapes of `Proof` are the
file's (docs/referee.md, `referee/proof.py`): what changes here changes there, with a new number of the format.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from guidefield.collision.bodies import bodies
from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.kernels.collide.parts import (
    BALL_ROW,
    BLOCKS,
    DISC,
    FIRST_BLOCK,
    HALF_LENGTH,
    KIND,
    LINK,
    OWN,
    PART,
    PLANE_OFFSET,
    POLYTOPE,
    ROUND,
    SHAPE,
    TRIANGLE,
    Parts,
)
from guidefield.kernels.collide.primitive import CYLINDER, HALF_SPACE
from guidefield.kernels.prove.kept_distance import ROW_A, ROW_AXIS, ROW_B, ROW_PAIR, ROW_SEGMENT
from guidefield.kernels.simd.vector import LANES
from guidefield.prove.curve import Curve
from guidefield.prove.search import SearchLog, SearchQuery, SearchResult, search
from guidefield.prove.tables import WorldTables, world_tables
from guidefield.read_only import ReadOnly, read_only
from guidefield.scene.movers import motion_of, movers

FIRST_ROWS = 4096  # rows of the log at first, above 0 (a Panda's motion has some hundred): too few repeat the search

CLAIM_MARGIN = 1e-6
"""A claimed distance is by this less than what was found, because a proof's numbers are in single precision [m].

With less the referee may refuse a claim that is true; with more a proof claims less.
"""


@dataclass(frozen=True, eq=False)
class Proof(ReadOnly):
    """A proof of a motion, in the names of a case (docs/referee.md)."""

    # begin and end of a time; 1 for pairs of the robot with itself, 0 for those with obstacles; a distance that all of
    # them keep then, which counts if it is more than is required, shape (c, 4) [s, s, -, m]
    claims: np.ndarray
    segments: np.ndarray  # begin and end of each, those that contain others before them, shape (s, 2) [s, or knots]
    slab_segments: np.ndarray  # the segment of each slab, shape (k,)
    slab_nodes: np.ndarray  # the two nodes of bodies' trees that the slab separates, shape (k, 2)
    # its direction in the world, from the second node to the first, shape (k, 3); 0: the spheres about both nodes are
    # apart along the line between their centres
    slab_axes: np.ndarray
    joints: np.ndarray  # names of joints
    views: np.ndarray  # two of `bodies`, the robot's own, and the one of `joints` whose frame motions are in, (p, 3)
    bodies: np.ndarray  # name of each body: its link, held object or obstacle
    numbers: np.ndarray  # the number of each among bodies of that name, shape (b,)
    # from where its lengths are measured, shape (b, 3) [m]: in the frame of the collision shape; of an obstacle in the
    # world, where it is at first
    origins: np.ndarray
    centres: np.ndarray  # centre of a sphere about it, from its origin, shape (b, 3) [m]
    node_bodies: np.ndarray  # the body of each node, shape (n,)
    node_children: np.ndarray  # its children, behind it; -1 where it isn't divided, shape (n, 2)
    # indices of a sphere and of another shape that contain all below it; -1 where none is needed, shape (n, 2)
    node_shapes: np.ndarray
    shape_begins: np.ndarray  # begin of the corners of each shape, and the number of all, shape (h + 1,)
    # a shape is the Minkowski sum of its corners' hull, a ball and a disc across an axis: radius of the ball, radius of
    # the disc, the axis; a half-space has an infinite ball, its offset and its normal, shape (h, 5) [m]
    shape_numbers: np.ndarray
    corners: np.ndarray  # shape (c, 3) [m]


def prove(
    world: World, curve: Curve, goal: SearchQuery, deadline: Deadline = UNLIMITED
) -> tuple[SearchResult, Proof | None]:
    """Search a motion and record its proof; None if it isn't free."""
    capacity, log = FIRST_ROWS, SearchLog.with_capacity(FIRST_ROWS)
    found = search(world, curve, goal, deadline, log)
    while not log.is_complete:
        capacity *= 2
        log = SearchLog.with_capacity(capacity)
        found = search(world, curve, goal, deadline, log)
    if not found.verdict.free:
        return found, None
    return found, _Writer(world, goal, log.rows).proof(_claims(found, goal), log.segments)


def _claims(found: SearchResult, goal: SearchQuery) -> np.ndarray:
    """Return the smallest distances that were found, if larger than what is required, as `Proof.claims`."""
    required = goal.min_clearance or 0.0
    rows = [(*span, 0.0, one.bound - CLAIM_MARGIN) for one, span in zip(found.obstacle, goal.spans, strict=True)]
    rows += [(*span, 1.0, found.own.bound - CLAIM_MARGIN) for span in goal.spans[:1]]
    kept = [row for row in rows if np.isfinite(row[3]) and row[3] > (0.0 if row[2] else required)]
    return np.array(kept, float).reshape(-1, 4)


class _Shape(NamedTuple):
    """A convex shape: see `Proof.shape_numbers`."""

    corners: np.ndarray
    ball: float
    disc: float = 0.0
    axis: Sequence[float] = (0.0, 0.0, 0.0)


class _Writer:
    """Writes the rows of a search's log as a proof, in the names of a case."""

    def __init__(self, world: World, goal: SearchQuery, rows: np.ndarray) -> None:
        self._world, self._rows = world, rows
        self._in_time = goal.in_time and world.scene.moves
        self._tables: WorldTables = world_tables(world, in_time=self._in_time)
        robot, obstacles, _, pairs, _ = self._tables
        self._links = len(robot.parent_joints)
        pair, mixed = rows[:, ROW_PAIR].astype(np.int64), rows[:, ROW_PAIR].astype(np.int64) - len(pairs.own)
        is_own = mixed < 0
        ends = np.empty((len(rows), 2), np.int64)
        ends[is_own] = pairs.own[pair[is_own]]
        ends[~is_own, 0] = pairs.moving[mixed[~is_own] // max(len(obstacles.roots), 1)]
        ends[~is_own, 1] = self._links + mixed[~is_own] % max(len(obstacles.roots), 1)
        self._ends = ends

    def proof(self, claims: np.ndarray, segments: np.ndarray) -> Proof:
        names, listed = self._world.body_names, self._list_bodies()
        place = {body: index for index, body in enumerate(listed)}
        numbers = [names[: body if body < self._links else self._links].count(names[body]) for body in listed]
        nodes = [_Nodes(*self._tree(body)) for body in listed]
        used = self._rows[:, [ROW_A, ROW_B]].astype(np.int64)
        by_spheres = (self._rows[:, ROW_AXIS:] == 0.0).all(axis=1)
        for side in range(2):
            for body in listed:
                own = self._ends[:, side] == body
                nodes[place[body]].use(used[own, side], by_spheres[own])
        for one in nodes:
            one.close()
        first = np.cumsum([0, *(len(one.order) for one in nodes)])
        slab_nodes = np.empty((len(used), 2), np.int32)
        for side in range(2):
            for row, (body, node) in enumerate(zip(self._ends[:, side].tolist(), used[:, side].tolist(), strict=True)):
                at = place[body]
                slab_nodes[row, side] = first[at] + nodes[at].order[node]
        written = [_write_tree(one, self._frame(body)) for one, body in zip(nodes, listed, strict=True)]
        shapes = [shape for _, some, _, _ in written for shape in some]
        below = np.cumsum([0, *(len(some) for _, some, _, _ in written)])
        children = [np.where(rows >= 0, rows + begin, -1) for (rows, *_), begin in zip(written, first, strict=False)]
        of_shapes = [
            np.where(rows >= 0, rows + begin, -1) for (*_, rows, _), begin in zip(written, below, strict=False)
        ]
        centres = [
            self._frame(body).act(self._centre(body)) - one[3] for body, one in zip(listed, written, strict=True)
        ]
        examined = ~np.isnan(segments[:, 0])
        begins = np.cumsum([0, *(len(shape.corners) for shape in shapes)])
        made = Proof(
            claims=claims,
            segments=segments[examined][:, :2],
            slab_segments=(self._rows[:, ROW_SEGMENT] - 1).astype(np.int32),
            slab_nodes=slab_nodes,
            slab_axes=self._rows[:, ROW_AXIS:].astype(np.float32),
            joints=np.array(list(self._world.model.names)),
            views=self._views(place),
            bodies=np.array([names[body] for body in listed], str),
            numbers=np.array(numbers, np.int32),
            origins=np.array([origin for *_, origin in written], float).reshape(-1, 3),
            centres=np.array(centres, float).reshape(-1, 3),
            node_bodies=np.repeat(np.arange(len(listed), dtype=np.int32), np.diff(first)),
            node_children=_rows(children, 2, np.int32),
            node_shapes=_rows(of_shapes, 2, np.int32),
            shape_begins=begins.astype(np.int32),
            shape_numbers=np.array([(s.ball, s.disc, *s.axis) for s in shapes], float).reshape(-1, 5),
            corners=_rows([shape.corners for shape in shapes], 3, np.float32),
        )
        read_only(*vars(made).values())
        return made

    def _list_bodies(self) -> list[int]:
        """List the robot's bodies, and obstacles that are in a slab or move."""
        listed = set(range(self._links)) | set(self._ends.ravel().tolist())
        if self._in_time:
            listed |= {self._links + int(index) for index in movers(self._world.scene).indices}
        return sorted(listed)

    def _tree(self, body: int) -> tuple[Parts, int, np.ndarray]:
        """Return the tables that a body is in, its root, and the anchor that they are relative to."""
        robot, obstacles = self._tables.robot, self._tables.obstacles
        if body < self._links:
            anchor = robot.anchor if robot.parent_joints[body] == 0 else np.zeros(3)
            return robot.parts, int(robot.roots[body]), anchor
        root = int(obstacles.roots[body - self._links])
        endless = self._world.scene.obstacles[body - self._links].endless
        return obstacles.parts, root, np.zeros(3) if endless else obstacles.anchor

    def _frame(self, body: int) -> Any:
        """Return the transform from the frame of a body's tables to the one that it is written in, a pinocchio.SE3."""
        if body < self._links:
            return self._world.group.geometry.geometryObjects[body].placement.inverse()
        return self._world.scene.obstacles[body - self._links].placement.Identity()

    def _centre(self, body: int) -> np.ndarray:
        """Return the centre of the sphere about a body, in the frame of its tables [m]; 0 where none is needed."""
        if body < self._links:
            centre: np.ndarray = bodies(self._world.group).centres[body]
            return centre
        at = body - self._links
        known = movers(self._world.scene)
        if self._in_time and at in known.indices:
            index = int(np.searchsorted(known.indices, at))
            ball = known.balls[index]
            return np.zeros(3) if ball is None else motion_of(known.obstacles[index]).placements[0].act(ball.centre)
        return np.zeros(3)

    def _views(self, place: dict[int, int]) -> np.ndarray:
        """Return `Proof.views`; the joint is the one nearest to where the coordinates on both sides begin."""
        robot, pairs, model = self._tables.robot, self._tables.pairs, self._world.model
        joint_of = np.repeat(np.arange(model.njoints), [joint.nv if i else 0 for i, joint in enumerate(model.joints)])
        found = np.empty((len(pairs.own), 3), np.int32)
        for row, (a, b) in enumerate(pairs.own.tolist()):
            shared = set(model.supports[int(robot.parent_joints[a])]) & set(model.supports[int(robot.parent_joints[b])])
            seen = max(shared, default=0)
            for body, by in ((a, pairs.first_by[row, :1]), (b, pairs.second_by[row, :1])):
                if len(by) and by[0] >= 0 and robot.moves[body, by[0]] < 0.0:
                    seen = int(joint_of[by[0]])
            found[row] = place[a], place[b], seen
        return found


class _Nodes:
    """The nodes of a body's tree that a proof needs."""

    def __init__(self, parts: Parts, root: int, anchor: np.ndarray) -> None:
        self.parts, self.root, self.anchor = parts, root, anchor
        self.spheres: set[int] = set()
        self.hulls: set[int] = set()
        self.order: dict[int, int] = {}

    def use(self, nodes: np.ndarray, by_spheres: np.ndarray) -> None:
        self.spheres |= set(nodes[by_spheres].tolist())
        self.hulls |= set(nodes[~by_spheres].tolist())

    def close(self) -> None:
        used, links = self.spheres | self.hulls, self.parts.links.reshape(-1, LINK)
        needed: set[int] = set()
        if used - {self.root}:
            above = np.full(len(links), -1)
            for side in range(2):
                inner = np.flatnonzero(links[:, side] >= 0)
                above[links[inner, side]] = inner
            for node in used:
                at = int(above[node]) if node != self.root else -1
                while at >= 0 and at not in needed:
                    needed.add(at)
                    at = int(above[at]) if at != self.root else -1
        self.inner, waiting = needed, [self.root]
        while waiting:
            node = waiting.pop(0)
            self.order[node] = len(self.order)
            if node in needed:
                waiting += links[node, :2].tolist()

    def shape(self, node: int, part: int) -> _Shape:
        """Return the part of a node, or its sphere if `part` is -1, in the frame of the tables."""
        if part < 0:
            centre, radius = np.split(self.parts.balls.reshape(-1, BALL_ROW)[node], [3])
            return _Shape(centre[None] + self.anchor, float(radius[0]))
        numbers, shape = self.parts.numbers.reshape(-1, PART)[part], self.parts.shapes.reshape(-1, SHAPE)[part]
        kind, ball = shape[KIND], float(numbers[ROUND])
        if kind == HALF_SPACE:
            return _Shape(np.empty((0, 3)), np.inf, float(numbers[PLANE_OFFSET]), numbers[:PLANE_OFFSET])
        if kind == POLYTOPE:
            blocks = self.parts.vertices.reshape(-1, 3, LANES)
            some = blocks[shape[FIRST_BLOCK] : shape[FIRST_BLOCK] + shape[BLOCKS]]
            return _Shape(np.unique(some.transpose(0, 2, 1).reshape(-1, 3).astype(float), axis=0) + self.anchor, ball)
        if kind == TRIANGLE:
            return _Shape(np.unique(numbers[:9].reshape(3, 3), axis=0) + self.anchor, ball)
        pose = numbers[:12].reshape(3, 4)
        ends = pose[:, 3] + np.array([[-1.0], [1.0]]) * numbers[HALF_LENGTH] * pose[:, 2]
        return _Shape(ends + self.anchor, ball, float(numbers[DISC]) if kind == CYLINDER else 0.0, pose[:, 2])


def _write_tree(nodes: _Nodes, frame: Any) -> tuple[np.ndarray, list[_Shape], np.ndarray, np.ndarray]:
    links, shapes, origin = nodes.parts.links.reshape(-1, LINK), list[_Shape](), None
    children, of_node = np.full((len(nodes.order), 2), -1), np.full((len(nodes.order), 2), -1)
    for node, at in nodes.order.items():
        if node in nodes.inner:
            children[at] = [nodes.order[child] for child in links[node, :2].tolist()]
        for column, is_used, part in ((0, node in nodes.spheres, -1), (1, node in nodes.hulls, links[node, OWN])):
            if is_used:
                of_node[at, column] = len(shapes)
                shape = nodes.shape(node, int(part))
                corners = shape.corners @ frame.rotation.T + frame.translation
                if origin is None and len(corners):
                    origin = corners.mean(axis=0)
                shapes.append(shape._replace(corners=corners, axis=frame.rotation @ np.asarray(shape.axis)))
    origin = np.zeros(3) if origin is None else origin
    return children, [one._replace(corners=one.corners - origin) for one in shapes], of_node, origin


def _rows(arrays: Sequence[np.ndarray], width: int, kind: type) -> np.ndarray:
    return np.concatenate([np.empty((0, width)), *arrays]).astype(kind)
