"""What the benchmarks share: the best of many repetitions, and the most that the core can do."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numba import types, void

from guidefield.kernels.jit.arrays import FLOATS, FLOATS_OUT, VECTOR, VECTOR_OUT
from guidefield.kernels.jit.decorators import compiled
from guidefield.kernels.simd.vector import lanes_of, load, store

_CHAINS = 10
_STEPS = 20_000


def best(call: Callable[[], object], seconds: float = 0.5, most: int = 2000) -> float:
    """Shortest time of a call, of as many as fit into some seconds (at least three) [s]."""
    shortest, spent, count = np.inf, 0.0, 0
    while count < 3 or (spent < seconds and count < most):
        start = time.perf_counter()
        call()
        elapsed = time.perf_counter() - start
        shortest, spent, count = min(shortest, elapsed), spent + elapsed, count + 1
    return shortest


@compiled([void(VECTOR, types.intp, VECTOR_OUT), void(FLOATS, types.intp, FLOATS_OUT)])
def _multiply_add(x, steps, out):  # type: ignore[no-untyped-def]
    """Ten independent chains of fused multiply-adds."""
    a, b, c = load(x, 0), load(x, 16), load(x, 32)
    r0, r1, r2, r3, r4, r5, r6, r7, r8, r9 = a, a + 1, a + 2, a + 3, a + 4, a + 5, a + 6, a + 7, a + 8, a + 9
    for _ in range(steps):
        r0, r1, r2, r3, r4 = r0 * b + c, r1 * b + c, r2 * b + c, r3 * b + c, r4 * b + c
        r5, r6, r7, r8, r9 = r5 * b + c, r6 * b + c, r7 * b + c, r8 * b + c, r9 * b + c
    store(out, 0, r0 + r1 + r2 + r3 + r4 + r5 + r6 + r7 + r8 + r9)


def multiply_add_peak(kind: type) -> float:
    """Fused multiply-adds of this core in a precision [GFLOP/s]."""
    x, out = np.full(64, 0.5, kind), np.empty(64, kind)
    lanes = lanes_of(x)
    return 2.0 * _CHAINS * _STEPS * lanes / best(lambda: _multiply_add(x, _STEPS, out)) * 1e-9
