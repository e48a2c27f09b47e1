"""Kernels of guide planes: descents on them, rounds towards them, free areas about points, a coarse way for the tip."""
