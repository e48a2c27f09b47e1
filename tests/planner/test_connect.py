"""Connections: straight where free, a tree where not; the soonest goal; shorter rounds; refusals; path constraints."""

import dataclasses
import time
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.clearance import clearance_at
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner import tree_search
from guidefield.planner.connect import (
    LEAST_SHORTER,
    Keeper,
    PoseKeeper,
    ShortenedPath,
    ShorteningRounds,
    connect,
    connect_constrained,
    estimate_time,
    find_quickest_path,
    shorten_path,
)
from guidefield.planner.ends import find_goal_points
from guidefield.planner.guide.guide import ATTEMPTS, cross_plane
from guidefield.planner.motion.timing import length_of
from guidefield.planner.task.problem import Objective, Problem, TipGoal
from guidefield.planner.tree_search import FARTHEST_STRIDE, STRIDE, explain_failed_search, sources_of
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.inverse_kinematics import PoseTarget
from guidefield.robot.group.path_constraints import Cone, line, plane, point
from tests.collision.batch.test_batch_collision import draw
from tests.planner.problems import densely_free, problem, scene_of, seed_problem
from tests.robots import box_arm, group, grouped, rest


def wall_between() -> tuple:
    """A Panda with a wall beside it, and local coordinates on both sides of the wall."""
    wall = messages.Box(name="wall", size=(0.5, 0.04, 0.7), position=(0.55, 0.0, 0.35))
    made = problem("panda", scene_of(wall))
    start, goal = made.group.to_local(rest(made.group)), made.group.to_local(rest(made.group))
    start[0], goal[0] = 0.9, -0.9
    start[1] = goal[1] = 0.3
    assert not made.world.in_collision(start)
    assert not made.world.in_collision(goal)
    return made, start, goal


@pytest.mark.parametrize("seed", range(3))
def test_the_tree_finds_a_path_round(seed: int) -> None:
    made, start, goal = wall_between()
    assert not densely_free(made, np.array([start, goal]))
    connection = connect(made, start, np.array([goal]), np.random.default_rng(seed))
    assert connection.status is Status.SUCCESS
    np.testing.assert_array_equal(connection.path[0], start)
    np.testing.assert_array_equal(connection.path[-1], goal)
    assert densely_free(made, connection.path)


@pytest.mark.parametrize("kinds", ["ball", "free ball", "planar", "floating x", "x planar y", "slide floating mimic"])
def test_joints_of_every_kind_find_a_path_round(kinds: str) -> None:
    names = {"ball": "chain_fixed_6x300_r25", "free ball": "chain_moving_3x260_r20", "planar": "chain_planar_3x260_r25"}
    planned = group(names[kinds]) if kinds in names else grouped(box_arm(kinds, len(kinds.split())))
    turned = (0.0, 0.6, 0.0, 0.8)
    walls = [
        messages.Box(name="near", size=(0.4, 0.8, 0.04), position=(0.35, 0.0, 0.1), quaternion_xyzw=turned),
        messages.Box(name="far", size=(0.05, 1.0, 1.0), position=(-0.7, 0.3, 0.1), quaternion_xyzw=turned),
    ]
    made = problem(planned, scene_of(*walls))
    zs = draw(planned, 400, 7)
    ends = zs[~made.batch.touching(zs)]
    paths = [(start, planned.unwrapped(goal, start)) for start, goal in pairwise(ends)]
    blocked = [pair for pair in paths if not made.batch.free_until(np.array(pair), 32.0)]
    assert len(blocked) > 2
    for start, goal in blocked[:3]:
        connection = connect(made, start, goal[None], np.random.default_rng(0))
        assert connection.status is Status.SUCCESS
        assert "tree" in connection.message
        assert connection.proven
        np.testing.assert_array_equal(connection.path[0], start)
        assert np.abs(planned.difference(*map(planned.from_local, (connection.path[-1], goal)))).max() < 1e-6
        for a, b in pairwise(connection.path):
            for t in np.linspace(0.0, 1.0, 1 + int(np.linalg.norm(b - a) / 0.05)):
                assert not made.world.in_collision(planned.expand_from_local(a + t * (b - a)))


