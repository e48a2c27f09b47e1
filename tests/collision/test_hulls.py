"""Hulls stand in for meshes: they contain them, and answers that begin with them are those of the meshes."""

import numpy as np
import pytest

from guidefield.collision.clearance import contacts_at
from tests.collision.listed import touching
from tests.collision.scenery import scattered, world_of
from tests.robots import group


@pytest.mark.parametrize("seed", range(3))
def test_contacts_are_those_of_the_meshes(seed):
    arm, rng = group("ur5"), np.random.default_rng(seed)
    world = world_of(arm, scattered(rng, 12))
    seen = 0
    for _ in range(15):
        q = arm.random(rng)
        expected = [world.pair_names(k) for k in touching(world, arm.expand(q))]
        assert [contact.pair for contact in contacts_at(world, q)] == expected
        seen += len(expected)
    assert seen
