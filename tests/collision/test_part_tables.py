"""Parts of shapes: the tree over a mesh's triangles holds each once, within every ball above it; balls lie inside."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
from hypothesis import given, settings, strategies as st

from guidefield.collision.part_tables import PartsTable
from guidefield.geometry.mesh_tree import mesh_tree


@settings(deadline=None, max_examples=12)
@given(count=st.integers(1, 60), before=st.integers(0, 3), seed=st.integers(0, 1000))
def test_every_triangle_is_once_in_the_tree_and_within_the_balls_above(count: int, before: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    table = PartsTable()
    for _ in range(before):
        table.add_shape(coal.Sphere(0.1), pin.SE3.Random())
    corners = rng.normal(size=(count, 1, 3)) + 0.1 * rng.normal(size=(count, 3, 3))
    alone = PartsTable()
    assert alone.add_tree(mesh_tree(corners)) == 0
    root = table.add_parts(alone.tables())
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

    vertices = parts.vertices.reshape(-1, 3, 16)
    shapes = parts.shapes.reshape(-1, 3)

    def below(node: int) -> list[np.ndarray]:
        if links[node, 0] < 0:
            return [numbers[links[node, 2], :9].reshape(3, 3)]
        return below(links[node, 0]) + below(links[node, 1])

    for node in range(root, len(links)):  # a polytope's vertices are the corners below it, where it is of few
        if links[node, 0] >= 0 and links[node, 2] >= 0 and (triangles := below(node)) and len(triangles) < 86:
            _, first, blocks = shapes[links[node, 2]]
            held = vertices[first : first + blocks].transpose(0, 2, 1).reshape(-1, 3)
            apart = np.linalg.norm(np.concatenate(triangles)[:, None] - held, axis=2)
            assert apart.min(axis=0).max() < 1e-6
            assert node == root or apart.min(axis=1).max() < 1e-6
    look(root, [])
    assert sorted(map(np.ndarray.tolist, found)) == sorted(corners.tolist())
