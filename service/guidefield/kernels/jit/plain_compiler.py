"""Kernels compiled by what numba offers and documents for everybody: slower, and the same results up to rounding.

Each part gets machine code that nobody calls, and each kernel is compiled once more into every kernel that calls it.
Functions are those of `patched_compiler`, as `compilers` calls either.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

from numba import njit
from numba.extending import register_jitable


def kernel(signatures: Any, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator of a kernel of one signature or several, or what tells them, with numba's options."""
    decorator: Callable[[Callable[..., Any]], Any] = njit(
        signatures() if callable(signatures) else signatures, **options
    )
    return decorator


def part(function: Callable[..., Any], optimized: bool, counting: bool | None, **options: Any) -> Any:  # noqa: ARG001
    """The function itself, that numba compiles into kernels from now on: always optimised, always counting."""
    return register_jitable(forceinline=True, **options)(function)


def load(module: ModuleType) -> None:
    """Nothing: the import of the file has compiled its kernels."""


def quicken() -> None:
    """Nothing: numba stays as it is."""
