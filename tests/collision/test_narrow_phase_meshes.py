"""Balls and meshes with triangles without area: Coal finds its own spheres in contact with these, anywhere."""

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st

from guidefield.collision.narrow_phase import NarrowPhase, transform
from guidefield.geometry.convex import bvh
from guidefield.messages.scene import Mesh
from guidefield.planner.guide.guide import find_touched_obstacle
from tests.planner.problems import scene_of

FLAT = {
    "three corners in a line": [(0.0, 0.0, 0.0), (1.0, 0.2, -0.3), (0.5, 0.1, -0.15)],
    "two corners at one place": [(0.0, 0.0, 0.0), (1.0, 0.2, -0.3), (0.0, 0.0, 0.0)],
    "all corners at one place": [(0.5, 0.1, -0.15), (0.5, 0.1, -0.15), (0.5, 0.1, -0.15)],
}
RADIUS = 0.05


def from_segment(point: np.ndarray, corners: np.ndarray) -> float:
    a, b = corners[0], corners[1]
    along = (point - a) @ (b - a) / max((b - a) @ (b - a), 1e-300)
    return float(np.linalg.norm(point - a - np.clip(along, 0.0, 1.0) * (b - a)))


@pytest.mark.parametrize("kind", list(FLAT))
@given(seed=st.integers(0, 2**32 - 1))
def test_a_ball_is_as_far_from_a_flat_triangle_as_it_is(kind, seed):
    corners = np.array(FLAT[kind])
    shapes = [bvh(corners, np.array([[0, 1, 2]])), coal.Sphere(RADIUS)]
    place = np.random.default_rng(seed).normal(size=3)
    stand = [pin.SE3.Identity(), pin.SE3(np.eye(3), place)]
    there = from_segment(place, corners) - RADIUS
    for order in ((0, 1), (1, 0)):
        narrow = NarrowPhase(
            lambda body, order=order: shapes[order[body]], lambda body, order=order: transform(stand[order[body]])
        )
        if there > 0.0:
            assert narrow.distance(0, 1).distance == pytest.approx(there, rel=0.0, abs=1e-6)
            assert narrow.penetration(0, 1) is None
        assert narrow.penetration(0, 1, abs(there) + 1e-5) is not None


def test_a_ball_fits_beside_a_mesh_with_flat_triangles():
    corners = [*FLAT["three corners in a line"], (0.0, 0.0, 1.0)]
    scene = scene_of(Mesh(name="fin", vertices=corners, triangles=[(0, 1, 2), (0, 1, 3)]))
    places = np.random.default_rng(1).normal(size=(50, 3)) + np.array([0.0, 5.0, 0.0])
    assert [find_touched_obstacle(scene, place, RADIUS) for place in places] == [None] * 50
