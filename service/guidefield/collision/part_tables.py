"""Coal shapes as the kernels' convex parts: a primitive or hull is one part, a triangle mesh a tree of triangles.

SIMD batches, proofs and streams measure exact distances by these tables; columns are those of kernels/collide/parts.py,
and parts have to be the shapes themselves. A further kind of shape needs branches in `PartsTable.add_shape`, kernels,
entries in narrow_phase.py, distance_bodies.py, prove/proof.py, recorder/surface.py, for links also in link_bounds.py
and link_charges.py.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from guidefield.geometry.cache import Arrays, Layout, allocate_in_memory
from guidefield.geometry.convex import CLUSTERS, Cluster, MeshTree, mesh_tree, polytope_about
from guidefield.geometry.surfaces import transform_points
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
    write_cluster_vertices,
)
from guidefield.kernels.collide.primitive import CAPSULE, CYLINDER, HALF_SPACE
from guidefield.kernels.jit.decorators import load_imported
from guidefield.kernels.simd.packing import BLOCK
from guidefield.kernels.simd.vector import LANES
from guidefield.memo import size_of
from guidefield.memory import MESH_TREES, PLACED_MESHES, BoundedMap, content_key
from guidefield.parallel import run_queue, usable_processors
from guidefield.read_only import read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.model.collision_shapes import hull_vertices, triangulation

_NO_VERTICES, _ZEROS = np.empty(0, np.float32), np.zeros(3, np.int64)


MANY_NUMBERS = 200_000  # tables with more numbers of balls (some 10,000 triangles) are written on all processors


class UnsupportedShape(Exception):
    """A kind of shape that the kernels don't know, and that neither robots nor scenes are made of."""


