"""The field of everything charged at many points: boxes, faces, spheres, capsules, planes and clouds summed.

`geometry/charged.py` and `far_tree.py` write the tables. Clusters of charges are far nodes of trees, which count by
their multipole expansion beyond their reach. A kind of charge has a branch in `_with_forms` and in
`_with_form_potentials`, which are the same sum, and a line in `single_precision`, which moves all places in its rows.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types, void

from guidefield.kernels.field.box import CHARGE as BOX_CHARGE, box_at, charged_capsule_at, plane_at, sphere_at
from guidefield.kernels.field.faces import (
    AFTER,
    BOXES,
    CAPSULES,
    FIRST_ROW,
    FIRST_VERTEX,
    FORM,
    HALF_ROWS,
    PAST_ROW,
    PAST_VERTEX,
    PLANE_ROWS,
    PLANES,
    POINTS,
    SPHERES,
    block_at,
    block_potential_at,
)
from guidefield.kernels.jit.arrays import FLOATS_OUT, MATRIX, MATRIX_OUT, Floats, IndexRows, Row, Rows, numba_type
from guidefield.kernels.jit.decorators import compiled, inlined
from guidefield.kernels.simd.vector import every, inverse_root, lane_count, load, store

TRIANGLE_COLUMNS, QUAD_COLUMNS = PLANE_ROWS + HALF_ROWS, PLANE_ROWS + 2 * HALF_ROWS  # plane, then halves: see faces.py

CHARGE, MOMENTS, AREA, CHARGE_PER_AREA, NODE_COLUMNS = 3, 4, 10, 13, 14
"""Columns of a node, behind its centre of charge (3): charge, its second moments xx xy xz yy yz zz, area vector (3),
charge per area of all faces below; then how many columns there are."""

SPHERE_RADIUS, SPHERE_CHARGE, SPHERE_COLUMNS = 3, 4, 5
"""Columns of a sphere, behind its centre (3); then how many there are."""

OTHER_END, CAPSULE_RADIUS, CAPSULE_CHARGE, CAPSULE_COLUMNS = 3, 6, 7, 8
"""Columns of a capsule, behind one end of its axis (3): the other end (3), radius, charge; then how many there are."""

OFFSET, PLANE_CHARGE, PLANE_COLUMNS = 3, 4, 5  # columns of a plane, behind its unit normal (3); then how many there are

POINT_CHARGE, SOFTENING, POINT_COLUMNS = 3, 4, 5
"""Columns of a point of a cloud, behind its position (3): charge [1], square of the softening length; then how many
there are."""


class FieldTables(NamedTuple):
    """Everything charged; one row each, C-contiguous, in double or in single precision, lengths in m.

    Faces stand in blocks that share corners. Blocks, and rows of closed forms (all other tables of charges), are the
    leaves of trees in depth-first order. A node's multipole expansion represents all below it where points are farther
    than its reach from its centre.
    """

    origin: Row  # what to subtract from points, shape (3,), always in double precision; tables are relative to it
    boxes: Rows  # as kernels/field/box.py reads them, shape (b, BOX_COLUMNS)
    vertices: Rows  # corners of blocks, shape (v, 3)
    triangle_corners: IndexRows  # indices into a block's vertices, shape (t, 3)
    triangles: Rows  # as kernels/field/faces.py reads them, shape (t, TRIANGLE_COLUMNS)
    quad_corners: IndexRows  # two triangles each, indices into a block's vertices, shape (q, 6)
    quads: Rows  # as kernels/field/faces.py reads them, shape (q, QUAD_COLUMNS)
    nodes: Rows  # shape (m, NODE_COLUMNS)
    links: IndexRows  # as kernels/field/faces.py reads them, shape (m, LINK_COLUMNS)
    reach: Row  # distance from a node's centre from which its expansion is used [m]; infinite for never; shape (m,)
    spheres: Rows  # shape (s, SPHERE_COLUMNS)
    capsules: Rows  # shape (c, CAPSULE_COLUMNS)
    planes: Rows  # shape (p, PLANE_COLUMNS)
    cloud: Rows  # points of clouds, shape (n, POINT_COLUMNS)


MATRIX_32 = types.Array(types.float32, 2, "C", readonly=True)  # for signatures of `field`


def _single(kind: types.Array) -> types.Array:
    """Return the type of an array in single precision; one of whole numbers stays."""
    return types.Array(types.float32, kind.ndim, "C", readonly=True) if kind.dtype == types.float64 else kind


TABLES = numba_type(FieldTables)
TABLES_32 = types.NamedTuple([TABLES.types[0], *map(_single, TABLES.types[1:])], FieldTables)


def exact(tables: FieldTables) -> FieldTables:
    """Return tables without expansions: every face counts by itself."""
    return tables._replace(reach=frozen(np.full(len(tables.reach), np.inf, tables.reach.dtype)))


def single_precision(tables: FieldTables, origin: np.ndarray) -> FieldTables:
    """Return tables in single precision, relative to an origin amidst the points where the field will be evaluated.

    Good to about 1e-6 where the distance to the surfaces is a hundredth of their size, and less nearer.

    Args:
        tables: In double precision.
        origin: In the frame of the tables, shape (3,) [m].
    """
    shift = np.asarray(origin, dtype=np.float64) - tables.origin

    def shift_rows(rows: np.ndarray, *columns: int) -> np.ndarray:
        result = rows.copy()
        for column in columns:
            result[:, column : column + 3] -= shift
        return frozen(result.astype(np.float32))

    planes = tables.planes.copy()
    planes[:, OFFSET] -= planes[:, :3] @ shift
    return tables._replace(
        origin=frozen(tables.origin + shift),
        boxes=shift_rows(tables.boxes, 0),
        vertices=shift_rows(tables.vertices, 0),
        triangles=shift_rows(tables.triangles, 0),
        quads=shift_rows(tables.quads, 0),
        nodes=shift_rows(tables.nodes, 0),
        reach=frozen(tables.reach.astype(np.float32)),
        spheres=shift_rows(tables.spheres, 0),
        capsules=shift_rows(tables.capsules, 0, OTHER_END),
        planes=frozen(planes.astype(np.float32)),
        cloud=shift_rows(tables.cloud, 0),
    )


def frozen(values: np.ndarray) -> np.ndarray:
    """The values as a C-contiguous array of the same shape that is read-only."""
    array = np.ascontiguousarray(values)
    array.setflags(write=False)
    return array


MATRIX_32_OUT = types.Array(types.float32, 2, "C")

LANES = 16  # points come in multiples of it: the longest vector, `LANES` of simd/vector.py; no setting


class Field(NamedTuple):
    """The field at points."""

    potential: Floats  # [1/m], shape (n,)
    gradient: Floats  # of the potential [1/m^2], shape (n, 3); minus the force on a unit charge
    # of the nearby surfaces [1/m^3], never negative, shape (n,): the sum of -2 Phi_h/h over triangles and rectangles,
    # what corresponds to it for other shapes
    curvature: Floats
    winding: Floats  # count of closed surfaces around the point, whatever their charge, shape (n,)


def field_at_points(tables: FieldTables, points: Floats) -> Field:
    """Return the field of all that is charged at points (n, 3) [m], in the precision and the frame of the tables.

    All is finite everywhere, on the surfaces too. Inside a solid it does not tell the way out.

    Raises ValueError if `points` is not of shape (n, 3) or not finite.
    """
    at = padded(tables, points)
    out = np.zeros((6, at.shape[1]), at.dtype)
    add_field(tables, at, 0, out)
    rows = out[:, : len(points)].astype(np.float64)
    return Field(rows[0], np.ascontiguousarray(rows[1:4].T), rows[4], rows[5])


def padded(tables: FieldTables, points: Floats) -> Floats:
    """Return points (n, 3) [m] as `add_field` takes them: (3, m), relative to the tables' origin, of their precision.

    m is the next multiple of `LANES`, the last point is repeated.

    Raises ValueError if `points` is not of shape (n, 3) or not finite.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"`points` must have shape (n, 3), got {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError(f"`points` must be finite, got {points[~np.isfinite(points).all(axis=1)][0]}")
    rows = (points - tables.origin).T.astype(tables.boxes.dtype)
    filled = np.zeros((3, len(points) + -len(points) % LANES), rows.dtype)
    filled[:, : len(points)] = rows
    if len(points):
        filled[:, len(points) :] = rows[:, -1:]
    return filled


