# ruff: noqa: ARG001  numba calls typing and code generation with arguments that most have no use for
"""Nested named tuples of arrays and whole numbers as one array of words, which a Python call hands over in no time.

A call that passes fifty arrays spends ten microseconds on looking at each; one that passes their addresses, a third of
one. The words hold addresses: who packs a tuple has to keep it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from guidefield.kernels.simd.f32x16 import INTEGER_POINTER, pointed

Words = NDArray[np.int64]


def packed(value: tuple[Any, ...]) -> Words:
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
        if isinstance(target, types.NamedTuple):
            fields = [read(context, builder, field, words, position) for field in target.types]
            return context.make_tuple(builder, target, fields)
        word = builder.load(builder.gep(words, [ir.Constant(ir.IntType(64), next(position))]))
        if isinstance(target, types.CPointer):
            return builder.inttoptr(word, context.get_value_type(target))
        return word

    def typed(typing: Any, words: Any) -> Any:
        def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return read(context, builder, made, args[0], iter(range(1 << 20)))

        return made(INTEGER_POINTER), generate

    typed.__name__, typed.__doc__ = "unpacked", "The tuple that was packed."
    made_function: Callable[[Any], Any] = intrinsic(typed)
    return made_function
