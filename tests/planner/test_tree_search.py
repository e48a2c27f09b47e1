"""Trees of SIMD batches: the sequence, whole turns; what they find is free at its samples."""

from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import pytest

from guidefield.collision.batch.batch_collision import BatchCollision
from guidefield.collision.clearance import clearance_at
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.messages import scene as messages
from guidefield.messages.requests import UrdfText
from guidefield.planner import tree_search
from tests.planner.problems import scene_of
from tests.planner.test_connect import wall_between
from tests.robots import box_arm, grouped


def search(seed: int = 0, **deadline: object) -> tuple[tree_search.FoundPath, BatchCollision]:
    made, start, goal = wall_between()
    batch = made.batch
    assert batch is not None
    rng = np.random.default_rng(seed)
    return tree_search.grow(batch, start[None], goal[None], 32.0, 0.0, rng, Deadline(**deadline)), batch


@pytest.mark.parametrize("locked", [0.1, 0.7])  # the nearest float32 is above the one and below the other
def test_rounding_takes_no_sample_beyond_a_limit(locked: float) -> None:
    joints = box_arm("y y y", 3).text.split("</joint>")
    joints[1] = joints[1].replace('lower="-2" upper="2"', f'lower="{locked}" upper="{locked}"')
    arm = grouped(UrdfText(text="</joint>".join(joints)))
    world = World.build(arm, scene_of(messages.Sphere(name="ball", radius=0.15, position=(0.0, 0.0, 1.2))))
    batch, ends = BatchCollision.build(world), np.array([[-1.2, locked, 0.0], [0.9, locked, 0.0]])
    found = tree_search.grow(batch, ends[:1], ends[1:], 32.0, 0.0, np.random.default_rng(0), Deadline())
    assert len(found.path) > 2
    assert (found.path[:, 1] == locked).all()


@pytest.mark.parametrize("seed", range(3))
def test_samples_of_what_is_found_are_free(seed: int) -> None:
    found, batch = search(seed)
    _, start, goal = wall_between()
    np.testing.assert_array_equal(found.path[[0, -1]], [start, goal])
    for a, b in pairwise(found.path):
        count = 1 + int(32.0 * np.linalg.norm(b - a))
        for t in np.linspace(0.0, 1.0, count)[1:]:
            z = a + t * (b - a)
            assert not batch.world.in_collision(z) or clearance_at(batch.world, z).obstacle_distance > -0.02
    assert batch.free_until(found.path, 32.0) == len(found.path) - 1


def test_the_same_seed_gives_the_same_path_in_a_world_that_has_answered_before() -> None:
    made, start, goal = wall_between()
    paths = []
    for _ in range(3):
        found = tree_search.grow(made.batch, start[None], goal[None], 32.0, 0.0, np.random.default_rng(3), Deadline())
        paths.append(found.path)
    np.testing.assert_array_equal(paths[0], paths[1])
    np.testing.assert_array_equal(paths[0], paths[2])
    assert not np.array_equal(paths[0], search(4)[0].path)


def test_angles_that_wrap_go_the_short_way_round() -> None:
    planned = grouped(box_arm("continuous", 1))
    batch = BatchCollision.build(World.build(planned, scene_of()))
    start, goal = np.array([3.0]), np.array([-3.0])
    found = tree_search.grow(batch, start[None], goal[None], 32.0, 0.0, np.random.default_rng(0), Deadline())
    assert (np.abs(np.diff(found.path, axis=0)) < np.pi).all()
    np.testing.assert_allclose(np.cos(found.path[-1]), np.cos(goal), atol=1e-6)
    np.testing.assert_allclose(np.sin(found.path[-1]), np.sin(goal), atol=1e-6)


def test_one_of_several_goals_is_reached() -> None:
    made, start, goal = wall_between()
    goals = np.stack([goal, goal + 0.02])
    found = tree_search.grow(made.batch, start[None], goals, 32.0, 0.0, np.random.default_rng(0), Deadline())
    assert any(np.array_equal(found.path[-1], goal) for goal in goals)
    # roots may lie in memory as they like
    across = tree_search.grow(
        made.batch, start[None], np.asfortranarray(goals), 32.0, 0.0, np.random.default_rng(0), Deadline()
    )
    np.testing.assert_array_equal(across.path, found.path)


def test_searches_of_two_threads_do_not_share_memory() -> None:
    alone = [search(seed)[0].path for seed in range(4)]
    with ThreadPoolExecutor(4) as threads:
        together = [found.path for found, _ in threads.map(search, range(4))]
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one, other)


def sliding_box() -> UrdfText:
    """A box of 0.1 m that slides in x and in y, by 8 m to either side."""
    link = '<link name="{}"/><joint name="{}" type="prismatic"><parent link="{}"/><child link="{}"/><axis xyz="{}"/>'
    limit = '<limit lower="-8" upper="8" effort="1" velocity="1"/></joint>'
    parts = [link.format("world", "x", "world", "along", "1 0 0"), link.format("along", "y", "along", "box", "0 1 0")]
    body = '<link name="box"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>'
    return UrdfText(text=f'<robot name="slider">{parts[0]}{limit}{parts[1]}{limit}{body}</robot>')


@pytest.mark.parametrize("seed", range(5))
def test_a_path_that_leads_far_round_is_found(seed: int) -> None:
    """Between start and goal, 2 m apart, is a wall that ends 12 m away: farther than most samples are from the path."""
    wall = messages.Box(name="wall", size=(0.1, 14.0, 1.0), position=(0.0, -1.0, 0.0))
    batch = BatchCollision.build(World.build(grouped(sliding_box()), scene_of(wall)))
    start, goal = np.array([[-1.0, -6.0]]), np.array([[1.0, -6.0]])
    found = tree_search.grow(batch, start, goal, 32.0, 0.0, np.random.default_rng(seed), Deadline())
    assert found.path[:, 1].max() > 6.0
    assert found.motions < 5000
    assert batch.free_until(found.path, 32.0) == len(found.path) - 1
