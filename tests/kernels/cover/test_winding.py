"""Winding numbers against NumPy's solid angles."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.kernels.cover.winding import winding_by_angles
from tests.geometry import solids

MESHES = {"ring": solids.torus(), "hollow": solids.hollow(), "overlapping": solids.overlapping(), "open": solids.bowl()}


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_it_is_the_sum_of_the_solid_angles(mesh: solids.Mesh) -> None:
    points = solids.in_box_of(mesh, 100, np.random.default_rng(0))
    found = [winding_by_angles(*point, *map(np.ascontiguousarray, mesh)) for point in points.tolist()]
    np.testing.assert_allclose(found, solids.winding(points, mesh), atol=1e-9)
