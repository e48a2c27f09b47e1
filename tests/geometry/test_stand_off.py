from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry import surfaces
from guidefield.geometry.convex import convex_hull
from guidefield.geometry.solid import TOLERANCE, solid, stand_off
from guidefield.geometry.surfaces import Surface
from tests.geometry import solids


def of_hull(mesh: solids.Mesh, enough: float = np.inf) -> float:
    return stand_off(convex_hull(mesh[0]), solid(*mesh), enough)


@pytest.mark.parametrize(
    "mesh", [solids.box((0.1, 0.2, 0.3)), tuple(surfaces.sphere(0.1)), solids.lying(solids.box((1, 2, 3)))]
)
def test_the_hull_of_a_convex_body_does_not(mesh: solids.Mesh) -> None:
    assert of_hull(mesh) <= TOLERANCE * max(1.0, np.ptp(mesh[0], axis=0).max())


def test_known_stand_offs() -> None:
    # half of the channel's width, over the middle of its mouth: the walls' edges are the nearest
    assert 0.02 <= of_hull(solids.channel()) <= 0.02 + TOLERANCE
    # the disc over the hole of a ring
    assert of_hull(solids.torus(around=128, across=64)) == pytest.approx(np.hypot(0.1, 0.03) - 0.03, abs=4e-3)


@pytest.mark.parametrize("seed", range(2))
def test_no_point_of_the_hull_stands_off_more_and_one_stands_off_as_much(seed: int) -> None:
    mesh = solids.lying([solids.torus(), solids.channel(), solids.overlapping(), solids.hollow()][seed], seed)
    hull = convex_hull(mesh[0])
    points = solids.on_surface((hull.vertices, hull.triangles), 3_000, np.random.default_rng(seed))
    sampled = solids.distance(points, mesh).max()
    assert sampled - 1e-12 <= of_hull(mesh) <= sampled + TOLERANCE + 4e-3  # points stand so far from the deepest


def test_beyond_enough_it_is_only_said_that_it_is_more() -> None:
    assert of_hull(solids.channel(), 0.005) > 0.005
    assert of_hull(solids.box((0.1, 0.1, 0.1)), 0.005) <= TOLERANCE


def test_it_is_about_the_triangles_inside_too() -> None:
    around = solids.box((0.3, 0.3, 0.3))
    assert stand_off(Surface(*around), solid(*solids.box((0.1, 0.1, 0.1)))) == pytest.approx(
        np.sqrt(3.0) * 0.1, abs=TOLERANCE
    )


def test_what_is_inside_a_body_does_not_stand_off() -> None:
    outer, inner = solids.box((0.2, 0.2, 0.2)), solids.box((0.1, 0.1, 0.1), (0.06, 0.0, 0.0))
    # the inner one reaches 10 mm out of the outer
    assert stand_off(Surface(*inner), solid(*outer)) == pytest.approx(0.01, abs=TOLERANCE)
    # an open surface has no inside
    lidless = solid(outer[0], outer[1][2:])
    assert stand_off(Surface(*solids.box((0.1, 0.1, 0.1))), lidless) >= 0.05 - TOLERANCE
