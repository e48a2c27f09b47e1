"""Charged points and clouds: they carry the area, and from a spacing on they are the sheet."""

import math
from fractions import Fraction

import numpy as np
import pytest

from guidefield.geometry.charged import field_tables
from guidefield.kernels.field.field import field_at_points
from guidefield.scene.cloud import cloud_rows
from tests.oracles import EPS


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
