"""Obstacles found by their place are those that going through all of them finds; pairs are counted without a gap."""

import numpy as np
import pytest

from guidefield.collision.clearance import clearance_at
from guidefield.messages import scene as messages
from tests.collision.listed import touching
from tests.collision.scenery import box, world_of
from tests.collision.test_world import pair_distances
from tests.robots import group

FLOOR = messages.HalfSpace(name="floor", normal=(0.1, 0.0, 1.0), offset=-0.4)


@pytest.mark.parametrize("seed", range(3))
def test_among_hundreds_of_obstacles_answers_are_those_of_all_pairs(seed):
    rng = np.random.default_rng(seed)
    crumbs = [
        box(f"c{k}", rng.uniform(0.01, 0.03, 3), p) for k, p in enumerate(rng.uniform(-1.2, 1.2, (400, 3)).tolist())
    ]
    world = world_of(group("panda"), [*crumbs, FLOOR], [("panda_link3", "c7"), ("panda_hand", "floor")])
    for _ in range(4):
        q = world.group.expand(world.group.random(rng))
        expected = touching(world, q)
        assert [k for k in world.near(q) if world.touches(k)] == expected
        assert world.in_collision(q) == bool(expected)
        distances = pair_distances(world, q)
        assert clearance_at(world, q).obstacle_distance == pytest.approx(
            distances[world.pairs.n_self :].min(), abs=2e-6
        )
