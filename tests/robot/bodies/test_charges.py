"""Links that repel each other are those whose surfaces are far enough apart at rest, whatever bounds say first."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from guidefield.robot.bodies.charges import ALWAYS_CLOSE, robot_charges
from guidefield.robot.model.model import RobotModel
from tests.robots import robot


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
