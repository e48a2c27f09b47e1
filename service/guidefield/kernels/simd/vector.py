"""Several numbers at once: a vector type for kernels, in double or single precision.

In kernels `+ - * /`, comparisons, `&` and `|` act lane by lane, between vectors and between a vector and a number, and
`select` chooses lane by lane. The precision of an array or pointer decides the lanes that `load` makes of it, the
vector type the precision of the numbers beside it, so one source serves both and compiles to vector instructions by
construction. LLVM splits the vectors where the machine's are shorter. The functions work on plain numbers too. Inside
kernels only: a vector can't be an argument of a Python call.

Run undecorated, the same kernel works on NumPy arrays (`vector_model`): `load` gives a slice, `select` is
`numpy.where`, and `+=` would change what other names hold. This file tells numba the types of the operations, and LLVM
its instructions for them; `vector_rules` those between the lanes of one vector.
"""

# ruff: noqa: ARG001, ARG005 - numba hands the same arguments to every rule

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types

from guidefield.kernels.simd.vector_model import (
    ALL_LANES,
    LANES,
    LANES_64,
    Mask,
    Vector,
    VectorType,
    f32x16,
    inverse_root,
    is_double,
    lanes_of,
    largest_of,
    load,
    magnitude,
    rint,
    root,
    select,
    smallest_gap,
    smallest_of,
    splat,
    store,
)
from guidefield.kernels.simd.vector_rules import (
    FLAGS,
    PAIRS,
    as_vector,
    below,
    call,
    every,
    first_lane,
    is_number,
    joint_type,
    lane,
    largest_lane,
    register,
    register_pair,
    smallest_lane,
    total,
)

__all__ = [
    "ALL_LANES", "LANES", "LANES_64", "Vector", "below", "every", "f32x16", "first_lane", "inverse_root", "is_double",
    "lane", "lanes_of", "largest_lane", "largest_of", "load", "magnitude", "rint", "root", "select", "smallest_gap",
    "smallest_lane", "smallest_of", "splat", "store", "total",
]  # fmt: skip

for _function, _method in (
    (operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"), (operator.truediv, "fdiv"),
    (operator.iadd, "fadd"), (operator.isub, "fsub"), (operator.imul, "fmul"), (operator.itruediv, "fdiv"),
):  # fmt: skip
    register_pair(_function, lambda k: k, lambda b, x, y, m=_method: getattr(b, m)(x, y, flags=FLAGS))

for _function, _comparison in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.eq, "=="),
):  # fmt: skip
    register_pair(_function, lambda k: Mask(k.count), lambda b, x, y, c=_comparison: b.fcmp_ordered(c, x, y))

for _function, _comparison in ((smallest_of, "<"), (largest_of, ">")):
    register_pair(_function, lambda k: k, lambda b, x, y, c=_comparison: b.select(b.fcmp_ordered(c, x, y), x, y))


def _same(kind: Any) -> Any:
    return kind if isinstance(kind, (VectorType, types.Float)) else None


def _vector(kind: Any) -> Any:
    return kind if isinstance(kind, VectorType) else None


def _intrinsic(name: str) -> Callable[..., Any]:
    return lambda context, builder, sig, args: call(builder, name, args[0])


_EITHER = [(VectorType,), (types.Float,)]

register(operator.neg, _vector, [(VectorType,)], lambda c, b, s, a: b.fneg(a[0], flags=FLAGS))
register(root, _same, _EITHER, _intrinsic("llvm.sqrt"))
register(magnitude, _same, _EITHER, _intrinsic("llvm.fabs"))
register(rint, _same, _EITHER, _intrinsic("llvm.rint"))


