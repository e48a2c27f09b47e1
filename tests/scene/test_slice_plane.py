"""Planes for pictures: they contain the path, show all of it, and stand upright."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.scene.field_slice import LEAST_MARGIN, SlicePlane, planes_along

LAWS = settings(deadline=None, max_examples=15)
paths = st.integers(0, 2**32 - 1).map(
    lambda seed: np.random.default_rng(seed).normal(size=(12, 3)) @ np.diag([1.0, 0.5, 0.01]) + [0.3, -0.2, 0.6]
)


def heights(plane: SlicePlane, path: np.ndarray) -> np.ndarray:
    values: np.ndarray = (path - plane.pose.translation) @ plane.pose.rotation[:, 2]
    return values


@LAWS
@given(paths)
def test_a_path_is_shown_whole_and_upright(path: np.ndarray) -> None:
    first, second = planes_along(path)
    for plane in (first, second):
        rows, columns = plane.pixels(200)
        pixels = plane.projected(path, rows, columns)
        assert (pixels > 0.0).all()
        assert (pixels < [columns, rows]).all()
        assert min(plane.size) >= 2.0 * LEAST_MARGIN - 1e-12
        rotation = plane.pose.rotation
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        assert rotation[2, 1] > 0.0 or rotation[2, 2] > 0.0
    # The first fits a nearly flat path, the second stands across it along its main direction.
    assert np.abs(heights(first, path)).max() < 0.1
    assert first.pose.rotation[:, 2] @ second.pose.rotation[:, 2] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.3, -0.9, 0.0), (0.0, 0.0, 1.0), (0.5, 0.2, 0.7)])
def test_a_straight_path_lies_in_both(direction: tuple[float, float, float]) -> None:
    path = np.linspace(0.0, 0.8, 9)[:, None] * np.array(direction) + [0.1, 0.2, 0.3]
    for plane in planes_along(path):
        assert heights(plane, path) == pytest.approx(np.zeros(9), abs=1e-12)
    level, upright = planes_along(path)
    if direction[2] == 0.0:
        assert level.pose.rotation[:, 2] == pytest.approx([0.0, 0.0, 1.0])
        assert upright.pose.rotation[:, 1] == pytest.approx([0.0, 0.0, 1.0])
