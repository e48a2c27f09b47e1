"""Limits of joints that follow others bind the joints they follow."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.engine import answer
from guidefield.errors import RobotInvalid
from guidefield.messages.requests import JointLimits, UrdfText
from guidefield.messages.scene import Scene
from guidefield.messages.streams import StreamOpen
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import FURTHEST, limit_faults
from guidefield.robot.model.followers import follow
from guidefield.scene.scene import build
from guidefield.stream.opening import read_opening
from tests.robots import load

BODY = '<link name="l{i}"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>'
JOINT = (
    '<joint name="j{i}" type="{kind}"><origin xyz="0 0 0.3"/><parent link="l{p}"/><child link="l{i}"/>'
    '<axis xyz="0 1 0"/><limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/>{mimic}</joint>'
)


def arm(*joints: tuple[str, float, float, str]) -> UrdfText:
    parts = [BODY.format(i=0)]
    for i, (kind, lower, upper, mimic) in enumerate(joints, 1):
        parts += [BODY.format(i=i), JOINT.format(i=i, p=i - 1, kind=kind, lower=lower, upper=upper, mimic=mimic)]
    return UrdfText(text=f'<robot name="arm">{"".join(parts)}</robot>')


def mimic(driver: int, multiplier: float, offset: float) -> str:
    return f'<mimic joint="j{driver}" multiplier="{multiplier}" offset="{offset}"/>'


def test_a_driver_goes_only_where_its_follower_keeps_its_limits():
    robot = load(arm(("revolute", -2, 2, ""), ("revolute", -0.5, 1, mimic(1, -2.0, 0.5))))
    assert robot.joints[0].lower == pytest.approx([-0.25])  # -2 x + 0.5 <= 1
    assert robot.joints[0].upper == pytest.approx([0.5])  # -2 x + 0.5 >= -0.5
    assert any("'j1', which 'j2' follows, only goes from -0.25 to 0.5" in warning for warning in robot.warnings)


def test_a_driver_that_turns_on_and_on_goes_where_its_followers_keep_their_limits():
    robot = load(
        arm(("continuous", 0, 0, ""), ("revolute", -1, 4, mimic(1, 0.5, 1.0)), ("prismatic", 0, 1, mimic(1, 0.1, 0)))
    )
    assert robot.joints[0].lower == pytest.approx([0.0])
    assert robot.joints[0].upper == pytest.approx([6.0])
    assert sum("only goes from" in warning for warning in robot.warnings) == 2


def test_a_driver_goes_no_further_than_can_be_asked_for():
    robot = load(arm(("continuous", 0, 0, ""), ("prismatic", -1, 1, mimic(1, 1e-6, 0.0))))
    assert (robot.joints[0].lower[0], robot.joints[0].upper[0]) == (-FURTHEST, FURTHEST)


def test_what_cannot_be_kept_is_told():
    robot = load(arm(("revolute", 0, 1, ""), ("revolute", 5, 6, mimic(1, 1.0, 0.0))))
    assert any("can't move with 'j2' within its limits: they are not kept" in warning for warning in robot.warnings)
    assert robot.joints[0].upper == 1.0
    assert np.isinf([robot.joints[1].lower, robot.joints[1].upper]).all()
    assert not limit_faults(robot.joints, robot.rest), "nothing that is told as not kept is a fault of a start"
    turning = arm(
        ("continuous", 0, 0, ""), ("revolute", 5, 6, mimic(1, 1.0, 0.0)), ("prismatic", 1, 2, mimic(1, 1.0, 0.0))
    )
    robot = load(turning)
    assert robot.joints[0].kind == "revolute"
    assert (robot.joints[0].lower[0], robot.joints[0].upper[0]) == (5.0, 6.0)
    assert any("can't move with 'j3' within its limits: they are not kept" in warning for warning in robot.warnings)
    assert not limit_faults(robot.joints, robot.rest)


def test_a_follower_of_a_fixed_joint_is_refused():
    fixed = arm(("fixed", 0, 0, ""), ("revolute", -1, 1, mimic(1, 1.0, 0.0)))
    with pytest.raises(RobotInvalid):
        load(fixed)


RANGE = st.tuples(st.floats(-3, 0), st.floats(0, 3))


@settings(deadline=None, max_examples=15)
@given(RANGE, RANGE, st.floats(-2, 2).filter(lambda m: m == 0.0 or abs(m) > 1e-3), st.floats(-1, 1), st.integers(0, 99))
def test_no_random_configuration_puts_a_follower_beyond_its_limits(first, second, multiplier, offset, seed):
    robot = load(arm(("revolute", *first, ""), ("revolute", *second, mimic(1, multiplier, offset))))
    if any("not kept" in warning for warning in robot.warnings) or multiplier == 0.0:
        return
    group = select(robot, ["j1"], None, robot.rest, pin.SE3.Identity())
    q = np.array(robot.rest)
    q[:1] = group.random(np.random.default_rng(seed))
    follow(robot.joints, q)
    assert all(fault.excess <= 2e-5 for fault in limit_faults(robot.joints, q))


GEARED = (
    '<robot name="c"><link name="base"/>{links}'
    '<joint name="a" type="revolute"><origin xyz="0 0 0.2"/><parent link="base"/><child link="A"/><axis xyz="1 0 0"/>'
    '<limit lower="-1" upper="1" velocity="0.5" effort="9"/></joint>'
    '<joint name="b" type="revolute"><origin xyz="0 0 0.2"/><parent link="A"/><child link="B"/><axis xyz="1 0 0"/>'
    '<limit lower="-3" upper="3" velocity="{velocity}" effort="9"/><mimic joint="a" multiplier="-2.4"/></joint>'
    '<joint name="c" type="prismatic"><origin xyz="0 0 0.2"/><parent link="B"/><child link="C"/><axis xyz="0 1 0"/>'
    '<limit lower="-3" upper="3" velocity="9" effort="9"/><mimic joint="b" multiplier="0.5" offset="0.2"/>'
    "</joint></robot>"
)
LINKS = "".join(
    f'<link name="{name}"><collision><geometry><sphere radius="0.02"/></geometry></collision></link>' for name in "ABC"
)
EMPTY = {"name": "empty", "obstacles": []}


def geared(velocity: float = 1.0) -> dict[str, str]:
    return {"type": "urdf", "text": GEARED.format(links=LINKS, velocity=velocity)}


def fastest(**request: object) -> tuple[float, float]:
    """Largest velocity and acceleration of joint a in a plan; the acceleration from velocities close together."""
    goal = {"type": "joints", "positions": {"a": 0.9}}
    reply = answer(
        {"robot": geared(), "scene": EMPTY, "start": {"a": -0.9}, "goal": goal, "sample_rate": 500, **request}
    )
    assert reply.status.name == "SUCCESS", reply.status
    velocities = np.array(reply.trajectory.velocities)[:, 0]
    return float(np.abs(velocities).max()), float(np.abs(np.diff(velocities) / np.diff(reply.trajectory.times)).max())


def test_velocity_limits_of_followers_bind_the_joint_that_is_planned():
    robot = load(UrdfText(text=geared()["text"]))
    group = select(robot, ["a"], None, robot.rest, pin.SE3.Identity())
    assert group.velocity_limits == pytest.approx([1 / 2.4])
    assert group.acceleration_limits == pytest.approx([2 / 2.4])
    assert group.joints[0].velocity_owner == "b"
    assert any("joint 'a', which 'b' follows, moves at 0.416667 at most" in told for told in robot.warnings)
    velocity, _ = fastest()
    assert 0.9 / 2.4 < velocity <= 1 / 2.4 + 1e-9


def test_a_request_may_limit_a_follower():
    velocity, acceleration = fastest(limits={"b": {"velocity": 0.5, "acceleration": 0.3}})
    assert 0.9 * 0.5 / 2.4 < velocity <= 0.5 / 2.4 + 1e-9
    assert acceleration <= 0.3 / 2.4 + 1e-6
    assert fastest(limits={"b": {"velocity": 9.0}})[0] == pytest.approx(0.5, rel=1e-2)
    assert fastest(limits={"a": {"velocity": 9.0}})[0] <= 1 / 2.4 + 1e-9, "b keeps its own"
    assert fastest(limits={"c": {"velocity": 0.12}})[0] <= 0.1 + 1e-9, "followers of followers, too"
    steps = [{"goal": {"type": "joints", "positions": {"a": value}}} for value in (0.9, -0.5)]
    reply = answer({"robot": geared(), "scene": EMPTY, "steps": steps, "limits": {"b": {"velocity": 0.5}}})
    assert np.abs(reply.trajectory.velocities).max() <= 0.5 / 2.4 + 1e-9


def test_certify_judges_the_follower_and_names_it():
    ask = {"type": "certify", "robot": geared(), "scene": EMPTY, "position_names": ["a"], "velocity_names": ["a"]}
    for speed, status in ((0.41, "SUCCESS"), (0.43, "INVALID_MOTION_PLAN")):
        motion = {"times": [0, 1], "positions": [[0.0], [speed]], "velocities": [[speed], [speed]]}
        reply = answer({**ask, "trajectory": motion})
        assert reply.status.name == status
        assert reply.limits.velocity.joint == "b"
        assert reply.limits.velocity.share == pytest.approx(2.4 * speed)
    reply = answer({**ask, "trajectory": motion, "limits": {"b": {"velocity": 1.1}}})
    assert reply.status.name == "SUCCESS"


def test_a_stream_keeps_the_limits_of_followers():
    robot, scene = load(UrdfText(text=geared()["text"])), build(Scene("empty", obstacles=[]))
    for limits, velocity in (({}, 1 / 2.4), ({"b": JointLimits(velocity=0.5)}, 0.5 / 2.4)):
        request = StreamOpen(robot=UrdfText(text=geared()["text"]), scene="empty", start={"a": 0.0}, limits=limits)
        assert read_opening(request, robot, scene).group.velocity_limits == pytest.approx([velocity])


def test_a_follower_that_would_let_nothing_move_has_no_limits():
    """The sign of the multiplier is wrong in many a gripper's file."""
    robot = load(arm(("revolute", 0, 2, ""), ("revolute", 0, 1, mimic(1, -1.0, 0.0))))
    assert any(
        "joint 'j1', which 'j2' follows, can't move with 'j2' within its limits" in told for told in robot.warnings
    )
    assert robot.joints[0].upper == [2.0]
    assert robot.joints[1].upper == [np.inf]
