"""Cropped scenes: every place in the ball is as far from what is left as from everything."""

from typing import Any

import coal
import msgspec
import numpy as np
import pytest

from guidefield.kernels.distance.distance import CROPPED_SOLID, distance_at_points
from guidefield.kernels.distance.winding import ROOM
from guidefield.memory import Limit
from guidefield.messages import scene as messages
from guidefield.messages.scene_changes import SceneDiff, apply_change, freeze
from guidefield.messages.values import Placement
from guidefield.scene import crop as room
from guidefield.scene.crop import Ball, crop, nearest_obstacles
from guidefield.scene.distance_tables import distance_tables
from guidefield.scene.scene import BuiltScenes, Scene, build
from tests.scene.test_incremental import OTHERS, PLACED


def scattered(seed: int, count: int, odd: float) -> messages.Scene:
    rng = np.random.default_rng(seed)
    chosen = [(OTHERS if rng.random() < odd else PLACED) for _ in range(count)]
    made = [kinds[int(rng.integers(len(kinds)))](f"o{k}", rng) for k, kinds in enumerate(chosen)]
    return messages.Scene("s", obstacles=made)


def distances(scene: Scene, place: np.ndarray) -> list[float]:
    """Coal's distances of a place from all obstacles [m]."""
    dot, here, found = coal.Sphere(1e-9), coal.Transform3s(np.eye(3), place), []
    for one in scene.obstacles:
        there, result = coal.Transform3s(one.placement.rotation, one.placement.translation), coal.DistanceResult()
        coal.distance(dot, here, one.shape, there, coal.DistanceRequest(), result)
        found.append(float(result.min_distance) - one.rounding)
    return found


@pytest.mark.parametrize("odd", [0.0, 0.05])
@pytest.mark.parametrize("seed", range(6))
def test_no_place_in_the_ball_has_lost_its_nearest(seed: int, odd: float) -> None:
    rng = np.random.default_rng(seed)
    scene = build(scattered(seed, 120, odd))
    ball = Ball(*rng.normal(scale=1.5, size=3).tolist(), float(rng.uniform(0.05, 0.8)))
    kept = nearest_obstacles(scene, ball)
    met = kept.of(scene)
    assert met.obstacles == tuple(scene.obstacles[k] for k in kept.chosen)
    assert met.message.obstacles == [scene.message.obstacles[k] for k in kept.chosen]
    for _ in range(40):
        away = rng.normal(size=3)
        place = np.array(ball[:3]) + away / np.linalg.norm(away) * ball.radius * rng.uniform() ** (1.0 / 3.0)
        found = distances(scene, place)
        assert min(found) == min(found[k] for k in kept.chosen.tolist())
        bounds = zip(kept.least, found, kept.most, strict=True)
        assert all(least <= distance <= most + 1e-9 or distance < 0.0 for least, distance, most in bounds)


def test_what_is_far_behind_something_near_is_left_out() -> None:
    far = [messages.Sphere(name=f"f{k}", radius=0.1, position=(10.0, 0.1 * k, 0.0)) for k in range(50)]
    near = messages.Box(name="near", size=(0.1, 0.1, 0.1), position=(0.5, 0.0, 0.0))
    kept = nearest_obstacles(build(messages.Scene("s", obstacles=[*far, near])), Ball(0.0, 0.0, 0.0, 1.0))
    assert kept.chosen.tolist() == [50]
    floor = messages.HalfSpace(name="floor", normal=(0.0, 0.0, 2.0), offset=-1.0)
    kept = nearest_obstacles(build(messages.Scene("s", obstacles=[*far, floor])), Ball(0.0, 0.0, 0.0, 1.0))
    assert kept.chosen.tolist() == [50]
    assert kept.most[50] == pytest.approx(1.5)
    kept = nearest_obstacles(build(messages.Scene("s", obstacles=far)), Ball(0.0, 0.0, 0.0, 1.0))
    assert 0 < len(kept.chosen) <= 50


def passing(name: str, begin: tuple[float, float, float], end: tuple[float, float, float]) -> messages.Sphere:
    """A sphere that slides from a place to another."""
    slides = messages.ObstacleTrajectory([0.0, 1.0], [Placement(begin), Placement(end)])
    return messages.Sphere(name=name, radius=0.1, trajectory=slides)


def test_what_moves_is_left_out_where_it_never_gets_near_and_nothing_for_where_it_only_gets() -> None:
    ball = Ball(0.0, 0.0, 0.0, 0.5)
    far, near = passing("far", (9.0, 0.0, 0.0), (9.0, 1.0, 0.0)), passing("near", (0.0, 9.0, 0.0), (0.0, 0.7, 0.0))
    rests = messages.Sphere(name="rests", radius=0.1, position=(3.0, 0.0, 0.0))
    assert nearest_obstacles(build(messages.Scene("s", obstacles=[far, near, rests])), ball).chosen.tolist() == [1, 2]
    comes = passing("comes", (20.0, 0.0, 0.0), (0.6, 0.0, 0.0))
    stays = passing("stays", (0.7, 0.0, 0.0), (0.8, 0.0, 0.0))
    assert nearest_obstacles(build(messages.Scene("s", obstacles=[comes, rests])), ball).chosen.tolist() == [0, 1]
    assert nearest_obstacles(build(messages.Scene("s", obstacles=[comes, stays, rests])), ball).chosen.tolist() == [
        0,
        1,
    ]


