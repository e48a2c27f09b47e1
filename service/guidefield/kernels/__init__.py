"""Pure compiled functions over arrays; the only room that imports numba."""

from guidefield.kernels.cache import use_kernel_folders
from guidefield.kernels.quick_typing import quicken_typing

# Before any kernel is decorated: numba chooses the folder when it meets `cache=True`.
use_kernel_folders()
quicken_typing()
