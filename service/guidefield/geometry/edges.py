"""The edges of triangles: which of them are the same, and how often each is run through."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.surfaces import Integers
from guidefield.kernels.cover.edge_numbers import count_ways, number_edges


def numbered_edges(triangles: Integers) -> tuple[Integers, int]:
    """Which edge each side of triangles (t, 3) is, whichever way it is run through.

    Returns:
        Numbers of ab, bc and ca of each triangle, shape (3 t,), ascending with the edge's lower vertex, then with the
        other one; and how many edges there are.
    """
    numbers = np.empty(triangles.size, np.int64)
    count = number_edges(np.ascontiguousarray(triangles, np.int64), int(triangles.max(initial=-1)) + 1, numbers)
    return numbers, count


def edge_counts(triangles: Integers, numbered: tuple[Integers, int] | None = None) -> tuple[Integers, Integers]:
    """How often each edge of triangles (t, 3) is run through upwards, and downwards, in the order of their numbers.

    `numbered` is what `numbered_edges` found, if it is at hand.
    """
    numbers, count = numbered or numbered_edges(triangles)
    up, down = np.zeros(count, np.int64), np.zeros(count, np.int64)
    count_ways(np.ascontiguousarray(triangles, np.int64), numbers, up, down)
    return up, down
