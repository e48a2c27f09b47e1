"""Charged surfaces as tables for the field's kernels, with trees over faces whose multipole nodes stand for all below.

Columns and their order are those of kernels/field (field.py, faces.py, box.py), which read them by number. The
field near a surface is always that of each face. An opening is accuracy; block sizes and `LEAST_FACES` are time, and
change the field within that accuracy; service/docs/algorithm.md states `LEAST_FACES`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from guidefield.geometry.closed import numbered_edges
from guidefield.geometry.surfaces import Floats, Integers
from guidefield.kernels.field.box import FAR
from guidefield.kernels.field.faces import (
    AFTER,
    BOXES,
    CAPSULES,
    EDGES,
    FIRST_QUAD,
    FIRST_TRIANGLE,
    FIRST_VERTEX,
    FLAT,
    FLATTENED,
    FORM,
    HALF_ROWS,
    LENGTH,
    LINK_COLUMNS,
    LONGEST,
    ORDINARY,
    PAST_ROW,
    PAST_VERTEX,
    PLANES,
    POINTS,
    QUADRUPLE,
    SPHERES,
    SQUARED,
    TAU,
    THIRD,
)
from guidefield.kernels.field.field import (
    AREA,
    CAPSULE_COLUMNS,
    CAPSULE_RADIUS,
    CHARGE,
    CHARGE_PER_AREA,
    MOMENTS,
    NODE_COLUMNS,
    PLANE_COLUMNS,
    POINT_COLUMNS,
    QUAD_COLUMNS,
    SOFTENING,
    SPHERE_COLUMNS,
    SPHERE_RADIUS,
    TRIANGLE_COLUMNS,
    FieldTables,
    frozen,
)

__all__ = [
    "FieldTables", "convex_quads", "expand_at_angle", "expand_within", "field_tables", "never_expand", "pair_faces",
]  # fmt: skip

LEAF = 48  # most faces of a block in a tree, where expansions stand for those that are far

BLOCK = 128
"""Most faces of a block elsewhere: the more, the more share a corner, as long as they fit into the fastest cache."""

LEAST_FACES = 1000  # surfaces of fewer faces are only cut in blocks: a tree doesn't pay


class FaceNode(NamedTuple):
    """A node: the faces below it, the next node not below it, whether it is a leaf, whether it may be expanded."""

    faces: Integers
    skip: int
    leaf: bool
    expandable: bool


def build_face_trees(centroids: Floats, owners: Integers, least_faces: float) -> list[FaceNode]:
    """Build the nodes in depth-first order over faces with centroids (n, 3), a tree for each owner, shape (n,).

    Nodes are halved across their longest extent. Surfaces of fewer than `least_faces` have leaves only.
    """
    nodes: list[FaceNode] = []
    for owner in np.unique(owners):
        faces = np.flatnonzero(owners == owner)
        _split(nodes, faces, centroids, len(faces) >= least_faces)
    return nodes


def _split(nodes: list[FaceNode], faces: Integers, centroids: Floats, expandable: bool) -> None:
    at = len(nodes)
    if len(faces) <= (LEAF if expandable else BLOCK):
        nodes.append(FaceNode(faces, at + 1, True, expandable))
        return
    inner = expandable
    if inner:
        nodes.append(FaceNode(faces, 0, False, True))
    here = centroids[faces]
    axis = int(np.argmax(np.ptp(here, axis=0)))
    order = np.argsort(here[:, axis], kind="stable")
    middle = len(faces) // 2
    _split(nodes, faces[order[:middle]], centroids, expandable)
    _split(nodes, faces[order[middle:]], centroids, expandable)
    if inner:
        nodes[at] = FaceNode(faces, len(nodes), False, True)


def expansion(corners: Floats, charge: float) -> tuple[Floats, float, float]:
    """Return the row of a node over triangles (n, 3, 3) of a charge density, its radius, and tr Q / (q radius^2)."""
    across = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(across, axis=1)
    q = float(areas.sum()) * charge
    centre = (areas[:, None] * corners.mean(axis=1)).sum(axis=0) / areas.sum()
    v = corners - centre
    total = v.sum(axis=1)
    moments = np.einsum("n,nki,nkj->ij", areas * (charge / 12.0), v, v)
    moments += np.einsum("n,ni,nj->ij", areas * (charge / 12.0), total, total)
    radius = float(np.linalg.norm(v, axis=2).max())
    row = np.zeros(NODE_COLUMNS)
    row[:CHARGE], row[CHARGE] = centre, q
    row[MOMENTS:AREA] = moments[np.triu_indices(3)]
    row[AREA:CHARGE_PER_AREA] = across.sum(axis=0)
    row[CHARGE_PER_AREA] = charge
    spread = float(np.trace(moments)) / (q * radius**2) if q > 0.0 else 1.0
    return row, radius, spread


Opening = Callable[[Floats, Floats], Floats]
"""From radii and spreads of nodes the distances from which their expansions are used, all of shape (n,) [m]."""


def never_expand(radii: Floats, _spreads: Floats) -> Floats:
    """Expand no node: from radii and spreads of nodes, shape (n,), infinite distances, shape (n,)."""
    return np.full(len(radii), np.inf)


def expand_at_angle(theta: float) -> Opening:
    """Expand nodes of at most `theta` times their distance.

    Largest errors over meshes of 1000 to 80 000 triangles: 0.1: 3e-5, 0.2: 5e-4, 0.3: 7e-3 of the potential, and twice
    that of the gradient.
    """
    return lambda radii, _: radii / theta


def expand_within(error: float) -> Opening:
    """Expand nodes where the potential can't be off by more than a share of it, whatever the faces.

    From |x - s|^-3 = sum_k C_k(cos) |s|^k / |x|^(k+3), |C_k| <= (k+1)(k+2)/2, with theta = radius/|x|: the relative
    error is at most (1 + theta)^3 spread ((1 - theta)^-3 - 1 - 3 theta - 6 theta^2). As all terms of the potential are
    positive the sum over nodes is as good. What is found is a hundred times less: see `expand_at_angle`.
    """

    def reach(radii: Floats, spreads: Floats) -> Floats:
        low, high = np.zeros(len(radii)), np.full(len(radii), 0.999)
        for _ in range(60):
            theta = 0.5 * (low + high)
            # The bracket, without its cancellation where theta is small.
            rest = theta**3 * (10.0 - 15.0 * theta + 6.0 * theta**2) / (1.0 - theta) ** 3
            fits = (1.0 + theta) ** 3 * spreads * rest <= error
            low, high = np.where(fits, theta, low), np.where(fits, high, theta)
        found: Floats = radii / np.maximum(low, 1e-12)
        return found

    return reach


def field_tables(
    triangles: Floats | None = None,
    triangle_charge: Floats | None = None,
    spheres: Floats | None = None,
    capsules: Floats | None = None,
    planes: Floats | None = None,
    *,
    triangle_owner: Integers | None = None,
    quads: Floats | None = None,
    quad_charge: Floats | None = None,
    boxes: Floats | None = None,
    cloud: Floats | None = None,
    opening: Opening = never_expand,
) -> FieldTables:
    """Return the tables of what is charged; all in one frame, lengths in m, charges per area.

    Faces without area are left out: they have no charge.

    Args:
        triangles: Corners, counter-clockwise from outside, shape (n, 3, 3).
        triangle_charge: Charge of each triangle, shape (n,); 1 if not given.
        spheres: x, y, z, radius, charge; shape (m, 5).
        capsules: x0, y0, z0, x1, y1, z1, radius, charge; shape (c, 8).
        planes: Normal (3), offset, charge; shape (p, 5). The points with ``normal . x < offset`` are behind.
        triangle_owner: Which surface each triangle belongs to, shape (n,); all to one if not given. A large one becomes
            a tree.
        quads: Corners of flat convex quadrilaterals, counter-clockwise from outside, shape (k, 4, 3).
        quad_charge: Charge of each quad, shape (k,); 1 if not given.
        boxes: Centre (3), unit axes (3 x 3), full sizes along them (3), charge; shape (b, 16).
        cloud: x, y, z, area it represents times charge, softening length; shape (s, 5).
        opening: Distances from which expansions stand for the faces of large surfaces: `never_expand`, or what
            `expand_at_angle` or `expand_within` return.

    Raises:
        ValueError: if an array has another shape, is not finite, a radius or size is not positive or a normal not a
            unit one.
    """
    corners = _check("triangles", triangles, (3, 3))
    fours = _check("quads", quads, (4, 3))
    charge = _charges("triangle", triangle_charge, len(corners))
    four_charge = _charges("quad", quad_charge, len(fours))
    owners = np.zeros(len(corners), np.int64) if triangle_owner is None else np.asarray(triangle_owner, np.int64)
    balls, pills = _check("spheres", spheres, (SPHERE_COLUMNS,)), _check("capsules", capsules, (CAPSULE_COLUMNS,))
    walls, crates = _check("planes", planes, (PLANE_COLUMNS,)), _check("boxes", boxes, (16,))
    points = _check("cloud", cloud, (POINT_COLUMNS,)).copy()
    for name, size in (
        ("spheres", balls[:, SPHERE_RADIUS]),
        ("capsules", pills[:, CAPSULE_RADIUS]),
        ("cloud", points[:, SOFTENING]),
    ):
        if (size <= 0.0).any():
            raise ValueError(f"`{name}` must have positive radii, got {size.min()}")
    if (crates[:, 12:15] <= 0.0).any():
        raise ValueError(f"`boxes` must have positive sizes, got {crates[:, 12:15].min()}")
    for name, units in (("planes", walls[:, :3]), ("boxes", crates[:, 3:12].reshape(-1, 3))):
        if (np.abs(np.linalg.norm(units, axis=1) - 1.0) > 1e-9).any():
            raise ValueError(f"`{name}` must have unit normals")
    points[:, SOFTENING] **= 2
    faces = _faces(corners, charge, owners, fours, four_charge, opening)
    counts = {BOXES: len(crates), SPHERES: len(balls), CAPSULES: len(pills), PLANES: len(walls), POINTS: len(points)}
    faces = faces | _with_leaves(faces["nodes"], faces["links"], faces["reach"], counts)
    return FieldTables(
        origin=frozen(np.zeros(3)),
        boxes=frozen(_box_rows(crates)),
        spheres=frozen(balls),
        capsules=frozen(pills),
        planes=frozen(walls),
        cloud=frozen(points),
        **{name: frozen(array) for name, array in faces.items()},
    )


def _with_leaves(nodes: Floats, links: Integers, reach: Floats, counts: Mapping[int, int]) -> dict[str, np.ndarray]:
    """Return nodes, links and reach of trees and, behind them, of a leaf for all closed forms of each kind."""
    kinds = [(form, count) for form, count in counts.items() if count]
    added = np.zeros((len(kinds), LINK_COLUMNS), np.int64)
    added[:, AFTER] = len(links) + 1 + np.arange(len(kinds))
    added[:, [FORM, PAST_ROW]] = np.array(kinds, np.int64).reshape(-1, 2)
    return {
        "nodes": np.concatenate([nodes, np.zeros((len(kinds), NODE_COLUMNS))]),
        "links": np.concatenate([links, added]),
        "reach": np.concatenate([reach, np.full(len(kinds), np.inf)]),
    }


def convex_quads(vertices: Floats) -> tuple[Floats, Floats]:
    """Return flat convex polygons (..., k, 3) as quads (..., q, 4, 3) and, for odd k, a triangle (..., m, 3, 3).

    Each costs one arctangent: a polygon as a product of all its triangles saves nothing where gradients are asked for.
    """
    last = vertices.shape[-2] - 1
    quads = np.array([(0, i, i + 1, i + 2) for i in range(1, last - 1, 2)], np.int64).reshape(-1, 4)
    rest = np.array([(0, last - 1, last)] * (last % 2 == 0), np.int64).reshape(-1, 3)
    return vertices[..., quads, :], vertices[..., rest, :]


_FLAT_PAIR = 1e-7
"""Two triangles are one quadrilateral if each far corner is at most this share of their edge off the other's plane."""

