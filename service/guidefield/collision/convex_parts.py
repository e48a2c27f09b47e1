"""Coal shapes as the kernels' convex parts: a primitive or hull is one part, a triangle mesh a tree of triangles."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import coal
import numpy as np

from guidefield.bounded_map import MESH_TREES, PLACED_MESHES, BoundedMap
from guidefield.geometry.decomposition import Decomposition
from guidefield.geometry.entries import Arrays, Layout, in_memory
from guidefield.geometry.mesh_pieces import pieces_tree, remembered_tree
from guidefield.geometry.mesh_tree import CLUSTERS, Cluster, MeshTree, mesh_tree, polytope_about, spread_points
from guidefield.geometry.placements import moved
from guidefield.kernels.collide.balls import BALL_ROW
from guidefield.kernels.collide.parts import (
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
    SURFACE,
    TRIANGLE,
    Parts,
    write_cluster_vertices,
)
from guidefield.kernels.collide.primitive import CAPSULE, CYLINDER, HALF_SPACE
from guidefield.kernels.simd.blocks import BLOCK
from guidefield.kernels.simd.vector_model import LANES
from guidefield.memo import size_of
from guidefield.read_only import read_only
from guidefield.robot.model.shapes import hull_vertices, triangulation

_NO_VERTICES, _ZEROS = np.empty(0, np.float32), np.zeros(3, np.int64)


class UnservedError(Exception):
    """What the lane kernels don't know: a kind of shape that neither robots nor scenes are made of."""


