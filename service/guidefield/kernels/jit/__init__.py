"""How numba compiles kernels, keeps their machine code, and compiles what is missing ahead."""
