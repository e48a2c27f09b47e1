"""Several points at once: a vector type for kernels, in double or single precision.

A kernel written for lanes looks as if written for one point: `+ - * /`, comparisons, `&` and `|` act lane by lane,
numbers are broadcast and take the precision of the lanes beside them. One source therefore serves both precisions, and
compiles to vector instructions by construction, not by the grace of an optimiser that may give up. LLVM splits the
vectors where the machine's are shorter. The functions work on plain numbers too.

Run undecorated, the same kernel works on NumPy arrays: `load` gives a slice, `select` is `numpy.where`, and `+=` would
change what other names hold. This file tells numba the types of the operations, and LLVM its instructions for them.
"""

# ruff: noqa: ARG001, ARG002, ARG005 - numba hands the same arguments to every rule

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin

from guidefield.kernels.simd.generic_vector_model import (
    Mask,
    VectorType,
    every,
    inverse_root,
    is_double,
    lanes_of,
    load,
    magnitude,
    root,
    select,
    smallest_gap,
    store,
    total,
)

__all__ = [
    "every", "inverse_root", "is_double", "lanes_of", "load", "magnitude", "root", "select", "smallest_gap",
    "store", "total",
]  # fmt: skip

_FLAGS = ("contract", "nsz", "arcp")
"""Sums keep their order, in which the formulas were written with care."""


def _is_number(kind: Any) -> bool:
    return isinstance(kind, (types.Float, types.Integer))


def _joint(kinds: tuple[Any, ...]) -> VectorType | None:
    """The lanes that operands make together: same lanes, or lanes and numbers."""
    lanes = {kind for kind in kinds if isinstance(kind, VectorType)}
    if len(lanes) == 1 and all(isinstance(kind, VectorType) or _is_number(kind) for kind in kinds):
        return next(iter(lanes))
    return None


def _as_lanes(context: Any, builder: Any, value: Any, kind: Any, lanes: VectorType) -> Any:
    """A number in every lane; lanes as they are."""
    if isinstance(kind, VectorType):
        return value
    scalar = context.cast(builder, value, kind, lanes.element)
    vector = context.get_value_type(lanes)
    if isinstance(scalar, ir.Constant) and not isinstance(scalar.constant, str):
        return ir.Constant(vector, [scalar] * lanes.count)
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), lanes.count), [0] * lanes.count)
    return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), mask)


_OPERANDS = (
    (VectorType, VectorType), (VectorType, types.Float), (types.Float, VectorType),
    (VectorType, types.Integer), (types.Integer, VectorType),
)  # fmt: skip


def _register(function: Callable[..., Any], result: Callable[[VectorType], Any], emit: Callable[..., Any]) -> None:
    """An operation of two operands."""

    @infer_global(function)
    class _Typing(AbstractTemplate):  # type: ignore[misc]
        def generic(self, args: Any, kws: Any) -> Any:
            lanes = _joint(args) if len(args) == 2 else None
            return None if lanes is None else signature(result(lanes), *args)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        lanes = _joint(sig.args)
        assert lanes is not None
        a, b = (_as_lanes(context, builder, v, k, lanes) for v, k in zip(args, sig.args, strict=True))
        return emit(builder, a, b)

    for kinds in _OPERANDS:
        lower_builtin(function, *kinds)(lower)


for _function, _method in (
    (operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"), (operator.truediv, "fdiv"),
    (operator.iadd, "fadd"), (operator.isub, "fsub"), (operator.imul, "fmul"), (operator.itruediv, "fdiv"),
):  # fmt: skip
    _register(_function, lambda k: k, lambda b, x, y, m=_method: getattr(b, m)(x, y, flags=_FLAGS))

for _function, _comparison in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.eq, "=="),
):  # fmt: skip
    _register(_function, lambda k: Mask(k.count), lambda b, x, y, c=_comparison: b.fcmp_ordered(c, x, y))


def _register_plain(function: Callable[..., Any], typing: Callable[..., Any], kinds: Any, lower: Any) -> None:
    """A function of given kinds of operands."""

    @infer_global(function)
    class _Typing(AbstractTemplate):  # type: ignore[misc]
        def generic(self, args: Any, kws: Any) -> Any:
            result = typing(*args) if len(args) == len(kinds[0]) else None
            return None if result is None else signature(result, *args)

    for one in kinds:
        lower_builtin(function, *one)(lower)


def _same(kind: Any) -> Any:
    return kind if isinstance(kind, (VectorType, types.Float)) else None


def _element(kind: Any) -> Any:
    return kind.element if isinstance(kind, VectorType) else None


def _call(builder: Any, name: str, x: Any) -> Any:
    """An LLVM intrinsic of one vector or number."""
    vector = isinstance(x.type, ir.VectorType)
    element = x.type.element if vector else x.type
    kind = ir.FunctionType(x.type, [x.type])
    suffix = (f"v{x.type.count}" if vector else "") + ("f64" if element == ir.DoubleType() else "f32")
    function = cgutils.get_or_insert_function(builder.module, kind, f"{name}.{suffix}")
    return builder.call(function, [x], fastmath=_FLAGS)


def _intrinsic(name: str) -> Callable[..., Any]:
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _call(builder, name, args[0])

    return lower


def _negate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fneg(args[0], flags=_FLAGS)


_EITHER = [(VectorType,), (types.Float,)]

_register_plain(operator.neg, lambda kind: kind if isinstance(kind, VectorType) else None, [(VectorType,)], _negate)
_register_plain(root, _same, _EITHER, _intrinsic("llvm.sqrt"))
_register_plain(magnitude, _same, _EITHER, _intrinsic("llvm.fabs"))