class PartsTable:
    """Collects the parts of bodies."""

    def __init__(self) -> None:
        self._added: list[tuple[Layout, Callable[[Arrays], None]]] = []
        self._alone: Parts | None = None
        self._pieces: dict[int, np.ndarray] = {}
        self._n_nodes = self._n_parts = self._n_blocks = 0

    def add_shape(self, shape: Any, placement: Any) -> int:  # noqa: PLR0911  one for each kind
        """Add a Coal shape that stands at a pinocchio.SE3 in its body; the root of its tree.

        Raises:
            UnservedError: if it is of a kind that the kernels don't know.
        """
        numbers = np.zeros(PART)
        numbers[:12] = np.c_[placement.rotation, placement.translation].ravel()
        centre = placement.translation
        if isinstance(shape, coal.BVHModelBase):
            return self._mesh(_known_mesh(shape), placement)
        if isinstance(shape, coal.Convex):
            return self._polytope(moved(placement, np.array(shape.points())))
        if isinstance(shape, coal.Box):
            corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * np.array(shape.halfSide)
            return self._polytope(moved(placement, corners))
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
        raise UnservedError(type(shape).__name__)

    def add_tree(self, mesh: MeshTree) -> int:
        """Add a mesh in the body's frame; the root of its tree."""
        return self._mesh(mesh, None)

    def add_parts(self, alone: Parts) -> int:
        """Add the parts of bodies that were made alone; where their first node is: of one body, its root."""
        self._alone = alone
        return self._add_copy(alone._asdict(), _ZEROS)

    def add_surface(self, shape: Any, placement: Any) -> int:
        """Add a Coal mesh as its triangles, that stands at a pinocchio.SE3 in its body; the root of its tree."""
        return self._mesh(known_surface(shape), placement)

    def add_pieces(self, shape: Any, cut: Decomposition, placement: Any) -> int:
        """Add a Coal mesh in convex parts that stands at a pinocchio.SE3 in its body; the root of its tree."""
        return self._mesh(known_pieces(shape, cut), placement)

    def pieces(self, root: int) -> np.ndarray:
        """Nodes, shape (k,), that together are all of a body, each nearly convex; the root itself where that is."""
        return self._pieces.get(root, np.array([root]))

    def tables(self) -> Parts:
        """The parts that were added, frozen."""
        alone = self._alone if len(self._added) == 1 else None  # of one mesh of a million triangles no copy is made
        parts = alone or Parts(**self._written())
        read_only(*parts)
        return parts

    def _written(self) -> Arrays:
        sizes = {name: sum(layout[name][1][0] for layout, _ in self._added) for name in _KINDS}
        made = in_memory({name: (kind, (sizes[name],)) for name, kind in _KINDS.items()})
        begins = dict.fromkeys(_KINDS, 0)
        for layout, write in self._added:
            ends = {name: begins[name] + layout[name][1][0] for name in _KINDS}
            write({name: made[name][begins[name] : ends[name]] for name in _KINDS})
            begins = ends
        return made

    def _mesh(self, mesh: MeshTree, placement: Any | None) -> int:
        """Add a mesh that stands at a pinocchio.SE3, or where it is; the root of its tree."""
        key = (id(mesh), None if placement is None else placement.homogeneous.tobytes())
        known = _PLACED.get(key)
        if known is not None:
            root = self._add_copy(known[1], known[2])
            self._pieces[root] = root + mesh.pieces
            return root

        def there(points: np.ndarray) -> np.ndarray:
            return points if placement is None else moved(placement, points)

        hulls = [(node, kind, there(points)) for node, kind, points in _hulls_of(mesh)]
        counts = [len(nodes) for nodes, _ in mesh.clusters]
        layout = tree_layout(len(mesh.corners), len(mesh.balls), counts, [len(points) for *_, points in hulls])

        def write(made: Arrays) -> None:
            made["balls"][:] = mesh.balls.ravel()
            if placement is not None:
                made["balls"].reshape(-1, BALL_ROW)[:, :3] = there(mesh.balls[:, :3])
            made["links"][:] = mesh.links.ravel()
            corners = np.ascontiguousarray(there(mesh.corners.reshape(-1, 3)).reshape(-1, 3, 3))
            write_triangles(corners, made)
            write_clusters(corners, mesh.clusters, made)
            write_hulls(hulls, made)

        def keep(made: Arrays, begins: np.ndarray) -> None:
            _PLACED.put(key, (mesh, made, begins), sum(array.nbytes for array in made.values()))

        root = self._add(layout, write, keep=keep)
        self._pieces[root] = root + mesh.pieces
        return root

    def _add_copy(self, known: Arrays, counted_from: np.ndarray) -> int:
        """Add a copy of parts whose first node, part and block, shape (3,), were those; its root."""

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
        """Add the parts of one mesh; its root.

        Args:
            layout: Of its arrays.
            write: Writes them where they stay, once all are known.
            counted_from: The first node, part and block that are written, shape (3,).
            keep: Is given the arrays in the end, and their first node, part and block.
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

    def _polytope(self, vertices: np.ndarray) -> int:
        centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        radius = float(np.linalg.norm(vertices - centre, axis=1).max())
        return self._single(POLYTOPE, np.zeros(PART), centre, radius, _in_blocks(vertices))

    def _single(
        self, kind: int, numbers: np.ndarray, centre: np.ndarray, radius: float, vertices: np.ndarray = _NO_VERTICES
    ) -> int:
        """Add one part, with its vertices in blocks and a ball about it; its node."""
        ball, link = np.array([*centre, radius]), np.array([-1, -1, 0])
        return self.add_parts(Parts(ball, link, np.array([kind, 0, len(vertices) // BLOCK]), numbers, vertices))


_KINDS = {"balls": "<f8", "links": "<i8", "shapes": "<i8", "numbers": "<f8", "vertices": "<f4"}
"""Types of the arrays of `Parts`."""


def tree_layout(
    triangles: int, nodes: int, clusters: Sequence[int], hulls: Sequence[int] = (), boxes: int = 0
) -> Layout:
    """The arrays of `Parts` for the tree of a mesh.

    Args:
        triangles: How many triangles it has.
        nodes: How many nodes.
        clusters: How many of these are of each of `CLUSTERS`.
        hulls: How many points each of the hulls has, about all that is below a node.
        boxes: How many larger ones have a box.
    """
    parts = triangles + sum(clusters) + len(hulls) + boxes
    blocks = sum(many * _blocks(most) for most, many in zip(CLUSTERS, clusters, strict=True)) + boxes
    blocks += sum(-(-points // LANES) for points in hulls)
    sizes = BALL_ROW * nodes, LINK * nodes, SHAPE * parts, PART * parts, BLOCK * blocks
    return {name: (kind, (size,)) for (name, kind), size in zip(_KINDS.items(), sizes, strict=True)}


def _hulls_of(mesh: MeshTree) -> Iterator[tuple[int, int, np.ndarray]]:
    """Hulls of all that is below some nodes, and points of the surface of a mesh's pieces: node, kind and points."""
    for node, hull in mesh.hulls.items():
        yield node, POLYTOPE, hull
        if len(mesh.pieces) > 1 and node in mesh.pieces:
            yield node, SURFACE, spread_points(mesh, node)


