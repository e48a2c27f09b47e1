"""Signed distance of points to the obstacles of a scene, and the unit vector along which it grows.

Every obstacle is a *body*: a shape in a frame of its own. Distances are negative inside boxes, cylinders, capsules
(spheres among them), half-spaces and closed surfaces, and the vector leads to the nearest way out; a sheet (a polygon,
an open mesh) has no inside; a cloud is balls about points. Where the vector isn't unique (at equal distances) it is one
of those possible. The optimizer, guides and motion bounds rely on distances that aren't too large; a new kind of body
is added as `BOX` and its neighbours say.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from guidefield.kernels.distance.point_tree import cloud_beyond, cloud_distance
from guidefield.kernels.distance.triangle_distance import (
    LEAF,
    Span,
    SurfaceTables,
    box_gap_squared,
    some_triangle_near,
    surface_distance,
)
from guidefield.kernels.distance.winding import surely_outside, surely_outside_seen
from guidefield.kernels.jit.arrays import (
    Blocks,
    Floats,
    IndexRows,
    Indices,
    IndicesOut,
    RowOut,
    Rows,
    RowsOut,
    Vector3,
    numba_type,
)
from guidefield.kernels.jit.decorators import counted, inlined, kernel, uncounted
from guidefield.kernels.kinematics.poses import moved_back_by, turned_by

Signed = tuple[float, float, float, float]  # signed distance [m] and the unit vector (3) along which it grows


@inlined
def box_distance(p: Vector3, half: Vector3) -> Signed:
    """Box of half extents `half` about the origin."""
    ex, ey, ez = abs(p[0]) - half[0], abs(p[1]) - half[1], abs(p[2]) - half[2]
    sx = 1.0 if p[0] >= 0.0 else -1.0
    sy = 1.0 if p[1] >= 0.0 else -1.0
    sz = 1.0 if p[2] >= 0.0 else -1.0
    if ex <= 0.0 and ey <= 0.0 and ez <= 0.0:
        if ex >= ey and ex >= ez:
            return ex, sx, 0.0, 0.0
        return (ey, 0.0, sy, 0.0) if ey >= ez else (ez, 0.0, 0.0, sz)
    ex, ey, ez = max(ex, 0.0), max(ey, 0.0), max(ez, 0.0)
    distance = math.sqrt(ex * ex + ey * ey + ez * ez)
    over = 1.0 / distance
    return distance, over * ex * sx, over * ey * sy, over * ez * sz


@inlined
def cylinder_distance(p: Vector3, radius: float, half: float) -> Signed:
    """Cylinder with flat ends along z, from -half to half."""
    rho = math.sqrt(p[0] * p[0] + p[1] * p[1])
    rx = p[0] / rho if rho > 0.0 else 1.0
    ry = p[1] / rho if rho > 0.0 else 0.0
    side, end = rho - radius, abs(p[2]) - half
    sz = 1.0 if p[2] >= 0.0 else -1.0
    if side <= 0.0 and end <= 0.0:
        return (side, rx, ry, 0.0) if side >= end else (end, 0.0, 0.0, sz)
    side, end = max(side, 0.0), max(end, 0.0)
    distance = math.sqrt(side * side + end * end)
    over = 1.0 / distance
    return distance, over * side * rx, over * side * ry, over * end * sz


@inlined
def capsule_distance(p: Vector3, radius: float, half: float) -> Signed:
    """Capsule about the segment from -half to half of the z axis."""
    dz = p[2] - min(max(p[2], -half), half)
    distance = math.sqrt(p[0] * p[0] + p[1] * p[1] + dz * dz)
    if distance == 0.0:
        return -radius, 1.0, 0.0, 0.0
    over = 1.0 / distance
    return distance - radius, over * p[0], over * p[1], over * dz


BOX, CYLINDER, CAPSULE, HALF_SPACE, SOLID, SHEET, CLOUD, CROPPED_SOLID = range(8)
"""Kinds of bodies; of a cropped solid only a part of the closed surface is there, see scene/crop.py.

