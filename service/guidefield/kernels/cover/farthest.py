"""Farthest point sampling: of many candidates a few that keep their distance, and to which of them each is nearest.

Candidates come in an order in which neighbours are near each other. Blocks of `BLOCK` of them have a ball around them
and know how far their farthest member is from all that is chosen: a new point too far from the ball changes nothing in
the block, so that after the first few only the blocks around it are looked at.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from guidefield.kernels.jit.signatures import INDICES_OUT, MATRIX, SCALAR, Floats, Integers, compiled, inlined

BLOCK = 64
"""Candidates of a block."""


@inlined
def _balls(candidates: Floats, balls: Floats) -> None:
    """Centre and radius of a ball around every block, about the middle of its extents."""
    for b in range(balls.shape[0]):
        first, past = b * BLOCK, min((b + 1) * BLOCK, candidates.shape[0])
        for c in range(3):
            low, high = candidates[first, c], candidates[first, c]
            for i in range(first, past):
                low, high = min(low, candidates[i, c]), max(high, candidates[i, c])
            balls[b, c] = 0.5 * (low + high)
        square = 0.0
        for i in range(first, past):
            dx, dy, dz = candidates[i, 0] - balls[b, 0], candidates[i, 1] - balls[b, 1], candidates[i, 2] - balls[b, 2]
            square = max(square, dx * dx + dy * dy + dz * dz)
        balls[b, 3] = math.sqrt(square)


@compiled(types.int64(MATRIX, types.int64, SCALAR, INDICES_OUT, INDICES_OUT))
def farthest_first(candidates: Floats, start: int, spacing: float, chosen_out: Integers, owner_out: Integers) -> int:
    """Choose candidates until none is as far as `spacing` from those chosen; ties go to the first.

    Args:
        candidates: Positions, neighbours near each other, shape (n, 3) [m].
        start: The first to choose.
        spacing: Least distance between two chosen [m].
        chosen_out: Gets the chosen, in order; shape (n,).
        owner_out: Gets the place in that order of the chosen one nearest to each candidate; shape (n,).

    Returns:
        How many were chosen.
    """
    n = candidates.shape[0]
    blocks = (n + BLOCK - 1) // BLOCK
    balls, farthest, which = np.empty((blocks, 4)), np.full(blocks, np.inf), np.zeros(blocks, np.int64)
    _balls(candidates, balls)
    nearest = np.full(n, np.inf)
    count, new = 0, start
    while True:
        chosen_out[count] = new
        x, y, z = candidates[new, 0], candidates[new, 1], candidates[new, 2]
        best, block = -1.0, 0
        for b in range(blocks):
            dx, dy, dz = balls[b, 0] - x, balls[b, 1] - y, balls[b, 2] - z
            # beyond the farthest member's distance nothing in the block comes nearer
            reach = balls[b, 3] + math.sqrt(farthest[b])
            if dx * dx + dy * dy + dz * dz < reach * reach:
                farthest[b] = -1.0
                for i in range(b * BLOCK, min((b + 1) * BLOCK, n)):
                    ex, ey, ez = candidates[i, 0] - x, candidates[i, 1] - y, candidates[i, 2] - z
                    square = ex * ex + ey * ey + ez * ez
                    if square < nearest[i]:
                        nearest[i] = square
                        owner_out[i] = count
                    if nearest[i] > farthest[b]:
                        farthest[b], which[b] = nearest[i], i
            if farthest[b] > best:
                best, block = farthest[b], b
        count += 1
        if best < spacing * spacing or count == n:
            return count
        new = which[block]