def _in_blocks(vertices: np.ndarray) -> np.ndarray:
    """Points (n, 3) in blocks of `LANES`, the last of them filled up, shape (k `BLOCK`,)."""
    blocks = -(-len(vertices) // LANES)
    padded = np.concatenate([vertices, np.repeat(vertices[:1], blocks * LANES - len(vertices), axis=0)])
    return padded.reshape(blocks, LANES, 3).transpose(0, 2, 1).ravel().astype(np.float32)


def _blocks(triangles: int) -> int:
    """In how many blocks the corners of a cluster are."""
    return -(-3 * triangles // LANES)


def write_triangles(corners: np.ndarray, made: Arrays) -> None:
    """Write the triangles of a mesh as its first parts.

    Args:
        corners: Shape (t, 3, 3) [m].
        made: As `tree_layout` has them, all zero.
    """
    made["numbers"].reshape(-1, PART)[: len(corners), :9] = corners.reshape(-1, 9)
    made["shapes"].reshape(-1, SHAPE)[: len(corners), KIND] = TRIANGLE


def write_clusters(corners: np.ndarray, clusters: tuple[Cluster, ...], made: Arrays) -> None:
    """Write the hulls of the clusters of a mesh as the parts behind its triangles.

    Args:
        corners: Of the triangles, contiguous, shape (t, 3, 3) [m].
        clusters: As of `MeshTree`.
        made: As `tree_layout` has them, with the tree's links.
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


def write_hulls(hulls: Sequence[tuple[int, int, np.ndarray]], made: Arrays) -> None:
    """Write hulls and points of surfaces as the last parts; what a hull is apart from, all that is below its node is.

    Args:
        hulls: Node, kind and points, shape (n, 3) [m].
        made: As `tree_layout` has them, with the tree's links.
    """
    shapes, links = made["shapes"].reshape(-1, SHAPE), made["links"].reshape(-1, LINK)
    written = [_in_blocks(points) for *_, points in hulls]
    part, block = len(shapes) - len(hulls), (len(made["vertices"]) - sum(map(len, written))) // BLOCK
    for (node, kind, _), words in zip(hulls, written, strict=True):
        made["vertices"][BLOCK * block : BLOCK * block + len(words)] = words
        shapes[part] = kind, block, len(words) // BLOCK
        if kind == POLYTOPE:
            links[node, OWN] = part
        part, block = part + 1, block + len(words) // BLOCK


def write_boxes(nodes: np.ndarray, boxes: np.ndarray, made: Arrays) -> None:
    """Write boxes about all that is below some nodes as the last parts.

    Args:
        nodes: Shape (k,).
        boxes: Their corners, shape (k, 8, 3) [m].
        made: As `tree_layout` has them, with the tree's links.
    """
    shapes, links = made["shapes"].reshape(-1, SHAPE), made["links"].reshape(-1, LINK)
    vertices = made["vertices"].reshape(-1, 3, LANES)
    part, block, count = len(shapes) - len(nodes), len(vertices) - len(nodes), len(nodes)
    vertices[block:] = np.tile(boxes, (1, LANES // 8, 1)).swapaxes(1, 2)
    shapes[part:, KIND], shapes[part:, BLOCKS] = POLYTOPE, 1
    shapes[part:, FIRST_BLOCK] = block + np.arange(count)
    links[nodes, OWN] = part + np.arange(count)


_PLACED: BoundedMap[tuple[int, bytes | None], tuple[MeshTree, Arrays, np.ndarray]] = BoundedMap(PLACED_MESHES)
"""By mesh, held so that no other gets its number, and placement: rows of a table, and what they count from."""

_KNOWN: BoundedMap[tuple[bytes, int, str], MeshTree] = BoundedMap(MESH_TREES)


def _known_mesh(shape: Any) -> MeshTree:
    """The tree of a Coal mesh, made once for the same vertices."""
    return _known(shape, pieces_tree, "as it is")


def known_pieces(shape: Any, cut: Decomposition) -> MeshTree:
    """The tree of a Coal mesh in convex parts, made once for the same vertices, and kept on disk."""
    return _known(shape, lambda vertices, faces: remembered_tree(vertices, faces, cut), "in convex parts")


def known_surface(shape: Any) -> MeshTree:
    """The tree of a Coal mesh as its triangles, made once for the same vertices."""

    def make(vertices: np.ndarray, faces: np.ndarray) -> MeshTree:
        hull = hull_vertices(shape)
        return mesh_tree(vertices[faces], None if hull is None else polytope_about(hull))

    return _known(shape, make, "as its triangles")


def _known(shape: Any, make: Callable[[np.ndarray, np.ndarray], MeshTree], how: str) -> MeshTree:
    """The tree of a Coal mesh, made in some way once."""
    digest = hashlib.blake2b(shape.vertices().tobytes(), digest_size=32).digest()
    key = (digest, int(shape.num_tris), how)
    tree = _KNOWN.get(key)
    if tree is None:
        tree = make(*triangulation(shape))
        tree = _KNOWN.put(key, tree, size_of(tree))
    return tree
