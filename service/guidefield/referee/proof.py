"""Read proofs from files (docs/referee.md), each with its case, and check that their shapes contain the case's bodies.

Names, widths and order of `Proof` are those that `prove/proof.py` and `case_file.py` write; a change needs a new number
in `FORMATS`. Sizes and indices are checked here, truth in `replay.py`.

Every triangle of a mesh, every point of a cloud, and a primitive as a whole, has to be in one of the nodes that aren't
divided, and in everything that holds this one. Then what keeps away from the nodes that a slab is between keeps away
from all of the body that is below them.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np

from guidefield.referee.case import Body
from guidefield.referee.loading import UnusableFile
from guidefield.referee.shapes import distinct, hull

FORMATS = ("guidefield proofs 2", "guidefield proofs 1")
"""Formats that are read; the first one is written. Cases have the format of the same number in `loading.FORMATS`."""

LARGEST = 2**31  # the largest proof that is read, unpacked [bytes]: a file of some MB could hold arrays of terabytes

WIDTHS = {"claims": 4, "segments": 2, "slab_nodes": 2, "slab_axes": 3, "views": 3, "origins": 3, "centres": 3}
WIDTHS |= {"node_children": 2, "node_shapes": 2, "shape_numbers": 5, "corners": 3}

LENGTHS = [("slab_segments", "slab_nodes", "slab_axes"), ("bodies", "numbers", "origins", "centres")]
LENGTHS += [("node_bodies", "node_children", "node_shapes")]


@dataclass(frozen=True, eq=False)
class Proof:
    """The content of a proof; nothing of it is believed."""

    # begin and end of a time; 1 for pairs of the robot with itself, 0 for those with obstacles; a distance that all of
    # them keep then, which counts if it is more than is required, shape (c, 4) [s, s, -, m]
    claims: np.ndarray
    segments: np.ndarray  # begin and end of each, shape (s, 2) [s, or knots]
    slab_segments: np.ndarray  # the segment of each slab, shape (k,)
    slab_nodes: np.ndarray  # the two nodes of bodies' trees that it separates, shape (k, 2)
    # its direction in the world, from the second node to the first, shape (k, 3); 0: the spheres about both nodes are
    # apart along the line between their centres
    slab_axes: np.ndarray
    joints: np.ndarray  # names of joints
    views: np.ndarray  # two bodies, and the joint in whose frame their motion is bounded, shape (p, 3)
    bodies: np.ndarray  # link, held object or obstacle of each body
    numbers: np.ndarray  # which of the bodies of that name it is, shape (b,)
    # from where its lengths are measured, shape (b, 3) [m]: in the shape's frame, of an obstacle where it is at first,
    # in the world
    origins: np.ndarray
    centres: np.ndarray  # centre of a sphere about it, from there, shape (b, 3) [m]
    node_bodies: np.ndarray  # the body of each node, shape (n,)
    node_children: np.ndarray  # the two nodes that it is divided into, -1 where it isn't, shape (n, 2)
    node_shapes: np.ndarray  # a sphere, and another shape, that contain all of it; -1 where none is given, shape (n, 2)
    shape_begins: np.ndarray  # begin of each shape's corners, and the number of all, shape (h + 1,)
    # radii of a ball and a disc, whose Minkowski sum with the corners' hull the shape is, and the disc's axis, shape
    # (h, 5) [m]; a half-space has an infinite ball, its offset and its normal
    shape_numbers: np.ndarray
    corners: np.ndarray  # shape (c, 3) [m]


NAMES = tuple(field.name for field in fields(Proof))


def is_proof(path: Path) -> bool:
    """Return whether a file begins as a zip archive of arrays: so do proofs, and cases don't."""
    with path.open("rb") as file:
        return file.read(2) == b"PK"


