import numpy as np
import pytest

from guidefield.geometry.solid import solid
from tests.geometry import solids

BODIES = {"box": solids.box((0.1, 0.2, 0.3)), "ring": solids.torus(), "channel": solids.channel()}


@pytest.mark.parametrize("far", [0.0, 1e3, 1e8])
@pytest.mark.parametrize("mesh", [*BODIES.values(), solids.overlapping(), solids.hollow()])
def test_what_is_known_of_a_point_changes_nothing_for_the_next(mesh: solids.Mesh, far: float) -> None:
    vertices, triangles = mesh
    body, rng = solid(far + vertices, triangles), np.random.default_rng(3)
    low, high = body.surface.vertices.min(axis=0), body.surface.vertices.max(axis=0)
    walk = rng.uniform(low, high) + np.cumsum(rng.normal(scale=0.02, size=(300, 3)), axis=0)
    points = np.vstack([walk, rng.uniform(low - 0.05, high + 0.05, (300, 3)), np.repeat(walk[:1], 3, axis=0)])
    for asked in (body.depths, body.distances):
        assert (asked(points) == np.concatenate([asked(point[None]) for point in points])).all()
