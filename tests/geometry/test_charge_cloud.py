import math

import numpy as np
import pytest

from guidefield.geometry.charged import field_tables
from guidefield.kernels.field.field import field_at_points
from guidefield.scene.cloud import cloud_rows

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
