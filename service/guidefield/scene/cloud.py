"""Point clouds: collision shapes are balls around their points, charges those of the surface that they were taken from.

The tables of a cloud (`BatchCloud`, kernels/distance/point_tree.py) are made once: kernels hold their address, and
write distances that they find into `cells`. Softening, neighbours and `_MOST_CHARGED` shape the field alone; `CELL`,
 `MOST_CELLS` and `AROUND_POINTS` cost time and memory.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from guidefield.geometry import surfaces
from guidefield.geometry.surfaces import Floats, box_about
from guidefield.kernels.distance.bvh import fill_tree, sort_for_tree
from guidefield.kernels.distance.point_tree import NUMBERS, BatchCloud
from guidefield.kernels.simd.packing import AROUND, BLOCK, Words, pack
from guidefield.kernels.simd.vector import LANES
from guidefield.memo import memoized
from guidefield.scene.obstacle_parts import Charges

SOFTENING = 0.1  # softening length over the spacing: the field of a point stays finite
NEIGHBOURS = 6  # number of nearest neighbours by which density is estimated
_AT_ONCE = 512  # points whose distances to all are held in memory


def spacings(points: Floats, least: float, most: Floats | float) -> Floats:
    """Return the spacing of a square grid as dense as a cloud is around each of its points, shape (n,) [m].

    pi r^2 / k with r the distance of the k-th neighbour: unbiased for points spread at random on a smooth surface, 5 %
    too much for those of a square grid.

    Args:
        points: Shape (n, 3) [m].
        least: Least spacing that is returned [m], positive: points may coincide.
        most: Largest spacing that is returned [m], for all or for each, shape (n,).
    """
    k = min(NEIGHBOURS, len(points) - 1)
    if k < 1:
        return np.broadcast_to(np.asarray(most, float), len(points)).copy()
    squares = (points * points).sum(axis=1)
    found = np.empty(len(points))
    for first in range(0, len(points), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        apart = squares[some, None] + squares - 2.0 * (points[some] @ points.T)
        found[some] = np.partition(apart, k, axis=1)[:, k]
    spread: Floats = np.sqrt(np.maximum(found, 0.0) * (math.pi / k))
    return np.clip(spread, least, most)


def cloud_rows(points: Floats, spacing: Floats | float, charge: float = 1.0) -> Floats:
    """Return points of a surface sampled about evenly as rows for `geometry.charged.field_tables(cloud=...)`, (n, 5).

    From a distance of a spacing on, a sheet of such points has the potential of the sheet to within 1 %. Nearer than
    that the field is lumpy: in the middle of a hole of a square grid it is 16.5 / spacing, that of a wall 0.38 spacings
    away, so that a way may lead through. No certificate relies on it.

    Args:
        points: Shape (n, 3) [m], in the frame of the field.
        spacing: Distance of neighbours [m], of all or of each, shape (n,); every point represents its square.
        charge: Charge per area [1].

    Raises:
        ValueError: if a spacing isn't positive.
    """
    if not np.all(np.asarray(spacing) > 0.0):
        raise ValueError(f"`spacing` must be positive, got {np.min(spacing)} m")
    rows = np.empty((len(points), 5))
    rows[:, :3], rows[:, 3], rows[:, 4] = points, charge * np.square(spacing), SOFTENING * np.asarray(spacing)
    return rows


CELL = 0.04  # sides of the cells of a cloud's grid of distances [m], where that doesn't make too many
MOST_CELLS = 4_000_000  # at most, about: with more, cells are made larger
MOST_PLACES = 2**24  # never more, also of flat clouds: places of cells have to be whole numbers in float32
AROUND_POINTS = 0.1  # how far the grid goes beyond the points [m]


@dataclass(frozen=True, eq=False)
class CloudTables:
    """A cloud for kernels: tables, and the same packed, whose address is valid as long as the tables live."""

    tables: BatchCloud
    words: Words

    @property
    def address(self) -> int:
        """Address of the words."""
        return int(self.words.__array_interface__["data"][0])


def make_cloud_tables(points: np.ndarray, box: np.ndarray, radius: float) -> CloudTables:
    """Make the tables of points (n, 3) in a box (2, 3), with a radius [m, world]; kernels write into their grid."""
    points = points.copy()
    sort_for_tree(points)
    sizes = [-(-len(points) // LANES)]
    while len(sizes) == 1 or sizes[-1] > 1:
        sizes.append(-(-sizes[-1] // LANES))
    firsts = np.array([0, *np.cumsum([0, *sizes[1:-1]])], np.int64)
    packed_points = np.empty(BLOCK * sizes[0], np.float32)
    boxes = np.empty(AROUND * sum(sizes[1:]), np.float32)
    fill_tree(points, firsts, packed_points, boxes)
    low, high = box.astype(np.float32).astype(float)
    extent = high - low + 2.0 * AROUND_POINTS
    cell = max(CELL, math.cbrt(float(extent.prod()) / MOST_CELLS))
    while (counts := np.ceil(extent / cell)).prod() > MOST_PLACES:
        cell *= 1.25
    columns, rows, layers = counts.astype(int).tolist()
    numbers = np.empty(NUMBERS, np.float32)
    numbers[:] = [*(low - AROUND_POINTS + 0.5 * cell), cell, 1.0 / cell, *low, *high, radius]
    tables = BatchCloud(
        levels=len(firsts) - 1,
        columns=columns,
        rows=rows,
        layers=layers,
        firsts=firsts,
        points=packed_points,
        boxes=boxes,
        numbers=numbers,
        cells=np.zeros(columns * rows * layers, np.float32),
    )
    for array in tables[4:-1]:
        array.setflags(write=False)
    return CloudTables(tables, pack(tables))


MOST_IN_BODIES = 5_000  # most points of a cloud that a robot holds, which become a mesh (`handlers/attached.py`)
CORNERS = 12  # vertices of the body of each point, the icosahedron of `cloud_surface`: no setting

_MOST_CHARGED = 3_000
"""A cloud of more points has neighbours merged to one charge, because all are summed at every point of the robot;
service/docs/algorithm.md says so."""

_SPECK = 1e-9  # sides of the triangles that stand for points: this times 1 m plus the largest coordinate
_DENSEST = 0.01  # least spacing of a cloud's charges, over its radius
_SPHERE = math.sqrt(4.0 * math.pi)  # side of the square with the area of a sphere, over its radius


_MAKING = threading.Lock()


@dataclass(frozen=True, eq=False)
class Cloud:
    """Balls of one radius about points (n, 3) [m, world], of which some may be the same."""

    points: np.ndarray
    radius: float

    @cached_property
    def box(self) -> np.ndarray:
        """Corners of the box about the points, without their radius, shape (2, 3) [m, world]."""
        return box_about(self.points)

    @cached_property
    def tables(self) -> CloudTables:
        """Its tables for kernels, made once for all threads, because others keep only their address.

        A cached property would be made twice if two threads ask at the same time (since Python 3.12).
        """
        with _MAKING:
            made: CloudTables | None = vars(self).get("tables")
            if made is None:
                made = vars(self)["tables"] = make_cloud_tables(self.points, self.box, self.radius)
            return made


def cloud_specks(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Make a tiny triangle at each of points (n, 3) [m]: vertices (3 n, 3) and triangles (n, 3).

    If its corners are the same, Coal (3.0.3) takes distances of spheres for 0.
    """
    size, count = _SPECK * (1.0 + np.abs(points).max()), len(points)
    vertices = (points[:, None] + size * np.eye(3)).reshape(-1, 3)
    return vertices, np.arange(3 * count).reshape(-1, 3)


