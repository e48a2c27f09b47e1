# ruff: noqa: ARG001  numba calls typing and code generation with arguments that most have no use for
"""Allocation from an array that several threads share, for cells of `self_narrowphase`: no two get the same numbers.

`collision/lanes/cell_grids.py` makes that array, and writes from where on numbers are free.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from guidefield.kernels.jit.decorators import lane_part


@intrinsic
def _added(typing: Any, numbers: Any, amount: Any) -> Any:
    """Add to the first of some int32 at once for all threads; what it was before."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        more = builder.trunc(args[1], ir.IntType(32))
        return builder.sext(builder.atomic_rmw("add", args[0], more, "seq_cst"), ir.IntType(64))

    return types.int64(types.CPointer(types.int32), types.int64), generate


@lane_part
def claimed(numbers: Any, amount: int, size: int) -> int:
    """Return the first of `amount` numbers of (size,) that nobody has; -1 if there aren't that many left.

    The first number, int32, says from where on they are free.
    """
    if numbers[0] + amount > size:
        return -1
    first = _added(numbers, amount)
    return first if first + amount <= size else -1
