"""Clouds of a stream: their neighbours stand together, however they are given."""

import numpy as np
import pytest

from guidefield.kernels.collide.parts import BALL_ROW, LEFT, LINK, RIGHT
from guidefield.messages.scene import PointCloud, Scene
from guidefield.scene.scene import build
from guidefield.stream.shapes import shape_of


@pytest.mark.parametrize("stray", [0.0, 1e4])
def test_of_a_cloud_neighbours_stand_together_however_it_is_given(stray: float) -> None:
    """Whoever gave points in any order had each leaf of the judge's tree and each box for ways about all."""
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (4000, 3))
    points[7] += stray  # cameras see such
    message = PointCloud(name="cloud", points=points.tolist(), radius=0.01)
    shape = shape_of(build(Scene("room", obstacles=[message])).obstacles[0])
    balls, links = shape.parts.balls.reshape(-1, BALL_ROW), shape.parts.links.reshape(-1, LINK)
    leaves = links[:, LEFT] < 0
    assert np.array_equal(np.unique(balls[leaves, :3], axis=0), np.unique(points, axis=0))
    above, pending = np.full((len(balls), 4), np.nan), [0]
    for node in pending:  # which grows
        if not leaves[node]:
            above[links[node, [LEFT, RIGHT]]] = balls[node]
            pending += links[node, [LEFT, RIGHT]].tolist()
            below = balls[links[node, [LEFT, RIGHT]]]
            assert (np.linalg.norm(below[:, :3] - balls[node, :3], axis=1) <= balls[node, 3] - 0.01 + 1e-9).all()
    assert sorted(pending) == list(range(len(balls))), "each node is below one other"
    assert np.median(above[leaves, 3]) < 0.2
    assert np.median(shape.boxes[:, 12:15].max(axis=1)) < 0.5
