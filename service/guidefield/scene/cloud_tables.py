"""Clouds of points as tables for the kernels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from guidefield.kernels.distance.bvh import fill_tree, sort_for_tree
from guidefield.kernels.distance.point_tree import NUMBERS, LaneCloud
from guidefield.kernels.simd.blocks import AROUND, BLOCK
from guidefield.kernels.simd.packing import Words, packed
from guidefield.kernels.simd.vector_model import LANES

CELL = 0.04
"""Sides of the grid's cells [m], where that doesn't make too many."""

MOST_CELLS = 4_000_000
"""With more, cells are larger: their places have to be whole numbers in float32."""

AROUND_POINTS = 0.1
"""How far the grid goes beyond the points [m]."""


@dataclass(frozen=True, eq=False)
class CloudTables:
    """A cloud for kernels.

    Attributes:
        tables: What the kernels read.
        words: The same packed; valid as long as the tables live.
    """

    tables: LaneCloud
    words: Words

    @property
    def address(self) -> int:
        """Address of the words."""
        return int(self.words.__array_interface__["data"][0])


def make_cloud_tables(points: np.ndarray, box: np.ndarray, radius: float) -> CloudTables:
    """Make the tables of a cloud; what kernels find of its grid stays in them.

    Args:
        points: Shape (n, 3) [m, world].
        box: Corners of the box about them, shape (2, 3) [m].
        radius: Of the balls about them [m].
    """
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
    columns, rows, layers = np.ceil(extent / cell).astype(int).tolist()
    numbers = np.empty(NUMBERS, np.float32)
    numbers[:] = [*(low - AROUND_POINTS + 0.5 * cell), cell, 1.0 / cell, *low, *high, radius]
    tables = LaneCloud(
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
    return CloudTables(tables, packed(tables))
