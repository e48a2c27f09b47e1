"""How the fields of a named tuple that kernels take are declared: with their type in Python and in numba at once."""

from __future__ import annotations

import functools
from typing import Annotated, Any, get_args, get_type_hints

import numpy as np
from numba import types
from numpy.typing import NDArray

from guidefield.kernels.jit.signatures import (
    BLOCKS,
    BLOCKS_OUT,
    FLOATS,
    FLOATS_OUT,
    INDEX_MATRIX,
    INDEX_MATRIX_OUT,
    INDICES,
    INDICES_OUT,
    MATRIX,
    MATRIX_OUT,
    VECTOR,
    VECTOR_OUT,
    Floats,
    Floats32,
    Integers,
)

# What kernels read; what they write ends with Out.
Row = Annotated[Floats, VECTOR]
RowOut = Annotated[Floats, VECTOR_OUT]
Rows = Annotated[Floats, MATRIX]
RowsOut = Annotated[Floats, MATRIX_OUT]
Blocks = Annotated[Floats, BLOCKS]
BlocksOut = Annotated[Floats, BLOCKS_OUT]
Indices = Annotated[Integers, INDICES]
IndicesOut = Annotated[Integers, INDICES_OUT]
IndexRows = Annotated[Integers, INDEX_MATRIX]
IndexRowsOut = Annotated[Integers, INDEX_MATRIX_OUT]
IndexBlocksOut = Annotated[Integers, types.Array(types.int64, 3, "C")]
Singles = Annotated[Floats32, FLOATS]
SinglesOut = Annotated[Floats32, FLOATS_OUT]
Cells = Annotated[NDArray[np.int32], types.Array(types.int32, 1, "C")]
Bits = Annotated[NDArray[np.uint32], types.Array(types.uint32, 1, "C")]
Flags = Annotated[NDArray[np.bool_], types.Array(types.boolean, 2, "C", readonly=True)]

_NUMBERS = {int: types.int64, float: types.float64}


@functools.cache
def numba_type(layout: type) -> Any:
    """The type for numba of a named tuple, by how its fields are declared; tuples may be in tuples."""
    return types.BaseTuple.from_types(tuple(_kinds(layout).values()), layout)


def array_types(layout: type) -> dict[str, np.dtype[Any]]:
    """The NumPy type of each field of a named tuple that is an array, by the field's name."""
    kinds = _kinds(layout).items()
    return {name: np.dtype(str(kind.dtype)) for name, kind in kinds if isinstance(kind, types.Array)}


def _kinds(layout: type) -> dict[str, Any]:
    declared = get_type_hints(layout, include_extras=True)
    return {name: _kind(declared[name]) for name in layout._fields}  # type: ignore[attr-defined]  # a named tuple has


def _kind(declared: Any) -> Any:
    if declared in _NUMBERS:
        return _NUMBERS[declared]
    found = get_args(declared)
    return found[1] if found else numba_type(declared)
