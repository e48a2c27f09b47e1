"""What is met most often, counted by hand."""

import numpy as np
import pytest

from guidefield.collision.clearance import (
    blocking_pairs,
    contacts_among,
    contacts_at,
)
from tests.collision.scenery import box, world_of
from tests.robots import box_arm, grouped


@pytest.fixture(scope="module")
def world():
    boxes = [box("right", (0.05, 0.05, 0.05), (0.15, 0.0, 0.3)), box("left", (0.05, 0.05, 0.05), (-0.15, 0.0, 0.3))]
    return world_of(grouped(box_arm("y", 2)), boxes)


def test_pairs_are_counted_and_the_most_frequent_told(world):
    right, left, up = np.array([np.pi / 2, 0.0]), np.array([-np.pi / 2, 0.0]), np.zeros(2)
    met = blocking_pairs(world, [right, right, left, up])
    assert met.looked_at == 4
    assert met.counts[("l1", "right")] == 2
    assert met.counts[("l1", "left")] == 1
    assert next(iter(met.counts)) == ("l1", "right")
    assert met.describe().startswith("most often l1 and right, 2 of 4 times")
    details = met.details()
    assert details["pair"] == ["l1", "right"]
    assert details["depth"] == pytest.approx(
        max(c.depth for c in contacts_at(world, right) if c.pair == ("l1", "right"))
    )
    assert details["counts"] == sorted(details["counts"], reverse=True)


def test_many_configurations_are_told_as_each_alone(world):
    qs = [*np.random.default_rng(3).uniform(-2.0, 2.0, (20, 2)), np.array([np.pi / 2, 0.0])]
    assert world.near_each(qs) == [world.near(q) for q in qs]
    assert world.in_collision_each(qs) == [world.in_collision(q) for q in qs]
    assert any(world.in_collision_each(qs))
    assert not all(world.in_collision_each(qs))
    assert world.near_each([]) == world.in_collision_each([]) == []
    for q, pairs in zip(qs, world.near_each(qs), strict=True):
        world.place(q)
        assert contacts_among(world, pairs) == contacts_at(world, q)
