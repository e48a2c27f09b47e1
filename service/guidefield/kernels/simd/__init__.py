"""Vector types for kernels, arithmetic and rotations on them, and how arguments are packed."""
