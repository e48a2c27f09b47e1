"""Layout of sixteen points and of sixteen boxes in memory: each number of all sixteen, then the next."""

from __future__ import annotations

from guidefield.kernels.jit.signatures import Floats32, Vector3, lane_part
from guidefield.kernels.simd.vector import LANES, Vector, load

BLOCK = 3 * LANES
"""Floats of sixteen points: x, y, z of all."""

AROUND = 2 * BLOCK
"""Floats of the boxes about sixteen things along the world's axes: the least x, y, z of all, then the largest."""


@lane_part
def points_at(numbers: Floats32, at: int) -> tuple[Vector, Vector, Vector]:
    """The sixteen points of a block that begins there in `numbers`, shape (n,)."""
    return load(numbers, at), load(numbers, at + LANES), load(numbers, at + 2 * LANES)


@lane_part
def point_at(numbers: Floats32, at: int) -> Vector3:
    """One point of a block in `numbers`, shape (n,), whose x is there."""
    return numbers[at], numbers[at + LANES], numbers[at + 2 * LANES]
