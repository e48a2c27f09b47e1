"""Contacts of robots with themselves: as Pinocchio says that tests all pairs."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from guidefield.robot.model import pairs
from guidefield.robot.model.pairs import SelfContacts, scratch_space
from tests.robots import robot


@pytest.mark.parametrize("name", ["panda", "ur5", "baxter", "talos_reduced"])
@pytest.mark.parametrize("margin", [0.0, 0.02])
def test_contacts_are_those_of_all_pairs(name: str, margin: float) -> None:
    model = robot(name)
    geometry = model.geometry.copy()
    geometry.removeAllCollisionPairs()
    geometry.addAllCollisionPairs()
    data, geometry_data = model.model.createData(), scratch_space(geometry)
    for request in geometry_data.collisionRequests:
        request.security_margin = margin
    contacts, rng = SelfContacts(model.model, geometry), np.random.default_rng(5)
    touching = 0
    for _ in range(10):
        q = pairs.random_configuration(model.model, model.joints, rng, model.size)
        pin.computeCollisions(model.model, data, geometry, geometry_data, q, False)
        expected = {k for k, result in enumerate(geometry_data.collisionResults) if result.isCollision()}
        contacts.place(q)
        assert set(contacts.find_contacts(margin)) == expected
        touching += len(expected)
    assert touching > 10
    assert contacts.exact_tests < 0.6 * 10 * len(geometry.collisionPairs)
