# ruff: noqa: ARG001  numba calls typing and code generation with arguments that most have no use for
"""A vector of sixteen floats for kernels: `f32x16`, with operators and the few functions that kernels need.

Loops over sixteen configurations, left to the compiler's vectoriser, ran fifteen times slower than the same arithmetic
on an explicit vector. The type stands for LLVM's ``<16 x float>``; LLVM splits it into what the processor has (one
AVX-512 register, two of AVX2, four of SSE). Inside kernels only: a vector can't be an argument of a Python call.

``+ - *`` and unary ``-`` work lane by lane, between vectors and between a vector and a scalar. Comparisons give a
*mask*: an int64 whose bit i is lane i's answer. `load` and `store` check no bounds: the caller's layout must be right.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from guidefield.kernels.jit.compilers import kernel as made, part
from guidefield.kernels.jit.signatures import Kernel

LANES = 16
ALL_LANES = (1 << LANES) - 1

AROUND = 6 * LANES
"""Floats of the boxes about sixteen obstacles along the world's axes: the least x, y, z of all, then the largest."""

BLOCK = 3 * LANES
"""Floats of sixteen vertices: x, y, z of all."""

_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_BITS, _I64, _I32 = ir.IntType(LANES), ir.IntType(64), ir.IntType(32)


class F32x16(types.Type):  # type: ignore[misc]  # numba is untyped
    """Numba's type of a vector of sixteen floats."""

    def __init__(self) -> None:
        super().__init__(name="f32x16")


f32x16 = F32x16()

Vector = Any
"""What an annotation says of a value that is an `f32x16` inside a kernel."""

FLOATS = types.Array(types.float32, 1, "C", readonly=True)
"""Input, flat."""
FLOATS_OUT = types.Array(types.float32, 1, "C")
"""Output, flat."""

FLOAT_POINTER, DOUBLE_POINTER, INTEGER_POINTER = map(types.CPointer, (types.float32, types.float64, types.int64))


def pointed(kind: Any) -> Any:
    """The type of what `pointers` makes of a value: pointers instead of arrays, in named tuples too."""
    if isinstance(kind, types.Array):
        return types.CPointer(kind.dtype)
    if isinstance(kind, types.NamedTuple):
        return types.NamedTuple([pointed(field) for field in kind.types], kind.instance_class)
    return kind


@intrinsic
def pointers(typing: Any, value: Any) -> Any:
    """An array's pointer; of a named tuple, one with pointers instead of arrays.

    What is passed on between kernels is pointers: with arrays, the counting of their references took ten times as long
    as the arithmetic. The caller from Python holds the arrays meanwhile.
    """

    def stripped(context: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, types.Array):
            return context.make_array(kind)(context, builder, value).data
        if isinstance(kind, types.NamedTuple):
            fields = cgutils.unpack_tuple(builder, value, len(kind))
            made = [stripped(context, builder, *pair) for pair in zip(kind.types, fields, strict=True)]
            return context.make_tuple(builder, pointed(kind), made)
        return value

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return stripped(context, builder, sig.args[0], args[0])

    return pointed(value)(value), generate


@register_model(F32x16)
class _Model(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _VECTOR)


def lane_part(kernel: Kernel) -> Kernel:
    """Decorator of parts of lane kernels: compiled into the caller.

    Sums keep their order, unlike in the other kernels: the range reduction of angles depends on it.
    """
    return cast(Kernel, part(kernel, fastmath={"contract"}))


def lane_kernel(signature: Any, **options: bool) -> Callable[[Kernel], Kernel]:
    """Decorator of a lane kernel of one signature: machine code from the cache, no GIL; sums keep their order."""
    return made(signature, fastmath={"contract"}, **options)


def lane_step(signature: Any) -> Callable[[Kernel], Kernel]:
    """The same for a kernel that only kernels call: quicker to compile, as Python can't call it."""
    return lane_kernel(signature, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def _spread(builder: Any, scalar: Any) -> Any:
    """A vector whose lanes all hold an LLVM float."""
    single = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), scalar, ir.Constant(_I32, 0))
    zeros = ir.Constant(ir.VectorType(_I32, LANES), [0] * LANES)
    return builder.shuffle_vector(single, ir.Constant(_VECTOR, ir.Undefined), zeros)


def _as_vector(builder: Any, kind: Any, value: Any) -> Any:
    if kind == types.float64:
        value = builder.fptrunc(value, ir.FloatType())
    return value if kind == f32x16 else _spread(builder, value)


