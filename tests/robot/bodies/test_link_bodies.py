"""Links as bodies: distances to them are Coal's."""

from __future__ import annotations

import coal
import numpy as np
import pytest

from guidefield.kernels.distance.distance import DistanceTables, distance_at_points
from guidefield.robot.bodies.charges import link_bodies
from tests.robots import ARMS, robot


def alone(tables: DistanceTables, index: int) -> DistanceTables:
    """The tables of one body."""
    picked = {name: np.ascontiguousarray(getattr(tables, name)[[index]]) for name in tables._fields[:7]}
    for array in picked.values():
        array.setflags(write=False)
    return tables._replace(**picked)


@pytest.mark.parametrize("name", ARMS)
def test_distances_to_links_are_those_of_coal(name: str) -> None:
    model, tables = robot(name), link_bodies(robot(name))
    assert link_bodies(robot(name)) is tables
    assert len(tables.kinds) == model.geometry.ngeoms
    rng = np.random.default_rng(0)
    here = coal.Transform3s.Identity()
    for index, shape in enumerate(model.geometry.geometryObjects):
        low, high = tables.bounds[index, :3], tables.bounds[index, 3:]
        points = rng.uniform(low - 0.05, high + 0.05, (25, 3))
        distances, _, _ = distance_at_points(alone(tables, index), points)
        for point, distance in zip(points, distances, strict=True):
            at, result = coal.Transform3s(np.eye(3), point), coal.DistanceResult()
            expected = coal.distance(coal.Sphere(1e-9), at, shape.geometry, here, coal.DistanceRequest(), result) + 1e-9
            # of a mesh Coal knows no inside, and within a hull not always the least depth
            ours = abs(distance) if isinstance(shape.geometry, coal.BVHModelBase) else distance
            assert ours == pytest.approx(expected, abs=1e-6) or (expected < 0.0 and ours < 0.0)
