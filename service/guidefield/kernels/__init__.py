"""Pure compiled functions over arrays; the only room that imports numba."""

from guidefield.kernels.cache import select_cache_folder

# Before any kernel is decorated: numba reads the folder when it meets `cache=True`.
select_cache_folder()
