"""The scene as a whole: its field is the sum of its obstacles' fields."""

import gc
import weakref

import msgspec
import numpy as np
import pytest

from guidefield.errors import SceneInvalid
from guidefield.kernels.field.field import field_at_points
from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.scene.scene import build
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
