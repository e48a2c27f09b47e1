"""Types and compiler options that the kernels share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import types
from numpy.typing import NDArray

from guidefield.kernels.jit.compilers import kernel as made, part

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Integers = NDArray[np.int64]
Vector3 = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]
"""Of a field at a point: potential [1/m], gradient (3) [1/m^2], curvature [1/m^3], winding number."""

SCALAR = types.float64

VECTOR = types.Array(types.float64, 1, "C", readonly=True)
"""Input, shape (n,); frozen and fresh arrays both fit, a strided one is refused."""

MATRIX = types.Array(types.float64, 2, "C", readonly=True)
"""Input, shape (m, n)."""

INDEX_MATRIX = types.Array(types.int64, 2, "C", readonly=True)
"""Input of whole numbers, shape (m, n)."""

INDICES = types.Array(types.int64, 1, "C", readonly=True)
"""Input of whole numbers, shape (n,)."""

BLOCKS = types.Array(types.float64, 3, "C", readonly=True)
"""Input, shape (k, m, n)."""

VECTOR_OUT = types.Array(types.float64, 1, "C")
"""Output, shape (n,)."""

MATRIX_OUT = types.Array(types.float64, 2, "C")
"""Output, shape (m, n)."""

INDICES_OUT = types.Array(types.int64, 1, "C")
"""Output of whole numbers, shape (n,)."""

INDEX_MATRIX_OUT = types.Array(types.int64, 2, "C")
"""Output of whole numbers, shape (m, n)."""

BLOCKS_OUT = types.Array(types.float64, 3, "C")
"""Output, shape (k, m, n)."""

FLOATS = types.Array(types.float32, 1, "C", readonly=True)
"""Input in single precision, shape (n,)."""

FLOATS_OUT = types.Array(types.float32, 1, "C")
"""Output in single precision, shape (n,)."""

FLOAT_POINTER, DOUBLE_POINTER, INTEGER_POINTER = map(types.CPointer, (types.float32, types.float64, types.int64))

FASTMATH = {"reassoc", "contract", "nsz", "arcp"}
"""How sums may be rearranged. Not `ninf` and `nnan`: selects discard infinities, which must stay what they are."""

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def inlined(kernel: Kernel) -> Kernel:
    """Decorator of the parts of kernels: compiled into each caller, so that its loops become vector loops."""
    return cast(Kernel, part(kernel, fastmath=FASTMATH))


def optimized(kernel: Kernel) -> Kernel:
    """Decorator like `inlined`, of a loop that is a fifth slower where it is optimised within its caller only."""
    return cast(Kernel, part(kernel, optimized=True, fastmath=FASTMATH))


def compiled(signature: Any) -> Callable[[Kernel], Kernel]:
    """Decorator of a kernel of one signature: machine code from the cache, no GIL, division by zero gives infinity."""
    return made(signature, fastmath=FASTMATH)


def exact_kernel(signature: Any) -> Callable[[Kernel], Kernel]:
    """Decorator of a kernel of one signature whose numbers are the same wherever they stand in an array."""
    return made(signature)


def exact_part(kernel: Kernel) -> Kernel:
    """Decorator of parts of exact kernels: compiled into the caller, the same numbers in each place."""
    return cast(Kernel, part(kernel))


def lane_part(kernel: Kernel) -> Kernel:
    """Decorator of parts of lane kernels: compiled into the caller.

    Sums keep their order, unlike in the other kernels: the range reduction of angles depends on it.
    """
    return cast(Kernel, part(kernel, fastmath={"contract"}))


def lane_kernel(signature: Any, **options: bool) -> Callable[[Kernel], Kernel]:
    """Decorator of a lane kernel of one signature: machine code from the cache, no GIL; sums keep their order."""
    return made(signature, fastmath={"contract"}, **options)


def lane_step(signature: Any) -> Callable[[Kernel], Kernel]:
    """The same for a kernel that only kernels call: quicker to compile, as Python can't call it."""
    return lane_kernel(signature, no_cpython_wrapper=True, no_cfunc_wrapper=True)
