"""Pairs of boxes that overlap: by a sweep, in the order of their lower ends, or by a tree."""

from __future__ import annotations

import numpy as np
from numba import types

from guidefield.kernels.jit.signatures import INDICES, MATRIX, Floats, Integers, compiled


@compiled(types.int64(MATRIX, MATRIX, INDICES, types.int64, types.int64, types.Array(types.int64, 2, "C")))
def swept_pairs(low: Floats, high: Floats, ends: Integers, first: int, last: int, pairs_out: Integers) -> int:
    """Write the pairs of some boxes and later ones whose boxes overlap across the sweep.

    Args:
        low: The two coordinates across of the lower corners, shape (2, n) [m].
        high: Those of the upper corners, shape (2, n) [m].
        ends: Behind the last box that begins within each box along the sweep, shape (n,).
        first: The first box that is compared with those behind it.
        last: The one behind the last of them.
        pairs_out: Gets the pairs, the earlier one first; shape (m, 2), enough for all.

    Returns:
        How many there are.
    """
    count = 0
    for one in range(first, last):
        for other in range(one + 1, ends[one]):
            if (
                low[0, one] <= high[0, other]
                and low[0, other] <= high[0, one]
                and low[1, one] <= high[1, other]
                and low[1, other] <= high[1, one]
            ):
                pairs_out[count, 0], pairs_out[count, 1] = one, other
                count += 1
    return count


@compiled(types.int64(MATRIX, INDICES, types.int64, MATRIX, MATRIX, types.Array(types.int64, 2, "C")))
def overlaps_in_tree(
    boxes: Floats, firsts: Integers, children: int, low: Floats, high: Floats, pairs_out: Integers
) -> int:
    """Write which boxes overlap which of a tree's; boxes that touch do.

    Args:
        boxes: Of all levels one after the other, the tree's own first, lower, then upper corners, shape (m, 6) [m].
        firsts: Where each level begins, and the last one ends, shape (levels + 1,).
        children: How many of a level are behind each of the next: those of box i begin at `children * i`.
        low: Lower corners of the others, shape (q, 3) [m].
        high: Upper corners, shape (q, 3) [m].
        pairs_out: Gets the index of one of the others and a box's place in the tree, shape (k, 2); as many as fit.

    Returns:
        How many there are.
    """
    count, levels = 0, firsts.shape[0] - 1
    nodes, depths = np.empty(children * levels, np.int64), np.empty(children * levels, np.int64)
    for asked in range(low.shape[0]):
        top = 0
        for node in range(firsts[levels] - firsts[levels - 1]):
            nodes[top], depths[top] = node, levels - 1
            top += 1
        while top > 0:
            top -= 1
            node, level = nodes[top], depths[top]
            box = boxes[firsts[level] + node]
            if not (
                box[0] <= high[asked, 0]
                and box[3] >= low[asked, 0]
                and box[1] <= high[asked, 1]
                and box[4] >= low[asked, 1]
                and box[2] <= high[asked, 2]
                and box[5] >= low[asked, 2]
            ):
                continue
            if level == 0:
                if count < pairs_out.shape[0]:
                    pairs_out[count, 0], pairs_out[count, 1] = asked, node
                count += 1
                continue
            below = firsts[level] - firsts[level - 1]
            for child in range(children * node, min(children * (node + 1), below)):
                nodes[top], depths[top] = child, level - 1
                top += 1
    return count
