"""Tables of charges as field kernels read them: their columns, and versions without expansions or in single precision.

`geometry/charged.py` and `far_tree.py` write them. `single_precision` moves the position that each row begins with: a
further kind of charge needs a line there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from guidefield.kernels.field.faces import HALF_ROWS, PLANE_ROWS
from guidefield.kernels.jit.arrays import IndexRows, Row, Rows, numba_type

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

    def moved(rows: np.ndarray, *columns: int) -> np.ndarray:
        result = rows.copy()
        for column in columns:
            result[:, column : column + 3] -= shift
        return frozen(result.astype(np.float32))

    planes = tables.planes.copy()
    planes[:, OFFSET] -= planes[:, :3] @ shift
    return tables._replace(
        origin=frozen(tables.origin + shift),
        boxes=moved(tables.boxes, 0),
        vertices=moved(tables.vertices, 0),
        triangles=moved(tables.triangles, 0),
        quads=moved(tables.quads, 0),
        nodes=moved(tables.nodes, 0),
        reach=frozen(tables.reach.astype(np.float32)),
        spheres=moved(tables.spheres, 0),
        capsules=moved(tables.capsules, 0, OTHER_END),
        planes=frozen(planes.astype(np.float32)),
        cloud=moved(tables.cloud, 0),
    )


def frozen(values: np.ndarray) -> np.ndarray:
    """The values as a C-contiguous array of the same shape that is read-only."""
    array = np.ascontiguousarray(values)
    array.setflags(write=False)
    return array