def _inverse_root(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """In single precision LLVM refines the machine's estimate; in double, one step of third order refines that."""
    x, wide = args[0], args[0].type
    if isinstance(sig.args[0], types.Float):
        return builder.fdiv(ir.Constant(wide, 1.0), _call(builder, "llvm.sqrt", x), flags=_FLAGS)
    narrow = ir.VectorType(ir.FloatType(), wide.count)
    double = sig.args[0].element == types.float64
    s = builder.fptrunc(x, narrow) if double else x
    r = _call(builder, "llvm.sqrt", s)
    r = builder.fdiv(ir.Constant(narrow, [1.0] * wide.count), r, flags=_FLAGS)
    if not double:
        return r
    r = builder.fpext(r, wide)

    def number(value: float) -> Any:
        return ir.Constant(wide, [value] * wide.count)

    def times(a: Any, b: Any) -> Any:
        return builder.fmul(a, b, flags=_FLAGS)

    error = builder.fsub(number(1.0), times(times(x, r), r), flags=("contract", "nsz"))
    gain = times(error, builder.fadd(number(0.5), times(number(0.375), error), flags=_FLAGS))
    return builder.fadd(r, times(r, gain), flags=("contract", "nsz"))


_register_plain(inverse_root, _same, _EITHER, _inverse_root)


def _load_type(array: Any, at: Any) -> Any:
    return VectorType(array.dtype) if isinstance(array, types.Array) and array.ndim == 1 else None


def _pointer(context: Any, builder: Any, kind: Any, array: Any, at: Any, lanes: VectorType) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    element = builder.gep(data, [at])
    return builder.bitcast(element, context.get_value_type(lanes).as_pointer())


def _load(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    lanes = sig.return_type
    loaded = builder.load(_pointer(context, builder, sig.args[0], args[0], args[1], lanes))
    loaded.align = lanes.element.bitwidth // 8
    return loaded


def _store(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    lanes = VectorType(sig.args[0].dtype)
    value = _as_lanes(context, builder, args[2], sig.args[2], lanes)
    stored = builder.store(value, _pointer(context, builder, sig.args[0], args[0], args[1], lanes))
    stored.align = lanes.element.bitwidth // 8
    return context.get_dummy_value()


_register_plain(load, _load_type, [(types.Array, types.Integer)], _load)
_register_plain(
    store, lambda a, i, v: types.none,
    [(types.Array, types.Integer, VectorType), (types.Array, types.Integer, types.Float)],
    _store,
)  # fmt: skip


def _select_type(mask: Any, yes: Any, no: Any) -> Any:
    if isinstance(mask, types.Boolean):
        return types.float64 if _is_number(yes) and _is_number(no) else None
    return _joint((yes, no)) if isinstance(mask, Mask) else None


def _select(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    mask, *values = args
    if isinstance(sig.args[0], types.Boolean):
        return builder.select(
            mask, *(context.cast(builder, v, k, types.float64) for v, k in zip(values, sig.args[1:], strict=True))
        )
    yes, no = (_as_lanes(context, builder, v, k, sig.return_type) for v, k in zip(values, sig.args[1:], strict=True))
    return builder.select(mask, yes, no)


_NUMBERS = [(types.Boolean, a, b) for a in (types.Float, types.Integer) for b in (types.Float, types.Integer)]
_register_plain(select, _select_type, [*((Mask, *kinds) for kinds in _OPERANDS), *_NUMBERS], _select)


def _masks(one: Any, other: Any) -> Any:
    return one if isinstance(one, Mask) and one == other else None


_register_plain(operator.and_, _masks, [(Mask, Mask)], lambda c, b, s, a: b.and_(*a))
_register_plain(operator.or_, _masks, [(Mask, Mask)], lambda c, b, s, a: b.or_(*a))


def _every(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    bits = ir.IntType(args[0].type.count)
    return builder.icmp_unsigned("==", builder.bitcast(args[0], bits), ir.Constant(bits, -1))


_register_plain(every, lambda kind: types.boolean if isinstance(kind, Mask) else None, [(Mask,)], _every)


def _reduction(name: str, start: tuple[float, ...]) -> Callable[..., Any]:
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vector = args[0].type
        element = context.get_value_type(sig.return_type)
        kind = ir.FunctionType(element, [*[element for _ in start], vector])
        function = cgutils.get_or_insert_function(
            builder.module, kind, f"llvm.vector.reduce.{name}.v{vector.count}f{sig.return_type.bitwidth}"
        )
        return builder.call(function, [*[ir.Constant(element, x) for x in start], args[0]], fastmath=("reassoc", "nsz"))

    return lower


_register_plain(total, _element, [(VectorType,)], _reduction("fadd", (-0.0,)))


def _lanes_of(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return context.get_constant(types.intp, VectorType(sig.args[0].dtype).count)


_register_plain(lanes_of, lambda a: types.intp if isinstance(a, types.Array) else None, [(types.Array,)], _lanes_of)


def _is_double(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return context.get_constant(types.boolean, _precision(sig.args[0]) == types.float64)


def _smallest_gap(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    double = _precision(sig.args[0]) == types.float64
    return context.get_constant(types.float64, 1e-15 if double else 1e-6)


def _precision(kind: Any) -> Any:
    return kind.element if isinstance(kind, VectorType) else kind


_register_plain(smallest_gap, lambda kind: types.float64, _EITHER, _smallest_gap)
_register_plain(
    is_double, lambda k: types.boolean if isinstance(k, (VectorType, types.Float)) else None, _EITHER, _is_double
)
