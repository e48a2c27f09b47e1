"""Signed distance of several points at once, one in each lane, to the nearest of some bodies.

Boxes, cylinders, capsules, half-spaces and surfaces of triangles are measured in all lanes, clouds lane by lane. All
distances are those of `distance.body_distance`: a kind of body or a rule changed there is to be changed here. A
surface's tree is searched for all points at once: a node is left out where no point is nearer to its box than to the
nearest triangle so far (ray packets of Wald et al., Interactive Rendering with Coherent Ray Tracing, 2001, for
distances).
"""

from __future__ import annotations

import math

from guidefield.kernels.distance.distance import (
    BOX,
    CAPSULE,
    CLOUD,
    CYLINDER,
    HALF_SPACE,
    SHEET,
    DistanceTables,
    distance_inside,
    span_of,
)
from guidefield.kernels.distance.point_tree import cloud_distance
from guidefield.kernels.distance.triangle_distance import LEAF, Span, SurfaceTables, signed_distance
from guidefield.kernels.jit.arrays import Floats, Integers
from guidefield.kernels.jit.decorators import uncounted
from guidefield.kernels.kinematics.poses import moved_back_by, turned_by
from guidefield.kernels.simd.vector import (
    LANES_64,
    Vector,
    every,
    largest_of,
    load,
    magnitude,
    root,
    select,
    smallest_of,
    store,
    total,
)

BatchVector3 = tuple[Vector, Vector, Vector]  # points or axes, by coordinate

SquareAndDirection = tuple[Vector, Vector, Vector, Vector]
"""Distances of points: the square of the distance, negative inside [m²], and a vector (3) along which the distance
grows, as long as the distance, or `NEXT_TO` where that is less [m]."""

Signed = tuple[Vector, Vector, Vector, Vector]  # signed distances [m] and the unit vectors (3) along which they grow
DEEPEST = 40  # most nodes of a tree that wait, a multiple of `LANES_64`: one of a million leaves is 20 levels deep

_FOUND, _NODES, _GAPS = 8, 9, 9 + DEEPEST // LANES_64
"""Rows of scratch: of the nearest triangles, of the nodes that wait, and of the points' distances from these."""

ROWS = _GAPS + DEEPEST  # rows of scratch, each of `LANES_64` numbers
NEXT_TO = 1e-12  # nearer than this to a surface the direction is that of what is inside, or of a sheet's normal [m]

_NEXT_TO_SQUARED = NEXT_TO * NEXT_TO

_TINY = 1e-300  # added to what may be zero and is divided by


@uncounted
def signed_distance_of_each(
    p: BatchVector3, candidates: Integers, count: int, tables: DistanceTables, cutoff: float, scratch: Floats
) -> Signed:
    """Return signed distances [m] of points to the nearest of the first `count` candidates (bodies,), and unit vectors.

    They are the cutoff, positive [m], and zero beyond it; scratch of `ROWS` times `LANES_64` numbers.
    """
    nothing = 0.0 * p[0]
    best, bx, by, bz = nothing + cutoff * cutoff, nothing, nothing, nothing
    for k in range(count):
        signed_square, ax, ay, az = _away_from_body(p, candidates[k], tables, best, scratch)
        nearer = signed_square < best
        best = select(nearer, signed_square, best)
        bx, by, bz = select(nearer, ax, bx), select(nearer, ay, by), select(nearer, az, bz)
    return _make_signed(best, bx, by, bz)


@uncounted
def _make_signed(signed_square: Vector, ax: Vector, ay: Vector, az: Vector) -> Signed:
    """Signed distances of squares and vectors as in `SquareAndDirection`."""
    distance = root(magnitude(signed_square))
    over = 1.0 / largest_of(distance, NEXT_TO)
    return select(signed_square < 0.0, -distance, distance), over * ax, over * ay, over * az


