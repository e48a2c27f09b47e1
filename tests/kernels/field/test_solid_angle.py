"""The forms for flat and for steep faces against the arctangent in more digits, and where each serves."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numba import njit

from guidefield.geometry import surfaces
from guidefield.kernels.field.box import FAR
from guidefield.kernels.field.faces import FLAT, flat_pair, single_field, steep_pair
from guidefield.kernels.simd.vector import load, store
from tests.kernels.evaluation import field, vectors
from tests.oracles import EPS

LAWS = settings(deadline=None, max_examples=30)
LANES = 16  # as many as any precision has

angles = st.lists(st.floats(0.02, 3.0), min_size=LANES, max_size=LANES).map(np.array)
flat_angles = st.lists(st.floats(0.02, np.pi / 16 - 1e-6), min_size=LANES, max_size=LANES).map(np.array)
heights = st.floats(-3.0, 1.0).map(lambda exponent: 10.0**exponent)


@njit
def one_triangle(h: Any, F: Any, row: Any, out: Any) -> None:
    for k, lanes in enumerate(single_field(load(h, 0), load(F, 0), row[0], row[1], row[2])):
        store(out[k], 0, lanes)


@njit
def two_triangles(h: Any, F: Any, row: Any, flat: Any, steep: Any) -> None:
    height, F1, F2 = load(h, 0), load(F[0], 0), load(F[1], 0)
    for k, lanes in enumerate(flat_pair(height * height, F1, F2, row[0], row[1])):
        store(flat[k], 0, lanes)
    for k, lanes in enumerate(steep_pair(height, F1, F2, row[0], row[1])):
        store(steep[k], 0, lanes)


def exactly(h: Any, F: Any, a: Any) -> tuple[Any, Any, Any]:
    """Phi, curvature and slope of a triangle in extended precision."""
    h, F, a = (np.asarray(value, np.longdouble) for value in (h, F, a))
    phi = 2 / h * np.arctan2(a * h, F)
    N = F * F + a * a * h * h
    return phi, 2 * (phi - 2 * a * F / N) / h**2, 2 * a / N


@pytest.mark.skipif(np.finfo(np.longdouble).eps == EPS, reason="this machine has no extended precision")
@pytest.mark.parametrize("kind", [np.float64, np.float32])
@pytest.mark.parametrize("drawn", ["all flat", "mixed"])
def test_triangles(kind: type, drawn: str) -> None:
    @LAWS
    @given(flat_angles if drawn == "all flat" else angles, heights)
    def agree(half: np.ndarray, h: float) -> None:
        a = kind(0.3)
        at = np.full(LANES, h, kind)
        F = (a * h / np.tan(half)).astype(kind)
        ours = np.empty((3, LANES), kind)
        step = 8 if kind == np.float64 else 16
        for i in range(0, LANES, step):
            one_triangle(at[i:], F[i:], np.array([a, a * a, a * FLAT], kind), ours[:, i:])
        eps = float(np.finfo(kind).eps)
        phi, curvature, slope = exactly(at, F, a)
        assert np.abs(ours[0] / phi - 1).max() < 4 * eps
        assert np.abs(ours[2] / slope - 1).max() < 6 * eps
        # What cancels in the curvature is of the size of Phi/h^2, but for flat faces of F's.
        scale = curvature + phi / np.asarray(at, np.longdouble) ** 2 * np.where(half < np.pi / 16, half**2, 1)
        assert np.abs((ours[1] - curvature) / scale).max() < 16 * eps

    agree()


@LAWS
@given(st.lists(st.floats(1e-6, np.pi / 16 - 1e-6), min_size=16, max_size=16), heights)
def test_flat_and_steep_forms_of_pairs_agree(halves: list[float], h: float) -> None:
    row = np.array([0.3, 0.2])
    F = row[:, None] * h / np.tan(np.array(halves).reshape(2, 8))
    flat, steep = np.empty((2, 4, 8))
    two_triangles(np.full(8, h), F, row, flat, steep)
    assert flat == pytest.approx(steep, rel=1e-12)


@LAWS
@given(st.tuples(*[st.floats(0.02, 1.0)] * 3).map(np.array), vectors(1.0).filter(lambda v: np.linalg.norm(v) > 0.1))
def test_faces_of_a_far_box_are_flat(size: np.ndarray, direction: np.ndarray) -> None:
    point = FAR * 0.5 * np.linalg.norm(size) * direction / np.linalg.norm(direction)
    box = surfaces.box(tuple(size))
    for k in range(6):
        face = box.corners[2 * k : 2 * k + 2]
        assert 2.0 * np.pi * abs(field(point, face).winding) < np.pi / 8