def _add_operator(function: Any, instruction: str) -> None:
    """Define a binary operator on vectors, and on a vector and a scalar."""
    operands = [(f32x16, f32x16)]
    for scalar in (types.float32, types.float64):
        operands += [(f32x16, scalar), (scalar, f32x16)]

    @infer_global(function)
    class _Operator(ConcreteTemplate):  # type: ignore[misc]
        cases = [signature(f32x16, *pair) for pair in operands]

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        left, right = (_as_vector(builder, kind, value) for kind, value in zip(sig.args, args, strict=True))
        return getattr(builder, instruction)(left, right)

    for pair in operands:
        lower_builtin(function, *pair)(lower)


_add_operator(operator.add, "fadd")
_add_operator(operator.sub, "fsub")
_add_operator(operator.mul, "fmul")


@infer_global(operator.neg)
class _Negation(ConcreteTemplate):  # type: ignore[misc]
    cases = [signature(f32x16, f32x16)]


@lower_builtin(operator.neg, f32x16)
def _negated(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fneg(args[0])


def _address(builder: Any, pointer: Any, index: Any) -> Any:
    """Where in memory sixteen floats begin."""
    return builder.bitcast(builder.gep(pointer, [index]), _VECTOR.as_pointer())


@intrinsic
def load(typing: Any, pointer: Any, index: Any) -> Any:
    """The sixteen floats from an index on."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.load(_address(builder, *args), align=4)

    return f32x16(FLOAT_POINTER, types.int64), generate


@intrinsic
def store(typing: Any, pointer: Any, index: Any, value: Any) -> Any:
    """Write sixteen floats from an index on."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        builder.store(args[2], _address(builder, *args[:2]), align=4)
        return context.get_dummy_value()

    return types.void(FLOAT_POINTER, types.int64, f32x16), generate


@intrinsic
def splat(typing: Any, value: Any) -> Any:
    """A vector whose lanes all hold a scalar."""
    scalar = types.float32 if value == types.float32 else types.float64

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _as_vector(builder, sig.args[0], args[0])

    return f32x16(scalar), generate


@intrinsic
def lane(typing: Any, value: Any, index: Any) -> Any:
    """One lane of a vector, a float32."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.extract_element(args[0], builder.trunc(args[1], _I32))

    return types.float32(f32x16, types.int64), generate


def _reduction(name: str, purpose: str) -> Any:
    """A function of all lanes of one vector that LLVM has."""

    def typed(typing: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            kind = ir.FunctionType(ir.FloatType(), [_VECTOR])
            function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.vector.reduce.{name}.v16f32")
            return builder.call(function, args, fastmath=("nnan",))

        return types.float32(f32x16), generate

    typed.__name__, typed.__doc__ = name, purpose
    return intrinsic(typed)


largest_lane = _reduction("fmax", "The largest of the sixteen lanes, a float32; none may be NaN.")
smallest_lane = _reduction("fmin", "The smallest of the sixteen lanes, a float32; none may be NaN.")


@intrinsic
def smallest_of(typing: Any, a: Any, b: Any) -> Any:
    """Lane by lane the smaller of two vectors."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", *args), *args)

    return f32x16(f32x16, f32x16), generate


@intrinsic
def largest_of(typing: Any, a: Any, b: Any) -> Any:
    """Lane by lane the larger of two vectors."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered(">", *args), *args)

    return f32x16(f32x16, f32x16), generate


@intrinsic
def where_below(typing: Any, a: Any, b: Any, then: Any, otherwise: Any) -> Any:
    """Lane by lane `then` where a < b, else `otherwise`."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", args[0], args[1]), args[2], args[3])

    return f32x16(f32x16, f32x16, f32x16, f32x16), generate


@intrinsic
def below(typing: Any, a: Any, b: Any) -> Any:
    """Mask of the lanes where a < b; a lane with a NaN counts as below, so that a broken value is never called free."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.zext(builder.bitcast(builder.fcmp_unordered("<", *args), _BITS), _I64)

    return types.int64(f32x16, f32x16), generate


@intrinsic
def first_lane(typing: Any, mask: Any) -> Any:
    """Index of the lowest set bit of a mask that has one."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.cttz(args[0], cgutils.true_bit)

    return types.int64(types.int64), generate


def _unary(name: str, purpose: str) -> Any:
    """A function of one vector that LLVM has."""

    def typed(typing: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            kind = ir.FunctionType(_VECTOR, [_VECTOR])
            function = cgutils.get_or_insert_function(builder.module, kind, f"{name}.v16f32")
            return builder.call(function, args)

        return f32x16(f32x16), generate

    typed.__name__, typed.__doc__ = name.rpartition(".")[2], purpose
    return intrinsic(typed)


sqrt = _unary("llvm.sqrt", "Lane by lane the square root.")
rint = _unary("llvm.rint", "Lane by lane the nearest whole number, to even from the middle.")
magnitude = _unary("llvm.fabs", "Lane by lane the absolute value.")
