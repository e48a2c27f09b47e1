"""Covers and inner balls, of solids and primitives: they contain or are within, and keep their overhang."""

import functools
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.geometry import surfaces
from guidefield.geometry.cover import Cover, cover
from guidefield.geometry.primitive_covers import (
    cover_box,
    cover_capsule,
    cover_cylinder,
    cover_sphere,
    inner_balls,
    inner_box,
    inner_capsule,
    inner_cylinder,
    inner_sphere,
)
from guidefield.geometry.solid import solid
from tests.geometry import solids

ROUNDING = 1e-12

BODIES = {
    "box": (solids.lying(solids.box((0.05, 0.08, 0.12))), 0.01),
    "thin plate": (solids.box((0.1, 0.08, 0.001)), 0.01),
    "needle": (solids.box((0.2, 0.002, 0.003)), 0.01),
    "ring": (solids.lying(solids.torus()), 0.01),
    "channel": (solids.channel(), 0.008),
    "hollow": (solids.hollow(), 0.02),
    "overlapping": (solids.overlapping(), 0.01),
    "inside out": (solids.turned(solids.channel()), 0.015),
    "cracked": (solids.cracked(), 0.01),
    "large overhang": (solids.box((0.05, 0.08, 0.12)), 0.3),
    "fine mesh": (tuple(surfaces.sphere(0.05, 3)), 0.01),
    "bowl": (solids.lying(solids.bowl()), 0.015),
    "two-sided sheet": (solids.together(solids.bowl(), solids.turned(solids.bowl())), 0.015),
}

bodies = pytest.mark.parametrize("name", BODIES)


@functools.cache
def covered(name: str) -> tuple[solids.Mesh, float, Cover]:
    mesh, delta = BODIES[name]
    return mesh, delta, cover(solid(*mesh, widest_gap=0.02), delta)


@bodies
def test_the_surface_is_contained(name: str) -> None:
    mesh, _, balls = covered(name)
    points = solids.on_surface(mesh, 800, np.random.default_rng(0))
    assert solids.in_balls(points, balls.spheres).all()


@bodies
def test_the_inside_is_contained(name: str) -> None:
    mesh, _, balls = covered(name)
    points = solids.in_box_of(mesh, 800, np.random.default_rng(1))
    inside = points[np.abs(solids.winding(points, mesh)) > 0.5]
    if name not in ("bowl", "two-sided sheet"):
        assert len(inside) > 50
        assert solids.in_balls(inside, balls.spheres).all()