def cloud_surface(points: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Make icosahedra that contain the balls around points (n, 3) [m], for pictures and held clouds.

    Vertices (12 n, 3), 1.26 radii from the points, and triangles (20 n, 3).
    """
    ball = surfaces.sphere(1.0, subdivisions=0)
    a, b, c = ball.corners[0]
    inner = float(abs(np.cross(b - a, c - a) @ a) / np.linalg.norm(np.cross(b - a, c - a)))
    vertices = points[:, None] + (radius / inner) * ball.vertices
    triangles = CORNERS * np.arange(len(points))[:, None, None] + ball.triangles
    return vertices.reshape(-1, 3), triangles.reshape(-1, 3)


def cloud_charges(points: np.ndarray, radius: float) -> Charges:
    """Charge points (n, 3) [m, world] by the area of the surface nearest to each, at most that of its ball.

    Points at the same place count once. Those of a large cloud in each cube of a grid are merged first.
    """
    points = np.unique(points, axis=0)
    points, members = _put_together(points, _MOST_CHARGED)
    counts = np.bincount(members)
    return Charges(cloud=cloud_rows(points, spacings(points, _DENSEST * radius, np.sqrt(counts) * _SPHERE * radius)))


@memoized
def covering(cloud: Cloud, most: int) -> Cloud:
    """Cover a cloud by one of at most this many points, whose balls contain its balls."""
    centres, members = _put_together(cloud.points, most)
    away = np.linalg.norm(cloud.points - centres[members], axis=1)
    return Cloud(centres, cloud.radius + float(away.max()))


def _put_together(points: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Merge points (n, 3) to at most `most`, (k, 3); return these, and for each point the index of its own, (n,)."""
    if len(points) <= most:
        return points, np.arange(len(points))
    low = points.min(axis=0)
    extent = np.sort(points.max(axis=0) - low)
    side = max(math.sqrt(float(extent[1] * extent[2]) / most), float(extent[2]) / most)
    while True:
        cells = np.floor((points - low) / side).astype(np.int64)
        keys = (cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2]
        _, members, counts = np.unique(keys, return_inverse=True, return_counts=True)
        if len(counts) <= most:
            break
        side *= max(1.05, (len(counts) / most) ** 0.4)
    sums = [np.bincount(members, points[:, axis]) for axis in range(3)]
    return np.column_stack(sums) / counts[:, None], members
