"""Decorators of kernels and of their parts, and what compiles them: numba with changes inside, or plain.

A further decorator of kernels has to be named in `_KERNELS` of `cache.py`, which knows by it what to compile ahead.
Another `FASTMATH` or `CONTRACT` changes the last bits of nearly all results, and compiles most kernels anew.

The changes (`patched_compiler`) fit the versions of numba that `first_start` knows, and save time only. With other
versions, and with ``GUIDEFIELD_PLAIN_NUMBA=1`` in the environment, they aren't imported: by what numba documents for
everybody each part gets machine code that nobody calls, and each kernel is compiled once more into every kernel that
calls it. That takes several times as long, and kernels return the same up to rounding. The machine code of both is kept
apart.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any, TypeVar, cast

from numba import njit
from numba.extending import register_jitable

from guidefield.deadline import waiting_for_kernels
from guidefield.first_start import plain_numba
from guidefield.kernels.jit.arrays import find_signature
from guidefield.kernels.jit.cache import is_kept, use_kernel_folders

# How sums may be rearranged. Not `ninf` and `nnan`: selects discard infinities, which must stay what they are.
FASTMATH = {"reassoc", "contract", "nsz", "arcp"}
# Sums keep their order in SIMD batches: the range reduction of angles depends on it.
CONTRACT = {"contract"}

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def _import_changes() -> Any:
    """Return the module with the changes to numba, or None if numba stays plain."""
    if plain_numba():
        return None
    from guidefield.kernels.jit import patched_compiler

    return patched_compiler


_CHANGES = _import_changes()


def make_kernel(signatures: Any, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator of a kernel of one signature or several, or what tells them later, with numba's options.

    Its machine code is kept, it runs without the GIL, and division by zero gives infinity.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        use_kernel_folders()
        # C calls none: what numba would make for that is left out
        common = {"cache": is_kept(function), "error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
        with waiting_for_kernels():  # plain numba compiles at once
            if _CHANGES is not None:
                return _CHANGES.kernel(signatures, **{**common, **options})(function)
            return njit(signatures() if callable(signatures) else signatures, **{**common, **options})(function)

    return decorate


def _make_part(
    function: Callable[..., Any], optimized: bool = False, counting: bool | None = None, **options: Any
) -> Any:
    """Make a part of kernels from its source, with numba's options: compiled into each caller.

    Called from Python, it runs as Python does. An `optimized` one is optimised before that, too: it costs time, and a
    few long loops become better vector loops. One that doesn't count references to arrays, which costs time, must
    neither make nor return arrays; None: as its caller does. Plain numba always optimises and always counts.
    """
    if _CHANGES is not None:
        return _CHANGES.part(function, optimized, counting, error_model="numpy", **options)
    return register_jitable(forceinline=True, error_model="numpy", **options)(function)


def load(module: ModuleType) -> None:
    """Compile the kernels of an imported file, or load their machine code; else their first calls do."""
    if _CHANGES is not None:  # plain numba has compiled them at the import
        _CHANGES.load(module)


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
    if _CHANGES is not None:
        _CHANGES.quicken()


def _decorate_kernels(**options: Any) -> Callable[[Kernel], Kernel]:
    """Make a decorator of kernels whose annotations are their signature."""

    def decorate(source: Kernel) -> Kernel:
        return cast(Kernel, make_kernel(functools.partial(find_signature, source), **options)(source))

    return decorate


def _decorate_parts(**options: Any) -> Callable[[Kernel], Kernel]:
    def decorate(source: Kernel) -> Kernel:
        return cast(Kernel, _make_part(source, **options))

    return decorate


kernel = _decorate_kernels(fastmath=FASTMATH)
# What only kernels call is quicker to compile, as Python can't call it.
inner_kernel = _decorate_kernels(fastmath=FASTMATH, no_cpython_wrapper=True)
# Numbers are the same wherever they stand in an array.
exact_kernel = _decorate_kernels()
# Kernels of SIMD batches.
vector_kernel = _decorate_kernels(fastmath=CONTRACT)


def compiled(signatures: Any) -> Callable[[Kernel], Kernel]:
    """Decorator like `kernel`, of one signature or several that its annotations don't tell."""
    return make_kernel(signatures, fastmath=FASTMATH)


def vector_step(signature: Any) -> Callable[[Kernel], Kernel]:
    """Decorator of kernels of SIMD batches, on pointers, that only kernels call."""
    return make_kernel(signature, fastmath=CONTRACT, no_cpython_wrapper=True)


inlined = _decorate_parts(fastmath=FASTMATH)
# Of a loop that is a fifth slower where it is optimised within its caller only.
optimized = _decorate_parts(optimized=True, fastmath=FASTMATH)
exact_part = _decorate_parts()
vector_part = _decorate_parts(fastmath=CONTRACT)
# Parts that neither make nor return arrays, or are only called from such parts: counting references of named tuples of
# fifty arrays takes a quarter of a microsecond a call. What is called from them inherits that; what makes arrays there
# is `counted`.
uncounted = _decorate_parts(counting=False, fastmath=FASTMATH)
counted = _decorate_parts(counting=True, fastmath=FASTMATH)
vector_uncounted = _decorate_parts(counting=False, fastmath=CONTRACT)
