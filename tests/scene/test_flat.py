"""Flat polygons: Newell's plane, and the faults that are found."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.scene.flat import crossing_edges, flat_polygon, flatness_fault

STAR = np.array(
    [[np.cos(a) * r, np.sin(a) * r, 0.0] for a, r in zip(np.arange(10) * np.pi / 5, [1, 0.3] * 5, strict=True)]
)
PENTAGRAM = STAR[[0, 4, 8, 2, 6]]


def shoelace(corners: np.ndarray) -> float:
    x, y = corners.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10**6))
def test_plane_of_a_moved_star_is_the_moved_plane(seed):
    rng = np.random.default_rng(seed)
    placement = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-1, 1, 3))
    radii = rng.uniform(0.2, 2.0, 12)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 12))
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False) + 0.1 * angles / 7
    corners = np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])
    points = np.column_stack([corners, np.zeros(12)]) @ placement.rotation.T + placement.translation
    flat = flat_polygon(points)
    assert flat.normal == pytest.approx(placement.rotation[:, 2], abs=1e-12)
    assert flat.area == pytest.approx(shoelace(corners))
    assert shoelace(flat.corners) == pytest.approx(flat.area)
    assert flat.from_plane(flat.corners) == pytest.approx(points, abs=1e-12)
    assert np.cross(*flat.axes) == pytest.approx(flat.normal)
    assert flatness_fault(flat) is None
    assert crossing_edges(flat) is None


def test_a_corner_off_the_plane_is_told_with_its_distance():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 1e-4], [0, 1, 0]], float)
    assert "off a plane" in flatness_fault(flat_polygon(square))
    assert flatness_fault(flat_polygon(square * [1, 1, 1e-3])) is None


@pytest.mark.parametrize("corners", [[[0, 0, 0], [1, 0, 0], [1, 0, 0]], [[0, 0, 0]] * 3])
def test_coinciding_corners_are_told(corners):
    assert "coincide" in flatness_fault(flat_polygon(np.array(corners, float)))


def test_a_line_is_told():
    assert "line" in flatness_fault(flat_polygon(np.array([[0, 0, 0], [1, 1, 1], [3, 3, 3]], float)))


def test_crossing_edges_are_found():
    assert crossing_edges(flat_polygon(STAR)) is None
    assert crossing_edges(flat_polygon(PENTAGRAM)) is not None
    hourglass = np.array([[0, 0, 0], [2, 1, 0], [2, 0, 0], [0, 1.5, 0]], float)
    assert crossing_edges(flat_polygon(hourglass)) == (0, 2)


def test_an_edge_that_touches_another_crosses_it():
    pinched = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [1, 0, 0], [0, 2, 0]], float)
    assert crossing_edges(flat_polygon(pinched)) is not None


def test_a_spike_folds_back():
    spike = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [2, 3, 0], [2, 1.5, 0], [0, 1, 0]], float)
    assert crossing_edges(flat_polygon(spike)) == (2, 3)
