"""A scene as tables for lanes: a kernel's tables of primitives against the general ones, and boxes."""

from __future__ import annotations

import coal
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.lanes.scene_tables import lane_scene, prepare_scene
from guidefield.collision.part_tables import PartsTable
from guidefield.deadline import UNLIMITED, Deadline, DeadlineExpired
from guidefield.kernels.collide.parts import PART
from guidefield.kernels.collide.primitive import HALF_SPACE
from guidefield.kernels.simd.packing import BLOCK
from guidefield.kernels.simd.vector_model import LANES
from guidefield.messages import scene as messages
from guidefield.scene.scene import Scene, build
from tests.collision.scenery import scattered
from tests.scene.solids import l_prism, mesh_message

RING = messages.Mesh(
    name="ring",
    vertices=[(0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1), (-0.1, 0.0, 0.0), (0.0, 0.02, 0.02)],
    triangles=[(0, 1, 2), (1, 3, 2), (0, 4, 1)],
    position=(0.4, 0.4, 0.4),
)
WALL = messages.Polygon(name="wall", vertices=[(0.7, -0.3, 0.2), (0.7, 0.3, 0.2), (0.6, 0.3, 0.9), (0.6, -0.3, 0.9)])
FLOOR = messages.HalfSpace(name="floor", normal=(0.1, 0.0, 1.0), offset=-0.2)
LEVEL = messages.HalfSpace(name="level", normal=(0.0, 0.0, 2.0), offset=-0.4)


def scene(seed: int, count: int) -> Scene:
    """Primitives with something else before, among and behind them."""
    obstacles = scattered(np.random.default_rng(seed), count)
    obstacles = [RING, *obstacles[: count // 2], FLOOR, WALL, LEVEL, *obstacles[count // 2 :]]
    return build(messages.Scene(name="test", obstacles=obstacles))


@settings(deadline=None, max_examples=9)
@given(seed=st.integers(0, 10_000), count=st.integers(0, 20))
def test_a_primitives_tables_are_those_of_its_shape(seed: int, count: int) -> None:
    made = scene(seed, count)
    lanes = lane_scene(made)
    (obstacles, parts), owners = lanes.tables, lanes.owners
    assert sorted(set(owners.tolist())) == list(range(len(made.obstacles)))
    links, shapes = parts.links.reshape(-1, 3), parts.shapes.reshape(-1, 3)
    for place, owner in enumerate(owners):
        obstacle = made.obstacles[owner]
        if isinstance(obstacle.shape, coal.BVHModelBase):
            assert not obstacles.whole[place]
            continue
        table = PartsTable()
        assert table.add_shape(obstacle.shape, obstacle.placement) == 0
        alone, root = table.tables(), obstacles.roots[place]
        part = links[root, 2]
        kind, first, blocks = shapes[part]
        assert [kind, blocks] == alone.shapes[[0, 2]].tolist()
        assert links[root, :2].tolist() == [-1, -1]
        if np.isfinite(alone.balls[3]):
            np.testing.assert_allclose(parts.balls[4 * root : 4 * root + 4], alone.balls, rtol=0, atol=1e-12)
        assert np.isinf(parts.balls[4 * root + 3]) == np.isinf(alone.balls[3])
        used = 4 if kind == HALF_SPACE else PART
        numbers = parts.numbers[PART * part : PART * part + used]
        np.testing.assert_allclose(numbers, alone.numbers[:used], rtol=0, atol=1e-12)
        vertices = parts.vertices[BLOCK * first : BLOCK * (first + blocks)]
        np.testing.assert_allclose(vertices, alone.vertices, rtol=0, atol=1e-6)


@settings(deadline=None, max_examples=9)
@given(seed=st.integers(0, 10_000), count=st.integers(0, 40))
def test_boxes_hold_their_obstacles_and_no_more(seed: int, count: int) -> None:
    made = scene(seed, count)
    lanes = lane_scene(made)
    (obstacles, _), owners = lanes.tables, lanes.owners
    boxes = obstacles.boxes.reshape(-1, 6, LANES).transpose(0, 2, 1).reshape(-1, 6)
    for box in boxes[len(owners) :]:
        assert box.tolist() == [np.inf] * 3 + [-np.inf] * 3
    for index, obstacle in enumerate(made.obstacles):
        own = boxes[np.flatnonzero(owners == index)]
        low, high = own[:, :3].min(axis=0), own[:, 3:].max(axis=0)
        if obstacle.message == FLOOR:
            assert not np.isfinite([*low, *high]).any()
        elif obstacle.message == LEVEL:
            np.testing.assert_allclose([*low, *high], [-np.inf] * 3 + [np.inf, np.inf, -0.2])
        elif isinstance(obstacle.shape, coal.BVHModelBase):
            assert (low <= obstacle.vertices.min(axis=0) + 1e-6).all()
            assert (high >= obstacle.vertices.max(axis=0) - 1e-6).all()
        else:
            points, radius = _skeleton(obstacle.shape)
            points = points @ obstacle.placement.rotation.T + obstacle.placement.translation
            np.testing.assert_allclose(low, points.min(axis=0) - radius, rtol=0, atol=2e-6)
            np.testing.assert_allclose(high, points.max(axis=0) + radius, rtol=0, atol=2e-6)


def _skeleton(shape) -> tuple[np.ndarray, float]:
    """Points (n, 3) and a radius: the hull of balls of that radius about them is a shape, to a few micrometres."""
    if isinstance(shape, coal.Box):
        return np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T * shape.halfSide, 0.0
    if isinstance(shape, coal.Sphere):
        return np.zeros((1, 3)), shape.radius
    ends = np.array([[0.0, 0.0, -shape.halfLength], [0.0, 0.0, shape.halfLength]])
    if isinstance(shape, coal.Capsule):
        return ends, shape.radius
    angles = np.linspace(0.0, 2.0 * np.pi, 2000)
    rim = shape.radius * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    return np.concatenate([end + rim for end in ends]), 0.0


def test_preparing_a_scene_stops_when_time_is_up_and_goes_on_later() -> None:
    solids = [
        msgspec.structs.replace(mesh_message(*l_prism(), position=(0.41, 0.13, 0.07 + k)), name=f"m{k}")
        for k in range(3)
    ]
    made = build(messages.Scene(name="s", obstacles=solids))
    for at, left in (("m0", 1), ("m0", 1), ("m1", 2), ("m2", 2)):
        answers = iter([False] * (left - 1) + [True])
        with pytest.raises(DeadlineExpired, match=f"^obstacle {at}$"):
            prepare_scene(made, Deadline(is_cancelled=lambda answers=answers: next(answers)))  # type: ignore[misc]
    prepare_scene(made, UNLIMITED)
    prepare_scene(made, Deadline(0.0))  # nothing is left to do
    assert len(lane_scene(made).owners) > 0