def test_a_body_that_flies_free_gets_there_turned_the_other_way_round_too() -> None:
    planned = grouped(box_arm("floating", 1))
    goal = planned.to_local(planned.q_origin)
    goal[3:6] = 0.0, 2.5, 0.0
    (other,) = planned.turned_otherwise(goal)
    np.testing.assert_allclose(planned.from_local(other)[:3], planned.from_local(goal)[:3])
    same = planned.difference(planned.from_local(other), planned.from_local(goal))
    np.testing.assert_allclose(same, np.zeros(planned.nv), atol=1e-9)
    assert np.linalg.norm(other[3:6]) == pytest.approx(2.0 * np.pi - 2.5)


def test_no_path_in_time_is_said_so() -> None:
    made, start, goal = wall_between()
    stopped = problem("panda", made.scene, deadline=Deadline(time.monotonic()))
    connection = connect(stopped, start, np.array([goal]), np.random.default_rng(0))
    assert connection.status is Status.TIMED_OUT
    assert len(connection.path) == 1


def test_min_clearance_is_kept_all_along() -> None:
    made, start, goal = wall_between()
    careful = problem("panda", made.scene, min_clearance=0.03)
    connection = connect(careful, start, np.array([goal]), np.random.default_rng(1))
    assert connection.status is Status.SUCCESS
    for a, b in zip(connection.path, connection.path[1:], strict=False):
        for t in np.linspace(0, 1, 20):
            assert clearance_at(careful.world, a + t * (b - a)).obstacle_distance >= 0.03


@pytest.mark.parametrize("title", ["seed_e_L_3", "seed_e_S_3", "seed_e_L_6_planar", "seed_d_passage_3"])
def test_snakes_go_through_tubes_to_configurations(title: str) -> None:
    made = seed_problem(title)
    q = made.q_start
    for index, crossed in enumerate(made.guide_planes):
        q = cross_plane(made, q, crossed, index, ATTEMPTS["projected"](made.group)).path[-1]
    start = made.group.to_local(made.q_start)
    goal = made.group.unwrapped(made.group.to_local(q), start)
    assert not densely_free(made, np.array([start, goal]), 1e-2)
    connection = connect(made, start, goal[None], np.random.default_rng(0))
    assert connection.status is Status.SUCCESS
    assert connection.proven
    np.testing.assert_array_equal(connection.path[0], start)
    reached = made.group.unwrapped(connection.path[-1], goal)
    np.testing.assert_allclose(reached, goal, atol=1e-9)
    assert densely_free(made, connection.path, 1e-2)


