"""Clearance against Coal's distance of every pair, and against meshes without hulls."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.clearance import clearance_at
from tests.collision.listed import are_signed
from tests.collision.plain import panda_among
from tests.collision.scenery import box, panda_in, world_of
from tests.collision.test_world import SCENES, pair_distances
from tests.robots import group, random_configuration, rest

ACCURACY = 2e-6
"""Coal's, for distances of convex bodies."""

HULL = 5e-4
"""How far the Panda's hulls stand off its meshes at most, with what sampling misses."""


@settings(deadline=None, max_examples=18)
@given(st.sampled_from(SCENES), st.integers(0, 10**6))
def test_smallest_distances_are_those_of_all_pairs(name, seed):
    world = panda_in(name)
    q = random_configuration(world.group, seed)
    distances = pair_distances(world, q)
    distances[~are_signed(world)] = np.maximum(distances[~are_signed(world)], 0.0)
    at = clearance_at(world, q)
    assert at.self_distance == pytest.approx(distances[: world.pairs.n_self].min(), abs=ACCURACY)
    assert at.obstacle_distance == pytest.approx(distances[world.pairs.n_self :].min(), abs=ACCURACY)
    named = [k for k in range(world.pairs.n_self, len(world.pairs)) if world.pair_names(k) == at.obstacle_pair]
    assert distances[named].min() == pytest.approx(at.obstacle_distance, abs=ACCURACY)
    own = [k for k in range(world.pairs.n_self) if world.pair_names(k) == at.self_pair]
    assert distances[own].min() == pytest.approx(at.self_distance, abs=ACCURACY)


@pytest.mark.parametrize("seed", range(4))
def test_hulls_hide_no_mesh_that_is_closer(seed):
    world = world_of(group("ur5"), [box("shelf", (0.5, 0.5, 0.02), (0.4, 0.1, 0.5))])
    assert not are_signed(world).all()
    q = random_configuration(world.group, seed)
    distances = np.maximum(pair_distances(world, q), np.where(are_signed(world), -np.inf, 0.0))
    at = clearance_at(world, q)
    assert at.self_distance == pytest.approx(distances[: world.pairs.n_self].min(), abs=ACCURACY)
    assert at.obstacle_distance == pytest.approx(distances[world.pairs.n_self :].min(), abs=ACCURACY)


@settings(deadline=None, max_examples=12)
@given(st.integers(0, 10**6))
def test_witness_points_are_as_far_apart_as_the_distance(seed):
    world = panda_in("bookshelf")
    at = clearance_at(world, random_configuration(world.group, seed))
    if at.obstacle_distance > 1e-4:
        assert np.linalg.norm(at.witness[0] - at.witness[1]) == pytest.approx(at.obstacle_distance, abs=1e-5)
        obstacle = world.scene.obstacle(at.obstacle_pair[1])
        local = np.abs(obstacle.placement.actInv(at.witness[1]))
        assert (local <= 0.5 * (obstacle.shape.aabb_local.max_ - obstacle.shape.aabb_local.min_) + 1e-5).all()


def test_hulls_are_as_far_away_as_the_meshes():
    world = panda_in("bookshelf")
    plain = panda_among(world.scene.message.obstacles, finger=0.001)
    rng = np.random.default_rng(3)
    for q in [rest(world.group), *(rest(world.group) + rng.uniform(-0.4, 0.4, (12, 7)))]:
        distances = plain.distances(q)[plain.self_pairs :]
        if distances.min() > 0:
            assert 0 <= distances.min() - clearance_at(world, q).obstacle_distance + ACCURACY <= HULL
