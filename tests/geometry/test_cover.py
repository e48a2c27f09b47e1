"""Covers contain bodies and keep their overhang, by plain distances and dense sampling."""

import functools

import numpy as np
import pytest

from guidefield.geometry import surfaces
from guidefield.geometry.cover import Cover, cover
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
