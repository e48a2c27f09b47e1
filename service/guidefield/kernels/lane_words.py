# ruff: noqa: ARG001  numba calls typing and code generation with arguments that most have no use for
"""The words of a scene, written by a kernel: `packed` asks Python for each address, two microseconds for each array."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types, void
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from guidefield.kernels.lane_tables import LANE_OBSTACLES, SCRATCH
from guidefield.kernels.lanes import FLOATS, FLOATS_OUT, INTEGERS_OUT
from guidefield.kernels.separation import PARTS
from guidefield.kernels.signatures import compiled


def _leaves(kind: Any) -> Iterator[Any]:
    """The kinds of the arrays and numbers in a tuple, in order."""
    for field in kind.types:
        if isinstance(field, types.BaseTuple):
            yield from _leaves(field)
        else:
            yield field


@intrinsic
def _write_addresses(typing: Any, value: Any, words: Any) -> Any:
    """Write what `packed` makes of a tuple to an array."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        word = ir.IntType(64)
        target = cgutils.create_struct_proxy(sig.args[1])(context, builder, args[1]).data
        count = 0

        def write(kind: Any, value: Any) -> None:
            nonlocal count
            if isinstance(kind, types.BaseTuple):
                for index, field in enumerate(kind.types):
                    write(field, builder.extract_value(value, index))
                return
            if isinstance(kind, types.Array):
                value = builder.ptrtoint(cgutils.create_struct_proxy(kind)(context, builder, value).data, word)
            builder.store(value, builder.gep(target, [ir.Constant(word, count)]))
            count += 1

        write(sig.args[0], args[0])
        return context.get_dummy_value()

    return types.void(value, words), generate


_SCENE = types.Tuple([LANE_OBSTACLES, PARTS, SCRATCH, FLOATS_OUT, FLOATS, types.int64])
"""All of `LaneWorld` that is not the robot's."""

SCENE_WORDS = len(list(_leaves(_SCENE)))
"""How many words that is."""


@compiled(void(_SCENE, INTEGERS_OUT))
def scene_words(scene: Any, words: NDArray[np.int64]) -> None:
    """Write the words of a scene, shape (SCENE_WORDS,), as `packed` would."""
    _write_addresses(scene, words)