def load_proofs(path: Path) -> list[tuple[dict[str, Any], Proof]]:
    """Read proofs, each with the case that it is about, as JSON has it.

    Raises:
        UnusableFile: if they can't be used, with what is wrong.
        OSError: if the file can't be read.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            size = sum(one.file_size for one in file.zip.infolist())
            if size > LARGEST:
                raise UnusableFile(f"{path.name} has {size} bytes unpacked, at most {LARGEST} are read")
            arrays = {name: file[name] for name in file.files}
        told, said = str(arrays.pop("format")), str(arrays.pop("digest"))
        if told not in FORMATS:
            raise UnusableFile(f"{path.name} must have `format` {FORMATS[0]!r}")
        if said != digest(arrays):
            raise UnusableFile(f"{path.name} has been changed: its digest is another one")
        first, *others = json.loads(arrays.pop("cases").tobytes())
        cases = [first, *(first | other for other in others)]
        proofs = [proof_of({name: arrays.pop(f"{k}/{name}") for name in NAMES}) for k in range(len(cases))]
        if arrays:
            raise UnusableFile(f"{path.name} has arrays of no case: {', '.join(sorted(arrays))}")
        return list(zip(cases, proofs, strict=True))
    except UnusableFile:
        raise
    except (
        KeyError,
        ValueError,
        TypeError,
        zlib.error,
        zipfile.BadZipFile,
        EOFError,
        MemoryError,
        RecursionError,
    ) as error:
        raise UnusableFile(f"{path.name} is no proof: {error}") from None


def digest(arrays: Mapping[str, np.ndarray]) -> str:
    """Return the SHA-256, in hexadecimal, of the names, types, shapes and bytes of arrays, in the order of names."""
    found = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        found.update(f"{name} {array.dtype.str} {array.shape};".encode() + array.tobytes())
    return found.hexdigest()


def proof_of(arrays: dict[str, np.ndarray]) -> Proof:
    """Build a proof of arrays, checked for the shapes in `Proof`, for indices within range, and finite numbers.

    Raises:
        UnusableFile: if one is wrong.
    """
    p = Proof(**{name: arrays[name] for name in NAMES})
    for name, array in vars(p).items():
        if name in ("joints", "bodies"):
            continue
        if array.dtype.kind not in "if" or array.shape[1:] != ((WIDTHS[name],) if name in WIDTHS else ()):
            raise UnusableFile(f"`{name}` has another shape")
        if name != "shape_numbers" and not np.isfinite(array).all():
            raise UnusableFile(f"`{name}` must have finite numbers")
    nodes, shapes, child = len(p.node_bodies), len(p.shape_numbers), p.node_children
    divided = child[:, 0] >= 0
    if not _within(child[divided], nodes):
        raise UnusableFile("the proof contradicts itself (a node's child is none)")
    once = np.bincount(child[divided].ravel(), minlength=nodes) if divided.any() else np.zeros(nodes, int)
    counts = np.diff(p.shape_begins)[:shapes]
    balls = np.where(np.isinf(p.shape_numbers[:, 0]), 0.0, p.shape_numbers[:, 0])
    right = [
        *(len({len(getattr(p, name)) for name in names}) == 1 for names in LENGTHS),
        len(p.segments) > 0,
        len(p.shape_begins) == shapes + 1 and p.shape_begins[0] == 0 and p.shape_begins[-1] == len(p.corners),
        ((counts > 0) | ((counts == 0) & np.isinf(p.shape_numbers[: len(counts), 0]))).all(),
        np.isfinite(p.shape_numbers[:, 1:]).all() and (balls >= 0.0).all(),
        _within(p.slab_segments, len(p.segments)) and _within(p.slab_nodes, nodes),
        _within(p.views[:, :2], len(p.bodies)) and _within(p.views[:, 2], len(p.joints)),
        _within(p.node_bodies, len(p.bodies)) and _within(p.node_shapes + 1, shapes + 1),
        (divided == (child[:, 1] >= 0)).all() and (once <= 1).all(),
        (child[divided] > np.flatnonzero(divided)[:, None]).all(),
        (p.node_bodies[child[divided]] == p.node_bodies[divided, None]).all(),
        (p.segments[:, 0] <= p.segments[:, 1]).all(),
    ]
    if not all(right):
        raise UnusableFile(f"the proof contradicts itself ({right.index(False)})")
    return p


def _within(indices: np.ndarray, count: int) -> bool:
    return bool(indices.dtype.kind == "i" and ((indices >= 0) & (indices < count)).all())


# with other numbers the bounds below are bounds, too, but take longer, or are looser: true proofs are refused then
NEAR = 1e-5  # a point farther than this from all corners of a shape isn't taken for one of them [m]
CLOSE = 1e-7  # a point this near to a corner needs no test by planes [m]: that is single precision
ONTO_PLANES = 8  # projections of a point onto the plane that it is farthest beyond: more bound flat hulls closer
MANY = 200_000  # above this many distances from points to corners the planes are tested first, to save time


class Declared(NamedTuple):
    """A body as it is declared, in its shape's frame: Minkowski sums of hulls of points, a disc and a ball."""

    points: np.ndarray  # shape (p, 3) [m]
    items: np.ndarray  # points of each hull, shape (t, k)
    ball: float  # radius of the ball [m]
    disc: float  # radius of the disc [m]
    axis: np.ndarray  # the disc's, shape (3,)
    plane: np.ndarray  # outward normal and offset of a half-space, shape (4,); of bounded bodies 0


