"""What blocks the tip however it is reached: no configuration that reaches the target is free, then."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from hypothesis import assume, given, settings, strategies as st

from guidefield.collision.world import World
from guidefield.messages import scene as messages
from guidefield.planner.ends import find_blocked_tip
from guidefield.robot.group.inverse_kinematics import PoseTarget, solve
from tests.planner.problems import scene_of
from tests.robots import group, random_configuration

EXACTLY = np.zeros(3)


def reaching(name: str, target: PoseTarget, seed: int) -> list[np.ndarray]:
    """Configurations that reach a target, whatever they touch."""
    planned = group(name)
    start = planned.chart(random_configuration(planned, seed))
    found = solve(planned, target, [start], 8, rng=np.random.default_rng(seed)).solutions
    return [planned.expand_from_chart(z) for z in found]


def where_the_tip_is(name: str, seed: int) -> pin.SE3:
    planned = group(name)
    data = planned.model.createData()
    pin.framesForwardKinematics(planned.model, data, planned.expand(random_configuration(planned, seed)))
    return pin.SE3(data.oMf[planned.tip_id])


@settings(max_examples=12)
@given(
    st.sampled_from(["panda", "ur5", "kinova"]),
    st.integers(0, 10**6),
    st.floats(0.0, 0.1),
    st.floats(0.0, 0.2),
    st.floats(0.0, 0.3),
)
def test_no_configuration_that_reaches_the_target_is_free(
    name: str, seed: int, off: float, position: float, turned: float
) -> None:
    rng = np.random.default_rng(seed)
    place = where_the_tip_is(name, seed)
    size = rng.uniform(0.05, 0.4, 3)
    box = messages.Box(name="box", size=tuple(size), position=tuple(place.translation + off * rng.normal(size=3)))
    target = PoseTarget(place, rng.uniform(0.0, position, 3), rng.uniform(0.0, turned, 3))
    world = World.build(group(name), scene_of(box))
    qs = reaching(name, target, seed)
    assume(qs)
    blocked = find_blocked_tip(world, target, qs[0])
    if blocked is not None:
        assert all(world.in_collision(q) for q in qs)
        assert next(iter(blocked.counts))[1] == "box"
        assert blocked.deepest is not None


def test_a_hand_in_a_box_is_blocked_and_named() -> None:
    place = where_the_tip_is("panda", 3)
    world = World.build(group("panda"), scene_of(messages.Box(name="box", size=(0.2,) * 3, position=place.translation)))
    (q, *_) = reaching("panda", PoseTarget(place, EXACTLY, EXACTLY), 3)
    blocked = find_blocked_tip(world, PoseTarget(place, EXACTLY, EXACTLY), q)
    assert {pair[1] for pair in blocked.counts} == {"box"}
    assert all(pair[0].startswith("panda_") for pair in blocked.counts)
    for free in (PoseTarget(place, np.full(3, 0.3), EXACTLY), PoseTarget(place, EXACTLY, np.array([np.inf, 0.0, 0.0]))):
        assert find_blocked_tip(world, free, q) is None


def test_what_may_touch_blocks_nothing() -> None:
    place = where_the_tip_is("panda", 3)
    exactly = PoseTarget(place, EXACTLY, EXACTLY)
    scene = scene_of(messages.Box(name="box", size=(0.2,) * 3, position=place.translation))
    (q, *_) = reaching("panda", exactly, 3)
    blocked = find_blocked_tip(World.build(group("panda"), scene), exactly, q)
    assert find_blocked_tip(World.build(group("panda"), scene, list(blocked.counts)), exactly, q) is None
