"""Pure compiled functions over arrays; the only room that imports numba."""
