"""How often pairs of links touch: as Pinocchio says that tests all of them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from guidefield.robot.model import pairs
from guidefield.robot.model.scratch_space import scratch_space
from tests.robots import robot


@pytest.mark.parametrize("name", ["panda", "ur5", "baxter", "talos_reduced"])
def test_links_that_are_not_tested_do_not_touch(name: str) -> None:
    model = robot(name)
    geometry = model.geometry.copy()
    geometry.removeAllCollisionPairs()
    geometry.addAllCollisionPairs()
    data, geometry_data = model.model.createData(), scratch_space(geometry)
    for request in geometry_data.collisionRequests:
        request.security_margin = pairs.TOUCH
    near, rng = pairs._Near(geometry), np.random.default_rng(5)
    touching = tested = 0
    for _ in range(15):
        q = pairs._random_configuration(model.model, model.joints, rng)
        pin.computeCollisions(model.model, data, geometry, geometry_data, q, False)
        found = {k for k, result in enumerate(geometry_data.collisionResults) if result.isCollision()}
        looked_at = near(geometry_data)
        assert found <= set(looked_at)
        touching, tested = touching + len(found), tested + len(looked_at)
    assert touching > 10
    assert tested < 0.7 * 15 * len(geometry.collisionPairs)
