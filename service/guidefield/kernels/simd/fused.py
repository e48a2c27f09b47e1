"""A product and a sum, rounded once: in the order in which BLAS takes them, where numbers are to be the same."""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import intrinsic


@intrinsic
def fused(typing: Any, x: Any, y: Any, z: Any) -> Any:  # noqa: ARG001  numba's
    """``x y + z``, rounded once."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001  numba's
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), emit
