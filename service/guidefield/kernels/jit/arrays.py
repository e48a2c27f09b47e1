"""Types of what kernels read and write, declared once for Python and for numba.

A kernel's signature follows from its annotations. A type that changes here recompiles every kernel that has it, and
needs arrays of that type and layout from all callers: others are refused, but
not in packed tuples (simd/packing.py).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np
from numba import types
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Integers = NDArray[np.int64]
Vector3 = tuple[float, float, float]
# Of a field at a point: potential [1/m], gradient (3) [1/m^2], curvature [1/m^3], winding number.
Six = tuple[float, float, float, float, float, float]

SCALAR = types.float64
# Arrays that kernels read are contiguous; frozen and fresh ones both fit.
VECTOR = types.Array(types.float64, 1, "C", readonly=True)
MATRIX = types.Array(types.float64, 2, "C", readonly=True)
BLOCKS = types.Array(types.float64, 3, "C", readonly=True)
INDICES = types.Array(types.int64, 1, "C", readonly=True)
INDEX_MATRIX = types.Array(types.int64, 2, "C", readonly=True)
FLOATS = types.Array(types.float32, 1, "C", readonly=True)
# Arrays that they write.
VECTOR_OUT = types.Array(types.float64, 1, "C")
MATRIX_OUT = types.Array(types.float64, 2, "C")
BLOCKS_OUT = types.Array(types.float64, 3, "C")
INDICES_OUT = types.Array(types.int64, 1, "C")
INDEX_MATRIX_OUT = types.Array(types.int64, 2, "C")
FLOATS_OUT = types.Array(types.float32, 1, "C")

FLOAT_POINTER, DOUBLE_POINTER, INTEGER_POINTER = map(types.CPointer, (types.float32, types.float64, types.int64))

# Annotations of fields and arguments: Row, Rows, Blocks have one, two, three axes of float64, Singles are float32.
# Kernels write those that end with Out, and four more, see below.
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
# written, too: verdicts on a grid's cells, their bits, rows in single precision, and of small indices
Cells = Annotated[NDArray[np.int32], types.Array(types.int32, 1, "C")]
Bits = Annotated[NDArray[np.uint32], types.Array(types.uint32, 1, "C")]
SingleRows = Annotated[Floats32, types.Array(types.float32, 2, "C")]
IndexRows32 = Annotated[NDArray[np.int32], types.Array(types.int32, 2, "C")]
Flags = Annotated[NDArray[np.bool_], types.Array(types.boolean, 2, "C", readonly=True)]
AnyRows = Annotated[Floats, types.Array(types.float64, 2, "A", readonly=True)]  # rows of any stride
# sets of bits, 64 to a word; `simd.packing` has words of another kind, addresses
Words = Annotated[NDArray[np.uint64], types.Array(types.uint64, 1, "C", readonly=True)]
WordRows = Annotated[NDArray[np.uint64], types.Array(types.uint64, 2, "C", readonly=True)]
WordRowsOut = Annotated[NDArray[np.uint64], types.Array(types.uint64, 2, "C")]
ByteRows = Annotated[NDArray[np.uint8], types.Array(types.uint8, 2, "C", readonly=True)]
ByteBlocksOut = Annotated[NDArray[np.int8], types.Array(types.int8, 3, "C")]  # signed
TruthsOut = Annotated[NDArray[np.bool_], types.Array(types.boolean, 1, "C")]

_PLAIN = {int: types.int64, float: types.float64, bool: types.boolean, type(None): types.void}


@functools.cache
def numba_type(layout: type) -> Any:
    """Return numba's type of a named tuple, by how its fields are declared; tuples may be in tuples."""
    return types.BaseTuple.from_types(tuple(_list_types(layout).values()), layout)


def array_types(layout: type) -> dict[str, np.dtype[Any]]:
    """Return the NumPy type of each field of a named tuple that is an array, by the field's name."""
    kinds = _list_types(layout).items()
    return {name: np.dtype(str(kind.dtype)) for name, kind in kinds if isinstance(kind, types.Array)}


def _list_types(layout: type) -> dict[str, Any]:
    declared = get_type_hints(layout, include_extras=True)
    return {name: _find_type(declared[name]) for name in layout._fields}  # type: ignore[attr-defined]  # a named tuple


def _find_type(declared: Any) -> Any:
    if declared in _PLAIN:
        return _PLAIN[declared]
    found = get_args(declared)
    if get_origin(declared) is tuple:
        return types.BaseTuple.from_types(tuple(map(_find_type, found)))
    return found[1] if found else numba_type(declared)


def find_signature(function: Callable[..., Any]) -> Any:
    """Return the types of a kernel's arguments and of what it returns, by its annotations."""
    *arguments, result = map(_find_type, get_type_hints(function, include_extras=True).values())
    return result(*arguments)
