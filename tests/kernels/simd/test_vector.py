"""Lanes against NumPy, and a lane kernel as plain Python against itself compiled."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from numba import njit

from guidefield.geometry import surfaces
from guidefield.geometry.charged import field_tables
from guidefield.kernels.field.field import field_at_points
from guidefield.kernels.simd.vector import (
    below,
    every,
    first_lane,
    inverse_root,
    is_double,
    lane,
    lanes_of,
    largest_lane,
    largest_of,
    load,
    magnitude,
    rint,
    root,
    select,
    smallest_lane,
    smallest_of,
    store,
    total,
)

PRECISIONS = pytest.mark.parametrize("kind", [np.float32, np.float64])


@njit
def everything(x: Any, y: Any, out: Any) -> Any:
    step = lanes_of(x)
    for i in range(0, x.shape[0], step):
        a, b = load(x, i), load(y, i)
        c = select((a < b) & (b > 0.5) | (a == 1), magnitude(a - b) * 2 - 1.5, -root(a) / b)
        c += select(a <= 0.25, 0.125, b)
        c *= 3
        store(out, i, c - inverse_root(b) * (2.0 if is_double(a) else 1.0))
    return total(load(out, 0)), every(load(x, 0) > 0.0), every(load(x, 0) < load(y, 0))


@PRECISIONS
def test_lanes_do_what_numpy_does(kind: type) -> None:
    x, y = np.random.default_rng(1).uniform(0.01, 2.0, (2, 64)).astype(kind)
    x[3] = 1.0
    out, expected = np.empty_like(x), np.empty_like(x)
    sums, plain = everything(x, y, out), everything.py_func(x, y, expected)
    tolerance = 8.0 * float(np.finfo(kind).eps)
    np.testing.assert_allclose(out, expected, rtol=tolerance, atol=32.0 * tolerance)
    np.testing.assert_allclose(sums, plain, rtol=64.0 * tolerance)


@njit
def among_lanes(x: Any, y: Any, out: Any) -> Any:
    a, b = load(x, 0), load(y, 0)
    bits = below(a, b)
    store(out, 0, rint(3.0 * a) + smallest_of(a, b) - 2.0 * largest_of(a, b))
    return bits, first_lane(bits), lane(a, 5), largest_lane(a), smallest_lane(b)


@PRECISIONS
def test_what_is_asked_of_lanes_is_the_same_undecorated(kind: type) -> None:
    x, y = np.random.default_rng(4).normal(size=(2, 8 if kind is np.float64 else 16)).astype(kind)
    x[2] = np.nan
    out, expected = np.empty_like(x), np.empty_like(x)
    with np.errstate(invalid="ignore"):
        found, plain = among_lanes(x, y, out), among_lanes.py_func(x, y, expected)
    assert found[:2] == plain[:2]
    assert found[0] >> 2 & 1, "what is not a number is below everything"
    assert found[2] == plain[2]
    known = np.arange(len(x)) != 2
    np.testing.assert_allclose(out[known], expected[known], rtol=1e-6)
    x[2] = 0.5
    assert among_lanes(x, y, out)[3:] == among_lanes.py_func(x, y, expected)[3:]


@njit
def inverse_roots(x: Any, out: Any) -> None:
    for i in range(0, x.shape[0], lanes_of(x)):
        store(out, i, inverse_root(load(x, i)))


@PRECISIONS
def test_inverse_roots_are_good_to_an_ulp_or_two(kind: type) -> None:
    x = (10.0 ** np.random.default_rng(2).uniform(-36.0, 36.0, 4096)).astype(kind)
    out = np.empty_like(x)
    inverse_roots(x, out)
    expected = 1.0 / np.sqrt(x.astype(np.longdouble))
    assert float(np.abs(out / expected - 1.0).max()) <= 2.0 * float(np.finfo(kind).eps)


PLAIN = """
import numpy as np
from guidefield.geometry import surfaces
from guidefield.geometry.charged import field_tables
from guidefield.kernels.field.field import field_at_points
tables = field_tables(surfaces.sphere(0.5, 1).corners, None, [[2, 0, 0, 0.3, 1]], [[0, 2, 0, 0, 3, 0, 0.2, 1]],
    [[0, 0, 1, -2, 1]], quads=surfaces.prism_quads(0.2, 0.5), boxes=[[0, 0, 2, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 2, 3, 1]])
points = np.random.default_rng(3).uniform(-1.5, 1.5, (8, 3))
"""


def test_the_field_as_plain_python() -> None:
    script = PLAIN + "print(repr([values.tolist() for values in field_at_points(tables, points)]))"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    names: dict[str, Any] = {}
    exec(PLAIN, names)
    compiled = field_at_points(names["tables"], names["points"])
    for values, plain in zip(compiled, eval(done.stdout), strict=True):
        np.testing.assert_allclose(plain, values, rtol=1e-11, atol=1e-11 * np.abs(values).max())


def test_kernels_refuse_the_wrong_precision() -> None:
    tables = field_tables(surfaces.box((1.0, 1.0, 1.0)).corners)
    with pytest.raises(TypeError):
        field_at_points(tables._replace(boxes=tables.boxes.astype(np.float32)), np.zeros((1, 3)))
