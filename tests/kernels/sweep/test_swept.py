"""The fast judgement of motions against Coal: a yes is never wrong, and of capsules a no hardly ever."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.collision.swept import swept_world
from guidefield.collision.world import World
from guidefield.messages import scene as messages
from guidefield.prove.certificate import motion_free
from tests.planner.problems import library_scene, scene_of
from tests.robots import box_arm, group, grouped, rest

MARGIN = 2e-3


def motions(planned, count: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    origin = planned.chart(rest(planned))
    pairs = []
    for _ in range(count):
        z0 = origin + rng.normal(size=planned.nv) * rng.choice([0.05, 0.3])
        pairs.append((z0, z0 + rng.normal(size=planned.nv) * rng.choice([0.02, 0.1])))
    return pairs


@pytest.mark.parametrize(
    ("name", "scene"),
    [
        ("chain_fixed_6x300_r25", "seed_a_gates"),
        ("chain_moving_3x260_r25", "seed_e_L_3"),
        ("chain_moving_6x200_r20", "seed_d_passage_6"),
        ("chain_universal_fixed_6x320_r25", "seed_c_blocked"),
        ("panda", "bookshelf"),
        ("ur5", "table"),
    ],
)
def test_a_yes_is_coals_yes(name: str, scene: str) -> None:
    planned = group(name)
    world = World.build(planned, library_scene(scene))
    swept = swept_world(world)
    agreed = 0
    for z0, z1 in motions(planned, 40, 1):
        fast, judged = swept.apart(z0, z1, MARGIN), motion_free(world, z0, z1, MARGIN).free
        assert judged or not fast
        agreed += fast == judged
    if swept.exact:
        assert agreed >= 38
    assert swept.exact == name.startswith("chain")


@pytest.mark.parametrize(
    "joints",
    ["x slide oblique", "continuous oblique-continuous y", "x mimic slide", "planar x y", "continuous screw half-gear"],
)
def test_every_kind_of_joint_is_bounded(joints: str) -> None:
    planned = grouped(box_arm(joints, 0))
    ball = messages.Sphere(name="ball", radius=0.2, position=(0.35, 0.1, 0.6))
    world = World.build(planned, scene_of(ball, messages.HalfSpace(name="floor", normal=(0, 0, 1), offset=-0.2)))
    swept = swept_world(world)
    yes = 0
    for z0, z1 in motions(planned, 40, 2):
        if swept.apart(z0, 3.0 * z1 - 2.0 * z0, MARGIN):
            yes += 1
            assert motion_free(world, z0, 3.0 * z1 - 2.0 * z0, MARGIN).free
    assert yes >= 3


def test_a_motion_through_an_obstacle_between_free_ends_is_refused() -> None:
    planned = group("chain_fixed_6x300_r25")
    post = messages.Box(name="post", size=(0.01, 0.01, 2.0), position=(0.9, 0.0, 0.0))
    swept = swept_world(World.build(planned, scene_of(post)))
    before, after = np.zeros(planned.nv), np.zeros(planned.nv)
    before[2], after[2] = -0.4, 0.4
    assert swept.apart(before, before, MARGIN)
    assert swept.apart(after, after, MARGIN)
    assert not swept.apart(before, after, MARGIN)


def test_what_may_touch_is_left_to_coal() -> None:
    planned = group("chain_fixed_6x300_r25")
    scene = scene_of(messages.Box(name="wall", size=(0.01, 1.0, 1.0), position=(0.9, 0.0, 0.0)))
    assert swept_world(World.build(planned, scene)).exact
    assert not swept_world(World.build(planned, scene, [("link3", "wall")])).exact


@pytest.mark.parametrize("name", ["chain_moving_3x260_r20", "chain_universal_fixed_6x300_r25", "panda", "kinova"])
def test_ends_are_the_groups_own_chart_points(name: str) -> None:
    planned = group(name)
    swept = swept_world(World.build(planned, scene_of()))
    rng = np.random.default_rng(3)
    for _ in range(20):
        q0, q1 = planned.random(rng), planned.random(rng)
        z0 = planned.chart(q0)
        for found, expected in zip(swept.ends(q0, q1), (z0, planned.unwrapped(planned.chart(q1), z0)), strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-9)


def test_ends_of_a_planar_joint_and_of_followers() -> None:
    for kind in ("planar x", "x mimic continuous", "continuous gear y"):
        planned = grouped(box_arm(kind, 0))
        swept = swept_world(World.build(planned, scene_of()))
        q0, q1 = rest(planned), planned.random(np.random.default_rng(5))
        z0 = planned.chart(q0)
        np.testing.assert_allclose(swept.ends(q0, q1)[1], planned.unwrapped(planned.chart(q1), z0), atol=1e-12)


@pytest.mark.parametrize("name", ["chain_fixed_6x300_r25", "panda", "baxter"])
def test_the_joints_between_a_pair_are_those_that_move_one_of_both(name: str) -> None:
    planned = group(name)
    robot = swept_world(World.build(planned, scene_of())).robot
    for pair, apart in zip(robot.own.tolist(), robot.apart.tolist(), strict=True):
        moving = [set(planned.model.supports[int(robot.carriers[one])]) - {0} for one in pair]
        for mine, others, top in ((*moving, apart[0]), (*moving[::-1], apart[1])):
            between, joint = set(), max(mine, default=0) if top else 0
            while joint:
                between.add(joint)
                joint = int(robot.joints.parents[joint]) if joint != top else 0
            assert between == mine - others
