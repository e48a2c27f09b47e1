"""Named tuples declared once: their types for numba against what numba finds of values."""

from typing import NamedTuple

import numba
import numpy as np

from guidefield.kernels.field.field import frozen
from guidefield.kernels.jit.arrays import (
    Bits,
    Indices,
    IndicesOut,
    Row,
    RowOut,
    Rows,
    RowsOut,
    Singles,
    array_types,
    numba_type,
)


class Inner(NamedTuple):
    """All alike, as numba tells such tuples from others."""

    rows: Rows
    more: Rows


class Outer(NamedTuple):
    """Something of each kind."""

    size: int
    share: float
    inner: Inner
    row: Row
    row_out: RowOut
    rows_out: RowsOut
    indices: Indices
    indices_out: IndicesOut
    singles: Singles
    bits: Bits


def test_the_type_is_the_one_that_numba_finds_of_a_value() -> None:
    rows = frozen(np.eye(3))
    value = Outer(
        size=3,
        share=0.5,
        inner=Inner(rows, rows),
        row=frozen(np.ones(2)),
        row_out=np.ones(2),
        rows_out=np.eye(2),
        indices=frozen(np.arange(3)),
        indices_out=np.arange(3),
        singles=frozen(np.ones(2, np.float32)),
        bits=np.zeros(2, np.uint32),
    )
    assert numba_type(Outer) == numba.typeof(value)
    assert numba_type(Inner) == numba.typeof(value.inner)
    assert array_types(Outer) == {
        name: array.dtype for name, array in value._asdict().items() if isinstance(array, np.ndarray)
    }
