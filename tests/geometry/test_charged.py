from fractions import Fraction

import numpy as np
import pytest

from guidefield.geometry.charged import field_tables
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
