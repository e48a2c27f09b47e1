"""The speed profile against a linear program at every grid point, and against a bang-bang motion."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import linprog

from guidefield.kernels.timing.path_parameterization import fastest_speeds


def profile(first, second, steps, caps, limits, offsets=None, kernel=fastest_speeds):
    controllable, x = np.full(len(first), np.nan), np.full(len(first), np.nan)
    kernel(first, second, steps, caps, limits, np.zeros_like(limits) if offsets is None else offsets, controllable, x)
    return controllable, x


FEASIBLE = 1e-7  # how far HiGHS lets a solution stray beyond its constraints


def random_path(seed, points=12, nv=3):
    rng = np.random.default_rng(seed)
    first = rng.normal(size=(points, nv))
    second = rng.normal(size=(points, nv)) * 10.0 ** rng.uniform(-1, 1)
    first[:, 0] *= rng.integers(0, 2)  # sometimes a joint that stays, or has only curvature
    steps = rng.uniform(0.05, 0.5, points - 1)
    return first, second, steps, rng.uniform(0.5, 5.0, points), rng.uniform(0.5, 5.0, (points - 1, nv))


def constraints(first, second, steps, limits, offsets, i, x_next):
    """Rows of A (x, u) <= b of step i: both ends of the step, and 0 <= x + 2 h u <= x_next."""
    h = steps[i]
    rows, bounds = [], []
    for j, (limit, offset) in enumerate(zip(limits[i], offsets[i], strict=True)):
        near = (second[i, j], first[i, j])
        far = (second[i + 1, j], first[i + 1, j] + 2.0 * h * second[i + 1, j])
        for row in (near, far):
            rows += [row, (-row[0], -row[1])]
            bounds += [limit * (1.0 - offset), limit * (1.0 + offset)]
    return np.array([*rows, (1.0, 2.0 * h), (-1.0, -2.0 * h)]), np.array([*bounds, x_next, 0.0])


def largest(objective, rows, bounds, x_range):
    found = linprog(-np.array(objective), rows, bounds, bounds=[x_range, (None, None)], method="highs")
    assert found.status == 0, found.message
    return -found.fun


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), aside=st.sampled_from([0.0, 0.9]))
def test_agrees_with_a_linear_program_at_every_point(seed, aside):
    first, second, steps, caps, limits = random_path(seed)
    offsets = np.random.default_rng([seed, 1]).uniform(-aside, aside, limits.shape)
    controllable, x = profile(first, second, steps, caps, limits, offsets)
    assert x[0] == x[-1] == controllable[-1] == 0.0
    for i in range(len(steps)):
        rows, bounds = constraints(first, second, steps, limits, offsets, i, controllable[i + 1])
        assert controllable[i] == pytest.approx(
            largest((1.0, 0.0), rows, bounds, (0.0, caps[i])), rel=1e-6, abs=FEASIBLE
        )
        x_next = largest((1.0, 2.0 * steps[i]), rows, bounds, (x[i] * (1 - 1e-12), x[i]))
        assert x[i + 1] == pytest.approx(x_next, rel=1e-6, abs=FEASIBLE)
