"""The ends of a motion: configurations that reach a goal, by Coal and Pinocchio; what blocks the tip."""

import itertools

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings, strategies as st

from guidefield.collision.clearance import clearance_at
from guidefield.collision.world import World
from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner import ends
from guidefield.planner.ends import (
    CANDIDATES,
    GRAZING_DISTANCE,
    SOLUTIONS,
    _sample_about_start,
    _soonest,
    check_start,
    find_blocked_tip,
    find_goal_points,
    find_tip_points,
)
from guidefield.planner.task.problem import ConfigurationGoal, TipGoal
from guidefield.planner.task.stages import Ending, StageFailed
from guidefield.robot.group.inverse_kinematics import PoseTarget, solve
from tests.planner.problems import closed_shell, problem, scene_of
from tests.robots import group, random_configuration, rest

DOWN = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.45, 0.1, 0.5]))


def pose(placement: pin.SE3 = DOWN) -> TipGoal:
    return TipGoal(PoseTarget(placement, np.full(3, 1e-4), np.full(3, 1e-3)))


def ball(radius: float, *position: float) -> messages.Sphere:
    return messages.Sphere(name="ball", radius=radius, position=position)


def refused(made) -> Ending:
    with pytest.raises(StageFailed) as failure:
        find_goal_points(made)
    return failure.value.ending


def test_a_pose_has_free_configurations_far_from_each_other() -> None:
    made = problem("panda", "table", pose())
    goals = find_goal_points(made)
    assert SOLUTIONS <= len(goals) <= 2 * SOLUTIONS
    soonest = (np.abs(goals - made.z_start) / made.group.velocity_limits).max(axis=1)
    assert soonest[0] == soonest.min()
    for z in goals:
        q = made.group.from_local(z)
        assert not made.world.in_collision(q)
        assert made.goal.target.is_reached(made.kinematics.frame_placement(q, made.group.tip_id))
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(goals, 2)) > 0.3
    assert np.array_equal(goals, find_goal_points(problem("panda", "table", pose())))


def test_a_pose_in_an_obstacle_names_what_its_solutions_meet() -> None:
    made = problem("panda", scene_of(ball(0.1, *DOWN.translation)), pose())
    failure = refused(made)
    assert failure.status is Status.GOAL_IN_COLLISION
    assert failure.details["cause"] == "in collision"
    assert failure.details["pair"][1] == "ball"
    assert failure.details["counts"][0] == failure.details["looked_at"]
    assert "panda_" in failure.message
    assert failure.message.endswith("however it is reached")
    assert failure.details["solutions"] >= failure.details["looked_at"]


def test_a_pose_at_which_elbows_touch_names_what_they_meet_most_often() -> None:
    made = problem(
        "panda", scene_of(ball(0.3, 0.0, 0.0, 0.4)), pose(), allowed_collisions=frozenset([("panda_link0", "ball")])
    )
    failure = refused(made)
    assert failure.status is Status.GOAL_IN_COLLISION
    assert "most often panda_" in failure.message
    assert failure.details["counts"][0] <= failure.details["looked_at"]


def test_a_pose_at_which_the_hand_all_but_touches_is_reached() -> None:
    place = np.array([0.8, 0.1, 0.5])
    far = problem("panda", scene_of(ball(0.05, *place.tolist())), pose())
    near = clearance_at(far.world, far.group.expand_from_local(find_goal_points(far)[0]))
    hand, other = near.witness
    place += (hand - other) * (1.0 - 0.5 * GRAZING_DISTANCE / near.obstacle_distance)
    made = problem("panda", scene_of(ball(0.05, *place.tolist())), pose())
    for z in find_goal_points(made):
        assert 0.0 < clearance_at(made.world, made.group.expand_from_local(z)).obstacle_distance < GRAZING_DISTANCE


def test_a_pose_inside_a_hollow_mesh_is_in_collision() -> None:
    made = problem("panda", scene_of(closed_shell(2.0)), pose())
    assert not made.world.in_collision(made.q_start)
    failure = refused(made)
    assert failure.details["pair"][1] == "shell"
    with pytest.raises(StageFailed, match="inside"):
        check_start(made)


def test_where_one_that_is_wanted_is_inside_of_something_others_are(monkeypatch: pytest.MonkeyPatch) -> None:
    made = problem("panda", "table", pose(), planes=())
    first, *_ = find_goal_points(made)
    closed = made.group.expand_from_local(first)
    seen = ends.find_enclosed_each

    def but_the_first(world, qs):
        around = seen(world, qs)
        return [("shell", "hand") if np.array_equal(q, closed) else one for q, one in zip(qs, around, strict=True)]

    monkeypatch.setattr(ends, "find_enclosed_each", but_the_first)
    goals = find_goal_points(made)
    assert first.tolist() not in goals.tolist()
    each = find_tip_points(made, made.goal.target, _sample_about_start(made), CANDIDATES)
    assert np.array_equal(goals, _soonest(made, each))


def test_of_a_set_those_that_are_free_are_left() -> None:
    made = problem("panda", "table")
    qs = tuple(random_configuration(made.group, seed) for seed in range(300))
    free = [not made.world.in_collision(q) for q in qs]
    assert 0 < sum(free) < 300
    made = problem("panda", "table", ConfigurationGoal(qs))
    kept = find_goal_points(made)
    expected = np.array([q for q, one in zip(qs, free, strict=True) if one])
    assert len(kept) == len(expected)  # none of them is within the batch's band of contact
    assert np.allclose(kept, expected)


def test_of_a_set_that_is_blocked_the_pair_met_most_is_named() -> None:
    made = problem("panda", "table")
    qs = tuple(q for q in (random_configuration(made.group, seed) for seed in range(60)) if made.world.in_collision(q))
    failure = refused(problem("panda", "table", ConfigurationGoal(qs)))
    assert failure.status is Status.GOAL_IN_COLLISION
    assert failure.details["goals"] == len(qs)
    assert f"all {len(qs)} goals are in collision: most often" in failure.message
    assert failure.details["counts"] == sorted(failure.details["counts"], reverse=True)


def test_a_slight_contact_at_the_start_can_be_left_and_that_is_said() -> None:
    made = problem("panda", scene_of(), q_start=None)
    near = made.kinematics.tip_position(rest(made.group))
    for radius, slight in ((0.11, False), (0.004, True)):
        touching = problem("panda", scene_of(ball(radius, *near)), ConfigurationGoal((rest(made.group),)))
        with pytest.raises(StageFailed) as failure:
            check_start(touching)
        ending = failure.value.ending
        assert ("leave_start_contact" in ending.message) is (slight and ending.details["depth"] <= 0.01)


EXACTLY = np.zeros(3)


def reaching(name: str, target: PoseTarget, seed: int) -> list[np.ndarray]:
    """Configurations that reach a target, whatever they touch."""
    planned = group(name)
    start = planned.to_local(random_configuration(planned, seed))
    found = solve(planned, target, [start], 8, rng=np.random.default_rng(seed)).solutions
    return [planned.expand_from_local(z) for z in found]


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
def test_no_configuration_that_reaches_the_target_is_free(name, seed, off, position, turned):
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
