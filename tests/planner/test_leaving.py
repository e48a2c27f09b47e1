"""A slight contact at the start is left on request: what touches never comes closer, everything else stays free."""

import dataclasses

import coal
import msgspec
import numpy as np
import pytest

from guidefield.collision.clearance import clearance_at, contacts_at
from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.planner.judgement import GivenProblem, Judgement, judge
from guidefield.planner.motion.limit_load import measure_limit_shares
from guidefield.planner.motion.submitted_motion import CurveKind, SubmittedMotion
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.plan import plan
from guidefield.planner.task.problem import Conditions, Problem
from guidefield.prove.certificate import certify
from guidefield.robot.group.group import Alike
from tests.planner.limit_attack import extremes
from tests.planner.problems import problem, scene_of, to_configuration
from tests.planner.test_schedule import flight
from tests.robots import group, rest


def pressed(depth: float) -> Problem:
    """The hand pressed into a board from above, and a goal beside."""
    arm = group("panda")
    start, goal = rest(arm), rest(arm)
    goal[0] += 0.7
    tip = problem(arm, scene_of(), planes=()).kinematics.tip_position(start)

    def with_top(height: float) -> Problem:
        board = messages.Box(name="board", size=(0.04, 0.04, 0.02), position=(tip[0], tip[1], height - 0.01))
        return problem(arm, scene_of(board), to_configuration(goal, arm), planes=(), leave_start_contact=True)

    low, high = tip[2] - 0.3, tip[2] + 0.2
    for _ in range(30):
        middle = 0.5 * (low + high)
        deep = clearance_at(with_top(middle).world, start).obstacle_distance < -depth
        low, high = (low, middle) if deep else (middle, high)
    return with_top(low)


def test_a_slight_contact_is_left_and_the_rest_certified() -> None:
    made = pressed(0.003)
    contacts = contacts_at(made.world, made.q_start)
    assert contacts
    assert plan(dataclasses.replace(made, leave_start_contact=False)).status is Status.START_STATE_IN_COLLISION
    result = plan(made)
    assert result.status is Status.SUCCESS, result.message
    assert "board" in result.warnings[0]
    motion = result.trajectory
    assert 0.0 < result.judged_from < motion.duration
    np.testing.assert_allclose(motion.positions[0], made.q_start)
    times = np.linspace(0.0, motion.duration, 400)
    qs = motion.evaluate(times)[0]
    distances = np.array([clearance_at(made.world, q).obstacle_distance for q in qs])
    leaving = times <= result.judged_from
    assert distances[0] == pytest.approx(-0.003, abs=5e-4)
    assert (np.diff(distances[leaving]) > -1e-5).all()
    assert (distances[~leaving] > 0.0).all()
    assert not any(made.world.in_collision(q) for q in qs[~leaving])
    pairs = {contact.pair for contact in contacts}
    assert all({contact.pair for contact in contacts_at(made.world, q)} <= pairs for q in qs[leaving])
    k = int(np.searchsorted(motion.times, result.judged_from))
    np.testing.assert_array_equal(motion.velocities[k], 0.0)
    assert certify(made.world, motion.bezier()[k:]).free


def among(made: Problem, times: list[float], *paths: tuple[float, float, float]) -> Problem:
    """The same with the board on its way from where it stands."""
    (board,) = made.scene.message.obstacles
    places = [tuple(np.add(board.position, path).tolist()) for path in paths]
    moving = msgspec.structs.replace(board, trajectory=flight(times, *places))
    return problem(made.group, scene_of(moving), made.goal, planes=(), leave_start_contact=True)


