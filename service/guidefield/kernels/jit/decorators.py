"""Decorators of kernels and of their parts.

A further decorator of kernels has to be named in `_KERNELS` of `cache.py`, which knows by it what to compile ahead.
Another `FASTMATH` or `CONTRACT` changes the last bits of nearly all results, and compiles most kernels anew.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

from guidefield.kernels.jit.arrays import find_signature
from guidefield.kernels.jit.compilers import kernel as make_kernel, part

# How sums may be rearranged. Not `ninf` and `nnan`: selects discard infinities, which must stay what they are.
FASTMATH = {"reassoc", "contract", "nsz", "arcp"}
# Sums keep their order in SIMD batches: the range reduction of angles depends on it.
CONTRACT = {"contract"}

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def _decorate_kernels(**options: Any) -> Callable[[Kernel], Kernel]:
    """Make a decorator of kernels whose annotations are their signature: machine code from the cache, without GIL."""

    def decorate(source: Kernel) -> Kernel:
        return cast(Kernel, make_kernel(functools.partial(find_signature, source), **options)(source))

    return decorate


def _decorate_parts(**options: Any) -> Callable[[Kernel], Kernel]:
    """Make a decorator of parts of kernels: compiled into each caller."""

    def decorate(source: Kernel) -> Kernel:
        return cast(Kernel, part(source, **options))

    return decorate


kernel = _decorate_kernels(fastmath=FASTMATH)
# What only kernels call is quicker to compile, as Python can't call it.
inner_kernel = _decorate_kernels(fastmath=FASTMATH, no_cpython_wrapper=True)
# Numbers are the same wherever they stand in an array.
exact_kernel = _decorate_kernels()
# Kernels of SIMD batches.
lane_kernel = _decorate_kernels(fastmath=CONTRACT)


def compiled(signatures: Any) -> Callable[[Kernel], Kernel]:
    """Decorator like `kernel`, of one signature or several that its annotations don't tell."""
    return make_kernel(signatures, fastmath=FASTMATH)


def lane_step(signature: Any) -> Callable[[Kernel], Kernel]:
    """Decorator of kernels of SIMD batches, on pointers, that only kernels call."""
    return make_kernel(signature, fastmath=CONTRACT, no_cpython_wrapper=True)


inlined = _decorate_parts(fastmath=FASTMATH)
# Of a loop that is a fifth slower where it is optimised within its caller only.
optimized = _decorate_parts(optimized=True, fastmath=FASTMATH)
exact_part = _decorate_parts()
lane_part = _decorate_parts(fastmath=CONTRACT)
# Parts that neither make nor return arrays, or are only called from such parts: counting references of named tuples of
# fifty arrays takes a quarter of a microsecond a call. What is called from them inherits that; what makes arrays there
# is `counted`.
uncounted = _decorate_parts(counting=False, fastmath=FASTMATH)
counted = _decorate_parts(counting=True, fastmath=FASTMATH)
lane_uncounted = _decorate_parts(counting=False, fastmath=CONTRACT)
