"""Measured among the obstacles that can be nearest alone, distances are those among all."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.collision.clearance import clearance_at
from guidefield.prove.curve import Curve
from guidefield.prove.nearest import FEW, with_nearest
from guidefield.prove.timed_world import TimedWorld
from tests.collision.scenery import box, world_of
from tests.robots import group, rest


@pytest.mark.parametrize("seed", range(4))
def test_what_is_nearest_anywhere_is_among_those_that_are_measured(seed: int) -> None:
    rng, arm = np.random.default_rng(seed), group("panda")
    places = rng.uniform(-1.5, 1.5, (FEW + 150, 3)).tolist()
    crumbs = [box(f"c{k}", rng.uniform(0.01, 0.05, 3), place) for k, place in enumerate(places)]
    world = world_of(arm, crumbs, [("panda_link3", "c7"), ("panda_hand", "c9")])
    worlds = TimedWorld.of(world, world)
    controls = rest(arm) + np.cumsum(rng.uniform(-0.2, 0.2, (7, 7)), axis=0)
    curve = Curve(np.array([controls[:4], controls[3:]]), np.array([0.0, 0.8, 1.7]))
    among = with_nearest(worlds, curve, np.linspace(0.0, 1.7, 9)).moving
    assert len(among.scene.obstacles) < len(crumbs)
    for z in curve.at(rng.uniform(0.0, 1.7, 25))[0]:
        of_all, of_some = (clearance_at(one, arm.expand_from_chart(z)) for one in (world, among))
        assert of_all.obstacle_distance == of_some.obstacle_distance
        assert of_all.obstacle_pair == of_some.obstacle_pair


def test_few_obstacles_are_measured_all() -> None:
    world = world_of(group("panda"), [box("far", (0.1, 0.1, 0.1), (9.0, 0.0, 0.0))])
    worlds = TimedWorld.of(world, world)
    pieces = np.array([[rest(world.group), rest(world.group) + 0.1]])
    assert with_nearest(worlds, Curve(pieces, np.array([0.0, 1.0])), np.array([0.0, 1.0])) is worlds


def test_without_pairs_with_obstacles_nothing_is_measured() -> None:
    arm = group("panda")
    crumbs = [box(f"c{k}", (0.1, 0.1, 0.1), (2.0 + 0.3 * k, 0.0, 0.0)) for k in range(FEW + 1)]
    allowed = [(link, crumb.name) for link in arm.robot.links for crumb in crumbs]
    world = world_of(arm, crumbs, allowed)
    assert len(world.pairs) == world.pairs.n_self
    pieces = np.array([[rest(arm), rest(arm) + 0.1]])
    among = with_nearest(TimedWorld.of(world, world), Curve(pieces, np.array([0.0, 1.0])), np.array([0.0, 1.0]))
    assert len(among.moving.scene.obstacles) == 0
