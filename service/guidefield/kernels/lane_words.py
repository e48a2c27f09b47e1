# ruff: noqa: ARG001  numba calls typing and code generation with arguments that most have no use for
"""The words of a world, written by kernels: `packed` asks Python for each address, two microseconds for each array."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import int64, types, void
from numba.core import cgutils
from numba.extending import intrinsic

from guidefield.kernels.lane_tables import HITS, LANE_OBSTACLES, LaneObstacles, Scratch
from guidefield.kernels.lanes import INTEGERS_OUT
from guidefield.kernels.packing import Words
from guidefield.kernels.separation import PARTS
from guidefield.kernels.signatures import INDEX_MATRIX, compiled
from guidefield.kernels.tree_kinematics import INDICES

LINE = 64
"""Bytes of a line of the cache: sixteen floats that lie across two of them take twice as long to get."""


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


_SCENE = types.Tuple([LANE_OBSTACLES, PARTS])

SCENE_WORDS = len(LANE_OBSTACLES.types) + len(PARTS.types)
"""How many words obstacles and their shapes are."""

_TESTED = LaneObstacles._fields.index("tested")


@compiled(void(_SCENE, INTEGERS_OUT))
def scene_words(scene: Any, words: Words) -> None:
    """Write the words of obstacles and their shapes, shape (SCENE_WORDS,), as `packed` would."""
    _write_addresses(scene, words)


MEMORY_WORDS = len(Scratch._fields) + 2
"""How many words there are behind those: of the scratch and the block, and how many numbers the axes are."""

_HITS = 1 + Scratch._fields.index("hits")


@compiled(int64(INDICES, INDICES, INDICES, INDICES, INDEX_MATRIX, int64, INTEGERS_OUT, INTEGERS_OUT))
def lay_out(
    robot: Words,
    scene: Words,
    offsets: Words,
    owners: Words,
    mixed: np.ndarray,
    bodies: int,
    memory: Words,
    words: Words,
) -> int:
    """Write a world's words, and what its memory holds at first.

    Args:
        robot: Words of the robot.
        scene: Those of obstacles and their shapes, shape (SCENE_WORDS,).
        offsets: Where in the memory there is what is tested, the scratch and the block [bytes]; last, how many numbers
            the axes are; shape (1 + MEMORY_WORDS,).
        owners: For each obstacle which one of the scene it stands for, shape (n,).
        mixed: The pairs of a body and an obstacle of the scene, counted behind the bodies, that are tested; (p, 2).
        bodies: How many bodies there are.
        memory: All zero; what is in it begins where a line of the cache does.
        words: Gets the words.

    Returns:
        Where that is [bytes].
    """
    first, n, begins = len(robot), len(owners), -memory.ctypes.data % LINE
    start = memory.ctypes.data + begins
    words[:first] = robot
    words[first : first + SCENE_WORDS] = scene
    words[first + _TESTED] = start + offsets[0]
    for k in range(MEMORY_WORDS - 1):
        words[first + SCENE_WORDS + k] = start + offsets[1 + k]
    words[first + SCENE_WORDS + MEMORY_WORDS - 1] = offsets[MEMORY_WORDS]
    at = (begins + offsets[_HITS]) // 8
    memory[at : at + 3 * HITS] = -1
    at, count = (begins + offsets[0]) // 8, 0
    for p in range(len(mixed)):
        count = max(count, mixed[p, 1] + 1 - bodies)
    tested = np.zeros((bodies, count), np.int64)
    for p in range(len(mixed)):
        tested[mixed[p, 0], mixed[p, 1] - bodies] = 1
    for o in range(n):
        if owners[o] < count:
            for body in range(bodies):
                memory[at + body * n + o] = tested[body, owners[o]]
    return begins
