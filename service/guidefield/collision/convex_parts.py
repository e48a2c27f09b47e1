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
from guidefield.geometry.mesh_tree import CLUSTERS, Cluster, MeshTree, mesh_tree, spread_points
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
from guidefield.robot.model.shapes import triangulation


class UnservedError(Exception):
    """What the lane kernels don't know: a kind of shape that neither robots nor scenes are made of."""


class PartsTable:
    """Collects the parts of bodies."""

    def __init__(self) -> None:
        self._balls: list[np.ndarray] = []
        self._links: list[np.ndarray] = []
        self._shapes: list[np.ndarray] = []
        self._numbers: list[np.ndarray] = []
        self._vertices: list[np.ndarray] = []
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
        """Add a mesh in the body's frame to a table that is empty; the root of its tree."""
        self.add_moved(mesh, None)
        return 0

    def add_parts(self, alone: Parts) -> int:
        """Add the parts of bodies that were made alone; where their first node is: of one body, its root."""
        return self._add(alone, np.zeros(1, np.int64))

    def add_surface(self, shape: Any, placement: Any) -> int:
        """Add a Coal mesh as its triangles, that stands at a pinocchio.SE3 in its body; the root of its tree."""
        return self._mesh(known_surface(shape), placement)

    def add_pieces(self, shape: Any, cut: Decomposition, placement: Any) -> int:
        """Add a Coal mesh in convex parts that stands at a pinocchio.SE3 in its body; the root of its tree."""
        return self._mesh(known_pieces(shape, cut), placement)

    def pieces(self, root: int) -> np.ndarray:
        """Nodes, shape (k,), that together are all of a body, each nearly convex; the root itself where that is."""
        return self._pieces.get(root, np.array([root]))

    def _mesh(self, mesh: MeshTree, placement: Any) -> int:
        """Add a mesh that stands at a pinocchio.SE3 in its body; the root of its tree."""
        return self._add(_mesh_alone(mesh, placement), mesh.pieces)

    def _add(self, alone: Parts, pieces: np.ndarray) -> int:
        """Add the parts of one mesh, in pieces from some nodes on; the root of its tree."""
        root = self._n_nodes
        links, shapes = alone.links.reshape(-1, LINK), alone.shapes.reshape(-1, SHAPE)
        self._balls.append(alone.balls)
        if root:
            links = links + np.where(links >= 0, [root, root, self._n_parts], 0)
            shapes = shapes + np.array([0, self._n_blocks, 0])
        self._links.append(links.ravel())
        self._shapes.append(shapes.ravel())
        self._numbers.append(alone.numbers)
        self._vertices.append(alone.vertices)
        self._pieces[root] = root + pieces
        self._n_nodes += len(links)
        self._n_parts += len(shapes)
        self._n_blocks += len(alone.vertices) // BLOCK
        return root

    def add_moved(self, mesh: MeshTree, placement: Any | None) -> None:
        """Add a mesh that stands at a pinocchio.SE3 to a table that is empty: its root is 0; None: where it is."""

        def there(points: np.ndarray) -> np.ndarray:
            return points if placement is None else moved(placement, points)

        counts, hulls = [len(nodes) for nodes, _ in mesh.clusters], list(_hulls_of(mesh))
        made = in_memory(tree_layout(len(mesh.corners), len(mesh.balls), counts, [len(points) for *_, points in hulls]))
        made["balls"][:] = mesh.balls.ravel()
        if placement is not None:
            made["balls"].reshape(-1, 4)[:, :3] = there(mesh.balls[:, :3])
        made["links"][:] = mesh.links.ravel()
        corners = np.ascontiguousarray(there(mesh.corners.reshape(-1, 3)).reshape(-1, 3, 3))
        write_triangles(corners, made)
        write_clusters(corners, mesh.clusters, made)
        write_hulls([(node, kind, there(points)) for node, kind, points in hulls], made)
        self._n_nodes, self._n_parts = len(mesh.balls), len(made["shapes"]) // SHAPE
        self._n_blocks = len(made["vertices"]) // BLOCK
        self._numbers.append(made["numbers"])
        self._shapes.append(made["shapes"])
        self._vertices.append(made["vertices"])
        self._balls.append(made["balls"])
        self._links.append(made["links"])

    def _add_vertices(self, vertices: np.ndarray) -> int:
        """Add vertices in blocks; how many blocks."""
        blocks = _in_blocks(vertices)
        self._vertices.append(blocks)
        return len(blocks) // BLOCK

    def tables(self) -> Parts:
        """What was added, frozen."""
        arrays = (
            _behind_one_another(self._balls, float),
            _behind_one_another(self._links, np.int64),
            _behind_one_another(self._shapes, np.int64),
            _behind_one_another(self._numbers, float),
            _behind_one_another(self._vertices, np.float32),
        )
        for array in arrays:
            array.setflags(write=False)
        return Parts(*arrays)

    def _polytope(self, vertices: np.ndarray) -> int:
        blocks = self._add_vertices(vertices)
        centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        radius = float(np.linalg.norm(vertices - centre, axis=1).max())
        self._n_blocks += blocks
        return self._single(POLYTOPE, np.zeros(PART), centre, radius, blocks)

    def _single(self, kind: int, numbers: np.ndarray, centre: np.ndarray, radius: float, blocks: int = 0) -> int:
        """Add one part, whose vertices are the last blocks, with a ball about it; its node."""
        self._shapes.append(np.array([kind, self._n_blocks - blocks, blocks]))
        self._numbers.append(numbers)
        self._links.append(np.array([-1, -1, self._n_parts]))
        self._balls.append(np.array([*centre, radius]))
        self._n_parts += 1
        self._n_nodes += 1
        return self._n_nodes - 1


