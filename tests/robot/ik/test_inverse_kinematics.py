"""Inverse kinematics, judged by the forward kinematics of the whole robot and by arms with closed solutions."""

import itertools
import math
import random
import re

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.deadline import Deadline
from guidefield.messages.requests import PoseGoal, TargetPose
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.robot.group.tip_chain import DISTINCT, chain_to_tip
from guidefield.robot.ik.inverse_kinematics import solve
from guidefield.robot.ik.pose_search import EXACT, PoseTarget
from guidefield.robot.model.configuration import configuration_from_wire, configuration_to_wire
from tests.robot.random_chains import chain
from tests.robots import ARMS, box_arm, group, grouped, random_configuration, rest, robot

ZERO, FREE = np.zeros(3), np.full(3, np.inf)
ROUNDING = 1e-12


def tip(planned: PlanningGroup, z: np.ndarray) -> pin.SE3:
    """Where the tip is at a chart point, by the model of the whole robot."""
    model, values = planned.robot.model, configuration_to_wire(planned.joints, planned.from_chart(z))
    data = model.createData()
    pin.framesForwardKinematics(model, data, configuration_from_wire(planned.robot, values, base=planned.q_reference))
    return data.oMf[planned.robot.frame_id(planned.tip)].copy()


def exact(placement: pin.SE3) -> PoseTarget:
    return PoseTarget(placement, ZERO, ZERO)


def drawn(planned: PlanningGroup, seed: int) -> np.ndarray:
    """A random chart point."""
    return planned.chart(random_configuration(planned, seed))


def resting(planned: PlanningGroup) -> np.ndarray:
    """The chart point of rest."""
    return planned.chart(rest(planned))


def found(planned, target, starts=(), count=8, seed=0, **options):
    return solve(planned, target, starts, count, rng=np.random.default_rng(seed), **options)


def rotation_angle(R: np.ndarray) -> float:
    """Angle of a small rotation, from its skew part: no logarithm shared with the code under test."""
    skew = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return math.atan2(float(np.linalg.norm(skew)), 0.5 * (np.trace(R) - 1.0))


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("seed", range(6))
def test_solutions_reach_the_pose_by_the_whole_robots_kinematics(name, seed):
    planned = group(name)
    goal = tip(planned, drawn(planned, seed))
    result = found(planned, exact(goal), seed=seed)
    assert result.solutions
    assert (result.reason == "") == (len(result.solutions) == 8)
    for z in result.solutions:
        here = tip(planned, z)
        assert np.linalg.norm(here.translation - goal.translation) <= EXACT
        assert rotation_angle(goal.rotation.T @ here.rotation) <= EXACT
        assert (planned.lower - ROUNDING <= z).all()
        assert (z <= planned.upper + ROUNDING).all()
    for z0, z1 in itertools.combinations(result.solutions, 2):
        turn = z1 - z0
        for joint in planned.joints:
            if joint.nq == 2:
                turn[joint.idx_v] = math.remainder(turn[joint.idx_v], math.tau)
        assert np.abs(turn).max() > DISTINCT


def test_a_redundant_arm_has_as_many_as_are_asked():
    planned = group("panda")
    goal = exact(tip(planned, resting(planned)))
    for count in (1, 8, 20):
        result = found(planned, goal, count=count)
        assert (len(result.solutions), result.reason) == (count, "")


def test_the_same_generator_gives_the_same_solutions():
    planned = group("ur5")
    goal = exact(tip(planned, drawn(planned, 1)))
    first, again, other = (found(planned, goal, seed=seed).solutions for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("name", ARMS)
def test_a_start_leads_to_the_first_solution(name):
    planned = group(name)
    z = drawn(planned, 5)
    reached = found(planned, exact(tip(planned, z)), [z]).solutions[0]
    assert np.allclose(reached, z, rtol=0.0, atol=ROUNDING)
    reached = found(planned, exact(tip(planned, z)), [z + 0.01]).solutions[0]
    assert np.abs(planned.difference(planned.from_chart(z), planned.from_chart(reached))).max() < 0.1


def test_starts_beyond_the_limits_are_brought_back():
    planned = group("panda")
    goal = exact(tip(planned, drawn(planned, 2)))
    result = found(planned, goal, [planned.upper + 1.0], count=1)
    assert (planned.lower <= result.solutions[0]).all()
    assert (result.solutions[0] <= planned.upper).all()


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 2**32), st.lists(st.sampled_from([0.0, 0.01, 0.3, np.inf]), min_size=6, max_size=6))
def test_tolerances_are_a_box_in_the_goals_frame(seed, tolerances):
    planned = group("panda")
    q_inside = drawn(planned, seed)
    goal = tip(planned, q_inside)
    target = PoseTarget(goal, np.array(tolerances[:3]), np.array(tolerances[3:]))
    result = found(planned, target, [q_inside], seed=seed, count=4)
    assert result.solutions
    for q in result.solutions:
        here = tip(planned, q)
        assert target.is_reached(here)
        position = goal.rotation.T @ (here.translation - goal.translation)
        assert (np.abs(position) <= np.maximum(tolerances[:3], EXACT)).all()
        rotation = pin.AngleAxis(goal.rotation.T @ here.rotation)
        assert (np.abs(rotation.angle * rotation.axis) <= np.maximum(tolerances[3:], EXACT) + 1e-9).all()


