"""Parts of shapes: the tree over a mesh's triangles holds each once, within every ball above it; balls lie inside."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.convex_parts import PartsTable, UnservedError
from guidefield.collision.inner_balls import inner_balls
from guidefield.geometry import surfaces
from guidefield.geometry.convex import convex_hull
from guidefield.robot.shapes import triangulation


@settings(deadline=None, max_examples=20)
@given(count=st.integers(1, 60), before=st.integers(0, 3), seed=st.integers(0, 1000))
def test_every_triangle_is_once_in_the_tree_and_within_the_balls_above(count: int, before: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    table = PartsTable()
    for _ in range(before):
        table.add_shape(coal.Sphere(0.1), pin.SE3.Random())
    corners = rng.normal(size=(count, 1, 3)) + 0.1 * rng.normal(size=(count, 3, 3))
    root = table.add_triangles(corners)
    parts = table.tables()
    balls, links = parts.balls.reshape(-1, 4), parts.links.reshape(-1, 3)
    numbers = parts.numbers.reshape(-1, 16)
    found = []

    def look(node: int, above: list[int]) -> None:
        above = [*above, node]
        if links[node, 0] >= 0:
            look(links[node, 0], above)
            look(links[node, 1], above)
            return
        triangle = numbers[links[node, 2], :9].reshape(3, 3)
        found.append(triangle)
        for ball in above:
            assert np.linalg.norm(triangle - balls[ball, :3], axis=1).max() <= balls[ball, 3] + 1e-12

    look(root, [])
    assert sorted(map(np.ndarray.tolist, found)) == sorted(corners.tolist())


def test_an_unknown_shape_is_refused() -> None:
    with pytest.raises(UnservedError, match="Cone"):
        PartsTable().add_shape(coal.Cone(0.1, 0.2), pin.SE3.Identity())


@pytest.mark.parametrize("seed", range(5))
def test_balls_inside_a_hull_are_inside(seed: int) -> None:
    hull = convex_hull(np.random.default_rng(seed).normal(size=(40, 3)) * [0.3, 0.1, 0.05])
    points = coal.StdVec_Vec3s()
    points.extend([np.array(vertex) for vertex in hull.vertices])
    shape = coal.Convex.convexHull(points, True, "Qt")
    balls = inner_balls(shape)
    vertices, triangles = triangulation(shape)
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    offsets = np.einsum("ij,ij->i", normals, corners[:, 0])
    signs = np.sign(offsets - normals @ vertices.mean(axis=0))
    depths = (signs * (offsets - balls[:, :3] @ normals.T)).min(axis=1)
    assert 0 < len(balls) <= 8
    assert (balls[:, 3] <= depths + 1e-9).all()


@pytest.mark.parametrize("shape", [coal.Box(0.2, 0.5, 0.1), coal.Cylinder(0.1, 0.6), coal.Capsule(0.1, 0.3)])
def test_balls_inside_a_primitive_are_inside(shape: coal.ShapeBase) -> None:
    here = coal.Transform3s.Identity()
    for x, y, z, radius in inner_balls(shape):
        directions = surfaces.sphere(1.0).vertices
        for direction in directions:
            there = coal.Transform3s(np.eye(3), np.array([x, y, z]) + (radius - 1e-6) * direction)
            result = coal.DistanceResult()
            assert coal.distance(coal.Sphere(1e-9), there, shape, here, coal.DistanceRequest(), result) <= 1e-7
