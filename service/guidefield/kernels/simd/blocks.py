"""How sixteen points and sixteen boxes lie in memory: each number of all sixteen, then the next."""

from guidefield.kernels.simd.vector_model import LANES

BLOCK = 3 * LANES
"""Floats of sixteen points: x, y, z of all."""

AROUND = 6 * LANES
"""Floats of the boxes about sixteen things along the world's axes: the least x, y, z of all, then the largest."""