@pytest.mark.parametrize("seed", range(4))
def test_no_place_in_the_ball_has_lost_its_nearest_at_any_time(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = rng.uniform(-3.0, 3.0, (40, 2, 3))
    movers = [passing(f"m{k}", tuple(a.tolist()), tuple((a + 0.2 * b).tolist())) for k, (a, b) in enumerate(places)]
    scene, ball = build(messages.Scene("s", obstacles=movers)), Ball(*rng.normal(size=3).tolist(), 0.3)
    kept = nearest_obstacles(scene, ball)
    assert 0 < len(kept.chosen) < len(movers)
    for time in np.linspace(-0.1, 1.1, 13):
        held, away = scene.at(float(time)), rng.normal(size=(5, 3))
        for place in np.array(ball[:3]) + 0.3 * away / np.linalg.norm(away, axis=1)[:, None]:
            found = distances(held, place)
            assert min(found) == min(found[k] for k in kept.chosen.tolist())


def test_where_nothing_is_another_what_is_left_is_the_very_same_scene() -> None:
    ball, kept = Ball(0.0, 0.0, 0.0, 0.5), BuiltScenes(Limit(4, 2**29))
    rng = np.random.default_rng(3)
    places = rng.uniform(-6.0, 6.0, (2000, 3)).tolist()
    boxes = [messages.Box(name=f"b{k}", size=(0.1, 0.1, 0.1), position=tuple(place)) for k, place in enumerate(places)]
    scene = freeze(messages.Scene("s", obstacles=boxes))
    first = nearest_obstacles(kept.of(scene), ball)
    out, within = f"b{(set(range(2000)) - set(first.chosen.tolist())).pop()}", f"b{first.chosen[0]}"
    moved = apply_change(scene, SceneDiff(move={out: Placement((5.0, 5.0, 5.0))}))
    assert nearest_obstacles(kept.of(moved), ball).some is first.some
    removed = apply_change(moved, SceneDiff(remove=[out]))
    assert nearest_obstacles(kept.of(removed), ball).some is first.some
    comes = apply_change(removed, SceneDiff(move={within: Placement((0.5, 0.0, 0.0))}))
    last = nearest_obstacles(kept.of(comes), ball).some
    assert last is not first.some
    assert first.some.obstacle(within).message == scene.obstacles[first.chosen[0]]
    assert last.obstacle(within).message.position == (0.5, 0.0, 0.0)


BALL = Ball(0.1, -0.2, 0.5, 0.7)


def grid(corner: tuple[float, float, float], u: Any, v: Any, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a parallelogram."""
    s, t = np.meshgrid(np.linspace(0.0, 1.0, count + 1), np.linspace(0.0, 1.0, count + 1), indexing="ij")
    vertices = np.array(corner) + s.ravel()[:, None] * np.array(u) + t.ravel()[:, None] * np.array(v)
    at = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    halves = [[at, at + count + 1, at + 1], [at + 1, at + count + 1, at + count + 2]]
    return vertices, np.concatenate([np.column_stack(half) for half in halves])


def cube(half: float, count: int, *, inwards: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """A closed cube about the origin, each side of 2 count^2 triangles."""
    vertices, triangles = [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            corner, u, v = np.full(3, -half), np.zeros(3), np.zeros(3)
            corner[axis] = side * half
            u[(axis + 1) % 3] = v[(axis + 2) % 3] = 2.0 * half
            points, faces = grid(tuple(corner.tolist()), u, v, count)
            outwards = (side > 0.0) != inwards
            triangles.append(len(vertices) * (count + 1) ** 2 + (faces if outwards else faces[:, ::-1]))
            vertices.append(points)
    return np.concatenate(vertices), np.concatenate(triangles)


def mesh(name: str, vertices: np.ndarray, triangles: np.ndarray, **placed: Any) -> messages.Mesh:
    return messages.Mesh(
        name=name, vertices=[*map(tuple, vertices.tolist())], triangles=[*map(tuple, triangles.tolist())], **placed
    )


def everything() -> messages.Scene:
    """A hall with a room in its wall, a sheet, a cloud, and a box."""
    ground = grid((-5.0, -5.0, -0.4), (10.0, 0.0, 0.3), (0.0, 10.0, 0.0), 40)
    hall, hollow = cube(4.0, 24), cube(3.6, 24, inwards=True)
    walls = np.concatenate([hall[0], hollow[0]]), np.concatenate([hall[1], len(hall[0]) + hollow[1]])
    turned = {"position": (0.3, 0.2, 1.0), "quaternion_xyzw": (0.6, 0.0, 0.0, 0.8)}
    points = np.random.default_rng(5).uniform(-5.0, 5.0, (4000, 3)) * [1.0, 1.0, 0.02] - [0.0, 0.0, 0.4]
    return messages.Scene(
        name="hall",
        obstacles=[
            mesh("ground", *ground),
            mesh("walls", *walls, **turned),
            messages.PointCloud(name="cloud", points=[*map(tuple, points.tolist())], radius=0.02),
            messages.Box(name="box", size=(0.1, 0.2, 0.3), position=(0.5, 0.5, 0.5)),
        ],
    )


@pytest.fixture(autouse=True)
def _small_is_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "is_large", lambda count: count >= 500)


def places(ball: Ball, count: int) -> np.ndarray:
    rng = np.random.default_rng(count)
    away = rng.normal(size=(count, 3))
    away *= (ball.radius * rng.uniform(0.0, 1.3, count).clip(max=1.0) / np.linalg.norm(away, axis=1))[:, None]
    return np.array(ball[:3]) + away


def one_alone(scene: messages.Scene, index: int) -> Scene:
    return build(msgspec.structs.replace(scene, obstacles=[scene.obstacles[index]]))


@pytest.mark.parametrize("index", range(3))
@pytest.mark.parametrize("ball", [BALL, Ball(4.2, 0.0, 1.0, 0.9), Ball(7.0, 1.0, 0.0, 0.5)])
def test_every_place_in_the_ball_is_as_far_from_it(index: int, ball: Ball) -> None:
    whole = one_alone(everything(), index)
    met = crop(whole, ball)[0]
    assert met.obstacles[0].faces < 0.7 * whole.obstacles[0].faces
    points = places(ball, 400)
    tables = distance_tables(whole), distance_tables(met)
    (far, normals, _), (near, same, _) = (distance_at_points(each, points) for each in tables)
    np.testing.assert_allclose(near, far, atol=1e-12)
    assert (np.abs(same - normals).max(axis=1) < 1e-6).mean() > 0.99  # ties have several


def test_what_is_inside_a_wall_is_told_as_before() -> None:
    whole = one_alone(everything(), 1)
    points = places(ball := Ball(4.1, 0.2, 1.0, 0.6), 400)
    far = distance_at_points(distance_tables(whole), points)[0]
    assert (far < -0.05).any()
    assert (far > 0.05).any()
    near = distance_at_points(distance_tables(crop(whole, ball)[0]), points)[0]
    np.testing.assert_allclose(near, far, atol=1e-12)


@pytest.mark.parametrize("cutoff", [0.01, 0.3])
@pytest.mark.parametrize("ball", [Ball(4.1, 0.2, 1.0, 0.6), Ball(3.3, 0.0, 1.2, 0.5)])
def test_a_cutoff_leaves_out_what_is_beyond_and_nothing_inside(ball: Ball, cutoff: float) -> None:
    whole = one_alone(everything(), 1)
    points, met = places(ball, 400), distance_tables(crop(whole, ball)[0])
    assert CROPPED_SOLID in met.kinds
    assert (met.anchors[:, ROOM] > 0.0).all()
    assert len(met.anchors) == met.spans[:, 4].max() == (met.kinds == CROPPED_SOLID).sum()
    far = distance_at_points(distance_tables(whole), points)[0]
    near = distance_at_points(met, points, cutoff)[0]
    assert (far > cutoff).any()
    np.testing.assert_allclose(near, np.where(far < cutoff, far, np.inf), atol=1e-12)


def test_coal_sees_what_is_met() -> None:
    whole = build(everything())
    met = crop(whole, BALL)[0]
    for index in range(3):
        part, one = met.obstacles[index], whole.obstacles[index]
        assert part.shape.num_tris == part.faces == part.facets.count < one.faces
        assert (part.box[0] >= one.box[0]).all()
        assert (part.box[1] <= one.box[1]).all()


def test_what_has_no_area_hides_no_surface() -> None:
    """A line near the ball is nearer to all of its places than the ground; kernels measure to the ground alone."""
    vertices, triangles = grid((-6.0, -6.0, -5.0), (12.0, 0.0, 0.0), (0.0, 12.0, 0.0), 90)
    line = np.array([[0.9, 0.2, 0.6], [0.9, 0.3, 0.6], [0.9, 0.4, 0.6]])
    count = len(vertices)
    with_line = np.concatenate([triangles, [[count, count + 1, count + 2]]])
    whole = build(messages.Scene(name="yard", obstacles=[mesh("m", np.concatenate([vertices, line]), with_line)]))
    met = crop(whole, Ball(0.0, 0.0, 0.3, 1.2))[0].obstacles[0]
    assert met is not whole.obstacles[0]
    assert met.cropped is not None
    below = (met.vertices[met.triangles][:, :, 2] < -4.0).all(axis=1)
    assert 0 < below.sum() < len(triangles)
    assert (~below).sum() == 1
