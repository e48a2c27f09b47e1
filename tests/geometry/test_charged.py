"""Charged points and clouds are the sheet; trees over everything charged are the sum over all of it."""

import math
from fractions import Fraction

import numpy as np
import pytest

from guidefield.geometry.charged import field_tables
from guidefield.geometry.far_tree import with_far_trees
from guidefield.kernels.field.field import exact, field_at_points
from guidefield.messages import scene as messages
from guidefield.potential import Precision, RobotField
from guidefield.scene.cloud import cloud_rows
from guidefield.scene.scene import Scene, build
from tests.oracles import EPS
from tests.robots import group, rest


@pytest.mark.skipif(np.finfo(np.longdouble).eps == EPS, reason="this machine has no extended precision")
@pytest.mark.parametrize("width", [1e-4, 1e-8, 1e-10])
def test_area_of_an_oblique_sliver_is_exact(width: float) -> None:
    turn = np.linalg.qr(np.array([[1.0, 2.0, 0.5], [0.3, -1.0, 2.0], [2.0, 0.1, 1.0]]))[0]
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.4, width, 0.0]]) @ turn.T
    a, b, c = ([Fraction(float(x)) for x in corner] for corner in corners)
    u, v = ([end[i] - a[i] for i in range(3)] for end in (b, c))
    cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    # A square root of a fraction, to more digits than a float has.
    exact = float(sum(x * x for x in cross) * Fraction(10) ** 60) ** 0.5 / 1e30
    assert field_tables(corners[None]).triangles[0, 6] == pytest.approx(2.0 * exact, rel=8 * EPS)


SPACING = 0.02
GRID = np.arange(-100, 101) * SPACING
SHEET = np.array([(x, y, 0.0) for x in GRID for y in GRID])
TABLES = field_tables(cloud=cloud_rows(SHEET, SPACING))


@pytest.mark.parametrize("heights", [1.0, 2.0, 4.0])
def test_from_a_spacing_on_it_is_the_sheet(heights: float) -> None:
    h = heights * SPACING
    points = np.array([[0.0, 0.0, h], [0.5 * SPACING, 0.3 * SPACING, h]])
    # The sheet ends 2 m away: that leaves out about 2 pi / 2.2 m.
    sheet = 2.0 * math.pi / h - 2.0 * math.pi / 2.2
    assert field_at_points(TABLES, points).potential == pytest.approx([sheet, sheet], rel=0.015)


def test_the_field_is_finite_and_high_in_the_middle_of_a_hole() -> None:
    middle = np.array([[0.5 * SPACING, 0.5 * SPACING, z] for z in np.linspace(-0.05, 0.05, 101)])
    potentials = field_at_points(TABLES, middle).potential
    assert potentials[50] == pytest.approx(16.5 / SPACING, rel=0.03)
    assert potentials.max() > 15.7 / SPACING


COUNT = 300


def quaternion(rng: np.random.Generator) -> tuple[float, float, float, float]:
    x, y, z, w = (made := rng.normal(size=4)) / np.linalg.norm(made)
    return x, y, z, w


def obstacle(kind: str, k: int, rng: np.random.Generator) -> messages.Obstacle:
    """One that stands somewhere within two metres, at least 0.3 m above the plane of the points."""
    x, y, z = rng.uniform((-2.0, -2.0, 0.3), 2.0).tolist()
    a, b, c = rng.uniform(0.01, 0.1, 3).tolist()
    at = {"name": f"{kind}{k}", "charge": rng.uniform(0.5, 2.0)}
    match kind:
        case "box":
            return messages.Box(size=(a, b, c), position=(x, y, z), quaternion_xyzw=quaternion(rng), **at)
        case "capsule":
            return messages.Capsule(radius=a, length=3 * b, position=(x, y, z), quaternion_xyzw=quaternion(rng), **at)
        case "polygon":
            corners = [(x, y, z), (x + a, y, z + b), (x + a, y + c, z), (x, y + c, z - b)][: 3 + k % 2]
            return messages.Polygon(vertices=corners, **at)
    raise AssertionError(kind)


def scene_of(*kinds: str) -> Scene:
    """Three hundred of each kind; a ball, a floor and a few points, which have no trees."""
    rng = np.random.default_rng(3)
    many = [obstacle(kind, k, rng) for kind in kinds for k in range(COUNT)]
    few = [
        messages.Sphere(name="ball", radius=0.1, position=(0.0, 0.0, -0.5)),
        messages.HalfSpace(name="floor", normal=(0.0, 0.0, 1.0), offset=-1.0),
        messages.PointCloud(name="cloud", points=[(0.5, 0.1 * k, -0.4) for k in range(5)], radius=0.01),
    ]
    return build(messages.Scene(name="many", obstacles=[*many, *few]))


@pytest.mark.parametrize("kinds", [("box",), ("capsule",), ("polygon",), ("box", "capsule", "polygon")], ids="-".join)
def test_the_field_is_that_of_all(kinds: tuple[str, ...]) -> None:
    tables = scene_of(*kinds).tables
    far = with_far_trees(tables)
    points = np.random.default_rng(4).uniform((-1.0, -1.0, -0.2), (1.0, 1.0, 0.2), (400, 3))
    direct, opened, found = (field_at_points(one, points) for one in (exact(tables), exact(far), far))
    np.testing.assert_allclose(opened.potential, direct.potential, rtol=1e-10)  # everything is below some leaf, once
    np.testing.assert_allclose(opened.gradient, direct.gradient, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(found.potential, direct.potential, rtol=1e-2)
    error = np.linalg.norm(found.gradient - direct.gradient, axis=1) / np.linalg.norm(direct.gradient, axis=1)
    assert np.quantile(error, 0.9) < 2e-2
    np.testing.assert_array_equal(np.round(found.winding), np.round(direct.winding))
    assert len(far.links) > COUNT
    assert len(tables.links) < len(far.links)


def test_a_robots_potential_is_that_of_single_precision() -> None:
    planned, scene = group("panda"), scene_of("box", "polygon")
    qs = np.array([rest(planned) + 0.1 * k for k in range(4)])
    coarse, single = (RobotField(planned, scene, one) for one in (Precision.COARSE, Precision.SINGLE))
    np.testing.assert_allclose(coarse.potentials(qs), single.potentials(qs), rtol=1e-2)
    np.testing.assert_allclose(coarse.evaluate(qs[0]).wrenches, single.evaluate(qs[0]).wrenches, atol=2e-2)
