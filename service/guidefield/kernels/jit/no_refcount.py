"""Parts of kernels that don't count references to their arguments.

A part that is handed named tuples of fifty arrays counts each of them up and down again: a quarter of a microsecond a
call. One that neither makes nor returns arrays needs none of that. What is called from it inherits its options, so that
what makes arrays there has to say so.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from guidefield.kernels.jit.compilers import part
from guidefield.kernels.jit.signatures import FASTMATH

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def uncounted(kernel: Kernel) -> Kernel:
    """Decorator like `inlined`, of what neither makes nor returns arrays, or is only called from such parts."""
    return cast(Kernel, part(kernel, counting=False, fastmath=FASTMATH))


def counted(kernel: Kernel) -> Kernel:
    """Decorator like `inlined`, of what makes arrays and is called from parts that don't count."""
    return cast(Kernel, part(kernel, counting=True, fastmath=FASTMATH))


def lane_uncounted(kernel: Kernel) -> Kernel:
    """Decorator like `lane_part`, of what neither makes nor returns arrays, or is only called from such parts."""
    return cast(Kernel, part(kernel, counting=False, fastmath={"contract"}))