class PartsTable:
    """Collects the parts of bodies."""

    def __init__(self) -> None:
        self._added: list[tuple[Layout, Callable[[Arrays], None]]] = []
        self._alone: Parts | None = None
        self._n_nodes = self._n_parts = self._n_blocks = 0

    def add_shape(self, shape: Any, placement: Any) -> int:  # noqa: PLR0911  one for each kind
        """Add a Coal shape that stands at a pinocchio.SE3 in its body; return the root of its tree.

        Raises:
            UnsupportedShape: if it is of a kind that the kernels don't know.
        """
        numbers = np.zeros(PART)
        numbers[:12] = np.c_[placement.rotation, placement.translation].ravel()
        centre = placement.translation
        if isinstance(shape, coal.BVHModelBase):
            return self._mesh(recall_mesh_tree(shape), placement)
        if isinstance(shape, coal.Convex):
            return self.add_hull(transform_points(placement, np.array(shape.points())))
        if isinstance(shape, coal.Box):
            corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * np.array(shape.halfSide)
            return self.add_hull(transform_points(placement, corners))
        if isinstance(shape, coal.Cylinder):
            numbers[DISC], numbers[HALF_LENGTH] = shape.radius, shape.halfLength
            return self._single(CYLINDER, numbers, centre, float(np.hypot(shape.radius, shape.halfLength)))
        if isinstance(shape, coal.Capsule):
            numbers[HALF_LENGTH], numbers[ROUND] = shape.halfLength, shape.radius
            return self._single(CAPSULE, numbers, centre, shape.halfLength + shape.radius)
        if isinstance(shape, coal.Sphere):
            numbers[ROUND] = shape.radius
            return self._single(CAPSULE, numbers, centre, shape.radius)
        if isinstance(shape, coal.Halfspace):
            normal = placement.rotation @ shape.n
            numbers[: PLANE_OFFSET + 1] = *normal, shape.d + normal @ centre
            return self._single(HALF_SPACE, numbers, centre, np.inf)
        raise UnsupportedShape(type(shape).__name__)

    def add_above(self, balls: np.ndarray, links: np.ndarray, hull: np.ndarray | None = None) -> int:
        """Add nodes without parts above bodies that may be added later; return the first one.

        Balls about them are of shape (n, 4) [m]; `links` (n, 2) are their children, nodes counted from the first one.
        That one may have the hull of points (k, 3) about all.
        """
        vertices = _NO_VERTICES if hull is None else _in_blocks(hull)

        def write(made: Arrays) -> None:
            made["balls"][:] = balls.ravel()
            made["links"][:] = np.column_stack([links, np.full(len(links), -1)]).ravel()
            if len(vertices):
                _write_hull(vertices, made)

        return self._add(tree_layout(0, len(balls), [0] * len(CLUSTERS), len(vertices) // BLOCK), write)

    def add_pieces(self, hull: np.ndarray, pieces: Sequence[np.ndarray]) -> int:
        """Add hulls of a body's pieces, points (k, 3) of each, below the hull of points about all; return the root."""
        if len(pieces) < 2:
            return self.add_hull(hull)
        roots = len(pieces) - 1 + np.arange(len(pieces))
        root = self.add_above(*tree_above([one[:, None] for one in pieces], roots), hull)
        for one in pieces:
            self.add_hull(one)
        return root

    def add_tree(self, mesh: MeshTree) -> int:
        """Add a mesh in the body's frame; return the root of its tree."""
        return self._mesh(mesh, None)

    def add_parts(self, alone: Parts) -> int:
        """Add parts that were made as a table of their own; return their first node, which is a single body's root."""
        self._alone = alone
        return self._add_copy(alone._asdict(), _ZEROS)

    def add_hull(self, points: np.ndarray, kind: int = POLYTOPE) -> int:
        """Add points (n, 3) of the body's frame as one part, their hull unless of another kind; return its node."""
        centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
        radius = float(np.linalg.norm(points - centre, axis=1).max())
        return self._single(kind, np.zeros(PART), centre, radius, _in_blocks(points))

    def tables(self) -> Parts:
        """Return the parts that were added, frozen."""
        alone = self._alone if len(self._added) == 1 else None  # of one mesh of a million triangles no copy is made
        parts = alone or Parts(**self._write_tables())
        read_only(*parts)
        return parts

    def _write_tables(self) -> Arrays:
        sizes = {name: sum(layout[name][1][0] for layout, _ in self._added) for name in _DTYPES}
        made = allocate_in_memory({name: (kind, (sizes[name],)) for name, kind in _DTYPES.items()})
        begins, works = dict.fromkeys(_DTYPES, 0), []
        for layout, write in self._added:
            ends = {name: begins[name] + layout[name][1][0] for name in _DTYPES}
            works.append(functools.partial(write, {name: made[name][begins[name] : ends[name]] for name in _DTYPES}))
            begins = ends
        threads = usable_processors() if sizes["balls"] > MANY_NUMBERS else 1
        if threads > 1:
            load_imported("collide.parts")
        run_queue(iter(works), threads)
        return made

    def _mesh(self, mesh: MeshTree, placement: Any | None) -> int:
        """Add a mesh that stands at a pinocchio.SE3, or where it is; return the root of its tree."""
        key = (id(mesh), None if placement is None else placement.homogeneous.tobytes())
        known = _PLACED.get(key)
        if known is not None:
            return self._add_copy(known[1], known[2])

        def there(points: np.ndarray) -> np.ndarray:
            return points if placement is None else transform_points(placement, points)

        hull = _NO_VERTICES if mesh.hull is None else _in_blocks(there(mesh.hull))
        counts = [len(nodes) for nodes, _ in mesh.clusters]
        layout = tree_layout(len(mesh.corners), len(mesh.balls), counts, len(hull) // BLOCK)

        def write(made: Arrays) -> None:
            made["balls"][:] = mesh.balls.ravel()
            if placement is not None:
                made["balls"].reshape(-1, BALL_ROW)[:, :3] = there(mesh.balls[:, :3])
            made["links"][:] = mesh.links.ravel()
            corners = np.ascontiguousarray(there(mesh.corners.reshape(-1, 3)).reshape(-1, 3, 3))
            write_triangles(corners, made)
            write_clusters(corners, mesh.clusters, made)
            if len(hull):
                _write_hull(hull, made)

        def keep(made: Arrays, begins: np.ndarray) -> None:
            _PLACED.insert(key, (mesh, made, begins), sum(array.nbytes for array in made.values()))

        return self._add(layout, write, keep=keep)

    def _add_copy(self, known: Arrays, counted_from: np.ndarray) -> int:
        def write(made: Arrays) -> None:
            for name, array in known.items():
                made[name][:] = array

        layout = {name: (array.dtype.str, array.shape) for name, array in known.items()}
        return self._add(layout, write, counted_from)

    def _add(
        self,
        layout: Layout,
        write: Callable[[Arrays], None],
        counted_from: np.ndarray = _ZEROS,
        keep: Callable[[Arrays, np.ndarray], None] = lambda _made, _begins: None,
    ) -> int:
        """Add the parts of one mesh, whose arrays `write` fills in place once all lengths are known; return its root.

        Its indices count from a node, part and block, (3,). `keep` receives the arrays in the end, and these numbers.
        """
        begins = np.array([self._n_nodes, self._n_parts, self._n_blocks])

        def write_here(made: Arrays) -> None:
            write(made)
            node, part, block = (begins - counted_from).tolist()
            if node or part or block:
                links, shapes = made["links"].reshape(-1, LINK), made["shapes"].reshape(-1, SHAPE)
                links += np.where(links >= 0, [node, node, part], 0)
                shapes[:, FIRST_BLOCK] += block
            keep(made, begins)

        self._added.append((layout, write_here))
        self._n_nodes += layout["links"][1][0] // LINK
        self._n_parts += layout["shapes"][1][0] // SHAPE
        self._n_blocks += layout["vertices"][1][0] // BLOCK
        return int(begins[0])

    def _single(
        self, kind: int, numbers: np.ndarray, centre: np.ndarray, radius: float, vertices: np.ndarray = _NO_VERTICES
    ) -> int:
        ball, link = np.array([*centre, radius]), np.array([-1, -1, 0])
        return self.add_parts(Parts(ball, link, np.array([kind, 0, len(vertices) // BLOCK]), numbers, vertices))


_DTYPES = {"balls": "<f8", "links": "<i8", "shapes": "<i8", "numbers": "<f8", "vertices": "<f4"}
"""Types of the arrays of `Parts`."""


def tree_above(bodies: Sequence[np.ndarray], roots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Halve bodies, corners (t, k, 3) [m] of each, along the widest side of their middles until each is alone.

    Return the ball about each node above their roots, (n - 1, 4) [m], and its children, (n - 1, 2); the root is first.
    """
    boxes = np.array([(some.min(axis=(0, 1)), some.max(axis=(0, 1))) for some in bodies])
    centres = boxes.mean(axis=1)
    radii = [np.linalg.norm(some - centre, axis=2).max() for some, centre in zip(bodies, centres, strict=True)]
    reach = np.array(radii)
    balls, links, pending = list[np.ndarray](), np.empty((len(bodies) - 1, 2), np.int64), [np.arange(len(bodies))]
    for members in pending:  # which grows
        middle = 0.5 * (boxes[members, 0].min(axis=0) + boxes[members, 1].max(axis=0))
        farthest = (np.linalg.norm(centres[members] - middle, axis=1) + reach[members]).max()
        order = members[np.argsort(centres[members, np.argmax(np.ptp(centres[members], axis=0))], kind="stable")]
        for side, half in enumerate(np.split(order, [len(order) // 2])):
            links[len(balls), side] = roots[half[0]] if len(half) == 1 else len(pending)
            pending += [half] if len(half) > 1 else []
        balls.append(np.array([*middle, farthest]))
    return np.array(balls), links


def tree_layout(triangles: int, nodes: int, clusters: Sequence[int], hull_blocks: int = 0, boxes: int = 0) -> Layout:
    """Lay out `Parts` of a mesh's tree, by its numbers of triangles, nodes, and nodes of each of `CLUSTERS`.

    Behind them there is room for blocks of vertices of a hull about all of it, and for boxes about larger nodes.
    """
    parts = triangles + sum(clusters) + (hull_blocks > 0) + boxes
    blocks = sum(many * _blocks(most) for most, many in zip(CLUSTERS, clusters, strict=True)) + hull_blocks + boxes
    sizes = BALL_ROW * nodes, LINK * nodes, SHAPE * parts, PART * parts, BLOCK * blocks
    return {name: (kind, (size,)) for (name, kind), size in zip(_DTYPES.items(), sizes, strict=True)}


def _in_blocks(vertices: np.ndarray) -> np.ndarray:
    """Arrange points (n, 3) in blocks of `LANES`, the last of them filled up, shape (k `BLOCK`,)."""
    blocks = -(-len(vertices) // LANES)
    padded = np.concatenate([vertices, np.repeat(vertices[:1], blocks * LANES - len(vertices), axis=0)])
    return padded.reshape(blocks, LANES, 3).transpose(0, 2, 1).ravel().astype(np.float32)


def _blocks(triangles: int) -> int:
    return -(-3 * triangles // LANES)


def write_triangles(corners: np.ndarray, made: Arrays) -> None:
    """Write triangles, corners (t, 3, 3) [m], as the first parts; `made` is as `tree_layout` has it, all zero."""
    made["numbers"].reshape(-1, PART)[: len(corners), :9] = corners.reshape(-1, 9)
    made["shapes"].reshape(-1, SHAPE)[: len(corners), KIND] = TRIANGLE


def write_clusters(corners: np.ndarray, clusters: tuple[Cluster, ...], made: Arrays) -> None:
    """Write the hulls of the clusters of a mesh as the parts behind its triangles, contiguous corners (t, 3, 3) [m].

    `made` is as `tree_layout` has it, with the tree's links.
    """
    part, block = len(corners), 0
    shapes, links = made["shapes"].reshape(-1, SHAPE), made["links"].reshape(-1, LINK)
    for nodes, members in clusters:
        count, each = len(nodes), _blocks(members.shape[1])
        rows = np.ascontiguousarray(members, np.int64)
        write_cluster_vertices(corners, rows, made["vertices"][BLOCK * block : BLOCK * (block + each * count)])
        shapes[part : part + count, KIND], shapes[part : part + count, BLOCKS] = POLYTOPE, each
        shapes[part : part + count, FIRST_BLOCK] = block + each * np.arange(count)
        links[nodes, OWN] = np.arange(part, part + count)
        part, block = part + count, block + each * count


def _write_hull(words: np.ndarray, made: Arrays) -> None:
    """Write a hull about all of a mesh, its vertices in blocks, as the last part; made as `tree_layout` has it."""
    shapes, blocks = made["shapes"].reshape(-1, SHAPE), len(words) // BLOCK
    made["vertices"][-len(words) :] = words
    shapes[-1] = POLYTOPE, len(made["vertices"]) // BLOCK - blocks, blocks
    made["links"][OWN] = len(shapes) - 1


def write_boxes(nodes: np.ndarray, boxes: np.ndarray, made: Arrays) -> None:
    """Write boxes, corners (k, 8, 3) [m], about all below nodes (k,) as the last parts, as `write_clusters` does."""
    shapes, links = made["shapes"].reshape(-1, SHAPE), made["links"].reshape(-1, LINK)
    vertices = made["vertices"].reshape(-1, 3, LANES)
    part, block, count = len(shapes) - len(nodes), len(vertices) - len(nodes), len(nodes)
    vertices[block:] = np.tile(boxes, (1, LANES // 8, 1)).swapaxes(1, 2)
    shapes[part:, KIND], shapes[part:, BLOCKS] = POLYTOPE, 1
    shapes[part:, FIRST_BLOCK] = block + np.arange(count)
    links[nodes, OWN] = part + np.arange(count)


_PLACED: BoundedMap[tuple[int, bytes | None], tuple[MeshTree, Arrays, np.ndarray]] = BoundedMap(PLACED_MESHES)
"""By a mesh's `id` and placement: the mesh, held so that no other gets its `id`, its rows, and what they count from."""

_KNOWN: BoundedMap[tuple[bytes, int], MeshTree] = BoundedMap(MESH_TREES)


def recall_mesh_tree(shape: Any) -> MeshTree:
    """Return the tree of a Coal mesh, built once for the same vertices."""
    key = (content_key(shape.vertices()), int(shape.num_tris))
    tree = _KNOWN.get(key)
    if tree is None:
        (vertices, faces), hull = triangulation(shape), hull_vertices(shape)
        tree = mesh_tree(vertices[faces], None if hull is None else polytope_about(hull))
        tree = _KNOWN.insert(key, tree, size_of(tree))
    return tree


NEAR_ORIGIN = 100.0  # a robot whose base is farther from the origin is seen from there [m]: docs/certificate.md


class BodyParts(NamedTuple):
    """Roots of bodies, shape (n,), their parts, and the anchor from which parts in the world are seen, (3,) [m]."""

    roots: np.ndarray
    parts: Parts
    anchor: np.ndarray


@memoized_for_alike
def robot_parts(group: PlanningGroup) -> BodyParts:
    """Build the convex parts of the robot's bodies in the frames of their joints; of fixed ones relative to an anchor.

    The anchor is the world's origin, or one of the bodies if that is far away, where single precision would be coarse.
    Raises UnsupportedShape if a shape is of a kind that the kernels don't know.
    """
    table, shapes = PartsTable(), group.geometry.geometryObjects
    fixed = [shape.placement.translation for shape in shapes if shape.parentJoint == 0]
    anchor = np.array(fixed[0]) if fixed and np.abs(fixed[0]).max() > NEAR_ORIGIN else np.zeros(3)
    roots = []
    for shape in shapes:
        shift = anchor if shape.parentJoint == 0 else np.zeros(3)
        roots.append(
            table.add_shape(shape.geometry, pin.SE3(shape.placement.rotation, shape.placement.translation - shift))
        )
    made = BodyParts(np.array(roots, np.int64), table.tables(), anchor)
    read_only(*made)
    return made
