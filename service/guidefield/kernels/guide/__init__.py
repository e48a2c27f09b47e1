"""Kernels of guide planes: descents on them, rounds towards them, free space and a coarse path for the tip."""
