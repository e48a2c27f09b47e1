# ruff: noqa: ARG001  numba calls typing and code generation with arguments that most have no use for
"""Nested named tuples of arrays and whole numbers: as pointers, and as one array of words for a call from Python.

A call that passes fifty arrays takes ten microseconds to look at each; one that passes their addresses takes a third of
a microsecond. The words hold addresses, so a packed tuple has to live as long as they are used. `pointed`, `pack` and
`unpacked` know the same types in the same order. Also blocks of sixteen points, as tables in float32 have them, and a
fused product.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from guidefield.kernels.jit.arrays import INTEGER_POINTER, Floats32, Vector3
from guidefield.kernels.jit.decorators import vector_part
from guidefield.kernels.simd.vector import LANES, Vector, load


@intrinsic
def fused(typing: Any, x: Any, y: Any, z: Any) -> Any:
    """``x y + z``, rounded once."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), emit


BLOCK = 3 * LANES  # floats of sixteen points: x, y, z of all

AROUND = 2 * BLOCK
"""Floats of the boxes about sixteen things along the world's axes: the least x, y, z of all, then the largest."""


@vector_part
def points_at(numbers: Floats32, at: int) -> tuple[Vector, Vector, Vector]:
    """The sixteen points of a block that begins there in `numbers`, shape (n,)."""
    return load(numbers, at), load(numbers, at + LANES), load(numbers, at + 2 * LANES)


@vector_part
def point_at(numbers: Floats32, at: int) -> Vector3:
    """One point of a block in `numbers`, shape (n,), whose x is there."""
    return numbers[at], numbers[at + LANES], numbers[at + 2 * LANES]


Words = NDArray[np.int64]  # addresses and whole numbers; those of `jit.arrays` are sets of bits


def pointed(kind: Any) -> Any:
    """The type of what `pointers` makes of a value: pointers instead of arrays, in named tuples too."""
    if isinstance(kind, types.Array):
        return types.CPointer(kind.dtype)
    if isinstance(kind, types.BaseNamedTuple):
        return types.BaseTuple.from_types(tuple(pointed(field) for field in kind.types), kind.instance_class)
    return kind


@intrinsic
def pointers(typing: Any, value: Any) -> Any:
    """An array's pointer; of a named tuple, one with pointers instead of arrays.

    What is passed on between kernels is pointers: with arrays, the counting of their references took ten times as long
    as the arithmetic. The caller from Python holds the arrays.
    """

    def stripped(context: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, types.Array):
            return context.make_array(kind)(context, builder, value).data
        if isinstance(kind, types.BaseNamedTuple):
            fields = cgutils.unpack_tuple(builder, value, len(kind))
            made = [stripped(context, builder, *pair) for pair in zip(kind.types, fields, strict=True)]
            return context.make_tuple(builder, pointed(kind), made)
        return value

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return stripped(context, builder, sig.args[0], args[0])

    return pointed(value)(value), generate


def pack(value: tuple[Any, ...]) -> Words:
    """Addresses and numbers of a named tuple, in order; tuples in it one after the other.

    Raises:
        TypeError: if there is anything in it but arrays that are contiguous, whole numbers and such tuples.
    """
    words = np.array(list(_words(value)), np.int64)
    words.setflags(write=False)
    return words


def _words(value: Any) -> Iterator[int]:
    if isinstance(value, tuple):
        for field in value:
            yield from _words(field)
    elif isinstance(value, np.ndarray):
        if not value.flags.c_contiguous:
            raise TypeError("an array that is not contiguous can't be packed")
        yield value.__array_interface__["data"][0]
    elif isinstance(value, int):
        yield value
    else:
        raise TypeError(f"a {type(value).__name__} can't be packed")


def unpacked(kind: Any) -> Callable[[Any], Any]:
    """The function for kernels that makes of a pointer to words the tuple of a kind again, pointers for its arrays."""
    made = pointed(kind)

    def read(context: Any, builder: Any, target: Any, words: Any, position: Iterator[int]) -> Any:
        if isinstance(target, types.BaseNamedTuple):
            fields = [read(context, builder, field, words, position) for field in target.types]
            return context.make_tuple(builder, target, fields)
        word = builder.load(builder.gep(words, [ir.Constant(ir.IntType(64), next(position))]))
        if isinstance(target, types.CPointer):
            return builder.inttoptr(word, context.get_value_type(target))
        return word

    def typed(typing: Any, words: Any) -> Any:
        def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return read(context, builder, made, args[0], iter(range(1 << 20)))  # more words than tuples have

        return made(INTEGER_POINTER), generate

    typed.__name__, typed.__doc__ = "unpacked", "The tuple that was packed."
    made_function: Callable[[Any], Any] = intrinsic(typed)
    return made_function
