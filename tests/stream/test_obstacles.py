"""What a stream knows of obstacles: only what was seen anew is written, and it stands where Pinocchio puts it."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.placements import se3
from guidefield.kernels.collide.parts import BALL_ROW, LEFT, LINK, RIGHT
from guidefield.messages.scene import Box, HalfSpace, PointCloud, Scene
from guidefield.messages.streams import Deviation, Observation, StreamObstacle
from guidefield.messages.values import Placement
from guidefield.scene.scene import build
from guidefield.stream.obstacles import Assumption, Obstacles
from guidefield.stream.shapes import shape_of

TURNED = (0.5, -0.5, 0.5, 0.5)


def known(deviation: Deviation | None = None) -> Obstacles:
    scene = build(Scene("floor", obstacles=[HalfSpace(name="floor", normal=(0.0, 0.0, 1.0), offset=0.0)]))
    obstacles = Obstacles(scene, Assumption(deviation, 0.01, 0.1), lambda _: np.array([True, True]))
    for name, speed in (("a", 0.2), ("b", 0.4)):
        shape = Box(name=name, size=(0.2, 0.4, 0.6))
        obstacles.take(obstacles.prepared(StreamObstacle(shape, speed, 0.5, uncertainty=0.003), "$", ()))
    return obstacles


def test_only_what_is_seen_anew_moves_and_what_is_gone_stands_nowhere() -> None:
    obstacles = known()
    assert obstacles.boxes([0.0]).shape == (0, 16)
    obstacles.observe(Observation("a", 1.0, Placement((1.0, 2.0, 3.0), TURNED), (0.1, 0.0, 0.0)))
    obstacles.observe(Observation("b", 2.0))
    seen = obstacles.see(0.5)
    movers, before = seen.movers, seen.movers.poses[::2].copy()
    placed = se3((1.0, 2.0, 3.0), TURNED)
    assert np.allclose(before[0].reshape(3, 4), np.column_stack([placed.rotation, placed.translation]), atol=1e-15)
    reach = 0.5 * np.sqrt(0.2**2 + 0.4**2 + 0.6**2)
    rates = np.array([0.2 + 0.5 * reach, 0.4 + 0.5 * reach])
    assert movers.growths == pytest.approx(rates, abs=1e-9)
    assert movers.margins == pytest.approx(0.003 + 0.1 * rates, abs=1e-9)
    assert seen.reserved.margins == pytest.approx(movers.margins + 0.5 * rates, abs=1e-12)
    assert movers.since.tolist() == movers.times[::2].tolist() == [1.0, 2.0]
    assert not movers.twists.any(), "the largest speed holds, wherever it goes"
    boxes = obstacles.boxes([1.0, 3.0])
    assert boxes[:, [3, 7, 11]].tolist() == [[1.0, 2.0, 3.0], [0.0, 0.0, 0.0], [1.2, 2.0, 3.0], [0.0, 0.0, 0.0]]
    obstacles.observe(Observation("b", 2.5, Placement((5.0, 0.0, 0.0))))
    movers = obstacles.see(0.5).movers
    assert np.array_equal(movers.poses[0], before[0])
    assert movers.poses[2, 3] == 5.0
    assert obstacles.see(0.5).bodies.boxes.apart.tolist() == [0, 1, 2]
    obstacles.lose("a")
    assert obstacles.see(0.5).bodies.boxes.apart.tolist() == [0, 2]
    assert obstacles.boxes([2.5])[:, 3].tolist() == [5.0]
    # what is declared anew, in another shape, is where it was seen
    obstacles.take(obstacles.prepared(StreamObstacle(Box(name="b", size=(1.0, 1.0, 1.0)), 0.4), "$", ()))
    assert obstacles.boxes([2.5])[0, [3, 12]].tolist() == [5.0, 0.5]


def test_deviations_take_the_place_of_largest_speeds() -> None:
    obstacles = known(Deviation(0.1, 0.2))
    seen = Observation("a", 1.0, Placement(), (0.3, 0.0, 0.4), (0.0, 1.0, 0.0))
    obstacles.observe(seen)
    movers = obstacles.see(0.0).movers
    reach = 0.5 * np.sqrt(0.2**2 + 0.4**2 + 0.6**2)
    assert movers.growths[0] == pytest.approx(0.1 + 1.2 * reach, abs=1e-9)
    assert movers.twists[0].tolist() == [0.3, 0.0, 0.4, 0.0, 0.0, 0.0]
    assert movers.margins[0] == pytest.approx(0.003 + 0.1 * (movers.growths[0] + 0.5), abs=1e-9)


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
