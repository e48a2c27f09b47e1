"""The scene as a whole: its field is the sum of its obstacles' fields; scenes are kept by content, within bounds."""

import gc
import weakref

import msgspec
import numpy as np
import pytest

from guidefield.deadline import Deadline, DeadlineExpired
from guidefield.errors import SceneInvalid
from guidefield.kernels.field.field import field_at_points
from guidefield.memory import BYTES_PER_FACE, BoundedMap, Limit
from guidefield.messages import scene as messages
from guidefield.messages.scene_changes import SceneDiff, apply_change, freeze
from guidefield.messages.values import Float32Array, Placement
from guidefield.scene import obstacle, scene as scenes
from guidefield.scene.scene import BuiltScenes, build
from tests.scene.solids import box_mesh, l_prism, mesh_message

TURNED = (0.0, 0.0, np.sin(0.4), np.cos(0.4))
OBSTACLES = [
    messages.Box(name="box", size=(0.2, 0.3, 0.4), position=(0.5, 0, 0), quaternion_xyzw=TURNED),
    messages.Sphere(name="sphere", radius=0.1, position=(0, 0.6, 0), charge=2.0),
    messages.Cylinder(name="can", radius=0.05, length=0.2, position=(0, -0.5, 0)),
    messages.Capsule(name="pill", radius=0.04, length=0.3, position=(-0.6, 0, 0), quaternion_xyzw=TURNED, charge=0.5),
    mesh_message(*l_prism(), name="l", position=(1.0, 1.0, -0.5), charge=3.0),
    messages.Polygon(name="wall", vertices=[(-1, -1, 0), (-0.5, -1, 0), (-0.5, -0.8, 0.3), (-1, -0.8, 0.3)]),
    messages.HalfSpace(name="floor", normal=(0, 0, 2.0), offset=-1.6, charge=0.25),
]
POINTS = np.random.default_rng(5).uniform([-1.2, -1.2, -0.7], [0.3, 0.3, 1], (40, 3))


def field(obstacles, points=POINTS):
    potential, gradient, _, winding = field_at_points(
        build(messages.Scene(name="s", obstacles=obstacles)).tables, points
    )
    return potential, gradient, winding


