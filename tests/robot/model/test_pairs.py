"""Pairs of links that always touch are left out: as Pinocchio says that tests all of them at all configurations."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from guidefield.robot.model import pairs
from guidefield.robot.model.pairs import scratch_space
from tests.robots import robot


@pytest.mark.parametrize("name", ["ur5"])
def test_the_pairs_that_always_touch_are_those_that_do_at_all_samples(name: str) -> None:
    model = robot(name)
    geometry = model.geometry.copy()
    geometry.removeAllCollisionPairs()
    geometry.addAllCollisionPairs()
    links = [model.link_of_geometry(index) for index in range(len(geometry.geometryObjects))]
    names = [frozenset((links[pair.first], links[pair.second])) for pair in geometry.collisionPairs]
    disabled = set(names[::7])
    found = pairs._shares_touching(model.model, geometry, model.joints, links, model.rest, disabled, model.size)
    data, geometry_data = model.model.createData(), scratch_space(geometry)
    for request in geometry_data.collisionRequests:
        request.security_margin = pairs.TOUCH_DISTANCE
    counts, rng = dict.fromkeys(names, 0), np.random.default_rng(0)
    for q in [
        model.rest,
        *(pairs.random_configuration(model.model, model.joints, rng, model.size) for _ in range(pairs.SAMPLES)),
    ]:
        pin.computeCollisions(model.model, data, geometry, geometry_data, q, False)
        results = zip(names, geometry_data.collisionResults, strict=True)
        for pair in {pair for pair, result in results if result.isCollision()}:
            counts[pair] += 1
    shares = {pair: count / (pairs.SAMPLES + 1) for pair, count in counts.items()}
    assert {pair for pair in shares if shares[pair] > pairs.ALWAYS_SHARE} == {
        pair for pair in found if found[pair] > pairs.ALWAYS_SHARE
    }
    assert any(share > pairs.ALWAYS_SHARE for share in shares.values())
    assert {pair: found.get(pair, 0.0) for pair in disabled} == {pair: shares[pair] for pair in disabled}
