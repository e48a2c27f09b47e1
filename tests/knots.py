"""Knots of Hermite curves, drawn at random."""

import numpy as np


def random_knots(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,), positions (n, 3) and velocities (n, 3), of magnitudes that differ by a hundred."""
    rng = np.random.default_rng(seed)
    n = rng.integers(2, 12)
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.5, n - 1))])
    return times, rng.normal(size=(n, 3)), rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-1, 1)
