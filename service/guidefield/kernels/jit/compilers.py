"""Compiler of kernels and their parts: with changes to what is inside numba, or plain.

The changes (`patched_compiler`) fit the versions of numba that `first_start` knows, and save time only. With other
versions, and with ``GUIDEFIELD_PLAIN_NUMBA=1`` in the environment, they aren't imported (`plain_compiler`): compiling
takes several times as long, and kernels return the same up to rounding. The machine code of both is kept apart.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

from guidefield.deadline import waiting_for_kernels
from guidefield.first_start import plain_numba
from guidefield.kernels.jit.cache import is_kept, use_kernel_folders


def _choose_compiler() -> Any:
    """The file whose functions compile."""
    if plain_numba():
        from guidefield.kernels.jit import plain_compiler

        return plain_compiler
    from guidefield.kernels.jit import patched_compiler

    return patched_compiler


_COMPILER = _choose_compiler()


def kernel(signatures: Any, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator of a kernel of one signature or several, or what tells them later, with numba's options.

    Its machine code is kept, it runs without the GIL, and division by zero gives infinity.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        use_kernel_folders()
        # C calls none: what numba would make for that is left out
        common = {"cache": is_kept(function), "error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
        with waiting_for_kernels():  # the plain compiler compiles at once
            return _COMPILER.kernel(signatures, **{**common, **options})(function)

    return decorate


def part(
    function: Callable[..., Any], optimized: bool = False, counting: bool | None = None, **options: Any
) -> Callable[..., Any]:
    """Make a part of kernels from its source, with numba's options: compiled into each caller.

    Called from Python, it runs as Python does. An `optimized` one is optimised before that, too: it costs time, and a
    few long loops become better vector loops. One that doesn't count references to arrays, which costs time, must
    neither make nor return arrays; None: as its caller does.
    """
    made: Callable[..., Any] = _COMPILER.part(function, optimized, counting, error_model="numpy", **options)
    return made


def load(module: ModuleType) -> None:
    """Compile the kernels of an imported file, or load their machine code; else their first calls do."""
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