A further kind needs a branch in `body_distance` and `_body_near`, and in `points_distance._away_from_body`. The order
of the numbers counts: from HALF_SPACE on kinds aren't bounded primitives (`scene/distance_tables.py`).
"""

_STACK = 64  # nodes that wait, at most
_FEW = 32  # up to this many bodies are examined one by one, without their tree: a matter of speed, as is `_SMALL`
_SMALL = 64  # a surface of up to this many triangles counts as near where its box is; its triangles aren't asked


class DistanceTables(NamedTuple):
    """The bodies of a scene as the kernels read them; half-spaces first, the others in the order of their tree."""

    kinds: Indices  # kind of each body, shape (n,)
    obstacles: Indices  # index of the obstacle that it belongs to, shape (n,)
    placements: Blocks  # rotation and translation of its frame in the world, shape (n, 3, 4) [m]
    # shape (n, 3) [m]: half extents of a box; radius and half length of a cylinder or capsule along its z
    # (0 for a sphere). A half-space is z <= 0.
    sizes: Rows
    bounds: Rows  # a box about it in its own frame, lower then upper corner, shape (n, 6) [m]
    boxes: Rows  # a box about it along the world's axes, shape (n, 6) [m]
    # of a surface, where its tree stands, see `Span`, and the row of its anchor counted from 1, 0 of all that have
    # none; shape (n, 5)
    spans: IndexRows
    # of seen solids, how their sides are found, in their own frames, see `winding.ANCHOR`; shape (k, 9)
    anchors: Rows
    nodes: Rows  # tree of boxes in the world about the bodies that aren't half-spaces, shape (m, 6) [m]
    surfaces: SurfaceTables  # triangles of all surfaces
    clouds: Indices  # address of the words of each body's `point_tree.BatchCloud`, 0 of all that are none, shape (n,)


TABLES = numba_type(DistanceTables)


def distance_at_points(
    tables: DistanceTables, points: Floats, cutoff: float = math.inf
) -> tuple[Floats, Floats, np.ndarray]:
    """Signed distance of points to the nearest body.

    Args:
        points: Points in the world, shape (n, 3) [m].
        cutoff: Distance beyond which nothing is searched for [m].

    Returns:
        Distance [m], shape (n,); the unit vector along which it grows, shape (n, 3); index of the obstacle, shape (n,).
        Beyond the cutoff they are infinite, zero and -1.

    Raises:
        ValueError: if `points` is not of shape (n, 3) or not finite.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"`points` must have shape (n, 3), got {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError(f"`points` must be finite, got {points[~np.isfinite(points).all(axis=1)][0]}")
    distances, normals, bodies = np.zeros(len(points)), np.zeros((len(points), 3)), np.zeros(len(points), np.int64)
    _distance_at_points(points, tables, cutoff, distances, normals, bodies)
    return distances, normals, np.where(bodies < 0, -1, np.append(tables.obstacles, -1)[bodies])


@uncounted
def body_distance(
    x: float, y: float, z: float, body: int, tables: DistanceTables, cutoff: float, depth: float
) -> Signed:
    """Return the signed distance of a point to a body [m] and the unit vector along which it grows, in the world.

    Infinite and zero, or a value not below it, where the distance is not below `cutoff`, which may be infinite or
    negative [m]; `depth` is how deep inside a solid its surface is searched for [m].
    """
    T = tables.placements[body]
    p = moved_back_by(T, x, y, z)
    gap = box_gap_squared(p[0], p[1], p[2], tables.bounds, body)
    if gap > 0.0 and (cutoff <= 0.0 or gap >= cutoff * cutoff):
        return math.inf, 0.0, 0.0, 0.0
    kind = tables.kinds[body]
    a, b, c = tables.sizes[body, 0], tables.sizes[body, 1], tables.sizes[body, 2]
    if kind == BOX:
        d, nx, ny, nz = box_distance(p, (a, b, c))
    elif kind == CYLINDER:
        d, nx, ny, nz = cylinder_distance(p, a, b)
    elif kind == CAPSULE:
        d, nx, ny, nz = capsule_distance(p, a, b)
    elif kind == HALF_SPACE:
        d, nx, ny, nz = p[2], 0.0, 0.0, 1.0
    elif kind == CLOUD:
        d, nx, ny, nz = cloud_distance(tables.clouds[body], p[0], p[1], p[2], cutoff)
    else:
        d, nx, ny, nz = _from_surface(p, body, tables, gap == 0.0, cutoff, depth)
    nx, ny, nz = turned_by(T, nx, ny, nz)
    return d, nx, ny, nz


@uncounted
def _from_surface(p: Vector3, body: int, tables: DistanceTables, boxed: bool, cutoff: float, depth: float) -> Signed:
    """`body_distance` of a point in the frame of a surface; `boxed`: in the box about it.

    What is far from the surface but in its box may be deep inside a solid. A ray tells: to find the nearest triangle
    takes long where many are almost as far.
    """
    kind, span, near = tables.kinds[body], span_of(tables, body), max(cutoff, 0.0)
    x, y, z = p
    if kind == SHEET or not boxed or depth <= near:
        return surface_distance(x, y, z, tables.surfaces, span, kind != SHEET, near)
    if near < math.inf:
        found = surface_distance(x, y, z, tables.surfaces, span, True, near)
        return found if found[0] < math.inf else distance_inside(x, y, z, body, tables, depth)
    return surface_distance(x, y, z, tables.surfaces, span, True, depth)


@uncounted
def distance_inside(x: float, y: float, z: float, body: int, tables: DistanceTables, depth: float) -> Signed:
    """`body_distance` of a point in the frame of a solid that is far from its surface: infinite outside."""
    if _surely_outside((x, y, z), body, tables):
        return math.inf, 0.0, 0.0, 0.0
    return surface_distance(x, y, z, tables.surfaces, span_of(tables, body), True, depth)