@inlined
def _plus(total: Any, charge: float, term: Any) -> Any:
    """Sum of fields; the winding number counts surfaces whatever their charge."""
    return (
        total[0] + charge * term[0],
        total[1] + charge * term[1],
        total[2] + charge * term[2],
        total[3] + charge * term[3],
        total[4] + charge * term[4],
        total[5] + term[5],
    )


@inlined
def _expansion(dx: Any, dy: Any, dz: Any, square: Any, node: Any) -> Any:
    """Potential of a cluster at an offset from its centre of charge; what its gradient needs: two factors and Q x.

    Phi = q/|x|^3 + (15 x.Q x/|x|^2 - 3 tr Q) / (2 |x|^5); there is no dipole about the centre of charge.
    """
    i = inverse_root(square)
    ii = i * i
    i3 = ii * i
    i5 = i3 * ii
    xx, xy, xz = node[MOMENTS], node[MOMENTS + 1], node[MOMENTS + 2]
    yy, yz, zz = node[MOMENTS + 3], node[MOMENTS + 4], node[MOMENTS + 5]
    qx = xx * dx + xy * dy + xz * dz
    qy = xy * dx + yy * dy + yz * dz
    qz = xz * dx + yz * dy + zz * dz
    trace = xx + yy + zz
    xqx = (qx * dx + qy * dy + qz * dz) * ii
    phi = node[CHARGE] * i3 + (7.5 * xqx - 1.5 * trace) * i5
    along = -3.0 * node[CHARGE] * i5 + (7.5 * trace - 52.5 * xqx) * (i5 * ii)
    return phi, along, 15.0 * i5 * ii, (qx, qy, qz), i3


