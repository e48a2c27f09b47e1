"""Parts of kernels, compiled for Python too."""

from collections.abc import Callable
from typing import Any

import numba

from guidefield.kernels.jit.decorators import FASTMATH


def from_python(part: Any) -> Callable[..., Any]:
    """A part as a function that Python can call, compiled with the options of parts."""
    return numba.njit(fastmath=FASTMATH, error_model="numpy")(part.py_func)
