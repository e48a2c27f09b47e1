"""The fast judgement of motions against Coal: a yes is never wrong, and of capsules a no hardly ever."""

import numpy as np
import pytest

from guidefield.collision.world import World
from guidefield.messages import scene as messages
from guidefield.planner.guide.guided_path import swept_world
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
