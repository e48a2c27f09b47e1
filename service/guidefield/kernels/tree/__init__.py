"""RRT-Connect in SIMD batches: samples, nodes and the nearest of them, steps within path constraints, shortcuts."""