@uncounted
def _away_from_body(
    p: BatchVector3, body: int, tables: DistanceTables, best: Vector, scratch: Floats
) -> SquareAndDirection:
    """Signed square and direction from one body; where it isn't nearer than `best`, the values mean nothing."""
    T, nothing = tables.placements[body], 0.0 * p[0]
    q = moved_back_by(T, p[0], p[1], p[2])
    gap = _gap_squared(q, tables.bounds[body])
    if every((gap > 0.0) & (gap >= best)):
        return nothing + math.inf, nothing, nothing, nothing
    kind = tables.kinds[body]
    if kind == BOX:
        signed_square, ax, ay, az = _away_from_box(q, tables.sizes[body])
    elif kind == CYLINDER:
        signed_square, ax, ay, az = _away_from_cylinder(q, tables.sizes[body])
    elif kind == CAPSULE:
        signed_square, ax, ay, az = _away_from_capsule(q, tables.sizes[body])
    elif kind == HALF_SPACE:
        signed_square, ax, ay, az = _away(q[2], nothing, nothing, nothing + 1.0)
    elif kind == SHEET and tables.spans[body, 1] == 1:
        signed_square, ax, ay, az = _away_from_sheet(q, body, tables)
    elif kind == CLOUD:
        signed_square, ax, ay, az = _away_from_cloud(q, body, tables, best, scratch)
    else:
        signed_square, ax, ay, az = _away_from_surface(q, gap, body, tables, best, scratch)
    ax, ay, az = turned_by(T, ax, ay, az)
    return signed_square, ax, ay, az


@uncounted
def _away(d: Vector, nx: Vector, ny: Vector, nz: Vector) -> SquareAndDirection:
    """Square and direction of signed distances and unit vectors."""
    far = magnitude(d)
    length = largest_of(far, NEXT_TO)
    return d * far, length * nx, length * ny, length * nz


@uncounted
def _gap_squared(p: BatchVector3, box: Floats) -> Vector:
    """Square of the distance from points to a box, lower then upper corner, shape (6,); 0 inside [m²]."""
    dx = largest_of(largest_of(box[0] - p[0], p[0] - box[3]), 0.0)
    dy = largest_of(largest_of(box[1] - p[1], p[1] - box[4]), 0.0)
    dz = largest_of(largest_of(box[2] - p[2], p[2] - box[5]), 0.0)
    return dx * dx + dy * dy + dz * dz


@uncounted
def _away_from_box(p: BatchVector3, half: Floats) -> SquareAndDirection:
    """`distance.box_distance` of points."""
    ex, ey, ez = magnitude(p[0]) - half[0], magnitude(p[1]) - half[1], magnitude(p[2]) - half[2]
    ox, oy, oz = largest_of(ex, 0.0), largest_of(ey, 0.0), largest_of(ez, 0.0)
    square = ox * ox + oy * oy + oz * oz
    if not every(square > _NEXT_TO_SQUARED):
        deepest = largest_of(largest_of(ex, ey), ez)
        inside, far = square <= _NEXT_TO_SQUARED, magnitude(deepest)
        square, length = select(inside, deepest * far, square), largest_of(far, NEXT_TO)
        by_x, by_y = (ex >= ey) & (ex >= ez), ey >= ez
        ox = select(inside, select(by_x, length, 0.0), ox)
        oy = select(inside, select(by_x, 0.0, select(by_y, length, 0.0)), oy)
        oz = select(inside, select(by_x, 0.0, select(by_y, 0.0, length)), oz)
    return square, _with_sign(ox, p[0]), _with_sign(oy, p[1]), _with_sign(oz, p[2])


@uncounted
def _with_sign(length: Vector, by: Vector) -> Vector:
    return select(by < 0.0, -length, length)


@uncounted
def _away_from_cylinder(p: BatchVector3, size: Floats) -> SquareAndDirection:
    """`distance.cylinder_distance`, of its radius and half its length."""
    rho = root(p[0] * p[0] + p[1] * p[1])
    over = 1.0 / largest_of(rho, _TINY)
    side, end = rho - size[0], magnitude(p[2]) - size[1]
    across, along = largest_of(side, 0.0), largest_of(end, 0.0)
    square = across * across + along * along
    if not every(square > _NEXT_TO_SQUARED):
        deepest = largest_of(side, end)
        inside, far = square <= _NEXT_TO_SQUARED, magnitude(deepest)
        square, length = select(inside, deepest * far, square), largest_of(far, NEXT_TO)
        by_side = side >= end
        across = select(inside, select(by_side, length, 0.0), across)
        along = select(inside, select(by_side, 0.0, length), along)
    return square, across * select(rho > 0.0, over * p[0], 1.0), across * (over * p[1]), _with_sign(along, p[2])


@uncounted
def _away_from_capsule(p: BatchVector3, size: Floats) -> SquareAndDirection:
    """`distance.capsule_distance`, of its radius and half its length."""
    z = p[2] - largest_of(smallest_of(p[2], size[1]), -size[1])
    distance = root(p[0] * p[0] + p[1] * p[1] + z * z)
    over = 1.0 / largest_of(distance, _TINY)
    return _away(distance - size[0], select(distance > 0.0, over * p[0], 1.0), over * p[1], over * z)


