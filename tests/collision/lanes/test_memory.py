"""The memory of a world for lanes: where its arrays lie, what is in them at first, what a search forgets."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.kernels.collide.layout import AXIS_AND_REACH
from guidefield.kernels.collide.primitives_layout import LINE
from guidefield.planner.connect import tree_search
from tests.collision.lanes.test_scene_tables import scene
from tests.robots import group


@pytest.mark.parametrize("robot", ["panda", "ur5"])
@pytest.mark.parametrize("count", [0, 5, 17])
def test_the_memory_of_a_world_is_laid_out_without_overlaps(robot: str, count: int) -> None:
    lanes = BatchCollision.build(World.build(group(robot), scene(1, count)))
    tables = lanes.tables
    arrays = [*tables.scratch, tables.block, tables.obstacles.may_touch]
    for array in arrays:
        assert array.ctypes.data % LINE == 0
        assert array.size == 0 or np.shares_memory(array, lanes.memory)
    for one, other in itertools.combinations(arrays, 2):
        assert not np.shares_memory(one, other)
    scratch = tables.scratch
    assert (scratch.hits == -1).all()
    for array in (*scratch[:-1], tables.block):
        assert not array.any()


def test_a_search_forgets_what_was_asked_before_it() -> None:
    lanes = BatchCollision.build(World.build(group("ur5"), scene(1, 5)))
    scratch, nv, rng = lanes.tables.scratch, lanes.world.group.nv, np.random.default_rng(0)
    lanes.touching(rng.uniform(-3.0, 3.0, (2000, nv)))
    assert (scratch.hits >= 0).any()
    assert scratch.pair_axes.any()
    assert scratch.obstacle_axes.any()
    for axes, places in ((scratch.pair_axes, scratch.pair_places), (scratch.obstacle_axes, scratch.obstacle_places)):
        kept = np.flatnonzero(axes.reshape(-1, AXIS_AND_REACH)[:, :3].any(axis=1)) * AXIS_AND_REACH
        assert sorted(places[1 : 1 + places[0]]) == kept.tolist()
    tree_search.grow(lanes, np.zeros((1, nv)), np.ones((1, nv)), 32.0, 0.0, rng, Deadline(0.0))
    assert (scratch.hits == -1).all()
    assert not scratch.pair_axes.any()
    assert not scratch.obstacle_axes.any()
    assert scratch.pair_places[0] == scratch.obstacle_places[0] == 0
