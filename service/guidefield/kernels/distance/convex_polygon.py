"""The inradius of a convex polygon, exactly."""

from __future__ import annotations

import numpy as np

from guidefield.kernels.jit.signatures import MATRIX, SCALAR, VECTOR, Floats, compiled, inlined

_PARALLEL = 1e-12
"""Edges whose normals have a smaller cross product don't meet."""


@inlined
def _cross(normals: Floats, a: int, b: int) -> float:
    return float(normals[a, 0] * normals[b, 1] - normals[a, 1] * normals[b, 0])


@inlined
def _edge_length(normals: Floats, offsets: Floats, count: int, k: int, inset: float) -> float:
    """Length of edge k, all of them moved inwards; negative where its neighbours meet beyond."""
    before, after = (k - 1) % count, (k + 1) % count
    o0, o1, o2 = offsets[before] + inset, offsets[k] + inset, offsets[after] + inset
    t1, t2 = _cross(normals, before, k), _cross(normals, k, after)
    x1 = (o0 * normals[k, 1] - o1 * normals[before, 1]) / t1
    y1 = (normals[before, 0] * o1 - normals[k, 0] * o0) / t1
    x2 = (o1 * normals[after, 1] - o2 * normals[k, 1]) / t2
    y2 = (normals[k, 0] * o2 - normals[after, 0] * o1) / t2
    return float((x2 - x1) * normals[k, 1] - (y2 - y1) * normals[k, 0])


@compiled(SCALAR(MATRIX, VECTOR, SCALAR))
def inradius(inward: Floats, offsets: Floats, straight: float) -> float:
    """Largest inset that leaves something over: edges move inwards, the first to vanish is dropped, until all is gone.

    Each edge's length is linear in the inset between two such events, so each event is exact.

    Args:
        inward: Unit normals of the edges, to the inside, counter-clockwise, shape (k, 2).
        offsets: Shape (k,): ``inward[i] . x - offsets[i]`` is the height of x over edge i [m].
        straight: Edges whose normals have a smaller cross product are in line: they have no corner of their own.

    Returns:
        The inradius [m].
    """
    edges = inward.shape[0]
    normals, at = np.empty((edges, 2)), np.empty(edges)
    count = 0
    for k in range(edges):
        if _cross(inward, (k - 1) % edges, k) > straight:
            normals[count, 0], normals[count, 1], at[count] = inward[k, 0], inward[k, 1], offsets[k]
            count += 1
    while True:
        first, soonest = 0, np.inf
        for k in range(count):
            length = _edge_length(normals, at, count, k, 0.0)
            vanishes = length / max(length - _edge_length(normals, at, count, k, 1.0), 1e-300)
            if vanishes < soonest:
                first, soonest = k, vanishes
        if count <= 3 or _cross(normals, (first - 1) % count, (first + 1) % count) <= _PARALLEL:
            return soonest
        count -= 1
        for k in range(first, count):
            normals[k, 0], normals[k, 1], at[k] = normals[k + 1, 0], normals[k + 1, 1], at[k + 1]