_MOST_ROUNDS = 16  # most rounds of pairing free neighbours: all but a few triangles are paired after two or three


def pair_faces(vertices: Floats, triangles: Integers) -> tuple[Floats, Floats]:
    """Join neighbours in one plane across their longest edges to convex quads, which cost what one triangle does.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Shape (t, 3).

    Returns:
        Corners of the quads, shape (q, 4, 3), and of the other triangles, shape (t - 2 q, 3, 3) [m].
    """
    numbers, count = numbered_edges(triangles)
    order = np.argsort(numbers, kind="stable")
    starts = np.cumsum(np.bincount(numbers, minlength=count))[np.bincount(numbers, minlength=count) == 2] - 2
    first, second = order[starts], order[starts + 1]
    corners = [triangles[side // 3, (side + k) % 3] for side in (first, second) for k in range(3)]
    opposed = corners[0] == corners[4]
    first, second = first[opposed] // 3, second[opposed] // 3
    a, b, c, d = (vertices[corners[k][opposed]] for k in (0, 1, 2, 5))
    normal, other, length = np.cross(b - a, c - a), np.cross(d - a, b - a), np.linalg.norm(b - a, axis=1)
    heights = [np.abs(np.einsum("ij,ij->i", *sides)) for sides in ((normal, d - a), (other, c - a))]
    turns = [np.einsum("ij,ij->i", normal, np.cross(x, y)) for x, y in ((a - c, d - a), (b - d, c - b))]
    joins = heights[0] <= _FLAT_PAIR * length * np.linalg.norm(normal, axis=1)
    joins &= heights[1] <= _FLAT_PAIR * length * np.linalg.norm(other, axis=1)  # of a sliver any corner is near
    joins &= (np.einsum("ij,ij->i", normal, other) > 0.0) & (turns[0] > 0.0) & (turns[1] > 0.0)
    waiting = np.flatnonzero(joins)
    waiting = waiting[np.argsort(length[waiting], kind="stable")]
    free, chosen = np.ones(len(triangles), bool), list[Integers]()
    for _ in range(_MOST_ROUNDS):
        longest, places = np.full(len(triangles), -1), np.arange(len(waiting))
        longest[first[waiting]] = places
        np.maximum.at(longest, second[waiting], places)
        taken = waiting[(longest[first[waiting]] == places) & (longest[second[waiting]] == places)]
        chosen.append(taken)
        free[first[taken]] = free[second[taken]] = False
        waiting = waiting[free[first[waiting]] & free[second[waiting]]]
    pairs = np.concatenate(chosen)
    return np.stack([a[pairs], d[pairs], b[pairs], c[pairs]], axis=1), vertices[triangles[free]]


def _faces(
    corners: Floats,
    charge: Floats,
    owners: Integers,
    fours: Floats,
    four_charge: Floats,
    opening: Opening,
) -> dict[str, np.ndarray]:
    one, other = fours[:, [0, 1, 2]], fours[:, [0, 2, 3]]
    whole = (_areas(one) > 0.0) & (_areas(other) > 0.0)
    # A quad with a flat half is a triangle.
    corners = np.concatenate([corners, one[~whole], other[~whole]])
    charge = np.concatenate([charge, four_charge[~whole], four_charge[~whole]])
    next_owner = owners.max(initial=-1) + 1
    owners = np.concatenate([owners, np.full(2 * (~whole).sum(), next_owner)])
    solid = _areas(corners) > 0.0
    corners, charge, owners = corners[solid], charge[solid], owners[solid]
    one, other, four_charge = one[whole], other[whole], four_charge[whole]
    normal, half, ordered, ordinary = _halves(corners)
    normal1, half1, ordered1, ordinary1 = _halves(one)
    _, half2, ordered2, ordinary2 = _halves(other)
    faces = _Faces(
        triangles=np.concatenate([ordered[:, 0], normal, half], axis=1),
        triangle_corners=ordered,
        quads=np.concatenate([ordered1[:, 0], normal1, half1, half2], axis=1),
        quad_corners=np.concatenate([ordered1, ordered2], axis=1),
        charge=np.concatenate([charge, four_charge]),
        sliver=~np.concatenate([ordinary, ordinary1 & ordinary2]),
    )
    return _blocks(faces, np.concatenate([owners, np.full(len(one), next_owner)]), opening)


@dataclass(frozen=True, eq=False)
class _Faces:
    """Rows as kernels/field/faces.py has them, and corners; charge, and whether a sliver, of triangles, then quads."""

    triangles: Floats
    triangle_corners: Floats
    quads: Floats
    quad_corners: Floats
    charge: Floats
    sliver: np.ndarray


def _blocks(faces: _Faces, owners: Integers, opening: Opening) -> dict[str, np.ndarray]:
    """The faces in the order of the leaves of their trees: those of a tree charged alike, slivers last in a leaf."""
    ordered, pairs, count = faces.triangle_corners, faces.quad_corners, len(faces.triangles)
    centroids = np.concatenate([ordered.mean(axis=1), pairs.mean(axis=1)])
    alike = np.unique(np.column_stack([owners, faces.charge]), axis=0, return_inverse=True)[1].reshape(-1)
    nodes = build_face_trees(centroids, alike, np.inf if opening is never_expand else LEAST_FACES)
    rows, links = np.zeros((len(nodes), NODE_COLUMNS)), np.zeros((len(nodes), LINK_COLUMNS), np.int64)
    radii, spreads = np.full(len(nodes), np.inf), np.ones(len(nodes))
    vertices: list[Floats] = [np.empty((0, 3))]
    order: tuple[list[Integers], list[Integers]] = ([np.empty(0, np.int64)], [np.empty(0, np.int64)])
    corners: tuple[list[Integers], list[Integers]] = ([np.empty((0, 3), np.int64)], [np.empty((0, 6), np.int64)])
    vertex, counts = 0, [0, 0]
    for m, node in enumerate(nodes):
        links[m, AFTER] = node.skip
        rows[m, CHARGE_PER_AREA] = charge = float(faces.charge[node.faces[0]])
        here = node.faces[np.argsort(faces.sliver[node.faces], kind="stable")]
        kinds = here[here < count], here[here >= count] - count
        if node.expandable:
            below = np.concatenate([ordered[kinds[0]], pairs[kinds[1], :3], pairs[kinds[1], 3:]])
            rows[m], radii[m], spreads[m] = expansion(below, charge)
        if not node.leaf:
            continue
        used = np.concatenate([ordered[kinds[0]].reshape(-1, 3), pairs[kinds[1]].reshape(-1, 3)])
        unique, index = np.unique(used, axis=0, return_inverse=True)
        index = index.reshape(-1)
        vertices.append(unique)
        links[m, [FIRST_VERTEX, PAST_VERTEX]] = vertex, vertex + len(unique)
        vertex += len(unique)
        cut = 3 * len(kinds[0])
        for k, part in enumerate((index[:cut].reshape(-1, 3), index[cut:].reshape(-1, 6))):
            corners[k].append(part)
            order[k].append(kinds[k])
            whole = len(part) - int(faces.sliver[kinds[k] + k * count].sum())
            first = (FIRST_TRIANGLE, FIRST_QUAD)[k]
            links[m, first : first + 3] = counts[k], counts[k] + whole, counts[k] + len(part)
            counts[k] += len(part)
    return {
        "vertices": np.concatenate(vertices),
        "triangle_corners": np.concatenate(corners[0]),
        "triangles": faces.triangles[np.concatenate(order[0])].reshape(-1, TRIANGLE_COLUMNS),
        "quad_corners": np.concatenate(corners[1]),
        "quads": faces.quads[np.concatenate(order[1])].reshape(-1, QUAD_COLUMNS),
        "nodes": rows,
        "links": links,
        "reach": opening(radii, spreads),
    }


def _halves(corners: Floats) -> tuple[Floats, Floats, Floats, np.ndarray]:
    """Return unit normals, half rows (kernels/field/faces.py), corners with the longest edge first, and non-slivers.

    In extended precision where the machine has it, and normal and area from the two shortest edges: from the others
    a sliver would lose its length over its width in digits.
    """
    v = _longest_edge_first(corners.astype(np.longdouble))
    edge = v[:, 1] - v[:, 0]
    arm = v[:, 2] - v[:, 0]
    across = np.cross(v[:, 0] - v[:, 2], v[:, 1] - v[:, 2])
    twice_area = np.sqrt(_squares(across))
    length = np.sqrt(_squares(edge))
    t = edge / length[:, None]
    tau = (arm * t).sum(axis=1)
    squares = np.stack([_squares(v[:, (i + 2) % 3] - v[:, (i + 1) % 3]) for i in range(3)], axis=1)
    rows = np.zeros((len(v), HALF_ROWS))
    a = 2.0 * twice_area
    rows[:, QUADRUPLE], rows[:, SQUARED], rows[:, FLATTENED], rows[:, EDGES:LONGEST] = a, a * a, a * FLAT, squares
    rows[:, LONGEST:LENGTH], rows[:, LENGTH], rows[:, TAU] = t, length, tau
    rows[:, THIRD:] = arm - tau[:, None] * t
    ordinary = twice_area >= ORDINARY * length * length
    return (across / twice_area[:, None]).astype(np.float64), rows, v.astype(np.float64), ordinary


def _longest_edge_first(v: np.ndarray) -> np.ndarray:
    edges = np.stack([_squares(v[:, (i + 1) % 3] - v[:, i]) for i in range(3)], axis=1)
    order = (edges.argmax(axis=1)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(v, order[:, :, None], axis=1)


def _areas(corners: Floats) -> np.ndarray:
    v = corners.astype(np.longdouble)
    v = _longest_edge_first(v)
    return _squares(np.cross(v[:, 0] - v[:, 2], v[:, 1] - v[:, 2]))


def _box_rows(boxes: Floats) -> Floats:
    """Return the rows of kernels/field/box.py: axes from the longest side to the shortest, half sides."""
    order = np.argsort(-boxes[:, 12:15], axis=1, kind="stable")
    axes = np.take_along_axis(boxes[:, 3:12].reshape(-1, 3, 3), order[:, :, None], axis=1).reshape(-1, 9)
    halves = 0.5 * np.take_along_axis(boxes[:, 12:15], order, axis=1)
    far = FAR**2 * (halves * halves).sum(axis=1, keepdims=True)
    return np.concatenate([boxes[:, :3], axes, halves, boxes[:, 15:], far], axis=1)


def _squares(vectors: np.ndarray) -> np.ndarray:
    squares: np.ndarray = (vectors * vectors).sum(axis=1)
    return squares


def _charges(kind: str, given: Floats | None, count: int) -> Floats:
    charge = np.ones(count) if given is None else _check(f"{kind}_charge", given, ())
    if len(charge) != count:
        raise ValueError(f"`{kind}_charge` must be as many as `{kind}s` ({count}), got {len(charge)}")
    return charge


def _check(name: str, values: Floats | None, shape: tuple[int, ...]) -> Floats:
    array = np.zeros((0, *shape)) if values is None else np.asarray(values, dtype=np.float64)
    if array.shape[1:] != shape or array.ndim != len(shape) + 1:
        raise ValueError(f"`{name}` must have shape {('n', *shape)}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"`{name}` must be finite")
    return array
