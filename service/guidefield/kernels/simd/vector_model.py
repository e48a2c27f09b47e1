"""The vector types of kernels, and the functions of their values as they run undecorated, on NumPy arrays.

The numbers of lanes are part of tables' layouts, and sixteen stands in `point_tree`, too: they are no settings.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import models, register_model

LANES = 16  # lanes of a vector in single precision
LANES_64 = 8  # lanes of a vector in double precision
ALL_LANES = (1 << LANES) - 1  # the bit mask of all lanes of a vector in single precision


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


def lanes_of(array: Any) -> int:
    """Return how many lanes a vector of an array's precision has."""
    return LANES_64 if array.dtype == np.float64 else LANES


def smallest_gap(lanes: Any) -> float:
    """Least height and least distance to a corner [m]: keeps points on a surface finite, changes nothing else."""
    return 1e-15 if is_double(lanes) else 1e-6


def load(array: Any, at: int) -> Any:
    """Lanes from consecutive elements of a 1-D array, or of what a pointer points to; bounds are not checked."""
    return array[at : at + lanes_of(array)]


def store(array: Any, at: int, lanes: Any) -> None:
    """Lanes, or one number in all, into consecutive elements of a 1-D array, shape (n,), or behind a pointer."""
    array[at : at + lanes_of(array)] = lanes


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