class Shapes(NamedTuple):
    """Convex shapes in the frame of a body: Minkowski sums of a hull of corners, a disc and a ball."""

    begins: np.ndarray  # begin of each shape's corners, and the number of all, shape (h + 1,)
    balls: np.ndarray  # radius of the ball, shape (h,) [m]; infinite of a half-space
    discs: np.ndarray  # radius of the disc, shape (h,) [m]; of a half-space its offset
    axes: np.ndarray  # the disc's axis, shape (h, 3); of a half-space its outward normal
    corners: np.ndarray  # shape (c, 3) [m]


def declared(body: Body) -> Declared:
    """Describe a body as its case declares it."""
    exact, none, z = body.exact, np.zeros(4), np.array([0.0, 0.0, 1.0])
    if isinstance(exact, coal.Halfspace):
        plane = np.array([*exact.n, exact.d])
        return Declared(np.empty((0, 3)), np.empty((0, 1), int), 0.0, 0.0, z, plane)
    if len(body.triangles):
        corners = body.triangles.reshape(-1, 3)
        first, index = distinct(corners)
        return Declared(corners[first], index.reshape(-1, 3), body.rounding, 0.0, z, none)
    if isinstance(exact, coal.BVHModelBase):
        return Declared(body.points, np.arange(len(body.points))[:, None], body.rounding, 0.0, z, none)
    if isinstance(exact, coal.Capsule | coal.Cylinder):
        ends = np.array([[0.0, 0.0, -exact.halfLength], [0.0, 0.0, exact.halfLength]])
        ball, disc = (exact.radius, 0.0) if isinstance(exact, coal.Capsule) else (0.0, exact.radius)
        return Declared(ends, np.arange(2)[None], ball, disc, z, none)
    if isinstance(exact, coal.Box):
        corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * np.array(exact.halfSide)
    else:
        corners = np.array(exact.points())
    return Declared(corners, np.arange(len(corners))[None], 0.0, 0.0, z, none)


def radius_about(body: Declared, centre: np.ndarray) -> float:
    """Return the radius of the sphere about a point (3,) that contains a body [m]."""
    return float(_farthest(body, centre, body.points).max(initial=0.0))


