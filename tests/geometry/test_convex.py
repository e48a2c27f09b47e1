import numpy as np
import pytest
import scipy.spatial
from hypothesis import given, settings, strategies as st

from guidefield.geometry.convex import convex_hull
from tests.geometry.measures import is_closed, volume
from tests.oracles import EPS

clouds = st.tuples(st.integers(0, 2**32 - 1), st.integers(4, 60), st.floats(-7.0, 0.0), st.floats(-3.0, 3.0))
"""Seed, number of points, exponent of the thickness, exponent of the size."""


def cloud(seed: int, count: int, thin: float, size: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return 10.0**size * (
        rng.uniform(-1.0, 1.0, (count, 3)) * [1.0, 10.0 ** (0.5 * thin), 10.0**thin] @ turn + rng.normal(size=3)
    )


@settings(max_examples=24)
@given(clouds)
def test_hull_contains_the_points_and_is_convex(drawn: tuple[int, int, float, float]) -> None:
    points = cloud(*drawn)
    hull = convex_hull(points)
    assert is_closed(hull)
    assert volume(hull) > 0.0
    assert {tuple(vertex) for vertex in hull.vertices} <= {tuple(point) for point in points}
    # Not the height over a thin triangle's plane, which rounding tilts, but the volume of the point over it.
    a, b, c = hull.corners.transpose(1, 0, 2)
    volumes = np.einsum("tj,tpj->tp", np.cross(b - a, c - a), points[None] - a[:, None])
    assert volumes.max() <= 1e-6 * volume(hull) + 64 * EPS * np.abs(points).max() ** 3


@settings(max_examples=24)
@given(clouds, st.integers(1, 4), st.floats(-18.0, -6.0))
def test_the_volume_is_that_of_the_hull_whatever_lies_at_one_place(drawn, times, noise):
    points = cloud(*drawn)
    rng = np.random.default_rng(drawn[0])
    again = [points + rng.normal(size=points.shape) * 10.0 ** (noise + drawn[3]) for _ in range(times)]
    points = np.concatenate([points, points, *again])  # Coal alone ends the process at many of these
    size = np.prod(np.ptp(points, axis=0))
    expected = scipy.spatial.ConvexHull(points, qhull_options="QJ").volume
    assert volume(convex_hull(points)) == pytest.approx(expected, rel=1e-6, abs=1e-7 * size)


@pytest.mark.parametrize("apart", [1e-17, 1e-16, 1e-15, 1e-14, 1e-13, 1e-12])
def test_many_points_a_few_roundings_apart_have_a_hull(apart: float) -> None:
    rng = np.random.default_rng(5)
    for side in (0.02, 0.2, 3.0):  # the cut through a round body: a flat face of many corners, each met twice
        angles = 2.0 * np.pi * rng.random(150)
        rim = side * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(150)])
        round_ = side * rng.normal(size=(1200, 3))
        round_ /= np.linalg.norm(round_, axis=1)[:, None] / side
        points = np.concatenate([rim, round_[round_[:, 2] < 0.0]]) @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
        doubled = np.concatenate([points, points + side * apart * rng.normal(size=points.shape)])
        hull = convex_hull(doubled)
        expected = scipy.spatial.ConvexHull(doubled, qhull_options="QJ").volume
        assert volume(hull) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("apart", [1e-13, 1e-11, 1e-10, 1e-9, 1e-7])
def test_no_point_is_outside_the_hull_of_points_that_are_close_to_each_other(apart: float) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        ball = rng.normal(size=(400, 3))
        ball /= np.linalg.norm(ball, axis=1)[:, None]
        points = np.concatenate([ball, ball + apart * rng.normal(size=ball.shape)])
        hull = convex_hull(points)
        a, b, c = hull.vertices[hull.triangles].swapaxes(0, 1)
        normals = np.cross(b - a, c - a)
        areas = np.linalg.norm(normals, axis=1)
        normals, a = normals[areas > 1e-14] / areas[areas > 1e-14, None], a[areas > 1e-14]
        assert (points @ normals.T - np.einsum("ni,ni->n", normals, a)).max() < 2e-8
