from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.geometry.cover import Cover
from guidefield.geometry.primitive_covers import (
    cover_box,
    cover_capsule,
    cover_cylinder,
    cover_sphere,
    inner_box,
    inner_capsule,
    inner_cylinder,
    inner_sphere,
)
from tests.geometry import solids

Depth = Callable[[np.ndarray], np.ndarray]


def box_depth(size: np.ndarray) -> Depth:
    def depth(points: np.ndarray) -> np.ndarray:
        gaps = np.abs(points) - 0.5 * size
        return np.where((gaps <= 0).all(axis=1), -gaps.max(axis=1), -np.linalg.norm(np.maximum(gaps, 0), axis=1))

    return depth


def cylinder_depth(radius: float, length: float) -> Depth:
    def depth(points: np.ndarray) -> np.ndarray:
        gaps = np.column_stack([np.hypot(points[:, 0], points[:, 1]) - radius, np.abs(points[:, 2]) - 0.5 * length])
        return np.where((gaps <= 0).all(axis=1), -gaps.max(axis=1), -np.linalg.norm(np.maximum(gaps, 0), axis=1))

    return depth


def capsule_depth(radius: float, length: float) -> Depth:
    def depth(points: np.ndarray) -> np.ndarray:
        beyond = np.abs(points[:, 2]) - 0.5 * length
        return radius - np.hypot(np.hypot(points[:, 0], points[:, 1]), np.maximum(beyond, 0.0))

    return depth


def check_cover(found: Cover, depth: Depth, delta: float, reach: np.ndarray, seed: int = 0) -> None:
    """Contained by dense sampling, also next to the surface; overhang by sampling the balls' surfaces."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-reach, reach, (6000, 3))
    edges = np.where(rng.random((3000, 3)) < 0.6, np.sign(rng.normal(size=(3000, 3))) * reach, points[:3000])
    points = np.vstack([points, edges])
    points = points[depth(points) >= -1e-15]
    assert len(points) > 50
    assert solids.in_balls(points, found.spheres).all()
    assert found.overhang <= delta + 1e-9
    outside = solids.around(found.spheres, 40, rng)
    beyond = np.maximum(-depth(outside.reshape(-1, 3)), 0.0).reshape(len(found.spheres), -1).max(axis=1)
    assert (beyond <= found.overhangs + 1e-9).all()
    assert (np.linalg.norm(points - found.bound[:3], axis=1) <= found.bound[3]).all()


def check_inner(balls: np.ndarray, depth: Depth) -> None:
    assert len(balls) <= 8
    if len(balls):
        assert (balls[:, 3] > 0.0).all()
        assert (balls[:, 3] <= depth(balls[:, :3]) + 1e-12).all()


sizes = st.floats(0.002, 0.25)
deltas = st.floats(0.008, 0.05)


@settings(max_examples=9)
@given(sizes, sizes, sizes, deltas)
def test_boxes(x: float, y: float, z: float, delta: float) -> None:
    size = np.array([x, y, z])
    check_cover(cover_box(size, delta), box_depth(size), delta, 0.5 * size)
    check_inner(inner_box(size), box_depth(size))


@settings(max_examples=15)
@given(st.floats(0.002, 0.12), sizes, deltas)
def test_cylinders(radius: float, length: float, delta: float) -> None:
    reach = np.array([radius, radius, 0.5 * length])
    check_cover(cover_cylinder(radius, length, delta), cylinder_depth(radius, length), delta, reach)
    check_inner(inner_cylinder(radius, length), cylinder_depth(radius, length))


@settings(max_examples=12)
@given(st.floats(0.002, 0.3), st.floats(0.0, 1.0), deltas)
def test_capsules(radius: float, length: float, delta: float) -> None:
    reach = np.array([radius, radius, 0.5 * length + radius])
    check_cover(cover_capsule(radius, length, delta), capsule_depth(radius, length), delta, reach)
    check_inner(inner_capsule(radius, length), capsule_depth(radius, length))


def test_a_sphere_is_its_own_cover_and_nearly_its_own_inside() -> None:
    found, inner = cover_sphere(0.07), inner_sphere(0.07)
    assert found.spheres[0] == pytest.approx([0, 0, 0, 0.07], rel=1e-9)
    assert found.overhang < 1e-9
    assert inner[0] == pytest.approx([0, 0, 0, 0.07], abs=2e-6)
    assert inner[0, 3] < 0.07
