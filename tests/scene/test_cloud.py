"""Point clouds: distances of the balls, bodies that contain them."""

import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import coal
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.geometry import surfaces
from guidefield.kernels.distance.distance import distance_at_points
from guidefield.messages import scene as messages
from guidefield.robot.link_charges import surface_points
from guidefield.scene.cloud import CORNERS, MOST_PLACES, Cloud, CloudTables, cloud_surface, covering, make_cloud_tables
from guidefield.scene.distance_tables import distance_tables
from guidefield.scene.obstacle import build
from guidefield.scene.scene import build as build_scene

LAWS = settings(deadline=None, max_examples=18)
RADIUS = 0.03
SOLID = surfaces.box((0.8, 0.6, 0.4))
SCAN = surface_points(SOLID.vertices, SOLID.triangles, 0.03).points


def cloud(points: np.ndarray, **more: float) -> messages.PointCloud:
    return messages.PointCloud(name="scan", points=[tuple(p) for p in points.tolist()], radius=RADIUS, **more)


@LAWS
@given(st.integers(1, 200), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_fewer_and_larger_balls_contain_those_of_a_cloud(count: int, most: int, seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(count, 3)) * [1.0, 0.3, 0.02]
    few = covering(Cloud(points, RADIUS), most)
    assert len(few.points) <= max(most, 1)
    away = np.linalg.norm(points[:, None] - few.points, axis=2).min(axis=1)
    assert (away + RADIUS <= few.radius + 1e-12).all()
    assert count > most or few.radius == RADIUS


@LAWS
@given(st.integers(0, 2**32 - 1))
def test_bodies_contain_the_balls_and_little_more(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-1.0, 1.0, 3)
    vertices, triangles = cloud_surface(np.array([[9.0, 9.0, 9.0], centre]), RADIUS)
    body = vertices[CORNERS:] - centre
    assert np.linalg.norm(body, axis=1) == pytest.approx(np.full(CORNERS, 1.2584 * RADIUS), rel=1e-4)
    a, b, c = vertices[triangles[20:]].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    heights = ((a - centre) * normals).sum(axis=1) / np.linalg.norm(normals, axis=1)
    assert heights == pytest.approx(np.full(20, RADIUS))


def test_coal_sees_the_points_and_is_told_their_radius() -> None:
    obstacle = build(cloud(SCAN), 0)
    assert obstacle.solid
    assert obstacle.rounding == RADIUS
    rng = np.random.default_rng(1)
    for point in rng.uniform(-1.0, 1.0, (40, 3)):
        there = coal.Transform3s(np.eye(3), point)
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        ours = coal.distance(obstacle.shape, coal.Transform3s.Identity(), coal.Sphere(1e-3), there, request, result)
        exact = float(np.linalg.norm(SCAN - point, axis=1).min())
        assert ours + 1e-3 == pytest.approx(exact, abs=1e-6)


def test_distances_are_those_of_the_balls() -> None:
    block = messages.Box(name="b", size=(0.1, 0.1, 0.1), position=(2.0, 0.0, 0.0))
    tables = distance_tables(build_scene(messages.Scene(name="s", obstacles=[block, cloud(SCAN[:50])])))
    assert len(tables.kinds) == 2
    points = np.random.default_rng(2).uniform(-1.0, 1.0, (60, 3))
    distances, away, owners = distance_at_points(tables, points)
    apart = points[:, None] - SCAN[:50]
    exact = np.linalg.norm(apart, axis=2)
    nearest = exact.argmin(axis=1)
    assert (owners == 1).all()
    assert distances == pytest.approx(exact.min(axis=1) - RADIUS, abs=1e-6)
    directions = apart[np.arange(60), nearest] / exact.min(axis=1)[:, None]
    assert away == pytest.approx(directions, abs=1e-6)
    assert np.isinf(distance_at_points(tables, points, 1e-3)[0]).sum() == (exact.min(axis=1) - RADIUS >= 1e-3).sum()


@pytest.mark.parametrize("far", [(1e3, 1e3, 1e3), (2e4, 2e4, 0.0), (1e9, 0.0, 0.0), (1e9, 1e9, 0.0), (1e9, 1e9, 1e9)])
def test_a_grid_has_no_more_cells_than_float32_counts(far: tuple[float, float, float]) -> None:
    """Also that of a flat or thin cloud, as a point far away makes of one."""
    points = np.array([np.zeros(3), far])
    made = make_cloud_tables(points, Cloud(points, RADIUS).box, RADIUS).tables
    assert len(made.cells) == made.columns * made.rows * made.layers <= MOST_PLACES
    sides = made.numbers[3] * np.array([made.columns, made.rows, made.layers])
    assert (sides >= 0.999 * np.array(far)).all()


def test_threads_that_ask_at_the_same_time_get_the_same_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    """Others keep the address of a cloud's tables alone: of two that were made, one would be gone."""
    made = []

    def make_slowly(*asked: Any) -> CloudTables:
        made.append(make_cloud_tables(*asked))
        time.sleep(0.05)
        return made[-1]

    monkeypatch.setattr("guidefield.scene.cloud.make_cloud_tables", make_slowly)
    seen = Cloud(SCAN, RADIUS)
    with ThreadPoolExecutor(4) as threads:
        told = list(threads.map(lambda _: seen.tables, range(4)))
    assert len(made) == 1
    assert all(one is made[0] for one in told)
