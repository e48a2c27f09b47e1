"""Of many obstacles those are kept that may be nearest to some place in a ball; no place in it has lost its nearest."""

import coal
import numpy as np
import pytest

from guidefield.memory import Limit
from guidefield.messages import scene as messages
from guidefield.messages.scene_changes import SceneDiff, apply_change, freeze
from guidefield.messages.values import Placement
from guidefield.scene.crop import Ball, nearest_obstacles
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