def _inverse_root(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """In single precision LLVM refines the machine's estimate; in double, one step of third order refines that."""
    x, wide = args[0], args[0].type
    if isinstance(sig.args[0], types.Float):
        return builder.fdiv(ir.Constant(wide, 1.0), call(builder, "llvm.sqrt", x), flags=FLAGS)
    narrow = ir.VectorType(ir.FloatType(), wide.count)
    double = sig.args[0].element == types.float64
    s = builder.fptrunc(x, narrow) if double else x
    r = call(builder, "llvm.sqrt", s)
    r = builder.fdiv(ir.Constant(narrow, [1.0] * wide.count), r, flags=FLAGS)
    if not double:
        return r
    r = builder.fpext(r, wide)

    def number(value: float) -> Any:
        return ir.Constant(wide, [value] * wide.count)

    def times(a: Any, b: Any) -> Any:
        return builder.fmul(a, b, flags=FLAGS)

    error = builder.fsub(number(1.0), times(times(x, r), r), flags=("contract", "nsz"))
    gain = times(error, builder.fadd(number(0.5), times(number(0.375), error), flags=FLAGS))
    return builder.fadd(r, times(r, gain), flags=("contract", "nsz"))


register(inverse_root, _same, _EITHER, _inverse_root)


def _is_memory(kind: Any) -> bool:
    """Tell if a type is a 1-D array's or a pointer's, of floating-point numbers."""
    flat = isinstance(kind, types.CPointer) or (isinstance(kind, types.Array) and kind.ndim == 1)
    return flat and isinstance(kind.dtype, types.Float)


def _address(context: Any, builder: Any, kind: Any, memory: Any, at: Any) -> Any:
    data = memory if isinstance(kind, types.CPointer) else context.make_array(kind)(context, builder, memory).data
    vector = context.get_value_type(VectorType(kind.dtype))
    return builder.bitcast(builder.gep(data, [at]), vector.as_pointer())


def _load(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    loaded = builder.load(_address(context, builder, sig.args[0], *args))
    loaded.align = sig.return_type.element.bitwidth // 8
    return loaded


def _store(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    vector = VectorType(sig.args[0].dtype)
    value = as_vector(context, builder, args[2], sig.args[2], vector)
    stored = builder.store(value, _address(context, builder, sig.args[0], *args[:2]))
    stored.align = vector.element.bitwidth // 8
    return context.get_dummy_value()


def _load_type(memory: Any, at: Any) -> Any:
    return VectorType(memory.dtype) if _is_memory(memory) else None


def _store_type(memory: Any, at: Any, value: Any) -> Any:
    return types.none if _is_memory(memory) and joint_type((VectorType(memory.dtype), value)) else None


def _splat(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return as_vector(context, builder, args[0], sig.args[0], f32x16)


_MEMORY = (types.Array, types.CPointer)
_VALUES = (VectorType, types.Float)

register(load, _load_type, [(memory, types.Integer) for memory in _MEMORY], _load)
register(store, _store_type, [(memory, types.Integer, value) for memory in _MEMORY for value in _VALUES], _store)
register(splat, lambda kind: f32x16 if is_number(kind) else None, [(types.Float,), (types.Integer,)], _splat)


def _select_type(mask: Any, yes: Any, no: Any) -> Any:
    if isinstance(mask, types.Boolean):
        return types.float64 if is_number(yes) and is_number(no) else None
    return joint_type((yes, no)) if isinstance(mask, Mask) else None


def _select(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    mask, *values = args
    if isinstance(sig.args[0], types.Boolean):
        return builder.select(
            mask, *(context.cast(builder, v, k, types.float64) for v, k in zip(values, sig.args[1:], strict=True))
        )
    yes, no = (as_vector(context, builder, v, k, sig.return_type) for v, k in zip(values, sig.args[1:], strict=True))
    return builder.select(mask, yes, no)


_NUMBERS = [(types.Boolean, a, b) for a in (types.Float, types.Integer) for b in (types.Float, types.Integer)]
register(select, _select_type, [*((Mask, *kinds) for kinds in PAIRS), *_NUMBERS], _select)


def _masks(one: Any, other: Any) -> Any:
    return one if isinstance(one, Mask) and one == other else None


register(operator.and_, _masks, [(Mask, Mask)], lambda c, b, s, a: b.and_(*a))
register(operator.or_, _masks, [(Mask, Mask)], lambda c, b, s, a: b.or_(*a))


def _lanes_of(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return context.get_constant(types.intp, VectorType(sig.args[0].dtype).count)


register(lanes_of, lambda a: types.intp if isinstance(a, types.Array) else None, [(types.Array,)], _lanes_of)


def _is_double_precision(kind: Any) -> bool:
    return bool((kind.element if isinstance(kind, VectorType) else kind) == types.float64)


def _is_double(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return context.get_constant(types.boolean, _is_double_precision(sig.args[0]))


def _smallest_gap(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return context.get_constant(types.float64, 1e-15 if _is_double_precision(sig.args[0]) else 1e-6)


register(smallest_gap, lambda kind: types.float64, _EITHER, _smallest_gap)
register(is_double, lambda kind: None if _same(kind) is None else types.boolean, _EITHER, _is_double)