@given(st.integers(0, 10_000), st.integers(2, 8))
def test_a_time_is_between_the_straight_ones_and_that_of_waiting_for_the_slowest(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    path, velocities = rng.normal(size=(count, 4)), rng.uniform(0.1, 3.0, 4)
    time = estimate_time(path, velocities)
    straight = max(abs(float(a)) / float(v) for a, v in zip(path[-1] - path[0], velocities, strict=True))
    waiting = sum(max(np.abs(b - a) / velocities) for a, b in pairwise(path))
    assert straight * (1 - 1e-12) <= time <= waiting * (1 + 1e-12)
    assert estimate_time(path[[0, -1]], velocities) == pytest.approx(straight)


def test_a_goal_behind_a_wall_is_passed_by_for_one_that_is_farther_but_reached_sooner() -> None:
    made, start, behind = wall_between()
    aside = start.copy()
    aside[0] += 1.85  # a little more than through the wall
    assert densely_free(made, np.array([start, aside]))
    rng = np.random.default_rng(0)
    found = find_quickest_path(made, start, np.array([behind, aside]), rng)
    assert found.tried == 2
    np.testing.assert_array_equal(found.path, [start, aside])
    alone = find_quickest_path(made, start, behind[None], rng)
    assert len(alone.path) > 2
    limits = made.group.velocity_limits
    assert estimate_time(alone.path, limits) > estimate_time(found.path, limits)


def test_of_two_goals_as_soon_the_one_with_the_shorter_path_is_taken_unless_time_alone_counts() -> None:
    made = problem("panda", scene_of())
    z, limits = made.group.to_local(made.q_start), made.group.velocity_limits
    one_joint, all_joints = z + 0.1 * np.eye(7)[0] * limits, z + 0.099 * limits
    goals = np.array([all_joints, one_joint])
    for objective, taken in ((Objective.BALANCED, one_joint), (Objective.TIME, all_joints)):
        found = find_quickest_path(dataclasses.replace(made, objective=objective), z, goals, np.random.default_rng(0))
        np.testing.assert_array_equal(found.path, [z, taken])


COARSE = 32.0


def first_path(seed: int = 0) -> tuple:
    made, start, goal = wall_between()
    rng = np.random.default_rng(seed)
    found = tree_search.grow(made.batch, start[None], goal[None], COARSE, 0.0, rng, Deadline())
    assert found.path is not None
    return made, found.path


def improved(number: int, accepted: bool = True, seed: int = 0, **deadline: object) -> tuple[ShortenedPath, np.ndarray]:
    made, path = first_path()
    bounded = problem("panda", made.scene, deadline=Deadline(**deadline))
    rounds, rng = ShorteningRounds(number, COARSE, 0.0), np.random.default_rng(seed)
    return shorten_path(bounded, path, path[-1:], rounds, rng, lambda _: accepted), path


def test_more_rounds_make_no_longer_paths_with_the_same_ends() -> None:
    lengths = []
    for number in (0, 1, 3, 10):
        better, path = improved(number)
        np.testing.assert_array_equal(better.path[[0, -1]], path[[0, -1]])
        lengths.append(length_of(better.path, np.ones(7)))
        assert better.rounds == number
    assert lengths[0] == length_of(path, np.ones(7))
    assert (np.diff(lengths) <= 0.0).all()
    assert lengths[-1] < (1.0 - LEAST_SHORTER) * lengths[0]


@pytest.mark.parametrize("stop", [{"at": 0.0}, {"is_cancelled": lambda: True}])
def test_a_spent_budget_ends_the_rounds_and_keeps_the_path(stop: dict[str, object]) -> None:
    better, path = improved(1_000_000, **stop)
    assert better.path is path
    assert better.rounds == 0
    assert "time ended them" in better.message


def test_a_connection_that_is_asked_for_more_is_shorter_and_certified() -> None:
    made, start, goal = wall_between()
    asked = problem("panda", made.scene, optimization_iterations=8)
    plain, more = (connect(one, start, goal[None], np.random.default_rng(2)) for one in (made, asked))
    assert more.status is Status.SUCCESS
    assert length_of(more.path, np.ones(7)) <= length_of(plain.path, np.ones(7))
    assert "shorter in 8 rounds" in more.message
    assert "rounds" not in plain.message
    assert densely_free(asked, more.path)


@settings(max_examples=18)
@given(st.integers(0, 10_000), st.floats(1.0, 1.8), st.booleans())
def test_a_point_on_a_path_that_is_short_enough_is_in_the_box(seed: int, more: float, wraps: bool) -> None:
    planned = grouped(box_arm("continuous x oblique-continuous slide", 4)) if wraps else group("panda")
    rng, sources = np.random.default_rng(seed), sources_of(planned)
    start, goal, via = (planned.to_local(planned.random(rng)) for _ in range(3))
    goal, units = planned.unwrapped(goal, start), planned.units
    via = start + rng.random() * (planned.unwrapped(via, start) - start)
    length = sum(np.linalg.norm((b - planned.unwrapped(a, b)) / units) for a, b in ((start, via), (goal, via)))
    box = sources.between((start / units)[None], (goal / units)[None], more * length).sampling
    above = via / units - box.lower
    turns = box.period > 0.0
    above[turns] %= box.period[turns]
    assert (above >= -1e-9).all()
    assert (above <= box.width + 1e-9).all()
    assert (box.width <= sources.sampling.width + 1e-9).all()


def one_joint(kind: str, *angles: float) -> tuple[PlanningGroup, list[messages.Box]]:
    """An upright link on one joint about y, and boxes that it meets at some angles."""
    planned = grouped(box_arm(kind, 1))
    boxes = [
        messages.Box(
            name=f"stop{i}", size=(0.03, 0.03, 0.03), position=(0.28 * np.sin(angle), 0.0, 0.3 + 0.28 * np.cos(angle))
        )
        for i, angle in enumerate(angles)
    ]
    return planned, boxes


@pytest.mark.parametrize(("kind", "said"), [("y", "on the only way"), ("continuous", "either way round")])
def test_a_joint_that_is_stopped_on_every_path_is_known_not_to_get_there(kind: str, said: str) -> None:
    planned, boxes = one_joint(kind, 0.0, 1.9)
    made = problem(planned, scene_of(*boxes))
    connection = connect(made, np.array([-1.0]), np.array([[1.0]]), np.random.default_rng(0))
    assert connection.status is Status.PLANNING_FAILED
    assert said in connection.message
    assert planned.joints[0].name in connection.message
    assert made.counters.iterations == 0


def enclosed(gap: float) -> tuple[PlanningGroup, World, np.ndarray, np.ndarray]:
    """Two links that stand upright, the upper one between four walls, and a goal elsewhere."""
    planned, away = grouped(box_arm("x y", 2)), 0.02 + gap + 0.01
    walls = [
        messages.Box(name=f"{axis}{side}", size=(0.02, 0.02, 0.2), position=tuple(side * away * np.eye(3)[axis] + at))
        for axis in (0, 1)
        for side in (-1, 1)
        for at in [np.array([0.0, 0.0, 0.75])]
    ]
    world = World.build(planned, scene_of(*walls))
    return planned, world, np.zeros(2), np.array([1.5, 0.5])


def test_an_end_that_can_not_be_left_is_told_early() -> None:
    planned, world, start, goal = enclosed(0.001)
    assert not world.in_collision(planned.expand_from_local(start))
    made = dataclasses.replace(problem(planned, world.scene), world=world)
    for ends, name in (((start, goal), "start"), ((goal, start), "goal")):
        connection = connect(made, ends[0], ends[1][None], np.random.default_rng(0))
        assert connection.status is Status.PLANNING_FAILED
        assert f"the {name} can't be left" in connection.message


def test_what_was_not_found_in_time_comes_with_numbers() -> None:
    made, start, goal = wall_between()
    calls = iter(range(100))
    deadline = Deadline(is_cancelled=lambda: next(calls) > 20)
    found = tree_search.grow(made.batch, start[None], goal[None], 32.0, 2.0, np.random.default_rng(0), deadline)
    assert found.path is None
    message = explain_failed_search(found, 1, in_time=True)
    assert f"in time: {found.motions} motions were judged" in message
    assert "from the start and the goal have 1 and 1 configurations" in message
    assert "hard to get away from" in message
    assert sum(found.tried) <= found.motions
    assert "3000000" in explain_failed_search(found, 2, in_time=False)


def upright(arm: str, half_angle: float, *obstacles: messages.Obstacle) -> tuple[Problem, Keeper]:
    """An arm whose tip's z axis stays within a cone about the world's."""
    planned = grouped(box_arm(arm, len(arm.split())))
    up = np.array([0.0, 0.0, 1.0])
    made = problem(planned, scene_of(*obstacles), planes=())
    made = dataclasses.replace(made, path_constraints=(Cone(planned.tip, up, up, half_angle),))
    return made, Keeper(made, made.constrained_frames)


def apart(made: Problem, one: np.ndarray, other: np.ndarray) -> float:
    """By the group's metric, with no turn taken back."""
    return float(np.linalg.norm((other - one) / made.group.units))


def test_what_can_not_be_reached_is_told() -> None:
    made, keeper = upright("wide y", 0.3)  # once round, the second joint would have to turn by pi
    made = dataclasses.replace(made, deadline=Deadline(time.monotonic() + 0.2))
    start, goal = np.zeros(2), np.array([2.0 * np.pi, 0.0])
    assert (keeper.frames.values(goal) <= keeper.frames.limits).all()
    found = connect_constrained(made, keeper, start, goal[None], np.random.default_rng(0))
    assert found.status is Status.TIMED_OUT
    assert "within the path constraints no connection was found in time" in found.message
    np.testing.assert_array_equal(found.path, start[None])


@pytest.mark.parametrize("seed", range(4))
def test_a_path_keeps_the_constraint_and_never_jumps(seed: int) -> None:
    post = messages.Box(name="post", size=(0.2, 0.2, 1.0), position=(0.35, 0.35, 0.5))
    made, keeper = upright("continuous y oblique-continuous y", 0.7, post)
    rng, ends = np.random.default_rng(seed), []
    while len(ends) < 2:
        z = keeper.bring_back(made.group.to_local(made.group.random(rng)))
        if z is not None and not made.batch.touching(z[None])[0]:
            ends.append(z)
    found = connect_constrained(made, keeper, ends[0], np.array(ends[1:]), rng)
    assert found.status is Status.SUCCESS
    np.testing.assert_array_equal(found.path[0], ends[0])
    last, goal = (made.group.from_local(z) for z in (found.path[-1], ends[1]))
    np.testing.assert_allclose(last, goal, atol=1e-9)
    for a, b in pairwise(found.path):
        assert apart(made, a, b) <= FARTHEST_STRIDE * STRIDE + 1e-6
        for t in (0.0, 0.5, 1.0):
            q = made.group.expand_from_local(a + t * (b - a))
            axis = made.kinematics.frame_placement(q, made.group.tip_id).rotation[:, 2]
            assert np.arccos(np.clip(axis[2], -1.0, 1.0)) <= 0.7 + 1e-6
            assert not made.world.in_collision(q)


DOWN = pin.SE3(pin.Quaternion(0.0, 1.0, 0.0, 0.0).matrix(), np.array([0.45, 0.2, 0.45]))
PLACE = np.array([0.45, 0.2, 0.45])
X, Y, Z = np.eye(3)

CONSTRAINTS: dict[str, Any] = {
    "cone": Cone("panda_hand_tcp", Z, -Z, 1e-4),
    "cone beside the goal": Cone("panda_hand_tcp", Z, np.array([np.sin(8e-4), 0.0, -np.cos(8e-4)]), 1e-4),
    "plane": plane("panda_hand_tcp", PLACE + 8e-4 * Z, Z, 5e-5),
    "line": line("panda_hand_tcp", PLACE + 6e-4 * Y, X, 5e-5),
    "point": point("panda_hand_tcp", PLACE + 4e-4, 5e-5),
}


@pytest.mark.parametrize("constraint", CONSTRAINTS.values(), ids=CONSTRAINTS)
def test_goals_keep_narrow_constraints_within_their_tolerances(constraint: Any) -> None:
    target = PoseTarget(DOWN, np.full(3, 1e-3), np.full(3, 1e-3))
    made = problem("panda", scene_of(), TipGoal(target), path_constraints=(constraint,))
    goals = find_goal_points(made)
    assert len(goals) > 1
    frames = made.constrained_frames
    for z in goals:
        placed = made.kinematics.frame_placement(made.group.expand_from_local(z), made.group.tip_id)
        assert target.is_reached(placed)
        assert constraint.value(placed) <= constraint.limit
        assert frames.values(z)[0] <= constraint.limit
        assert ((z >= made.group.lower) & (z <= made.group.upper)).all()


def test_a_goal_that_no_tolerance_brings_to_the_constraint_stays_as_it_is() -> None:
    target = PoseTarget(DOWN, np.full(3, 1e-3), np.full(3, 1e-3))
    far = plane("panda_hand_tcp", PLACE + 0.01 * Z, Z, 5e-5)
    free = find_goal_points(problem("panda", scene_of(), TipGoal(target)))
    made = problem("panda", scene_of(), TipGoal(target), path_constraints=(far,))
    assert free is not None
    assert np.array_equal(PoseKeeper(made, target)(free), free)