def test_tolerances_are_used():
    planned = group("panda")
    goal = tip(planned, drawn(planned, 0))
    beyond = goal * pin.SE3(np.eye(3), np.array([0.0, 0.0, 3.0]))
    assert not found(planned, exact(beyond)).solutions
    assert found(planned, PoseTarget(beyond, np.array([0.0, 0.0, np.inf]), ZERO)).solutions


@pytest.mark.parametrize("kind", ["y", "continuous"])
def test_a_planar_arm_has_its_two_solutions_in_closed_form(kind):
    planned = grouped(box_arm(kind, 3))
    a, b, c = 0.4, 1.1, -0.3
    goal = tip(planned, np.array([a, b, c]))
    result = found(planned, exact(goal))
    assert result.reason == "2 distinct solutions from 128 starts"
    elbow_up_and_down = np.array([[a, b, c], [a + b, -b, b + c]])  # two links of one length: the triangle flipped
    charts = np.array(sorted((z.tolist() for z in result.solutions), key=lambda z: z[0]))
    assert np.allclose(charts, elbow_up_and_down, rtol=0.0, atol=1e-5)


def test_a_sliding_joint_has_its_length():
    planned = grouped(box_arm("y slide", 2, size=0.3))
    q = np.array([0.5, 0.4])
    goal = tip(planned, q)
    assert np.allclose(goal.translation, [0.7 * math.sin(0.5), 0.0, 0.3 + 0.7 * math.cos(0.5)])
    result = found(planned, PoseTarget(goal, ZERO, FREE))
    assert len(result.solutions) == 1  # the other one is beyond a limit
    assert np.allclose(result.solutions[0], q, rtol=0.0, atol=1e-5)


def test_moving_base_and_goal_alike_changes_nothing():
    T_world_base = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 1.0), np.array([1.0, -2.0, 0.5]))
    panda = robot("panda")
    moved, still = select(panda, None, None, panda.rest, T_world_base), group("panda")
    goal = tip(still, random_configuration(still, 3))
    there = found(moved, exact(T_world_base * goal), seed=1)
    here = found(still, exact(goal), seed=1)
    assert np.allclose(there.solutions, here.solutions, rtol=0.0, atol=1e-4)


@settings(deadline=None, max_examples=12)
@given(st.lists(st.floats(-4.0, 4.0), min_size=3, max_size=3), st.sampled_from([0.0, 0.2, np.inf]))
def test_what_is_called_out_of_reach_is_at_least_so_far(position, tolerance):
    planned = group("panda")
    target = PoseTarget(pin.SE3(np.eye(3), np.array(position)), np.array([0.0, tolerance, 0.0]), FREE)
    match = re.fullmatch(r"out of reach: at least (\d+) mm short, as .*", found(planned, target, count=1).reason)
    if match is None:
        return
    rng = np.random.default_rng(0)
    for _ in range(50):
        here = tip(planned, planned.random(rng)).translation - position
        here[1] = max(abs(here[1]) - tolerance, 0.0)
        assert np.linalg.norm(here) >= 0.001 * int(match[1])


def test_out_of_reach_counts_what_slides():
    planned = grouped(box_arm("y slide", 2, size=0.3))
    for distance, reached in ((2.2, True), (2.4, False)):
        goal = PoseTarget(pin.SE3(np.eye(3), np.array([distance, 0.0, 0.3])), ZERO, FREE)
        result = found(planned, goal, count=1)
        assert bool(result.solutions) is reached
    assert result.reason == "out of reach: at least 99 mm short, as the chain to the tip is 2.3 m long"