@uncounted
def _surely_outside(p: Vector3, body: int, tables: DistanceTables) -> bool:
    """Tell if a point in the frame of a solid, and not on its surface, is certain to be outside."""
    span, row = span_of(tables, body), tables.spans[body, 4]
    if tables.kinds[body] == SOLID:
        outside: bool = surely_outside(p[0], p[1], p[2], tables.surfaces, span)
        return outside
    return row > 0 and surely_outside_seen(p[0], p[1], p[2], tables.surfaces, span, tables.anchors, row - 1)


@uncounted
def span_of(tables: DistanceTables, body: int) -> Span:
    """Return where the tree of a surface stands."""
    spans = tables.spans
    return spans[body, 0], spans[body, 1], spans[body, 2], spans[body, 3]


@uncounted
def bounds_near(x: float, y: float, z: float, body: int, tables: DistanceTables, reach: float) -> bool:
    """Tell if the box about a body, in its own frame, is within reach of a world point [m]."""
    px, py, pz = moved_back_by(tables.placements[body], x, y, z)
    return box_gap_squared(px, py, pz, tables.bounds, body) < reach * reach


@uncounted
def _body_near(x: float, y: float, z: float, body: int, tables: DistanceTables, reach: float) -> bool:
    """Tell if a body may be within reach of a point; the cheapest test, its box in the world, comes first."""
    if box_gap_squared(x, y, z, tables.boxes, body) >= reach * reach:
        return False
    if not bounds_near(x, y, z, body, tables, reach):
        return False
    kind = tables.kinds[body]
    if kind == CLOUD:
        px, py, pz = moved_back_by(tables.placements[body], x, y, z)
        return not cloud_beyond(tables.clouds[body], px, py, pz, reach)
    if tables.spans[body, 3] <= _SMALL:
        return True
    p = moved_back_by(tables.placements[body], x, y, z)
    if some_triangle_near(p[0], p[1], p[2], tables.surfaces, span_of(tables, body), reach):
        return True
    return kind != SHEET and not _surely_outside(p, body, tables)


@counted
def _bodies_in_tree(
    x: float, y: float, z: float, reach: float, tables: DistanceTables, first: int, count: int, bodies_out: np.ndarray
) -> int:
    """`bodies_near` from the first body of the tree on, after some that were found."""
    bodies = tables.kinds.shape[0]
    leaves = (tables.nodes.shape[0] + 1) // 2
    waiting = np.empty(_STACK, np.int64)
    waiting[0] = 0
    top = 1
    while top > 0:
        top -= 1
        node = waiting[top]
        if not box_gap_squared(x, y, z, tables.nodes, node) < reach * reach:
            continue
        leaf = node - (leaves - 1)
        if leaf < 0:
            waiting[top], waiting[top + 1] = 2 * node + 2, 2 * node + 1
            top += 2
            continue
        for body in range(first + leaf * LEAF, min(bodies, first + (leaf + 1) * LEAF)):
            if _body_near(x, y, z, body, tables, reach):
                bodies_out[count] = body
                count += 1
    return count


@uncounted
def bodies_near(x: float, y: float, z: float, reach: float, tables: DistanceTables, bodies_out: np.ndarray) -> int:
    """Write the bodies (bodies,) that may be within reach of a point: all that are, and few others.

    In ascending order of the tree; `reach` is positive and may be infinite [m]. Returns their number.
    """
    count, bodies = 0, tables.kinds.shape[0]
    first = 0
    while first < bodies and (bodies <= _FEW or tables.kinds[first] == HALF_SPACE):
        if _body_near(x, y, z, first, tables, reach):
            bodies_out[count] = first
            count += 1
        first += 1
    if first == bodies:
        return count
    return _bodies_in_tree(x, y, z, reach, tables, first, count, bodies_out)


@uncounted
def nearest_body(
    x: float, y: float, z: float, candidates: np.ndarray, count: int, tables: DistanceTables, cutoff: float
) -> tuple[float, float, float, float, int]:
    """Return the signed distance [m], unit vector and index of the nearest of the first `count` candidates (bodies,).

    Beyond the cutoff [m] they are infinite, zero and -1.
    """
    best, bx, by, bz, nearest = cutoff, 0.0, 0.0, 0.0, -1
    for k in range(count):
        d, nx, ny, nz = body_distance(x, y, z, candidates[k], tables, best, math.inf)
        if d < best:
            best, bx, by, bz, nearest = d, nx, ny, nz, candidates[k]
    if nearest < 0:
        best = math.inf
    return best, bx, by, bz, nearest


@kernel
def _distance_at_points(
    points: Rows,
    tables: DistanceTables,
    cutoff: float,
    distances_out: RowOut,
    normals_out: RowsOut,
    bodies_out: IndicesOut,
) -> None:
    """`nearest_body` among all for every row of `points`."""
    candidates = np.empty(tables.kinds.shape[0], np.int64)
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        count = bodies_near(x, y, z, cutoff, tables, candidates)
        d, nx, ny, nz, body = nearest_body(x, y, z, candidates, count, tables, cutoff)
        distances_out[i] = d
        normals_out[i, 0] = nx
        normals_out[i, 1] = ny
        normals_out[i, 2] = nz
        bodies_out[i] = body
