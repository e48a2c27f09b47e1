"""Operations on the lanes of one vector: one of them, the sum, the largest, and bit masks that choose some."""

# ruff: noqa: ARG001, ARG005 - numba hands the same arguments to every rule

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils

from guidefield.kernels.simd.vector_model import (
    Mask,
    VectorType,
    below,
    every,
    first_lane,
    lane,
    largest_lane,
    smallest_lane,
    total,
)
from guidefield.kernels.simd.vector_rules import register, register_pair

__all__ = ["below", "every", "first_lane", "lane", "largest_lane", "smallest_lane", "total"]


def _element(kind: Any) -> Any:
    return kind.element if isinstance(kind, VectorType) else None


def _reduction(name: str, start: tuple[float, ...], flags: tuple[str, ...]) -> Callable[..., Any]:
    """The code of a function of all lanes of a vector that LLVM has, and what it starts from."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vector = args[0].type
        element = context.get_value_type(sig.return_type)
        kind = ir.FunctionType(element, [*[element for _ in start], vector])
        function = cgutils.get_or_insert_function(
            builder.module, kind, f"llvm.vector.reduce.{name}.v{vector.count}f{sig.return_type.bitwidth}"
        )
        return builder.call(function, [*[ir.Constant(element, x) for x in start], args[0]], fastmath=flags)

    return lower


register(total, _element, [(VectorType,)], _reduction("fadd", (-0.0,), ("reassoc", "nsz")))
register(largest_lane, _element, [(VectorType,)], _reduction("fmax", (), ("nnan",)))
register(smallest_lane, _element, [(VectorType,)], _reduction("fmin", (), ("nnan",)))


def _lane(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.extract_element(args[0], context.cast(builder, args[1], sig.args[1], types.int32))


register(lane, lambda kind, at: _element(kind), [(VectorType, types.Integer)], _lane)


def _bits(builder: Any, mask: Any) -> Any:
    """A vector of truth values as a whole number."""
    return builder.bitcast(mask, ir.IntType(mask.type.count))


def _below(builder: Any, a: Any, b: Any) -> Any:
    return builder.zext(_bits(builder, builder.fcmp_unordered("<", a, b)), ir.IntType(64))


register_pair(below, lambda vector: types.int64, _below)


def _first_lane(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.cttz(context.cast(builder, args[0], sig.args[0], types.int64), cgutils.true_bit)


def _every(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    bits = _bits(builder, args[0])
    return builder.icmp_unsigned("==", bits, ir.Constant(bits.type, -1))


register(
    first_lane, lambda bits: types.int64 if isinstance(bits, types.Integer) else None, [(types.Integer,)], _first_lane
)
register(every, lambda kind: types.boolean if isinstance(kind, Mask) else None, [(Mask,)], _every)