def test_a_place_beyond_a_limit():
    planned = grouped(box_arm("y", 2, size=0.3))
    angle = 2.5  # half a radian beyond the limit of the first joint
    goal = np.array([0.3 * math.sin(angle), 0.0, 0.3 + 0.3 * math.cos(angle)])
    result = found(planned, PoseTarget(pin.SE3(np.eye(3), goal), ZERO, FREE), [planned.lower])
    assert result.solutions == ()
    chord = 1000.0 * 2.0 * 0.3 * math.sin(0.25)
    assert result.reason == (
        f"no solution from 257 starts: the tip gets no nearer to the place than {chord:.3g} mm, in any orientation;"
        " without limits it is reached: j1 would have to be at 2.5, its limits are [-2, 2]"
    )
    assert result.details == {
        "cause": "position",
        "position_off": pytest.approx(0.001 * chord, abs=1e-6),
        "joint": "j1",
        "value": pytest.approx(angle, abs=1e-5),
        "limits": [-2.0, 2.0],
    }


def test_a_place_in_reach_but_not_in_this_orientation():
    planned = grouped(box_arm("y", 3, size=0.3))
    angle = 0.7  # about x, which no joint can
    goal = tip(planned, np.array([0.4, 1.1, -0.3])) * pin.SE3(pin.exp3(np.array([angle, 0.0, 0.0])), np.zeros(3))
    result = found(planned, exact(goal))
    assert result.solutions == ()
    assert "the place is in reach, but not in this orientation" in result.reason
    assert result.details["cause"] == "orientation"
    # the arm turns about y alone: each R_y(t) R_x(-angle) turns by at least the angle, its axis may be oblique
    allowed = [
        np.abs(pin.log3(pin.exp3(np.array([-angle, 0.0, 0.0])) @ pin.exp3(np.array([0.0, t, 0.0])))).max()
        for t in np.linspace(-2.0, 2.0, 2001)
    ]
    assert min(allowed) - 1e-3 <= result.details["orientation_off"] <= min(allowed) + 2.0 * math.pi / 2**8


def test_out_of_reach_is_told_as_a_number():
    planned = group("panda")
    result = found(planned, PoseTarget(pin.SE3(np.eye(3), np.array([3.0, 0.0, 0.0])), ZERO, FREE))
    short = result.details["short_by"]
    assert (result.details["cause"], 0.5 < short < 3.0) == ("out of reach", True)
    assert result.reason.startswith(
        f"out of reach: at least {int(1000 * short)} mm short, as the chain to the tip is 1."
    )


def test_solutions_that_are_not_accepted_are_counted():
    planned = group("panda")
    goal = exact(tip(planned, resting(planned)))
    none = found(planned, goal, accept=lambda zs: np.zeros(len(zs), bool))
    assert none.solutions == ()
    assert re.fullmatch(r"\d+ distinct solutions from \d+ starts, all in collision", none.reason)
    assert len(none.rejected) == none.details["solutions"] == int(none.reason.split()[0])
    for q in none.rejected:
        assert goal.is_reached(tip(planned, q))
    right = found(planned, goal, accept=lambda zs: zs[:, 0] > 0.5)
    assert len(right.solutions) == 8
    assert all(q[0] > 0.5 for q in right.solutions)
    assert all(q[0] <= 0.5 for q in right.rejected)
    arm = grouped(box_arm("y", 3))
    goal = exact(tip(arm, np.array([0.4, 1.1, -0.3])))
    one = found(arm, goal, accept=lambda zs: zs[:, 1] > 0.0, fault="too close")
    assert one.reason == "1 distinct solution from 128 starts, 1 more is too close"
    assert not one.exhausted


def test_a_search_that_finds_nothing_new_is_exhausted():
    arm = grouped(box_arm("y", 3))
    goal = exact(tip(arm, np.array([0.4, 1.1, -0.3])))
    none = found(arm, goal, accept=lambda zs: np.zeros(len(zs), bool))
    assert none.exhausted
    assert len(none.rejected) == 2
    longer = found(arm, goal, accept=lambda zs: np.zeros(len(zs), bool), most=8192)
    assert np.array_equal(longer.rejected, none.rejected)
    assert not found(arm, goal, accept=lambda zs: np.zeros(len(zs), bool), most=64).exhausted


def test_it_stops_when_it_is_told_to():
    planned = group("panda")
    goal = exact(tip(planned, resting(planned)))
    rounds = []

    def none(zs):
        return np.zeros(len(zs), bool)

    result = found(
        planned, goal, accept=none, deadline=Deadline(is_cancelled=lambda: bool(rounds.append(0)) or len(rounds) > 2)
    )
    assert result.reason.endswith("from 128 starts, all in collision")
    assert found(planned, goal, [resting(planned)], deadline=Deadline(0.0)).solutions  # what the starts lead to


