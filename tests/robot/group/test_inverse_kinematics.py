"""Inverse kinematics, judged by the forward kinematics of the whole robot and by arms with closed solutions."""

import itertools
import math
import random
import re

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.messages.requests import PoseGoal, TargetPose
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.inverse_kinematics import EXACT, PoseTarget, solve
from guidefield.robot.group.kinematics import DISTINCT
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import configuration_from_wire, configuration_to_wire
from tests.robot.random_chains import chain
from tests.robots import ARMS, box_arm, group, grouped, random_configuration, rest, robot

ZERO, FREE = np.zeros(3), np.full(3, np.inf)
ROUNDING = 1e-12


def tip(planned: PlanningGroup, z: np.ndarray) -> pin.SE3:
    """Where the tip is at local coordinates, by the model of the whole robot."""
    model, values = planned.robot.model, configuration_to_wire(planned.joints, planned.from_local(z))
    data = model.createData()
    pin.framesForwardKinematics(model, data, configuration_from_wire(planned.robot, values, base=planned.q_reference))
    return data.oMf[planned.robot.frame_id(planned.tip)].copy()


def exact(placement: pin.SE3) -> PoseTarget:
    return PoseTarget(placement, ZERO, ZERO)


def drawn(planned: PlanningGroup, seed: int) -> np.ndarray:
    """A random local coordinates."""
    return planned.to_local(random_configuration(planned, seed))


def resting(planned: PlanningGroup) -> np.ndarray:
    """The local coordinates of rest."""
    return planned.to_local(rest(planned))


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


@pytest.mark.parametrize("name", ARMS)
def test_a_start_leads_to_the_first_solution(name):
    planned = group(name)
    z = drawn(planned, 5)
    reached = found(planned, exact(tip(planned, z)), [z]).solutions[0]
    assert np.allclose(reached, z, rtol=0.0, atol=ROUNDING)
    reached = found(planned, exact(tip(planned, z)), [z + 0.01]).solutions[0]
    assert np.abs(planned.difference(planned.from_local(z), planned.from_local(reached))).max() < 0.1


@settings(max_examples=15)
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


@pytest.mark.parametrize("kind", ["y", "continuous"])
def test_a_planar_arm_has_its_two_solutions_in_closed_form(kind):
    planned = grouped(box_arm(kind, 3))
    a, b, c = 0.4, 1.1, -0.3
    goal = tip(planned, np.array([a, b, c]))
    result = found(planned, exact(goal))
    assert result.reason == "2 distinct solutions from 128 starts"
    elbow_up_and_down = np.array([[a, b, c], [a + b, -b, b + c]])  # two links of one length: the triangle flipped
    points = np.array(sorted((z.tolist() for z in result.solutions), key=lambda z: z[0]))
    assert np.allclose(points, elbow_up_and_down, rtol=0.0, atol=1e-5)


def test_moving_base_and_goal_alike_changes_nothing():
    T_world_base = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 1.0), np.array([1.0, -2.0, 0.5]))
    panda = robot("panda")
    moved, still = select(panda, None, None, panda.rest, T_world_base), group("panda")
    goal = tip(still, random_configuration(still, 3))
    there = found(moved, exact(T_world_base * goal), seed=1)
    here = found(still, exact(goal), seed=1)
    assert np.allclose(there.solutions, here.solutions, rtol=0.0, atol=1e-4)


@settings(max_examples=12)
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
