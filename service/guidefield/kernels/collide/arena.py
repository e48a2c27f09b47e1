"""The words of a world and what its memory holds at first, written by a kernel: one call instead of many arrays."""

from __future__ import annotations

import numpy as np
from numba import int64, void

from guidefield.kernels.collide.layout import HIT, HITS, LaneObstacles, Scratch
from guidefield.kernels.collide.parts import Parts
from guidefield.kernels.jit.signatures import INDEX_MATRIX, INDICES, INDICES_OUT, compiled
from guidefield.kernels.simd.packing import Words

LINE = 64
"""Bytes of a line of the cache: sixteen floats that lie across two of them take twice as long to get."""

SCENE_WORDS = len(LaneObstacles._fields) + len(Parts._fields)
"""How many words obstacles and their shapes are."""

_MAY_TOUCH = LaneObstacles._fields.index("may_touch")


MEMORY_WORDS = len(Scratch._fields) + 1
"""How many words there are behind those: of the scratch and the block."""

_HITS = 1 + Scratch._fields.index("hits")


@compiled(void(INDEX_MATRIX, INDICES, INDICES_OUT))
def _write_left_out(left_out: np.ndarray, owners: Words, may_touch: Words) -> None:
    """Mark what may touch: for each body all obstacles that stand for one of the scene."""
    n, most = len(owners), -1
    for o in range(n):
        most = max(most, owners[o])
    last, before = np.full(most + 1, -1), np.empty(n, np.int64)
    for o in range(n):
        before[o] = last[owners[o]]
        last[owners[o]] = o
    for p in range(len(left_out)):
        o = last[left_out[p, 1]] if left_out[p, 1] <= most else -1
        while o >= 0:
            may_touch[left_out[p, 0] * n + o] = 1
            o = before[o]


@compiled(int64(INDICES, INDICES, INDICES, INDICES, int64, INDICES, INDEX_MATRIX, INDICES_OUT, INDICES_OUT))
def lay_out(
    robot: Words,
    scene: Words,
    offsets: Words,
    owners: Words,
    bodies: int,
    moving: Words,
    left_out: np.ndarray,
    memory: Words,
    words: Words,
) -> int:
    """Write a world's words, and what its memory holds at first.

    Args:
        robot: Words of the robot.
        scene: Those of obstacles and their shapes, shape (SCENE_WORDS,).
        offsets: Where in the memory there is what may touch, the scratch and the block [bytes]; (1 + MEMORY_WORDS,).
        owners: For each obstacle which one of the scene it stands for, shape (n,).
        bodies: How many bodies the robot has.
        moving: Those that are tested against obstacles, ascending, shape (m,).
        left_out: The pairs of such a body and an obstacle of the scene that are not tested after all; (k, 2).
        memory: All zero; what is in it begins where a line of the cache does.
        words: Gets the words.

    Returns:
        Where that is [bytes].
    """
    first, n, begins = len(robot), len(owners), -memory.ctypes.data % LINE
    start = memory.ctypes.data + begins
    words[:first] = robot
    words[first : first + SCENE_WORDS] = scene
    words[first + _MAY_TOUCH] = start + offsets[0]
    for k in range(MEMORY_WORDS):
        words[first + SCENE_WORDS + k] = start + offsets[1 + k]
    at = (begins + offsets[_HITS]) // 8
    memory[at : at + HIT * HITS] = -1
    at = (begins + offsets[0]) // 8
    k = 0
    for body in range(bodies):  # of a mesh of very many triangles little is written: most stays as it is
        if k < len(moving) and moving[k] == body:
            k += 1
        else:
            memory[at + body * n : at + (body + 1) * n] = 1
    if len(left_out):
        _write_left_out(left_out, owners, memory[at:])
    return begins