def box_about(body: Declared, rotation: np.ndarray, translation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return lower and upper corner, (3,) each, of the box about a body that is rotated (3, 3) and moved (3,) [m]."""
    points, across = body.points @ rotation.T + translation, np.sqrt(np.maximum(0.0, 1.0 - (rotation @ body.axis) ** 2))
    more = body.disc * across + body.ball
    return points.min(axis=0) - more, points.max(axis=0) + more


def standing_out(body: Declared, shapes: Shapes, children: np.ndarray, of_node: np.ndarray) -> float:
    """Return how far a body stands out of the shapes of its nodes at most [m]; infinite if it isn't in them at all.

    Args:
        shapes: The shapes, in its frame.
        children: The two nodes below each node, behind it; -1 where there are none, shape (n, 2).
        of_node: Shapes that the proof says contain all of a node; -1 where none is, shape (n, 2).
    """
    if body.plane.any():  # its own plane is what counts
        return 0.0 if len(of_node) == 1 else np.inf
    count = len(body.items)
    best, waiting = np.full(count, np.inf), [(0, np.arange(count), np.zeros(count))]
    while waiting:
        node, mine, outside = waiting.pop()
        for shape in of_node[node][of_node[node] >= 0].tolist():
            items, found = body.items[mine], np.full(len(body.points), -np.inf)
            found[items] = np.inf
            asked = found == np.inf
            found[asked] = _outside(body, body.points[asked], shapes, shape)
            outside = np.maximum(outside, found[items].max(axis=1))
            mine, outside = mine[np.isfinite(outside)], outside[np.isfinite(outside)]
        if children[node, 0] < 0:
            best[mine] = np.minimum(best[mine], outside)
        elif len(mine):
            waiting += [(int(child), mine, outside) for child in children[node]]
    return float(best.max(initial=0.0))


def _farthest(body: Declared, centre: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the largest distance of a point (3,) from disc and ball about each of a body's points, (p,) [m]."""
    arms = points - centre
    along = arms @ body.axis
    across = np.linalg.norm(arms - along[:, None] * body.axis, axis=1) + body.disc
    found: np.ndarray = np.hypot(along, across) + body.ball
    return found


def _outside(body: Declared, points: np.ndarray, shapes: Shapes, shape: int) -> np.ndarray:
    """Bound how far disc and ball about points (p, 3) are out of a shape, shape (p,) [m]; infinite if not known."""
    corners, ball = shapes.corners[shapes.begins[shape] : shapes.begins[shape + 1]], float(shapes.balls[shape])
    if not np.isfinite(ball):
        return np.full(len(points), np.inf)
    if len(corners) == 1:
        return np.maximum(0.0, _farthest(body, corners[0], points) - ball)
    low, high = corners.min(axis=0) - NEAR, corners.max(axis=0) + NEAR
    within = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    found, disc, axis = np.full(len(points), np.inf), float(shapes.discs[shape]), shapes.axes[shape]
    found[within] = _from_hull(points[within], corners)
    turned = float(np.linalg.norm(np.cross(axis, body.axis))) if body.disc else 0.0
    return found + max(0.0, body.disc - disc) + body.disc * turned + max(0.0, body.ball - ball)


def _from_hull(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Bound the distances of points (p, 3) from the hull of corners (c, 3), shape (p,) [m]."""
    if len(points) * len(corners) > MANY:
        found = _by_planes(points, corners)
        left = np.flatnonzero(found > 0.0)
        found[left] = np.minimum(found[left], _from_corners(points[left], corners))
        return found
    found = _from_corners(points, corners)
    left = np.flatnonzero(found > CLOSE)
    if len(left):
        found[left] = np.minimum(found[left], _by_planes(points[left], corners))
    return found


def _from_corners(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    squares = ((points[:, None] - corners) ** 2).sum(axis=2)
    found: np.ndarray = np.sqrt(squares.min(axis=1, initial=np.inf))
    return np.where(found <= NEAR, found, np.inf)


def _by_planes(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Bound them as `_from_hull` by the planes of the hull's faces.

    With a point inside that is r from all of them, one that is v beyond them comes into the hull where it goes towards
    that point by v / (r + v) of the way. In a flat hull r is small: points are projected onto the planes first.
    """
    if len(corners) < 3:
        return np.full(len(points), np.inf)
    arms = corners - corners.mean(axis=0)
    _, spread, axes = np.linalg.svd(arms, full_matrices=False)
    if spread[1] <= 1e-9:
        return np.full(len(points), np.inf)
    if spread[2] <= 1e-9:  # of a flat one a prism about it, in whose middle plane it is
        normal = axes[2]
        heights = (points - corners.mean(axis=0)) @ normal
        prism = np.concatenate([corners + spread[1] * normal, corners - spread[1] * normal])
        within = _by_planes(points - heights[:, None] * normal, prism)
        from_flat: np.ndarray = within + np.abs(heights) + np.abs(arms @ normal).max()
        return from_flat
    convex = hull(corners)
    vertices, inside = np.array(convex.points()), corners.mean(axis=0)
    faces = np.array([[face[0], face[1], face[2]] for face in map(convex.polygons, range(convex.num_polygons))])
    a, b, c = vertices[faces].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals, a = normals[lengths > 0.0] / lengths[lengths > 0.0, None], a[lengths > 0.0]
    normals *= np.where(((a - inside) * normals).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
    offsets = (a * normals).sum(axis=1)
    depth, found = float((offsets - normals @ inside).min()), np.full(len(points), np.inf)
    left, there = np.arange(len(points)), points
    for _ in range(1 + ONTO_PLANES):
        out = there @ normals.T - offsets
        worst, beyond = out.argmax(axis=1), np.maximum(out.max(axis=1), 0.0)
        to_hull = beyond / (depth + beyond) * np.linalg.norm(there - inside, axis=1)
        near, known = beyond <= NEAR, np.linalg.norm(there - points[left], axis=1) + to_hull
        found[left[near]] = np.minimum(found[left[near]], known[near])
        again = near & (beyond > 0.0)
        if not again.any():
            break
        left, there = left[again], there[again] - beyond[again, None] * normals[worst[again]]
    return found
