"""The compiler of kernels: numba, the cache of their machine code, and what compiles the missing ones ahead."""
