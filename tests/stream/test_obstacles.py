"""What a stream knows of obstacles: only what was seen anew is written, and it stands where Pinocchio puts it."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.placements import se3
from guidefield.messages.scene import Box, HalfSpace, PointCloud, Scene
from guidefield.messages.streams import Deviation, Observation, StreamObstacle
from guidefield.messages.values import Placement
from guidefield.scene.scene import build
from guidefield.stream.obstacles import Assumption, Obstacles
from guidefield.stream.shapes import shape_of

TURNED = (0.5, -0.5, 0.5, 0.5)


def known(deviation: Deviation | None = None) -> Obstacles:
    scene = build(Scene("floor", obstacles=[HalfSpace(name="floor", normal=(0.0, 0.0, 1.0), offset=0.0)]))
    obstacles = Obstacles(scene, Assumption(deviation, 0.01, 0.1), lambda _: np.array([0, 1]))
    for name, speed in (("a", 0.2), ("b", 0.4)):
        shape = Box(name=name, size=(0.2, 0.4, 0.6))
        obstacles.take(obstacles.prepared(StreamObstacle(shape, speed, 0.5, uncertainty=0.003), "$", ()))
    return obstacles


def test_only_what_is_seen_anew_moves_and_what_is_gone_stands_nowhere() -> None:
    obstacles = known()
    assert obstacles.boxes([0.0]).shape == (0, 16)
    obstacles.observe(Observation("a", 1.0, Placement((1.0, 2.0, 3.0), TURNED), (0.1, 0.0, 0.0)))
    obstacles.observe(Observation("b", 2.0))
    _, places, reserved = obstacles.judged(0.5)
    before = places.poses.copy()
    placed = se3((1.0, 2.0, 3.0), TURNED)
    assert np.allclose(before[1].reshape(3, 4), np.column_stack([placed.rotation, placed.translation]), atol=1e-15)
    reach = 0.5 * np.sqrt(0.2**2 + 0.4**2 + 0.6**2)
    rates = np.array([0.0, 0.2 + 0.5 * reach, 0.4 + 0.5 * reach])
    assert places.rates == pytest.approx(rates, abs=1e-9)
    assert places.margins == pytest.approx([0.01, *(0.003 + 0.01 + 0.1 * rates[1:])], abs=1e-9)
    assert reserved.margins == pytest.approx(places.margins + 0.5 * rates, abs=1e-12)
    assert places.times.tolist() == [0.0, 1.0, 2.0]
    boxes = obstacles.boxes([1.0, 3.0])
    assert boxes[:, [3, 7, 11]].tolist() == [[1.0, 2.0, 3.0], [0.0, 0.0, 0.0], [1.2, 2.0, 3.0], [0.0, 0.0, 0.0]]
    obstacles.observe(Observation("b", 2.5, Placement((5.0, 0.0, 0.0))))
    _, places, _ = obstacles.judged(0.5)
    assert np.array_equal(places.poses[:2], before[:2])
    assert places.poses[2, 3] == 5.0
    assert len(places.met) == 6
    obstacles.lose("a")
    _, places, _ = obstacles.judged(0.5)
    assert places.met[:, 1].tolist() == [0, 0, 2, 2]
    assert obstacles.boxes([2.5])[:, 3].tolist() == [5.0]
    # what is declared anew, in another shape, is where it was seen
    obstacles.take(obstacles.prepared(StreamObstacle(Box(name="b", size=(1.0, 1.0, 1.0)), 0.4), "$", ()))
    assert obstacles.boxes([2.5])[0, [3, 12]].tolist() == [5.0, 0.5]


def test_deviations_take_the_place_of_largest_speeds() -> None:
    obstacles = known(Deviation(0.1, 0.2))
    seen = Observation("a", 1.0, Placement(), (0.3, 0.0, 0.4), (0.0, 1.0, 0.0))
    obstacles.observe(seen)
    _, places, _ = obstacles.judged(0.0)
    reach = 0.5 * np.sqrt(0.2**2 + 0.4**2 + 0.6**2)
    assert places.rates[1] == pytest.approx(0.1 + 1.2 * reach, abs=1e-9)
    assert places.velocities[1].tolist() == [0.3, 0.0, 0.4]
    assert places.margins[1] == pytest.approx(0.003 + 0.01 + 0.1 * (places.rates[1] + 0.5), abs=1e-9)


@pytest.mark.parametrize("stray", [0.0, 1e4])
def test_of_a_cloud_neighbours_stand_together_however_it_is_given(stray: float) -> None:
    """Whoever gave points in any order had each leaf of the judge's tree and each box for ways about all."""
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (4000, 3))
    points[7] += stray  # cameras see such
    message = PointCloud(name="cloud", points=points.tolist(), radius=0.01)
    shape = shape_of(build(Scene("room", obstacles=[message])).obstacles[0])
    leaves = shape.links[:, 0] < 0
    assert np.median(shape.nodes[leaves, 3]) < 0.4
    assert np.median(shape.boxes[:, 12:15].max(axis=1)) < 0.5
    assert np.array_equal(np.unique(shape.solids.points, axis=0), np.unique(points, axis=0))
