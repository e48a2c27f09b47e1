"""Links that repel each other are apart at rest, and distances to links are Coal's."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.kernels.distance.distance import DistanceTables, distance_at_points
from guidefield.robot.link_charges import ALWAYS_CLOSE, link_bodies, robot_charges
from guidefield.robot.model.model import RobotModel
from tests.robots import ARMS, robot


def gap(model: RobotModel, placements: list[pin.SE3], i: int, j: int) -> float:
    """Smallest distance from the points of one shape to the capsule of another one [m]."""
    charged = robot_charges(model).shapes
    points, capsule = charged[i].points, charged[j].capsule
    p0, p1 = (placements[j].act(np.asarray(end)) for end in (capsule.p0, capsule.p1))
    least = np.inf
    for point in points:
        there = placements[i].act(point)
        share = np.clip((there - p0) @ (p1 - p0) / max((p1 - p0) @ (p1 - p0), 1e-30), 0.0, 1.0)
        least = min(least, float(np.linalg.norm(there - p0 - share * (p1 - p0))))
    return least - capsule.radius


@pytest.mark.parametrize("name", ["panda", "ur5", "chain_fixed_12x155_r22"])
def test_links_repel_that_are_apart_at_rest(name: str) -> None:
    model = robot(name)
    data, geometry_data = model.model.createData(), model.geometry.createData()
    pin.updateGeometryPlacements(model.model, data, model.geometry, geometry_data, model.rest)
    charged = robot_charges(model)
    expected = []
    for pair in model.geometry.collisionPairs:
        i, j = pair.first, pair.second
        radius = max(charged.shapes[i].capsule.radius, charged.shapes[j].capsule.radius)
        least = min(gap(model, geometry_data.oMg, i, j), gap(model, geometry_data.oMg, j, i))
        if abs(least - ALWAYS_CLOSE * radius) < 1e-9:
            pytest.skip("a pair at the very bound")
        if least >= ALWAYS_CLOSE * radius:
            expected.append((i, j))
    assert list(charged.repelling) == expected
    assert expected


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
