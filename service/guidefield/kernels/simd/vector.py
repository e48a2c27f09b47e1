# ruff: noqa: ARG001, ARG005  numba hands the same arguments to every rule
"""Several numbers at once: a vector type for kernels, in double or single precision.

In kernels `+ - * /`, comparisons, `&` and `|` act lane by lane, between vectors and between a vector and a number, and
`select` chooses lane by lane. The precision of an array or pointer decides the lanes that `load` makes of it, the
vector type the precision of the numbers beside it, so one source serves both and compiles to vector instructions by
construction. LLVM splits the vectors where the machine's are shorter. The functions work on plain numbers too. Inside
kernels only: a vector can't be an argument of a Python call.

Run undecorated, the same kernel works on NumPy arrays: `load` gives a slice, `select` is `numpy.where`, and `+=` would
change what other names hold. Behind the functions stands what tells numba their types, and LLVM its instructions.
`FLAGS` are the only liberties that LLVM has with vectors, but for reductions over lanes: others would change the last
bits of all results. The numbers of lanes are part of tables' layouts, and sixteen stands in `point_tree`, too: they are
no settings.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model

LANES = 16  # lanes of a vector in single precision
LANES_64 = 8  # lanes of a vector in double precision
ALL_LANES = (1 << LANES) - 1  # the bit mask of all lanes of a vector in single precision
FLAGS = ("contract", "nsz", "arcp")  # sums keep their order, in which the formulas were written with care


class VectorType(types.Type):  # type: ignore[misc]  # numba is untyped
    """Lanes of one floating-point type."""

    def __init__(self, element: types.Float) -> None:
        self.element = element
        self.count = LANES_64 if element == types.float64 else LANES
        super().__init__(name=f"lanes<{element} x {self.count}>")

    @property
    def key(self) -> Any:
        """Return what tells one from another."""
        return self.element


f32x16 = VectorType(types.float32)

Vector = Any  # the annotation of a value that is an `f32x16` inside a kernel


class Mask(types.Type):  # type: ignore[misc]
    """Lanes of truth values."""

    def __init__(self, count: int) -> None:
        self.count = count
        super().__init__(name=f"mask<{count}>")

    @property
    def key(self) -> Any:
        """Return what tells one from another."""
        return self.count


@register_model(VectorType)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, dmm: Any, fe_type: VectorType) -> None:
        element = ir.DoubleType() if fe_type.element == types.float64 else ir.FloatType()
        super().__init__(dmm, fe_type, ir.VectorType(element, fe_type.count))


@register_model(Mask)
class _MaskModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, dmm: Any, fe_type: Mask) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(ir.IntType(1), fe_type.count))


# What kernels call; undecorated, each works on NumPy arrays.


def lane_count(array: Any) -> int:
    """Return how many lanes a vector of an array's precision has."""
    return LANES_64 if array.dtype == np.float64 else LANES


def smallest_gap(lanes: Any) -> float:
    """Least height and distance to a corner [m], lest fields be infinite; in kernels it is `vector._smallest_gap`."""
    return 1e-15 if is_double(lanes) else 1e-6


def load(array: Any, at: int) -> Any:
    """Lanes from consecutive elements of a 1-D array, or of what a pointer points to; bounds are not checked."""
    return array[at : at + lane_count(array)]


def store(array: Any, at: int, lanes: Any) -> None:
    """Lanes, or one number in all, into consecutive elements of a 1-D array, shape (n,), or behind a pointer."""
    array[at : at + lane_count(array)] = lanes


def splat(number: Any) -> Any:
    """A number in every lane of an `f32x16`."""
    return np.full(LANES, number, np.float32)


def select(mask: Any, yes: Any, no: Any) -> Any:
    """Lane by lane, one or the other; one of the two may be a number."""
    return np.where(mask, yes, no)


def smallest_of(a: Any, b: Any) -> Any:
    """Lane by lane the smaller of two vectors."""
    return np.where(a < b, a, b)


def largest_of(a: Any, b: Any) -> Any:
    """Lane by lane the larger of two vectors."""
    return np.where(a > b, a, b)


def root(lanes: Any) -> Any:
    """Square root."""
    return np.sqrt(lanes)


def inverse_root(lanes: Any) -> Any:
    """One over the square root, good to about an ulp; of 1e-37 to 1e37 in both precisions."""
    return 1 / np.sqrt(lanes)


def magnitude(lanes: Any) -> Any:
    """Absolute value."""
    return np.abs(lanes)


def rint(lanes: Any) -> Any:
    """The nearest whole number, to even from the middle."""
    return np.rint(lanes)


def total(lanes: Any) -> Any:
    """Sum over the lanes."""
    return np.sum(lanes)


def largest_lane(lanes: Any) -> Any:
    """The largest of the lanes; none may be NaN."""
    return np.max(lanes)


def smallest_lane(lanes: Any) -> Any:
    """The smallest of the lanes; none may be NaN."""
    return np.min(lanes)


def lane(lanes: Any, index: int) -> Any:
    """One lane of a vector."""
    return lanes[index]


def is_double(lanes: Any) -> bool:
    """Tell if the lanes are in double precision; known when a kernel is compiled."""
    return bool(lanes.dtype == np.float64)


def every(mask: Any) -> bool:
    """Tell if it is true of all lanes."""
    return bool(np.all(mask))


def below(a: Any, b: Any) -> int:
    """Bit mask of the lanes where a < b: bit i is lane i's answer.

    A lane with a NaN counts as below, so that a broken value is never called free.
    """
    return sum(1 << k for k in np.flatnonzero(~(a >= b)).tolist())


def first_lane(bits: int) -> int:
    """Index of the lowest set bit of a bit mask that has one."""
    return (bits & -bits).bit_length() - 1


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


def _lane_count(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return context.get_constant(types.intp, VectorType(sig.args[0].dtype).count)


register(lane_count, lambda a: types.intp if isinstance(a, types.Array) else None, [(types.Array,)], _lane_count)


def _is_double_precision(kind: Any) -> bool:
    return bool((kind.element if isinstance(kind, VectorType) else kind) == types.float64)


def _is_double(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return context.get_constant(types.boolean, _is_double_precision(sig.args[0]))


def _smallest_gap(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return context.get_constant(types.float64, 1e-15 if _is_double_precision(sig.args[0]) else 1e-6)


register(smallest_gap, lambda kind: types.float64, _EITHER, _smallest_gap)
register(is_double, lambda kind: None if _same(kind) is None else types.boolean, _EITHER, _is_double)
