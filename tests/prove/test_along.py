"""The smallest distances by kernels: against Coal's search along the same motions, and Coal at the same times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.clearance import clearance_at
from guidefield.collision.lanes import scene_tables
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.geometry import cache
from guidefield.kernels.jit.cache import cache_folder
from guidefield.messages import scene as messages
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.prove import by_kernels as kernel_search, nearest
from guidefield.prove.along import Along, smallest_along
from guidefield.prove.by_coal import ByCoal
from guidefield.prove.places import Surveyor
from guidefield.prove.smallest import TOLERANCE, Smallest
from guidefield.robot.group.reduced_model import select
from tests.collision.scenery import scattered, world_of
from tests.collision.test_motion_bound import ARMS, world
from tests.geometry import solids
from tests.planner.problems import library_scene, scene_of
from tests.planner.test_moving_kinds import KINDS, moving
from tests.prove.test_smallest import at, found_along, motion, plain_distance, surveyor_of
from tests.robots import group, robot
from tests.scene.solids import mesh_message

ACCURACY = 1e-5
"""How far a distance by kernels may be from Coal's [m]."""

SPAN = (0.25, 2.1)


@pytest.fixture
def without_coal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only kernels answer."""

    def refuse(*_: object) -> None:
        raise AssertionError("Coal was asked")

    monkeypatch.setattr(ByCoal, "obstacles", refuse)
    monkeypatch.setattr(ByCoal, "own", refuse)


def by_kernels(place: World, trajectory: Trajectory, times: Sequence[float] | None = None) -> Along:
    ends = (0.0, trajectory.duration)
    asked = np.linspace(*ends, 12) if times is None else np.array(times)
    return smallest_along(surveyor_of(place, trajectory), asked, [ends, SPAN])


def agree(place: World, trajectory: Trajectory, found: Along, by_coal: list[Smallest]) -> None:
    """What is told is attained, and no more than both tolerances from what Coal finds."""
    for mine, other in zip((*found.obstacle, found.own), by_coal, strict=True):
        assert mine.distance == pytest.approx(other.distance, abs=TOLERANCE + ACCURACY)
        assert mine.bound == mine.distance - TOLERANCE
        if mine.pair >= 0:
            assert plain_distance(place, trajectory, mine) == pytest.approx(mine.distance, abs=ACCURACY)
    times = np.linspace(0.0, trajectory.duration, 12)
    sampled = [clearance_at(place, at(place.group, trajectory, time)).obstacle_distance for time in times]
    np.testing.assert_allclose(found.distances, sampled, atol=ACCURACY)


def apart(by_coal: list[Smallest]) -> bool:
    return all(found.distance > 1e-4 for found in by_coal)


def apart_at_samples(place: World, trajectory: Trajectory) -> bool:
    times = np.linspace(0.0, trajectory.duration, 25)
    found = [clearance_at(place, at(place.group, trajectory, time)) for time in times]
    return all(min(one.obstacle_distance, one.self_distance) > 1e-4 for one in found)


def clear_motion(place: World, reach: float) -> tuple[Trajectory, list[Smallest]]:
    """A random motion along which nothing touches, and what Coal finds along it."""
    for seed in range(200):
        trajectory = motion(place.group, seed, reach)
        if apart_at_samples(place, trajectory) and apart(by_coal := found_along(place, trajectory, SPAN)):
            return trajectory, by_coal
    raise AssertionError("no motion is clear")


@settings(deadline=None, max_examples=12)
@given(st.sampled_from(sorted(ARMS)), st.integers(0, 10**6))
def test_kernels_find_what_coal_finds_for_joints_of_every_kind(name: str, seed: int) -> None:
    place = world(name)
    trajectory = motion(place.group, seed, 0.3)
    found, by_coal = by_kernels(place, trajectory), found_along(place, trajectory, SPAN)
    if apart(by_coal):
        agree(place, trajectory, found, by_coal)


@pytest.mark.parametrize(("name", "scene"), [("panda", "bookshelf"), ("ur5", "wall_with_window")])
@pytest.mark.usefixtures("without_coal")
def test_kernels_find_what_coal_finds_of_meshes(name: str, scene: str) -> None:
    place = World.build(group(name), library_scene(scene))
    trajectory, by_coal = clear_motion(place, 0.15)
    agree(place, trajectory, by_kernels(place, trajectory), by_coal)


@pytest.mark.parametrize("name", ["panda", "ur5"])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.usefixtures("without_coal")
def test_closed_meshes_whose_large_nodes_have_boxes_are_measured(
    name: str, seed: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    ring = solids.lying(solids.torus(rng.uniform(0.5, 1.2), rng.uniform(0.02, 0.1), 120, 24), seed)
    thin = solids.lying(solids.torus(0.4, 0.002, 90, 8), seed + 3)
    place = World.build(group(name), scene_of(mesh_message(*ring, name="r"), mesh_message(*thin, name="t")))
    trajectory, by_coal = clear_motion(place, 0.15)
    without = by_kernels(place, trajectory)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache_folder().parents[1]))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(cache, "LARGE", 1)
    monkeypatch.setattr(scene_tables, "MOST_TRIANGLES", 500)
    place = World.build(
        group(name), scene_of(mesh_message(*ring, name=f"{name} r"), mesh_message(*thin, name=f"{name} t"))
    )
    found = by_kernels(place, trajectory)
    assert list(cache.folder().glob("lanes-*")), "they count as large"
    agree(place, trajectory, found, by_coal)
    for one, other in zip(without.obstacle, found.obstacle, strict=True):
        assert one.distance == pytest.approx(other.distance, abs=ACCURACY)


@pytest.mark.usefixtures("without_coal")
def test_obstacles_of_every_kind_that_rests_are_measured() -> None:
    rng = np.random.default_rng(4)
    ground = messages.HalfSpace(name="ground", normal=(0.0, 0.0, 1.0), offset=-0.4)
    roof = messages.Polygon(
        name="roof", vertices=[(-1.0, -1.0, 1.6), (1.0, -1.0, 1.6), (1.0, 1.0, 1.5), (-1.0, 1.0, 1.5)]
    )
    corners = [(0.9, y, z) for y in (-0.4, 0.4) for z in (0.1, 0.9)] + [(1.2, 0.0, 0.5)]
    faces = [(0, 1, 2), (1, 3, 2), (0, 2, 4), (2, 3, 4), (3, 1, 4), (1, 0, 4)]
    wedge = messages.Mesh(name="wedge", vertices=corners, triangles=faces)
    place = World.build(group("panda"), scene_of(ground, roof, wedge, *scattered(rng, 3)))
    trajectory, by_coal = clear_motion(place, 0.1)
    agree(place, trajectory, by_kernels(place, trajectory), by_coal)


@pytest.mark.parametrize("name", ["panda", "ur5"])
@pytest.mark.parametrize("count", [1, 3, 40, 3000])
@pytest.mark.usefixtures("without_coal")
def test_clouds_are_measured_as_balls_about_their_points(name: str, count: int) -> None:
    rng = np.random.default_rng(count)
    points = rng.uniform(-1.0, 1.0, (count, 3)) * [1.0, 1.0, 0.05] + [0.0, 0.0, 1.5]
    points[: count // 2, 2] -= 2.0
    cloud = messages.PointCloud(name="cloud", points=[*map(tuple, points.tolist())], radius=0.013)
    place = World.build(group(name), scene_of(cloud, *scattered(rng, 1)))
    trajectory, by_coal = clear_motion(place, 0.15)
    agree(place, trajectory, by_kernels(place, trajectory), by_coal)


def test_a_hull_that_is_kilometres_away_is_measured_to_the_same_accuracy() -> None:
    """The kernels know its corners in float32, a tenth of a millimetre apart there; found by tools/doubt."""
    panda, stand = robot("panda"), np.array([-6282.3057, 4235.955, -11033.1812])
    arm = select(panda, None, None, panda.rest, pin.SE3(np.eye(3), stand))
    corners = np.array([(x, y, z) for x in (0.7, 1.1) for y in (-0.3, 0.4) for z in (0.1, 0.8)]) + stand
    faces = [(0, 1, 3), (0, 3, 2), (4, 7, 5), (4, 6, 7), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6)]
    faces += [(0, 6, 4), (1, 5, 7), (1, 7, 3)]
    block = messages.Mesh(name="block", vertices=[tuple(corner) for corner in corners.tolist()], triangles=faces)
    place = World.build(arm, scene_of(block))
    trajectory, by_coal = clear_motion(place, 0.1)
    agree(place, trajectory, by_kernels(place, trajectory), by_coal)


@pytest.mark.parametrize("chosen", [False, True], ids=["among all", "among the nearest"])
@pytest.mark.parametrize("kind", KINDS)
def test_among_what_moves_too_answers_are_those_of_coal_alone(
    kind: str, chosen: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm, rng = group("panda"), np.random.default_rng(KINDS.index(kind))
    rest = scattered(rng, 4)
    trajectory, _ = clear_motion(World.build(arm, scene_of(*rest)), 0.3)
    place = World.build(arm, scene_of(*rest[:2], moving(kind, kind, rng), *rest[2:]))
    surveyor, times = surveyor_of(place, trajectory), np.linspace(0.0, trajectory.duration, 12)
    if chosen:
        monkeypatch.setattr(nearest, "FEW", 0)
        surveyor = Surveyor(nearest.with_nearest(surveyor.worlds, surveyor.curve, times), surveyor.curve)
    spans = [(0.0, trajectory.duration), SPAN]
    found = smallest_along(surveyor, times, spans)
    monkeypatch.setattr(kernel_search, "is_served", lambda _: False)
    by_coal = smallest_along(surveyor, times, spans)
    for mine, other in zip((*found.obstacle, found.own), (*by_coal.obstacle, by_coal.own), strict=True):
        assert mine.distance == pytest.approx(other.distance, abs=TOLERANCE + ACCURACY)
        assert mine.distance - TOLERANCE - 1e-12 <= mine.bound <= other.distance
        if abs(mine.distance - other.distance) < ACCURACY:
            assert mine.pair == other.pair or mine.time != other.time
    np.testing.assert_allclose(found.distances, by_coal.distances, atol=ACCURACY)


def test_how_deep_bodies_are_in_each_other_is_coals_to_tell() -> None:
    place = world_of(group("panda"), [])
    trajectory = motion(place.group, 0)
    touching = next(
        seed for seed in range(100) if found_along(place, motion(place.group, seed), SPAN)[2].distance <= 0.0
    )
    trajectory = motion(place.group, touching)
    found, by_coal = by_kernels(place, trajectory), found_along(place, trajectory, SPAN)
    assert found.own.distance <= 0.0
    assert found.own.distance == pytest.approx(by_coal[2].distance, abs=TOLERANCE)
    assert found.obstacle[0] == Smallest() or np.isinf(found.obstacle[0].distance)


@pytest.mark.parametrize(("part", "other"), [("own", "obstacles"), ("obstacles", "own")])
def test_what_does_not_touch_is_measured_by_kernels_though_the_other_does(
    part: str, other: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    place, asked = world_of(group("panda"), scattered(np.random.default_rng(3), 3)), []
    for seed in range(200):
        trajectory = motion(place.group, seed)
        by_coal = found_along(place, trajectory, SPAN)
        touching = {"obstacles": by_coal[0].distance <= 0.0, "own": by_coal[2].distance <= 0.0}
        if touching[other] and not touching[part]:
            break
    for name in (part, other):
        search = getattr(ByCoal, name)
        monkeypatch.setattr(ByCoal, name, lambda self, name=name, search=search: asked.append(name) or search(self))
    found = by_kernels(place, trajectory)
    assert asked == [other]
    for mine, exact in zip((*found.obstacle, found.own), by_coal, strict=True):
        assert mine.distance == pytest.approx(exact.distance, abs=TOLERANCE + ACCURACY)


@pytest.mark.usefixtures("without_coal")
def test_a_search_that_is_stopped_tells_what_is_certain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel_search, "AT_ONCE", 4)
    place = World.build(group("panda"), library_scene("bookshelf"))
    trajectory, _ = clear_motion(place, 0.15)
    ends = (0.0, trajectory.duration)
    exact = by_kernels(place, trajectory).obstacle[0]
    bounds = []
    for patience in (0, 2, 5, 1000):
        left = iter(range(patience))
        deadline = Deadline(is_cancelled=lambda left=left: next(left, None) is None)
        found = smallest_along(surveyor_of(place, trajectory), np.array(ends), [ends], deadline)
        assert found.obstacle[0].bound <= exact.distance <= found.obstacle[0].distance + TOLERANCE
        bounds.append(found.obstacle[0].bound)
    assert bounds == sorted(bounds)
    assert bounds[0] < exact.distance - TOLERANCE
    assert bounds[-1] == pytest.approx(exact.distance - TOLERANCE, abs=TOLERANCE)
