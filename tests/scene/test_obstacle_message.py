"""Obstacles that move: on screws, posed as they are declared, and never faster than is said."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.scene.obstacle_message import ObstacleMotion, put_at
from guidefield.scene.scene import build

HALF = float(np.sqrt(0.5))
SWING = messages.ObstacleTrajectory(
    times=[1.0, 2.0, 4.0],
    placements=[
        Placement(position=(1.0, 0.0, 0.0)),
        Placement(position=(0.0, 1.0, 0.0), quaternion_xyzw=(0.0, 0.0, HALF, HALF)),
        Placement(position=(0.0, 1.0, 2.0), quaternion_xyzw=(0.0, 0.0, HALF, HALF)),
    ],
)
KINDS = [
    messages.Box(name="o", size=(0.2, 0.3, 0.4), trajectory=SWING),
    messages.Cylinder(name="o", radius=0.1, length=0.4, trajectory=SWING),
    messages.Capsule(name="o", radius=0.1, length=0.4, trajectory=SWING),
    messages.Sphere(name="o", radius=0.1, trajectory=SWING),
    messages.Polygon(name="o", vertices=[(0.1, 0, 0), (0.3, 0, 0), (0.2, 0.4, 0)], trajectory=SWING),
    messages.Mesh(
        name="o",
        vertices=[(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
        triangles=[(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)],
        trajectory=SWING,
    ),
    messages.HalfSpace(name="o", normal=(0.2, -0.4, 2.0), offset=-0.3, trajectory=SWING),
    messages.PointCloud(name="o", points=[(0.1, 0, 0), (0.3, 0, 0.2), (0.2, 0.4, 0)], radius=0.05, trajectory=SWING),
]


@given(st.floats(0.0, 5.0), st.floats(1e-4, 0.5), st.integers(0, 2**31))
@settings(max_examples=15)
def test_no_point_is_faster_than_the_speed_that_is_said(start: float, span: float, seed: int) -> None:
    motion, rng = ObstacleMotion.of(SWING), np.random.default_rng(seed)
    centre, radius = rng.normal(size=3), 0.3
    offset = rng.normal(size=3)
    point = centre + radius * offset / np.linalg.norm(offset)
    moved = np.linalg.norm(motion.at(start + span).act(point) - motion.at(start).act(point))
    assert moved <= motion.speed(start, start + span, centre, radius) * span + 1e-9


@given(st.floats(0.0, 5.0), st.floats(1e-4, 0.5), st.integers(0, 2**31))
@settings(max_examples=15)
def test_no_plane_comes_closer_to_a_point_at_rest_than_it_is_said_to_pass_it(start, span, seed):
    motion, rng = ObstacleMotion.of(SWING), np.random.default_rng(seed)
    centre, radius = 3.0 * rng.normal(size=3), 0.3
    offset, normal = rng.normal(size=(2, 3))
    point = centre + radius * offset / np.linalg.norm(offset)
    plane = messages.HalfSpace(name="o", normal=tuple((normal / np.linalg.norm(normal)).tolist()), offset=0.4)
    posed_then, posed_later = (put_at(plane, motion.at(time)) for time in (start, start + span))
    lost = (point @ posed_then.normal - posed_then.offset) - (point @ posed_later.normal - posed_later.offset)
    during = slice(np.searchsorted(motion.times, start, side="right"), np.searchsorted(motion.times, start + span) + 1)
    assert abs(lost) <= motion.passing(centre, radius)[during].max() * span + 1e-9


@pytest.mark.parametrize("message", KINDS, ids=lambda m: type(m).__name__)
def test_a_scene_at_a_time_has_its_obstacles_there(message: messages.Obstacle) -> None:
    scene = build(messages.Scene(name="s", obstacles=[message]))
    (first,) = scene.obstacles
    assert scene.moves
    assert scene.end == 4.0
    assert scene.resting.obstacles == ()
    for time in (0.0, 1.7, 3.0, 8.0):
        (there_then,) = scene.at(time).obstacles
        carried = first.placement_at(time) * first.placement.inverse()
        if isinstance(message, messages.HalfSpace):  # its patch lies elsewhere on the same plane
            plane = there_then.message
            np.testing.assert_allclose([carried.act(v) @ plane.normal for v in first.vertices], plane.offset, atol=1e-9)
            inward = carried.rotation @ np.array(message.normal)
            assert inward @ plane.normal > 0.999 * np.linalg.norm(message.normal) ** 2
            continue
        if isinstance(message, messages.PointCloud):
            there = [carried.act(point) for point in first.cloud.points]
            np.testing.assert_allclose(
                sorted(map(tuple, there_then.cloud.points)), sorted(map(tuple, there)), atol=1e-9
            )
            continue
        if not isinstance(message, messages.Sphere):  # a ball doesn't turn
            np.testing.assert_allclose(there_then.vertices, [carried.act(v) for v in first.vertices], atol=1e-9)
        centre = first.vertices.mean(axis=0)
        np.testing.assert_allclose(there_then.vertices.mean(axis=0), carried.act(centre), atol=1e-9)


@pytest.mark.parametrize("message", [KINDS[0], KINDS[-2]], ids=lambda m: type(m).__name__)
def test_a_scene_since_a_time_has_its_obstacles_where_they_are_then(message: messages.Obstacle) -> None:
    scene = build(messages.Scene(name="s", obstacles=[message]))
    assert scene.since(0.0) is scene
    for begin in (0.6, 1.4, 3.0):
        seen = scene.since(begin)
        assert seen.end == pytest.approx(4.0 - begin)
        for time in (0.0, 0.3, 2.0, 5.0):
            (here,), (there,) = seen.at(time).obstacles, scene.at(begin + time).obstacles
            np.testing.assert_allclose(here.vertices, there.vertices, atol=1e-9)
    for last in (4.0, np.inf):
        resting = scene.since(last)
        assert not resting.moves
        np.testing.assert_allclose(resting.obstacles[0].vertices, scene.at(9.0).obstacles[0].vertices)