def _behind_one_another(arrays: list[np.ndarray], kind: type) -> np.ndarray:
    """Arrays of one type, one behind the other; of one mesh of a million triangles they are not copied."""
    some = [array for array in arrays if len(array)]
    return some[0] if len(some) == 1 else np.concatenate([np.empty(0, kind), *some])


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
    return {
        "balls": ("<f8", (BALL_ROW * nodes,)),
        "links": ("<i8", (LINK * nodes,)),
        "shapes": ("<i8", (SHAPE * parts,)),
        "numbers": ("<f8", (PART * parts,)),
        "vertices": ("<f4", (BLOCK * blocks,)),
    }


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


def _mesh_alone(mesh: MeshTree, placement: Any) -> Parts:
    """The tables of a mesh that stands at a pinocchio.SE3, as if there were no other; the last ones are kept."""
    key = (id(mesh), placement.homogeneous.tobytes())
    known = _ALONE.get(key)
    if known is None:
        table = PartsTable()
        table.add_moved(mesh, placement)
        parts = table.tables()
        known = _ALONE.put(key, (mesh, parts), sum(array.nbytes for array in parts))
    return known[1]


_ALONE: BoundedMap[tuple[int, bytes], tuple[MeshTree, Parts]] = BoundedMap(PLACED_MESHES)
"""By mesh, which is held as well so that no other gets its number, and placement."""

_KNOWN: BoundedMap[tuple[bytes, int, str], MeshTree] = BoundedMap(MESH_TREES)


def _known_mesh(shape: Any) -> MeshTree:
    """The tree of a Coal mesh, made once for the same vertices."""
    return _known(shape, pieces_tree, "as it is")


def _surface_tree(vertices: np.ndarray, faces: np.ndarray) -> MeshTree:
    return mesh_tree(vertices[faces])


def known_pieces(shape: Any, cut: Decomposition) -> MeshTree:
    """The tree of a Coal mesh in convex parts, made once for the same vertices, and kept on disk."""
    return _known(shape, lambda vertices, faces: remembered_tree(vertices, faces, cut), "in convex parts")


def known_surface(shape: Any) -> MeshTree:
    """The tree of a Coal mesh as its triangles, made once for the same vertices."""
    return _known(shape, _surface_tree, "as its triangles")


def _known(shape: Any, make: Callable[[np.ndarray, np.ndarray], MeshTree], how: str) -> MeshTree:
    """The tree of a Coal mesh, made in some way once."""
    digest = hashlib.blake2b(shape.vertices().tobytes(), digest_size=32).digest()
    key = (digest, int(shape.num_tris), how)
    tree = _KNOWN.get(key)
    if tree is None:
        tree = make(*triangulation(shape))
        tree = _KNOWN.put(key, tree, size_of(tree))
    return tree
