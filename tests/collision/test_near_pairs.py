"""Obstacles found by their place are those that going through all of them finds; pairs are counted without a gap."""

import coal
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.clearance import clearance_at, separations
from guidefield.collision.obstacle_boxes import CHILDREN, BoxTree, obstacle_boxes, own_boxes
from guidefield.collision.pairs import Pairs
from guidefield.collision.world import TOUCHING
from guidefield.messages import scene as messages
from guidefield.scene.scene import build
from tests.collision.listed import part_separations, touching
from tests.collision.scenery import box, scattered, world_of
from tests.collision.test_world import pair_distances
from tests.robots import group
from tests.scene.solids import l_prism, mesh_message

FLOOR = messages.HalfSpace(name="floor", normal=(0.1, 0.0, 1.0), offset=-0.4)


def boxes(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners of boxes of all sizes, some flat, some at the same place."""
    low = np.round(rng.normal(size=(count, 3)), 1)
    return low, low + np.maximum(0.0, np.round(rng.normal(scale=rng.choice([0.01, 0.3, 3.0]), size=(count, 3)), 2))


@settings(deadline=None, max_examples=18)
@given(st.sampled_from([0, 1, CHILDREN, CHILDREN + 1, CHILDREN**2 + 1, 700]), st.integers(0, 12), st.integers(0, 10**6))
def test_a_tree_finds_the_boxes_that_overlap(count, asked, seed):
    rng = np.random.default_rng(seed)
    (low, high), (first, last) = boxes(rng, count), boxes(rng, asked)
    expected = ((low[None] <= last[:, None]) & (high[None] >= first[:, None])).all(axis=2)
    found = BoxTree.of(np.hstack([low, high])).overlapping(first, last)
    assert list(zip(*(part.tolist() for part in found), strict=True)) == list(zip(*np.nonzero(expected), strict=True))


@pytest.mark.parametrize("seed", range(4))
def test_boxes_along_the_worlds_axes_are_coals(seed):
    rng = np.random.default_rng(seed)
    turned = mesh_message(*l_prism(), position=(0.3, 0.1, 0.2), quaternion_xyzw=(0.5, 0.5, -0.5, 0.5))
    cloud = messages.PointCloud(name="cloud", points=[(0.1, 0.2, 0.3), (0.4, 0.2, 0.1)], radius=0.05)
    obstacles = build(messages.Scene(name="s", obstacles=[*scattered(rng, 40), turned, cloud])).obstacles
    low, high = np.split(own_boxes(list(obstacles)).boxes, 2, axis=1)
    for one, least, most in zip(obstacles, low, high, strict=True):
        placed = coal.CollisionObject(one.shape, one.placement.rotation, one.placement.translation)
        placed.computeAABB()
        around = placed.getAABB()
        assert (least <= np.array(around.min_) - one.rounding).all()
        assert (most >= np.array(around.max_) + one.rounding).all()
        if isinstance(one.message, messages.Sphere):
            np.testing.assert_allclose(most - least, 2.0 * one.message.radius, atol=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_boxes_along_own_axes_are_coals(seed):
    rng = np.random.default_rng(seed)
    turned = mesh_message(*l_prism(), position=(0.3, 0.1, 0.2), quaternion_xyzw=(0.5, 0.5, -0.5, 0.5))
    scene = build(messages.Scene(name="s", obstacles=[*scattered(rng, 40), turned, FLOOR]))
    boxes = obstacle_boxes(scene)
    for one, axes, centre, halves in zip(
        scene.obstacles, boxes.axes.reshape(-1, 3, 3), boxes.centres, boxes.halves, strict=True
    ):
        if isinstance(one.message, messages.HalfSpace):
            assert np.isinf(halves).all()
            continue
        np.testing.assert_allclose(axes, one.placement.rotation, atol=1e-14)
        np.testing.assert_allclose(axes @ centre, one.placement.act(0.5 * one.box.sum(axis=0)), atol=1e-12)
        np.testing.assert_allclose(halves, 0.5 * np.ptp(one.box, axis=0), atol=1e-12)


@settings(deadline=None, max_examples=18)
@given(st.integers(0, 10**6))
def test_an_index_is_the_place_in_the_list_that_is_never_made(seed):
    rng = np.random.default_rng(seed)
    links, obstacles = int(rng.integers(1, 6)), int(rng.integers(0, 7))
    moving = np.flatnonzero(rng.random(links) < 0.7)
    every = [(int(body), obstacle) for body in moving for obstacle in range(obstacles)]
    left_out = np.flatnonzero(rng.random(len(every)) < rng.choice([0.0, 0.3]))
    own = np.array([(0, 1)] * int(rng.integers(0, 3)), np.int64).reshape(-1, 2)
    pairs = Pairs(own, links, moving, obstacles, left_out)
    kept = [(body, links + obstacle) for k, (body, obstacle) in enumerate(every) if k not in left_out]
    listed = [*map(tuple, own.tolist()), *kept]
    assert len(pairs) == len(listed)
    assert [tuple(row) for row in pairs.bodies(np.arange(len(listed))).tolist()] == listed
    assert [pairs.of(k) for k in range(len(listed))] == listed
    assert {tuple(row) for row in pairs.bodies_left_out().tolist()} == {every[k] for k in left_out}
    rows, chosen = np.repeat(np.arange(len(moving)), obstacles), np.tile(np.arange(obstacles), len(moving))
    are, indices = pairs.with_obstacles(rows, chosen)
    assert np.flatnonzero(~are).tolist() == left_out.tolist()
    assert indices.tolist() == list(range(len(own), len(listed)))
    assert pairs.of_obstacles(np.arange(obstacles)).tolist() == indices.tolist()


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


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova"])
def test_near_pairs_are_those_that_bounds_of_all_pairs_leave(name):
    planned, rng = group(name), np.random.default_rng(11)
    world = world_of(planned, [*scattered(rng, 60), FLOOR], [])
    qs = [planned.expand_from_chart(planned.random(rng)) for _ in range(12)]
    pairs, margin = np.arange(len(world.pairs)), np.full(len(world.pairs), TOUCHING)
    for q, near in zip(qs, world.near_each(qs), strict=True):
        world.place(q)
        placements = world.joint_placements.copy()
        centres = world.bodies.centres_in_world(placements)
        bounds = separations(world, centres, pairs)
        close = np.maximum(bounds, part_separations(world, placements, pairs)) <= margin
        assert near == np.flatnonzero(close).tolist() == world.near(q)
        assert 0 < len(near) < len(pairs)