@uncounted
def _away_from_sheet(p: BatchVector3, body: int, tables: DistanceTables) -> SquareAndDirection:
    """`triangle_distance.surface_distance` of a sheet whose triangles are in one leaf."""
    surfaces, first, count = tables.surfaces, tables.spans[body, 2], tables.spans[body, 3]
    bx, by, bz = _away_from_triangle(p, surfaces.corners[first])
    best = _square(bx, by, bz)
    for i in range(first + 1, first + count):
        dx, dy, dz = _away_from_triangle(p, surfaces.corners[i])
        square = _square(dx, dy, dz)
        nearer = square < best
        best = select(nearer, square, best)
        bx, by, bz = select(nearer, dx, bx), select(nearer, dy, by), select(nearer, dz, bz)
    apart, normal = best > _NEXT_TO_SQUARED, surfaces.normals[first]
    return (
        best,
        select(apart, bx, NEXT_TO * normal[0]),
        select(apart, by, NEXT_TO * normal[1]),
        select(apart, bz, NEXT_TO * normal[2]),
    )


@uncounted
def _away_from_triangle(p: BatchVector3, corner: Floats) -> BatchVector3:
    """From the closest point of a triangle (9,): of its face where points are over it, else of its nearest edge."""
    ax, ay, az = p[0] - corner[0], p[1] - corner[1], p[2] - corner[2]
    ux, uy, uz, wx, wy, wz = corner[3], corner[4], corner[5], corner[6], corner[7], corner[8]
    uu, uw, ww = ux * ux + uy * uy + uz * uz, ux * wx + uy * wy + uz * wz, wx * wx + wy * wy + wz * wz
    # along each edge as seen from corners a, b and c, as in `triangle_distance`
    a1, a2 = ux * ax + uy * ay + uz * az, wx * ax + wy * ay + wz * az
    b1, b2, c1, c2 = a1 - uu, a2 - uw, a1 - uw, a2 - ww
    alpha, beta, gamma = b1 * c2 - c1 * b2, c1 * a2 - a1 * c2, a1 * b2 - b1 * a2
    nothing = 0.0 * ax
    # edge a b, then c a, then b c
    s, t = _share(a1 / max(uu, _TINY)), nothing
    best = _square(ax - s * ux, ay - s * uy, az - s * uz)
    other = _share(a2 / max(ww, _TINY))
    square = _square(ax - other * wx, ay - other * wy, az - other * wz)
    s, t, best = select(square < best, 0.0, s), select(square < best, other, t), smallest_of(square, best)
    other = _share((b2 - b1) / max(uu - 2.0 * uw + ww, _TINY))
    square = _square(ax - ux - other * (wx - ux), ay - uy - other * (wy - uy), az - uz - other * (wz - uz))
    s, t = select(square < best, 1.0 - other, s), select(square < best, other, t)
    over = 1.0 / largest_of(alpha + beta + gamma, _TINY)
    inside = (alpha > 0.0) & (beta > 0.0) & (gamma > 0.0)
    s, t = select(inside, over * beta, s), select(inside, over * gamma, t)
    return ax - s * ux - t * wx, ay - s * uy - t * wy, az - s * uz - t * wz


@uncounted
def _share(x: Vector) -> Vector:
    return largest_of(smallest_of(x, 1.0), 0.0)


@uncounted
def _square(x: Vector, y: Vector, z: Vector) -> Vector:
    return x * x + y * y + z * z


