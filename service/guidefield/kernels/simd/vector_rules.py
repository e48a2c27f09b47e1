# ruff: noqa: ARG001, ARG005  numba hands the same arguments to every rule
"""Typing and code of vector operations for numba: registration, a number beside a vector, and sums over lanes.

`FLAGS` are the only liberties that LLVM has: others would change the last bits of all results.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin

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

FLAGS = ("contract", "nsz", "arcp")  # sums keep their order, in which the formulas were written with care

PAIRS = (
    (VectorType, VectorType), (VectorType, types.Float), (types.Float, VectorType),
    (VectorType, types.Integer), (types.Integer, VectorType),
)  # fmt: skip
"""Kinds of two operands that make a vector together."""


def is_number(kind: Any) -> bool:
    """Tell if a type is one of plain numbers."""
    return isinstance(kind, (types.Float, types.Integer))


def joint_type(kinds: tuple[Any, ...]) -> VectorType | None:
    """The vector that operands make together: vectors of one type, or such and numbers; None of others."""
    vectors = {kind for kind in kinds if isinstance(kind, VectorType)}
    if len(vectors) == 1 and all(isinstance(kind, VectorType) or is_number(kind) for kind in kinds):
        return next(iter(vectors))
    return None


def as_vector(context: Any, builder: Any, value: Any, kind: Any, vector: VectorType) -> Any:
    """A number in every lane; a vector as it is."""
    if isinstance(kind, VectorType):
        return value
    scalar = context.cast(builder, value, kind, vector.element)
    made = context.get_value_type(vector)
    if isinstance(scalar, ir.Constant) and not isinstance(scalar.constant, str):
        return ir.Constant(made, [scalar] * vector.count)
    one = builder.insert_element(ir.Constant(made, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), vector.count), [0] * vector.count)
    return builder.shuffle_vector(one, ir.Constant(made, ir.Undefined), zeros)


def register(function: Callable[..., Any], typing: Callable[..., Any], kinds: Any, lower: Any) -> None:
    """Have kernels call a function of given kinds of operands: the type it returns, and the code for it."""

    @infer_global(function)
    class _Typing(AbstractTemplate):  # type: ignore[misc]
        def generic(self, args: Any, kws: Any) -> Any:  # noqa: ARG002  numba's
            result = typing(*args) if len(args) == len(kinds[0]) else None
            return None if result is None else signature(result, *args)

    for one in kinds:
        lower_builtin(function, *one)(lower)


def register_pair(function: Callable[..., Any], result: Callable[[VectorType], Any], emit: Callable[..., Any]) -> None:
    """Have kernels call a function of two vectors, or a vector and a number.

    `result` gives the type it returns from the vector's, `emit` its code from a builder and two LLVM vectors.
    """

    def typing(*kinds: Any) -> Any:
        vector = joint_type(kinds)
        return None if vector is None else result(vector)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vector = joint_type(sig.args)
        assert vector is not None, "the typing says so"
        a, b = (as_vector(context, builder, v, k, vector) for v, k in zip(args, sig.args, strict=True))
        return emit(builder, a, b)

    register(function, typing, PAIRS, lower)


def call(builder: Any, name: str, x: Any, flags: tuple[str, ...] = FLAGS) -> Any:
    """An intrinsic function of LLVM's of one vector or number that returns the same."""
    vector = isinstance(x.type, ir.VectorType)
    element = x.type.element if vector else x.type
    kind = ir.FunctionType(x.type, [x.type])
    suffix = (f"v{x.type.count}" if vector else "") + ("f64" if element == ir.DoubleType() else "f32")
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"{name}.{suffix}"), [x], fastmath=flags)


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