@pytest.mark.parametrize(
    ("times", "way"), [([0.0, 2.0], (0.3, 0.0, 0.0)), ([0.2, 1.5], (0.3, 0.0, 0.2)), ([-1.0, 2.0], (0.0, 0.0, -0.1))]
)
def test_a_contact_with_what_moves_is_left_and_the_rest_certified_in_time(times, way):
    still = pressed(0.003)
    since = np.multiply(way, max(-times[0], 0.0) / (times[1] - times[0]))  # where it is at time 0 it is touched
    made = among(still, times, tuple(-since), tuple(np.subtract(way, since)))
    result = plan(made)
    assert result.status is Status.SUCCESS, result.message
    assert "board" in result.warnings[0]
    motion = result.trajectory
    until = result.judged_from
    assert 0.0 < until < motion.duration
    samples, apart = np.linspace(0.0, motion.duration + 0.5, 400), []
    for now, q in zip(samples.tolist(), motion.evaluate(np.minimum(samples, motion.times[-1]))[0], strict=True):
        (board,), robot = made.scene.at(now).obstacles, made.world
        robot.place(q)
        links = [robot.exact.shape(body) for body in range(robot.pairs.links)]
        there = coal.Transform3s(board.placement.rotation, board.placement.translation)
        distances = []
        for body in robot.pairs.moving.tolist():
            at, result_of = robot.placement(body), coal.DistanceResult()
            here = coal.Transform3s(at.rotation, at.translation)
            distances.append(coal.distance(links[body], here, board.shape, there, coal.DistanceRequest(), result_of))
        apart.append(min(distances))
    left = samples > until
    assert apart[0] < 0.0 < min(np.array(apart)[left])
    assert (np.diff(np.array(apart)[~left]) > -1e-5).all()
    judged = certify_as_given(made, motion)
    assert judged.verdict.free
    assert judged.leaving.leaves


def certify_as_given(made: Problem, motion: Trajectory) -> Judgement:
    """A motion of a problem, judged as anybody's."""
    fields = {field.name: getattr(made, field.name) for field in dataclasses.fields(Conditions)}
    rows = np.arange(len(motion.times))
    given = SubmittedMotion(CurveKind.HERMITE, motion.positions, rows, motion.times, motion.velocities)
    return judge(GivenProblem(**fields, motion=given), measure_limit_shares(given, made.group, None))


def test_what_presses_on_the_robot_is_refused() -> None:
    made = among(pressed(0.003), [0.0, 0.5], (0.0, 0.0, 0.0), (0.0, 0.0, 0.01))
    result = plan(made)
    assert result.status is Status.START_STATE_IN_COLLISION
    assert "no short motion leads out of it" in result.message
    still = plan(pressed(0.003)).trajectory
    assert still is not None
    refused = certify_as_given(made, still)
    assert not refused.leaving.leaves


def test_a_deep_contact_is_refused_with_its_depth() -> None:
    result = plan(pressed(0.03))
    assert result.status is Status.START_STATE_IN_COLLISION
    assert "deeper" in result.message
    assert result.details["depth"] > 0.01


def test_a_free_start_is_planned_as_ever() -> None:
    free = pressed(-0.02)
    result = plan(free)
    assert result.status is Status.SUCCESS
    assert result.judged_from == 0.0
    assert not result.warnings


@pytest.mark.parametrize("jerk", [None, 100.0])
def test_limits_are_kept_while_a_contact_is_left(jerk: float | None) -> None:
    made = pressed(0.003)
    start, goal = made.q_start, made.goal.configurations[0]
    lower, upper = np.array(made.group.lower), np.array(made.group.upper)
    lower[:3], upper[4:] = np.minimum(start, goal)[:3], np.maximum(start, goal)[4:]  # the start is at many limits
    arm = dataclasses.replace(made.group, lower=lower, upper=upper, alike=Alike())
    jerks = None if jerk is None else np.full(arm.nv, jerk)
    limited = problem(arm, made.scene, made.goal, planes=(), leave_start_contact=True, jerk_limits=jerks)
    result = plan(limited)
    assert result.status is Status.SUCCESS, result.message
    motion = result.trajectory
    assert result.judged_from > 0.0
    low, high, *_ = extremes(motion.times, motion.positions, motion.velocities)
    assert (low >= lower - 1e-9).all()
    assert (high <= upper + 1e-9).all()
