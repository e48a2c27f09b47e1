from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.convex import convex_hull
from guidefield.geometry.solid import TOLERANCE, solid, stand_off
from tests.geometry import solids


def of_hull(mesh: solids.Mesh, enough: float = np.inf) -> float:
    return stand_off(convex_hull(mesh[0]), solid(*mesh), enough)


@pytest.mark.parametrize("seed", range(2))
def test_no_point_of_the_hull_stands_off_more_and_one_stands_off_as_much(seed: int) -> None:
    mesh = solids.lying([solids.torus(), solids.channel(), solids.overlapping(), solids.hollow()][seed], seed)
    hull = convex_hull(mesh[0])
    points = solids.on_surface((hull.vertices, hull.triangles), 3_000, np.random.default_rng(seed))
    sampled = solids.distance(points, mesh).max()
    assert sampled - 1e-12 <= of_hull(mesh) <= sampled + TOLERANCE + 4e-3  # points stand so far from the deepest