def test_solutions_lie_far_apart():
    planned = group("panda")
    chain = chain_to_tip(planned)
    for seed in range(5):
        goal = exact(tip(planned, drawn(planned, seed)))
        eight = np.array(found(planned, goal, count=8).solutions)
        many = np.array(found(planned, goal, count=64).solutions)
        least = [np.linalg.norm(a - b) for a, b in itertools.combinations(eight, 2)]
        among_many = [np.linalg.norm(a - b) for a, b in itertools.combinations(many[:8], 2)]
        assert min(least) > 0.5
        assert min(among_many) >= 0.5 * min(least)  # first those farthest apart, however many are asked for
    assert not chain.measure.periods[chain.turning].size


def test_whole_turns_come_last():
    planned = grouped(box_arm("wide", 3))
    q = np.array([0.4, 1.1, -0.3])
    goal = exact(tip(planned, q))
    start = q + 2.0 * math.pi * np.array([1.0, 0.0, 1.0])
    two = np.array(found(planned, goal, [start], count=2).solutions)
    assert np.allclose(two[0], start, rtol=0.0, atol=1e-9)
    for value, near in zip(two[1], start, strict=True):  # of all turns within the limits the nearest to the start
        turns = [value + 2.0 * math.pi * k for k in range(-3, 4) if abs(value + 2.0 * math.pi * k) <= 7.0]
        assert abs(value - near) == pytest.approx(min(abs(turn - near) for turn in turns))
    many = found(planned, goal, [q], count=20).solutions
    assert len(many) == 20
    for a, b in itertools.combinations(many, 2):
        assert np.abs(a - b).max() > DISTINCT
    for q in many:
        assert (np.abs(q) <= 7.0).all()
        assert goal.is_reached(tip(planned, q))


def test_joints_that_do_not_move_the_tip_stay():
    planned = grouped(box_arm("y", 4), tip="l3")
    assert planned.nq == 3
    whole = select(planned.robot, ["j1", "j2", "j3", "j4"], "l3", planned.robot.rest, pin.SE3.Identity())
    start = np.array([0.1, 0.2, 0.3, 0.77])
    result = found(whole, exact(tip(whole, np.array([0.4, 1.1, -0.3, 0.0]))), [start])
    assert len(result.solutions) == 2
    assert [q[3] for q in result.solutions] == [0.77, 0.77]


@pytest.mark.parametrize("arm", ["floating y", "planar y slide x", "chain_moving_3x260_r20", "y mimic x x mimic x"])
def test_joints_of_several_degrees_of_freedom(arm):
    planned = grouped(box_arm(arm, len(arm.split()))) if " " in arm else group(arm)
    for seed in range(4):
        goal = exact(tip(planned, drawn(planned, seed)))
        result = found(planned, goal, [resting(planned)], seed=seed, count=4)
        assert result.solutions
        for z in result.solutions:
            assert goal.is_reached(tip(planned, z))
            assert (planned.lower - ROUNDING <= z).all()
            assert (z <= planned.upper + ROUNDING).all()


@pytest.mark.parametrize("seed", range(1, 13))
def test_random_chains_reach_the_poses_that_they_have(seed):
    planned = grouped(chain(random.Random(seed), seed))
    target = exact(tip(planned, drawn(planned, seed)))
    result = found(planned, target, [resting(planned)], count=3, seed=seed)
    assert result.solutions
    for z in result.solutions:
        assert target.is_reached(tip(planned, z))
        assert (planned.lower - 1e-9 <= z).all()
        assert (z <= planned.upper + 1e-9).all()


def test_a_target_from_the_wire():
    pose = TargetPose((1.0, 2.0, 3.0), (0.0, 0.0, 0.70710678, 0.70710678), (0.1, None, 0.0), (None, 0.2, 0.0))
    target = PoseTarget.from_wire(pose)
    assert np.array_equal(target.position_tolerance, [0.1, np.inf, 0.0])
    assert np.array_equal(target.orientation_tolerance, [np.inf, 0.2, 0.0])
    assert np.allclose(target.placement.rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert np.allclose(target.placement.rotation @ target.placement.rotation.T, np.eye(3), rtol=0.0, atol=1e-15)
    goal = PoseTarget.from_wire(PoseGoal((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0)))
    assert goal.position_tolerance.max() == 1e-4
    for array in (target.position_tolerance, target.orientation_tolerance):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
