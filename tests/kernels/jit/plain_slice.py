"""What a few kernels return, on inputs that are always the same: ``python -m tests.kernels.jit.plain_slice FILE``.

They are compiled as the variable ``GUIDEFIELD_PLAIN_NUMBA`` says.
"""

import sys
from pathlib import Path

import numpy as np

from guidefield.kernels.field.field import frozen
from guidefield.kernels.jit.cache import keep_kernels_of
from guidefield.kernels.simd.packing import pack


def results() -> dict[str, np.ndarray]:
    """By name; masks are whole numbers, what vectors return is in single precision."""
    from guidefield.kernels.timing.hermite import piece_peaks
    from tests.kernels.jit.mechanisms import Turning, Weighted, fastest, sums, turned

    rng = np.random.default_rng(7)
    found = {"sums": np.empty(2), "masks": np.zeros(8, np.int64), "cosines": np.zeros(8 * 16, np.float32)}
    sums(Weighted(frozen(rng.normal(size=64)), frozen(rng.normal(size=64))), found["sums"])
    steps, values = rng.uniform(0.1, 1.0, 20), rng.normal(size=(21, 3))
    angles = rng.uniform(-20.0, 20.0, 8 * 16).astype(np.float32)
    turned(pack(Turning(angles, found["cosines"], 8)), found["masks"])
    found["speeds"], found["accelerations"] = np.empty((2, 20, 3))
    times, velocities = np.r_[0.0, np.cumsum(steps)], rng.normal(size=(21, 3))
    piece_peaks(times, values, velocities, found["speeds"], found["accelerations"])
    found["fastest"] = np.array([fastest(times, values, velocities, *np.empty((2, 20, 3)))])
    return found


if __name__ == "__main__":
    keep_kernels_of("tests", Path(__file__).parents[2])
    np.savez(sys.argv[1], **results())