@uncounted
def _find_nearest_triangles(
    p: BatchVector3, surfaces: SurfaceTables, span: Span, best: Vector, scratch: Floats
) -> None:
    """Write the nearest triangle of a tree to each point, where it is nearer than the best so far, else -1.

    Args:
        p: Points in the frame of the surface [m].
        surfaces: All surfaces.
        span: Where the tree stands.
        best: Squares of distances [m²].
        scratch: Gets the indices in row `_FOUND`.
    """
    root_node, leaves, first, count = span
    nodes, gaps = scratch[_NODES * LANES_64 :], scratch[_GAPS * LANES_64 :]
    found, top = 0.0 * p[0] - 1.0, 1
    nodes[0] = 0.0
    store(gaps, 0, _gap_squared(p, surfaces.nodes[root_node]))
    while top > 0:
        top -= 1
        if every(load(gaps, top * LANES_64) >= best):
            continue
        node = int(nodes[top])
        leaf = node - (leaves - 1)
        if leaf >= 0:
            for i in range(first + leaf * LEAF, first + min(count, (leaf + 1) * LEAF)):
                dx, dy, dz = _away_from_triangle(p, surfaces.corners[i])
                square = _square(dx, dy, dz)
                nearer = square < best
                best, found = select(nearer, square, best), select(nearer, float(i), found)
            continue
        near, far = 2 * node + 1, 2 * node + 2
        to_near = _gap_squared(p, surfaces.nodes[root_node + near])
        to_far = _gap_squared(p, surfaces.nodes[root_node + far])
        if total(select(to_far < to_near, 1.0, -1.0 + 0.0 * best)) > 0.0:  # the one nearer to more points comes first
            near, far, to_near, to_far = far, near, to_far, to_near
        nodes[top], nodes[top + 1] = float(far), float(near)
        store(gaps, top * LANES_64, to_far)
        store(gaps, (top + 1) * LANES_64, to_near)
        top += 2
    store(scratch, _FOUND * LANES_64, found)


@uncounted
def _away_from_surface(
    p: BatchVector3, gap: Vector, body: int, tables: DistanceTables, best: Vector, scratch: Floats
) -> SquareAndDirection:
    """`distance.body_distance`; infinite where it isn't below the best, the square of a signed distance.

    Args:
        p: Points in the frame of the surface [m].
        gap: Squares of their distances from the box about it [m²].
        body: Index of the body.
        tables: The bodies.
        best: Squares of signed distances [m²].
        scratch: Of `ROWS` times `LANES_64` numbers.
    """
    surfaces, span, solid = tables.surfaces, span_of(tables, body), tables.kinds[body] != SHEET
    _find_nearest_triangles(p, surfaces, span, largest_of(best, 0.0), scratch)
    store(scratch, 0, p[0])
    store(scratch, LANES_64, p[1])
    store(scratch, 2 * LANES_64, p[2])
    store(scratch, 3 * LANES_64, gap)
    for i in range(LANES_64):
        x, y, z = scratch[i], scratch[LANES_64 + i], scratch[2 * LANES_64 + i]
        nearest = int(scratch[_FOUND * LANES_64 + i])
        if nearest >= 0:
            d, nx, ny, nz = signed_distance(x, y, z, surfaces, nearest, solid)
        elif solid and scratch[3 * LANES_64 + i] == 0.0:
            d, nx, ny, nz = distance_inside(x, y, z, body, tables, math.inf)
        else:
            d, nx, ny, nz = math.inf, 0.0, 0.0, 0.0
        _write_signed(i, d, nx, ny, nz, scratch)
    return _read_away(scratch)


@uncounted
def _away_from_cloud(
    p: BatchVector3, body: int, tables: DistanceTables, best: Vector, scratch: Floats
) -> SquareAndDirection:
    """`cloud_distance` of each point in the frame of a cloud; infinite where it isn't below the best."""
    distance = root(magnitude(best))
    store(scratch, 0, p[0])
    store(scratch, LANES_64, p[1])
    store(scratch, 2 * LANES_64, p[2])
    store(scratch, 3 * LANES_64, select(best < 0.0, -distance, distance))
    for i in range(LANES_64):
        d, nx, ny, nz = cloud_distance(
            tables.clouds[body], scratch[i], scratch[LANES_64 + i], scratch[2 * LANES_64 + i],
            scratch[3 * LANES_64 + i],
        )  # fmt: skip
        _write_signed(i, d, nx, ny, nz, scratch)
    return _read_away(scratch)


@uncounted
def _write_signed(i: int, d: float, nx: float, ny: float, nz: float, scratch: Floats) -> None:
    """Write the signed distance of point i and the unit vector along which it grows."""
    scratch[4 * LANES_64 + i] = d
    scratch[5 * LANES_64 + i], scratch[6 * LANES_64 + i], scratch[7 * LANES_64 + i] = nx, ny, nz


@uncounted
def _read_away(scratch: Floats) -> SquareAndDirection:
    return _away(
        load(scratch, 4 * LANES_64),
        load(scratch, 5 * LANES_64),
        load(scratch, 6 * LANES_64),
        load(scratch, 7 * LANES_64),
    )
