"""Vector types for kernels, arithmetic on them, and how arguments are packed."""
