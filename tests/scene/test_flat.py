"""Flat polygons: Newell's plane, and the faults that are found."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.scene import guide_plane as flats
from guidefield.scene.guide_plane import PLANARITY, FlatPolygon, FlatPolygons, flat_polygons


def flat_polygon(points: np.ndarray) -> FlatPolygon:
    return flat_polygons(points[None]).one(0)


def alone(polygon: FlatPolygon) -> FlatPolygons:
    return flat_polygons(polygon.vertices[None])


def flatness_fault(polygon: FlatPolygon) -> str | None:
    return flats.flatness_faults(alone(polygon)).get(0)


def crossing_edges(polygon: FlatPolygon) -> tuple[int, int] | None:
    return flats.crossing_edges(alone(polygon)).get(0)


def shoelace(corners: np.ndarray) -> float:
    x, y = corners.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


@settings(deadline=None, max_examples=12)
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


def first_meeting(corners: np.ndarray, gap: float) -> tuple[int, int] | None:
    """The oracle: each edge against each that is no neighbour, the segments sampled by their closest points."""
    count, ends = len(corners), np.roll(corners, -1, axis=0)

    def apart(point: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
        share = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        return float(np.linalg.norm(point - (a + share * (b - a))))

    def side(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
        return float((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0])

    for i in range(count):
        for j in range(i + 2, count - (i == 0)):
            a, b, c, d = corners[i], ends[i], corners[j], ends[j]
            if min(apart(c, a, b), apart(d, a, b), apart(a, c, d), apart(b, c, d)) <= gap:
                return i, j
            if side(a, b, c) * side(a, b, d) < 0.0 and side(c, d, a) * side(c, d, b) < 0.0:
                return i, j
    return None


def outlines(rng: np.random.Generator, kind: int) -> np.ndarray:
    count = int(rng.integers(4, 30))
    if kind == 0:
        return rng.uniform(-1.0, 1.0, (count, 2))
    if kind == 1:
        return rng.integers(0, 7, (count, 2)).astype(float)
    angles = 2.0 * np.pi * (np.arange(count) + rng.uniform(-0.3, 0.3, count)) / count
    corners = rng.uniform(0.2, 1.0, (count, 1)) * np.column_stack([np.cos(angles), np.sin(angles)])
    one, other = rng.integers(0, count, 2)
    if kind == 2:  # nearly touching itself
        corners[one] = corners[other] + 10.0 ** rng.uniform(-8.0, -3.0) * rng.normal(size=2)
    return corners


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10**6), st.integers(0, 3))
def test_the_first_edges_that_meet_are_found(seed, kind):
    corners = outlines(np.random.default_rng(seed), kind)
    flat = flat_polygon(np.column_stack([corners, np.zeros(len(corners))]))
    if flatness_fault(flat) is not None:
        return
    found, expected = crossing_edges(flat), first_meeting(flat.corners, PLANARITY * flat.size)
    if found != expected:  # an edge that folds back is told before
        assert (found[1] - found[0]) % len(corners) == 1


def test_an_outline_of_ten_thousand_corners_is_looked_through():
    """Edge by edge and pair by pair it would take a minute."""
    angles = np.linspace(0.0, 2.0 * np.pi, 10_000, endpoint=False)
    spikes = np.where(np.arange(10_000) % 2, 1.0, 0.5)[:, None]
    star = spikes * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    assert crossing_edges(flat_polygon(star)) is None
    star[[2500, 7501]] = star[[7501, 2500]]
    assert crossing_edges(flat_polygon(star)) is not None