@inlined
def _largest_block(links: Any) -> int:
    largest = 0
    for m in range(links.shape[0]):
        largest = max(largest, links[m, PAST_VERTEX] - links[m, FIRST_VERTEX])
    return largest


@inlined
def _aligned(array: Any) -> Any:
    """The array from its first multiple of 64 bytes on: vectors that straddle cache lines take twice as long."""
    return array[(-array.ctypes.data % 64) // array.itemsize :]


@inlined
def _soft_point(p: Any, row: Any) -> Any:
    """Potential of a cloud's point, w (R^2 + eps^2)^(-3/2), and its slope over the offset, and the offset."""
    dx, dy, dz = p[0] - row[0], p[1] - row[1], p[2] - row[2]
    i = inverse_root(dx * dx + dy * dy + dz * dz + row[SOFTENING])
    potential = row[POINT_CHARGE] * (i * i * i)
    return potential, -3.0 * potential * (i * i), dx, dy, dz


@inlined
def _triple(row: Any, at: int) -> Any:
    return row[at], row[at + 1], row[at + 2]


@inlined
def _sphere_at(p: Any, row: Any) -> Any:
    return sphere_at(p, _triple(row, 0), row[SPHERE_RADIUS])


@inlined
def _capsule_at(p: Any, row: Any) -> Any:
    return charged_capsule_at(p, _triple(row, 0), _triple(row, OTHER_END), row[CAPSULE_RADIUS])


@inlined
def _plane_at(p: Any, row: Any) -> Any:
    return plane_at(p, _triple(row, 0), row[OFFSET])


@inlined
def _with_forms(t: Any, p: Any, f: Any, link: Any) -> Any:
    """The field with that of a leaf's closed forms added."""
    form, first, past = link[FORM], link[FIRST_ROW], link[PAST_ROW]
    if form == BOXES:
        for i in range(first, past):
            f = _plus(f, t.boxes[i, BOX_CHARGE], box_at(p[0], p[1], p[2], t.boxes[i]))
    elif form == SPHERES:
        for i in range(first, past):
            f = _plus(f, t.spheres[i, SPHERE_CHARGE], _sphere_at(p, t.spheres[i]))
    elif form == CAPSULES:
        for i in range(first, past):
            f = _plus(f, t.capsules[i, CAPSULE_CHARGE], _capsule_at(p, t.capsules[i]))
    elif form == PLANES:
        for i in range(first, past):
            f = _plus(f, t.planes[i, PLANE_CHARGE], _plane_at(p, t.planes[i]))
    elif form == POINTS:
        phi, gx, gy, gz, curvature, winding = f
        for i in range(first, past):
            potential, slope, dx, dy, dz = _soft_point(p, t.cloud[i])
            phi = phi + potential
            gx = gx + slope * dx
            gy = gy + slope * dy
            gz = gz + slope * dz
            # That of the law c/d with this potential and this slope.
            curvature = curvature + 2.0 * (slope * slope) * (dx * dx + dy * dy + dz * dz) / potential
        f = (phi, gx, gy, gz, curvature, winding)
    return f


@inlined
def _with_form_potentials(t: Any, p: Any, phi: Any, link: Any) -> Any:
    """`_with_forms` for the potential alone."""
    form, first, past = link[FORM], link[FIRST_ROW], link[PAST_ROW]
    if form == BOXES:
        for k in range(first, past):
            phi = phi + t.boxes[k, BOX_CHARGE] * box_at(p[0], p[1], p[2], t.boxes[k])[0]
    elif form == SPHERES:
        for k in range(first, past):
            phi = phi + t.spheres[k, SPHERE_CHARGE] * _sphere_at(p, t.spheres[k])[0]
    elif form == CAPSULES:
        for k in range(first, past):
            phi = phi + t.capsules[k, CAPSULE_CHARGE] * _capsule_at(p, t.capsules[k])[0]
    elif form == PLANES:
        for k in range(first, past):
            phi = phi + t.planes[k, PLANE_CHARGE] * _plane_at(p, t.planes[k])[0]
    elif form == POINTS:
        for k in range(first, past):
            phi = phi + _soft_point(p, t.cloud[k])[0]
    return phi


@inlined
def _field_of(t: Any, p: Any, scratch: Any, step: int) -> Any:
    """Down the trees: a node's expansion where all points are beyond its reach, what a leaf holds elsewhere."""
    zero = 0.0 * p[0]
    phi, gx, gy, gz, curvature, angle, winding = zero, zero, zero, zero, zero, zero, zero
    m = 0
    while m < t.links.shape[0]:
        node, link = t.nodes[m], t.links[m]
        dx, dy, dz = p[0] - node[0], p[1] - node[1], p[2] - node[2]
        square = dx * dx + dy * dy + dz * dz
        if every(square > t.reach[m] * t.reach[m]):
            term, along, across, q, i3 = _expansion(dx, dy, dz, square, node)
            phi = phi + term
            gx = gx + along * dx + across * q[0]
            gy = gy + along * dy + across * q[1]
            gz = gz + along * dz + across * q[2]
            angle = angle + (dx * node[AREA] + dy * node[AREA + 1] + dz * node[AREA + 2]) * i3
            m = link[AFTER]
            continue
        if link[PAST_VERTEX] > link[FIRST_VERTEX]:
            b = block_at(
                p, scratch, step, t.vertices[link[FIRST_VERTEX] : link[PAST_VERTEX]], link,
                t.triangle_corners, t.triangles, t.quad_corners, t.quads,
            )  # fmt: skip
            charge = node[CHARGE_PER_AREA]
            phi = phi + charge * b[0]
            gx = gx + charge * b[1]
            gy = gy + charge * b[2]
            gz = gz + charge * b[3]
            curvature = curvature + charge * b[4]
            angle = angle + b[5]
        if link[PAST_ROW] > link[FIRST_ROW]:
            phi, gx, gy, gz, curvature, winding = _with_forms(t, p, (phi, gx, gy, gz, curvature, winding), link)
        m += 1
    return phi, gx, gy, gz, curvature, angle * (-0.25 / math.pi) + winding


@inlined
def _potential_of(t: Any, p: Any, phi: Any, scratch: Any, step: int) -> Any:
    """`_field_of` for the potential alone, added to what there is."""
    m = 0
    while m < t.links.shape[0]:
        node, link = t.nodes[m], t.links[m]
        dx, dy, dz = p[0] - node[0], p[1] - node[1], p[2] - node[2]
        square = dx * dx + dy * dy + dz * dz
        if every(square > t.reach[m] * t.reach[m]):
            phi = phi + _expansion(dx, dy, dz, square, node)[0]
            m = link[AFTER]
            continue
        if link[PAST_VERTEX] > link[FIRST_VERTEX]:
            phi = phi + node[CHARGE_PER_AREA] * block_potential_at(
                p, scratch, step, t.vertices[link[FIRST_VERTEX] : link[PAST_VERTEX]], link,
                t.triangle_corners, t.triangles, t.quad_corners, t.quads,
            )  # fmt: skip
        if link[PAST_ROW] > link[FIRST_ROW]:
            phi = _with_form_potentials(t, p, phi, link)
        m += 1
    return phi


@compiled([void(TABLES, MATRIX, types.intp, MATRIX_OUT), void(TABLES_32, MATRIX_32, types.intp, MATRIX_32_OUT)])
def add_field(t: Any, points: Any, first: int, field_out: Any) -> None:
    """Add the field (6, n) at points (3, n) from the first on.

    Points behind the last whole vector are left out (`padded` adds some). They are in the frame of the tables, less its
    origin [m]; the field is potential [1/m], gradient (3) [1/m^2], curvature [1/m^3] and winding number.
    """
    x, y, z = points[0], points[1], points[2]
    step = lane_count(x)
    scratch = _aligned(np.empty((4 * _largest_block(t.links) + 1) * step, points.dtype))
    for i in range(first, points.shape[1] - step + 1, step):
        p = (load(x, i), load(y, i), load(z, i))
        for k, term in enumerate(_field_of(t, p, scratch, step)):
            row = field_out[k]
            store(row, i, load(row, i) + term)


@compiled(void(TABLES_32, MATRIX_32, types.intp, FLOATS_OUT))
def add_potential(t: Any, points: Any, first: int, potential_out: Any) -> None:
    """`add_field` for the potential alone, shape (n,), in half the time; as descents ask for it."""
    x, y, z = points[0], points[1], points[2]
    step = lane_count(x)
    scratch = _aligned(np.empty((_largest_block(t.links) + 1) * step, points.dtype))
    for i in range(first, points.shape[1] - step + 1, step):
        p = (load(x, i), load(y, i), load(z, i))
        store(potential_out, i, _potential_of(t, p, load(potential_out, i), scratch, step))