def test_the_field_is_the_sum_of_the_obstacles():
    whole = field(OBSTACLES)
    parts = [field([obstacle]) for obstacle in OBSTACLES]
    for index in range(3):
        assert whole[index] == pytest.approx(sum(part[index] for part in parts), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("obstacle", OBSTACLES, ids=lambda obstacle: obstacle.name)
def test_charge_multiplies_the_field(obstacle):
    single, triple = msgspec.structs.replace(obstacle, charge=1.0), msgspec.structs.replace(obstacle, charge=3.0)
    assert field([triple])[0] == pytest.approx(3.0 * field([single])[0], rel=1e-12)


HUGE = box_mesh(200.0)


@pytest.mark.parametrize(
    ("message", "large"),
    [
        (messages.Box(name="b", size=(1.0, 100.5, 1.0)), "100.5 m"),
        (messages.Sphere(name="b", radius=60.0), "120 m"),
        (messages.Cylinder(name="b", radius=1.0, length=600.0), "600 m"),
        (messages.Capsule(name="b", radius=80.0, length=1.0), "160 m"),
        (mesh_message(*HUGE, name="b"), "200 m"),
        (messages.PointCloud(name="b", points=[(0.0, 0.0, 0.0), (0.0, -350.0, 0.0)], radius=1.0), "350 m"),
        (messages.Polygon(name="b", vertices=[(0.0, 0.0, 0.0), (150.0, 0.0, 0.0), (0.0, 1.0, 0.0)]), "150 m"),
        (messages.Box(name="b", size=(100.0, 100.0, 100.0), position=(300.0, 0.0, 0.0)), None),
        (messages.HalfSpace(name="b", normal=(0.0, 0.0, 1.0), offset=-500.0), None),
    ],
)
def test_an_obstacle_in_millimetres_is_told(message: messages.Obstacle, large: str | None) -> None:
    told = [warning for warning in build(messages.Scene(name="s", obstacles=[message])).warnings if "large" in warning]
    wanted = [f"obstacle 'b' is {large} large: are its numbers millimetres? Lengths are in metres"] if large else []
    assert told == wanted


def test_a_fault_names_its_place_in_the_scene():
    bad = messages.Polygon(name="bent", vertices=[(0, 0, 0), (1, 0, 0), (1, 1, 1), (0, 1, 0)])
    with pytest.raises(SceneInvalid) as caught:
        build(messages.Scene(name="s", obstacles=[*OBSTACLES, bad]))
    assert caught.value.details["path"] == "$.obstacles[7].vertices"
    plane = messages.GuidePlane(name="GP", vertices=[(0, 0, 0), (1, 0, 0), (2, 0, 0)])
    with pytest.raises(SceneInvalid) as caught:
        build(messages.Scene(name="s", guide_planes=[plane]))
    assert caught.value.details["guide_plane"] == "GP"


@pytest.mark.parametrize("trajectory", [None, messages.ObstacleTrajectory([0.0, 1.0], [Placement(), Placement()])])
def test_a_scene_goes_with_its_last_user(trajectory: messages.ObstacleTrajectory | None) -> None:
    """Of a million points that move each scene kept 1.6 GB until the collector came by."""
    box = messages.Box(name="box", size=(0.1, 0.1, 0.1), trajectory=trajectory)
    scene = build(messages.Scene("s", obstacles=[box]))
    held = scene.at(0.5)
    assert [one.resting.moves for one in (scene, held)] == [False, False]
    gone = [weakref.ref(one) for one in (scene, held)]
    gc.disable()
    try:
        del scene, held
        assert [one() for one in gone] == [None, None]
    finally:
        gc.enable()


def scan(name: str, count: int) -> messages.Scene:
    points = Float32Array(np.random.default_rng(count).uniform(size=(count, 3)).astype("<f4").tobytes())
    return messages.Scene(name=name, obstacles=[messages.PointCloud(name=name, points=points, radius=0.01)])


def test_the_last_scenes_are_kept_by_content() -> None:
    kept = BuiltScenes(Limit(2, 2**29))
    first = kept.of(messages.Scene(name="a"))
    assert kept.of(messages.Scene(name="a")) is first
    kept.of(messages.Scene(name="b"))
    kept.of(messages.Scene(name="a"))
    kept.of(messages.Scene(name="c"))
    assert kept.of(messages.Scene(name="a")) is first


def test_a_scene_of_very_many_changes_is_built_though_all_before_are_held() -> None:
    """Each was found from the one before it: of 1000 that somebody held that was too deep."""
    kept, held = (
        BuiltScenes(Limit(2, 2**29)),
        [freeze(messages.Scene(name="a", obstacles=[messages.Sphere(name="b", radius=0.5)]))],
    )
    kept.of(held[0])
    for k in range(1, 3001):
        held.append(apply_change(held[-1], SceneDiff(move={"b": Placement((float(k), 0.0, 0.0))})))
    assert kept.of(held[-1]).obstacles[0].placement.translation.tolist() == [3000.0, 0.0, 0.0]
    assert kept.of(held[-1]) is kept.of(held[-1])


def test_large_clouds_are_kept_only_as_long_as_memory_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    memory = 1000 * BYTES_PER_FACE
    monkeypatch.setattr(obstacle, "_KNOWN", BoundedMap(Limit(512, memory)))
    kept = BuiltScenes(Limit(16, memory))
    small, large = kept.of(scan("small", 300)), kept.of(scan("large", 600))
    assert kept.of(scan("small", 300)) is small
    assert kept.of(scan("larger", 650)) is not None  # no room for the one that was asked for least
    assert kept.of(scan("small", 300)) is small
    assert kept.of(scan("large", 600)) is not large
    assert 0 < obstacle._KNOWN.size <= memory
    assert kept.of(scan("huge", 5000)) is kept.of(scan("huge", 5000))  # one at least


def test_a_large_scene_whose_time_is_up_is_not_even_hashed(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [(float(i), 0.0, 0.0) for i in range(1000)]
    cloud = messages.PointCloud(name="cloud", points=points, radius=0.1)
    monkeypatch.setattr(scenes, "scene_content", lambda *_: pytest.fail("there is no time"))
    with pytest.raises(DeadlineExpired, match="scene large"):
        BuiltScenes(Limit(2, 2**29)).of(messages.Scene(name="large", obstacles=[cloud]), Deadline(0.0))
