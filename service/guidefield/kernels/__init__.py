"""Pure compiled functions over arrays; the only room that imports numba."""

from guidefield.kernels.cache import use_kernel_folders

# Before any kernel is decorated: numba chooses the folder when it meets `cache=True`.
use_kernel_folders()
