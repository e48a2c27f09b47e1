"""Bodies are within shapes: how far they stand out is never said to be less than it is."""

import coal
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import nnls

from guidefield.referee.proof import Declared, Shapes, _by_planes, radius_about, standing_out
from guidefield.referee.shapes import hull

WHOLE = np.array([[-1, -1]]), np.array([[-1, 0]])  # children and shapes of a single node


def declared_points(points: np.ndarray) -> Declared:
    z = np.array([0.0, 0.0, 1.0])
    return Declared(points, np.arange(len(points))[:, None], 0.0, 0.0, z, np.zeros(4))


def hulls(*some: np.ndarray) -> Shapes:
    count = len(some)
    begins = np.cumsum([0, *map(len, some)])
    return Shapes(begins, np.zeros(count), np.zeros(count), np.zeros((count, 3)), np.concatenate(some))


@settings(max_examples=18)
@given(st.integers(0, 10**6))
def test_points_stand_out_of_a_hull_by_no_more_than_is_said(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(int(rng.integers(4, 60)), 3)) * [0.2, 0.1, rng.choice([0.1, 0.01])]
    weights = rng.dirichlet(np.full(len(corners), 0.2), 200)
    inside = weights @ corners
    assert standing_out(declared_points(inside), hulls(corners), *WHOLE) <= 1e-7
    moved = inside + rng.normal(size=inside.shape) * 1e-7
    said = standing_out(declared_points(moved), hulls(corners), *WHOLE)
    convex, here = hull(corners), coal.Transform3s.Identity()
    for point in moved[:40]:
        at = coal.Transform3s(np.eye(3), point)
        found = coal.distance(coal.Sphere(0.0), at, convex, here, coal.DistanceRequest(), coal.DistanceResult())
        assert found <= said + 1e-6


def test_a_corner_that_is_missing_is_found() -> None:
    corners = np.indices((2, 2, 2)).reshape(3, 8).T * 0.1
    assert standing_out(declared_points(corners), hulls(corners), *WHOLE) == 0.0
    assert standing_out(declared_points(corners), hulls(corners[:-1]), *WHOLE) == np.inf


def test_each_triangle_has_to_be_in_one_part_and_in_all_about_it() -> None:
    corners = np.indices((2, 2, 2)).reshape(3, 8).T * 0.1
    items = np.array([[0, 1, 2], [5, 6, 7]])
    body = Declared(corners, items, 0.0, 0.0, np.array([0.0, 0.0, 1.0]), np.zeros(4))
    children, of_node = np.array([[1, 2], [-1, -1], [-1, -1]]), np.array([[-1, 0], [-1, 1], [-1, 2]])
    first, second = corners[items[0]], corners[items[1]]
    assert standing_out(body, hulls(corners, first, second), children, of_node) == 0.0
    assert standing_out(body, hulls(corners, first, first), children, of_node) == np.inf
    assert standing_out(body, hulls(first, first, second), children, of_node) == np.inf


@pytest.mark.parametrize("less", [0.0, 1e-7])
def test_a_cylinder_is_in_one_that_is_as_large(less: float) -> None:
    z = np.array([0.0, 0.0, 1.0])
    ends = np.array([[0.0, 0.0, -0.2], [0.0, 0.0, 0.2]])
    body = Declared(ends, np.arange(2)[None], 0.0, 0.1, z, np.zeros(4))
    shapes = Shapes(np.array([0, 2]), np.zeros(1), np.array([0.1 - less]), z[None], ends)
    assert standing_out(body, shapes, *WHOLE) == pytest.approx(less, abs=1e-15)
    assert radius_about(body, np.zeros(3)) == pytest.approx(np.hypot(0.1, 0.2))


@pytest.mark.parametrize("thin", [1.0, 1e-2, 1e-4, 1e-12, 0.0])
def test_points_are_no_farther_from_a_flat_hull_than_is_said(thin: float) -> None:
    """A point that is a micrometre out of a hull, however flat, is said to be little farther."""
    rng = np.random.default_rng(7)
    corners = rng.normal(size=(60, 3)) * (1.0, 1.0, thin) @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    shares = rng.dirichlet(np.full(4, 0.3), 200)
    inside = np.einsum("nk,nkc->nc", shares, corners[rng.integers(60, size=(200, 4))])
    points = inside + 1e-6 * rng.normal(size=inside.shape)
    told = _by_planes(points, corners)
    near = [
        nnls(np.vstack([1e3 * (corners - one).T, np.ones(60)]), np.array([0.0, 0.0, 0.0, 1.0]))[0] for one in points
    ]
    apart = [np.linalg.norm(corners.T @ (x / x.sum()) - one) for x, one in zip(near, points, strict=True)]
    assert (told >= np.array(apart) - 1e-9).all()
    assert told.max() < 2e-5


def test_what_is_beside_or_above_a_flat_hull_is_not_in_it() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    within, on_edge = np.array([[0.02, 0.02, 0.0]]), np.array([[0.05, 0.05, 0.0]])
    for points in (within, on_edge):
        assert standing_out(declared_points(points), hulls(corners), *WHOLE) <= 1e-12
        for off in ([0.0, 0.0, 1e-3], [0.06, 0.06, 0.0]):
            assert standing_out(declared_points(points + off), hulls(corners), *WHOLE) == np.inf
    line = corners[:2].repeat(2, axis=0)
    assert standing_out(declared_points(within), hulls(line), *WHOLE) == np.inf
