"""How kernels and their parts are compiled: with changes to what is inside numba, or plainly.

The changes (`patched_compiler`, `typing_cache`) fit the versions of numba that `first_start` knows, and save time only.
With other versions, and with ``GUIDEFIELD_PLAIN_NUMBA=1`` in the environment, none of them is as much as imported
(`plain_compiler`): compiling takes several times as long, and what kernels return is the same up to rounding. The
machine code of both is kept apart.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

from guidefield.first_start import plain_numba
from guidefield.kernels.jit.cache import is_kept, use_kernel_folders


def _chosen() -> Any:
    """The file whose functions compile."""
    if plain_numba():
        from guidefield.kernels.jit import plain_compiler

        return plain_compiler
    from guidefield.kernels.jit import patched_compiler

    return patched_compiler


_COMPILER = _chosen()


def kernel(signature: Any, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator of a kernel: machine code that is kept, no GIL, division by zero gives infinity.

    Args:
        signature: The types of its arguments and of what it returns, or several such.
        options: Further options of numba's.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        use_kernel_folders()
        common = {"cache": is_kept(function), "error_model": "numpy", "nogil": True}
        return _COMPILER.kernel(signature, **common, **options)(function)

    return decorate


def part(
    function: Callable[..., Any], optimized: bool = False, counting: bool | None = None, **options: Any
) -> Callable[..., Any]:
    """A part of kernels from its source: compiled into each caller; called from Python, it runs as Python does.

    Args:
        function: Its source.
        optimized: Optimise it before that, too: it costs time, and a few long loops become better vector loops for it.
        counting: Whether it counts references to arrays, which costs time; None: as its caller does. One that doesn't
            must neither make nor return arrays.
        options: numba's.
    """
    made: Callable[..., Any] = _COMPILER.part(function, optimized, counting, error_model="numpy", **options)
    return made


def load(module: ModuleType) -> None:
    """Compile the kernels of a file that has been imported, or load what is kept of them; else their first calls do."""
    _COMPILER.load(module)


def load_imported(*rooms: str) -> None:
    """The same for all files of some rooms, or of all, that have been imported by now, so that no first call waits.

    Before threads call kernels at the same time, one has to load them: numba tells types apart by numbers, which two
    threads that meet a type for the first time could give twice.
    """
    beginnings = tuple(f"guidefield.kernels.{room}" for room in rooms) or ("guidefield.kernels.",)
    for name, module in list(sys.modules.items()):
        if name.startswith(beginnings):
            load(module)


def quicken() -> None:
    """Have numba compile in half the time, in this process: one that only compiles, as its answers to others change."""
    _COMPILER.quicken()