@bodies
def test_no_ball_leaves_the_body_by_more_than_said(name: str) -> None:
    mesh, delta, balls = covered(name)
    assert balls.overhang <= delta
    points = solids.around(balls.spheres, max(10, 200 // len(balls.spheres)), np.random.default_rng(2))
    flat = points.reshape(-1, 3)
    beyond = np.where(np.abs(solids.winding(flat, mesh)) > 0.5, 0.0, solids.distance(flat, mesh))
    if name == "cracked":
        # a lid may lie off the surface; the overhang is over the closed surface, here a little less than a ball
        beyond = np.maximum(np.linalg.norm(flat, axis=1) - 0.06, 0.0)
    assert (beyond.reshape(len(balls.spheres), -1).max(axis=1) <= balls.overhangs + ROUNDING).all()


@bodies
def test_levels_above_contain_what_is_below(name: str) -> None:
    mesh, _, balls = covered(name)
    assert balls.first[0] == 0
    assert balls.first[-1] == len(balls.spheres)
    assert (np.diff(balls.first) >= 1).all()
    assert (np.diff(balls.first) <= 8).all()
    for group, (first, last) in zip(balls.groups, zip(balls.first, balls.first[1:], strict=False), strict=True):
        own = balls.spheres[first:last]
        assert (np.linalg.norm(own[:, :3] - group[:3], axis=1) + own[:, 3] <= group[3] + ROUNDING).all()
    assert (np.linalg.norm(mesh[0][mesh[1]] - balls.bound[:3], axis=2) <= balls.bound[3]).all()


def test_what_takes_too_many_balls_is_refused() -> None:
    with pytest.raises(ValueError, match="too many balls"):
        cover(solid(*solids.box((10.0, 10.0, 10.0))), 0.001)


HOLDING = {
    "box": solids.lying(solids.box((0.05, 0.08, 0.12))),
    "ring": solids.lying(solids.torus()),
    "channel": solids.channel(),
    "hollow": solids.hollow(),
    "overlapping": solids.overlapping(),
    "inside out": solids.turned(solids.channel()),
}


@pytest.mark.parametrize("name", HOLDING)
def test_balls_are_inside_and_fill_much(name: str) -> None:
    mesh = HOLDING[name]
    balls = inner_balls(solid(*mesh))
    assert 4 <= len(balls) <= 8
    assert not balls.flags.writeable
    assert (np.abs(solids.winding(balls[:, :3], mesh)) > 0.5).all()
    rng = np.random.default_rng(0)
    on_balls = solids.around(balls, 100, rng).reshape(-1, 3)
    assert (np.abs(solids.winding(on_balls, mesh)) > 0.5).all()
    points = solids.in_box_of(mesh, 1500, rng)
    inside = points[np.abs(solids.winding(points, mesh)) > 0.5]
    assert solids.in_balls(inside, balls).mean() > (0.4 if name == "ring" else 0.2)


@pytest.mark.parametrize("mesh", [solids.torus(), solids.channel(), solids.hollow()], ids=["ring", "channel", "hollow"])
def test_balls_are_as_far_from_the_surface_as_they_are_large(mesh: solids.Mesh) -> None:
    balls = inner_balls(solid(*mesh))
    assert (balls[:, 3] < solids.distance(balls[:, :3], mesh)).all()


@pytest.mark.parametrize(
    "mesh",
    [solids.bowl(), solids.cracked(), solids.together(solids.bowl(), solids.turned(solids.bowl()))],
    ids=["open", "cracked", "sheet"],
)
def test_there_are_none_where_nothing_is_known_to_be_inside(mesh: solids.Mesh) -> None:
    assert inner_balls(solid(*mesh, widest_gap=0.02)).shape == (0, 4)


Depth = Callable[[np.ndarray], np.ndarray]


def box_depth(size: np.ndarray) -> Depth:
    def depth(points: np.ndarray) -> np.ndarray:
        gaps = np.abs(points) - 0.5 * size
        return np.where((gaps <= 0).all(axis=1), -gaps.max(axis=1), -np.linalg.norm(np.maximum(gaps, 0), axis=1))

    return depth


def cylinder_depth(radius: float, length: float) -> Depth:
    def depth(points: np.ndarray) -> np.ndarray:
        gaps = np.column_stack([np.hypot(points[:, 0], points[:, 1]) - radius, np.abs(points[:, 2]) - 0.5 * length])
        return np.where((gaps <= 0).all(axis=1), -gaps.max(axis=1), -np.linalg.norm(np.maximum(gaps, 0), axis=1))

    return depth


def capsule_depth(radius: float, length: float) -> Depth:
    def depth(points: np.ndarray) -> np.ndarray:
        beyond = np.abs(points[:, 2]) - 0.5 * length
        return radius - np.hypot(np.hypot(points[:, 0], points[:, 1]), np.maximum(beyond, 0.0))

    return depth


def check_cover(found: Cover, depth: Depth, delta: float, reach: np.ndarray, seed: int = 0) -> None:
    """Contained by dense sampling, also next to the surface; overhang by sampling the balls' surfaces."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-reach, reach, (6000, 3))
    edges = np.where(rng.random((3000, 3)) < 0.6, np.sign(rng.normal(size=(3000, 3))) * reach, points[:3000])
    points = np.vstack([points, edges])
    points = points[depth(points) >= -1e-15]
    assert len(points) > 50
    assert solids.in_balls(points, found.spheres).all()
    assert found.overhang <= delta + 1e-9
    outside = solids.around(found.spheres, 40, rng)
    beyond = np.maximum(-depth(outside.reshape(-1, 3)), 0.0).reshape(len(found.spheres), -1).max(axis=1)
    assert (beyond <= found.overhangs + 1e-9).all()
    assert (np.linalg.norm(points - found.bound[:3], axis=1) <= found.bound[3]).all()


def check_inner(balls: np.ndarray, depth: Depth) -> None:
    assert len(balls) <= 8
    if len(balls):
        assert (balls[:, 3] > 0.0).all()
        assert (balls[:, 3] <= depth(balls[:, :3]) + 1e-12).all()


sizes = st.floats(0.002, 0.25)
deltas = st.floats(0.008, 0.05)


@settings(max_examples=9)
@given(sizes, sizes, sizes, deltas)
def test_boxes(x: float, y: float, z: float, delta: float) -> None:
    size = np.array([x, y, z])
    check_cover(cover_box(size, delta), box_depth(size), delta, 0.5 * size)
    check_inner(inner_box(size), box_depth(size))


@settings(max_examples=15)
@given(st.floats(0.002, 0.12), sizes, deltas)
def test_cylinders(radius: float, length: float, delta: float) -> None:
    reach = np.array([radius, radius, 0.5 * length])
    check_cover(cover_cylinder(radius, length, delta), cylinder_depth(radius, length), delta, reach)
    check_inner(inner_cylinder(radius, length), cylinder_depth(radius, length))


@settings(max_examples=12)
@given(st.floats(0.002, 0.3), st.floats(0.0, 1.0), deltas)
def test_capsules(radius: float, length: float, delta: float) -> None:
    reach = np.array([radius, radius, 0.5 * length + radius])
    check_cover(cover_capsule(radius, length, delta), capsule_depth(radius, length), delta, reach)
    check_inner(inner_capsule(radius, length), capsule_depth(radius, length))


def test_a_sphere_is_its_own_cover_and_nearly_its_own_inside() -> None:
    found, inner = cover_sphere(0.07), inner_sphere(0.07)
    assert found.spheres[0] == pytest.approx([0, 0, 0, 0.07], rel=1e-9)
    assert found.overhang < 1e-9
    assert inner[0] == pytest.approx([0, 0, 0, 0.07], abs=2e-6)
    assert inner[0, 3] < 0.07
