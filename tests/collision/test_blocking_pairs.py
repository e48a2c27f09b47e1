"""What is met most often, counted by hand."""

import numpy as np
import pytest

from guidefield.collision.blocking_pairs import (
    MOST_LOOKED_AT,
    blocking_pairs,
    contacts_among,
    contacts_at,
    find_touching_each,
)
from guidefield.collision.clearance import clearance_at
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


def test_where_a_clearance_is_asked_the_nearest_counts(world):
    up, leaning = np.zeros(2), np.array([0.3, 0.0])
    met = blocking_pairs(world, [up, leaning], 0.3)
    distances = [clearance_at(world, q).obstacle_distance for q in (up, leaning)]
    assert met.clearest == pytest.approx(max(distances))
    assert sum(met.counts.values()) == 2
    assert f"the most that one keeps is {1000 * max(distances):.1f} mm" in met.describe()
    assert met.details()["clearance"] == met.clearest


def test_nothing_is_met(world):
    met = blocking_pairs(world, [np.zeros(2)])
    assert (met.describe(), met.details(), met.counts) == ("", {}, {})


def test_no_more_than_so_many_are_looked_at(world):
    assert blocking_pairs(world, [np.zeros(2)] * (MOST_LOOKED_AT + 1)).looked_at == MOST_LOOKED_AT


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


def test_what_is_known_to_touch_is_not_asked_again(world, monkeypatch: pytest.MonkeyPatch) -> None:
    qs = [*np.random.default_rng(4).uniform(-2.0, 2.0, (MOST_LOOKED_AT + 5, 2)), np.array([np.pi / 2, 0.0])]
    met, touch = find_touching_each(world, qs)
    assert touch == [world.in_collision(q) for q in qs]
    assert len(met) == MOST_LOOKED_AT
    assert any(touch[MOST_LOOKED_AT:])
    alone = blocking_pairs(world, qs, 0.3)
    monkeypatch.setattr(type(world), "touches", None)
    assert blocking_pairs(world, qs, 0.3, met) == alone
    assert find_touching_each(world, []) == ([], [])
