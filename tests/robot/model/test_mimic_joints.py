"""A mimic joint is at multiplier * x + offset of the unwrapped value x, and its limits bind its source joint."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.engine import Engine, answer
from guidefield.errors import RobotInvalid
from guidefield.handlers.kinematics import clearance, forward_kinematics, inverse_kinematics
from guidefield.kernels.kinematics.forward_kinematics import joint_placements
from guidefield.messages import requests
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import GuidePlaneGoal, JointLimits, PlanRequest, PoseGoal, TargetPose, UrdfText
from guidefield.messages.scene import GuidePlane, Scene, Sphere
from guidefield.messages.streams import StreamOpen
from guidefield.planner.guide.guide import arm_reach
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import chain_to_tip
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import configuration_from_wire, configuration_to_wire, limit_faults
from guidefield.robot.model.joints import LARGEST_VALUE, JointKind
from guidefield.robot.model.mimic_joints import follow
from guidefield.robot.model.model import joint_table
from guidefield.scene.scene import build
from guidefield.stream.opening import read_opening
from tests.robot.by_formula import ByFormula, given_by
from tests.robot.random_chains import KINDS, WOUND, chains
from tests.robot.winding import OFFSET, nearest, place, winding
from tests.robots import grouped, load

ENGINE = Engine()
EXACT = 1e-12  # rounding of a chain of a few joints [m], and of a rotation's entries
BEYOND = 3.5, -4.0, 9.0, 3.0  # angles, some of them beyond half a turn [rad]


BESIDE = UrdfText(
    text='<robot name="r"><link name="base"/><link name="beside"/><link name="slide"/><link name="tool"><collision>'
    '<geometry><sphere radius="0.1"/></geometry></collision></link>'
    '<joint name="j1" type="continuous"><parent link="base"/><child link="beside"/></joint>'
    '<joint name="j2" type="prismatic"><parent link="base"/><child link="slide"/>'
    '<limit lower="-3" upper="3" effort="1" velocity="1"/><mimic joint="j1" multiplier="0" offset="0.4"/></joint>'
    '<joint name="j3" type="continuous"><parent link="slide"/><child link="tool"/></joint></robot>'
)
"""A slide that follows a joint beside it by nothing, before another joint."""


def kind_of_source(*laws: tuple[str, str, float]) -> JointKind:
    """Kind of the continuous joint `j` that joints of some kinds follow by some multiple of others."""
    text = '<link name="base"/><link name="l"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>'
    text += '<joint name="j" type="continuous"><parent link="base"/><child link="l"/></joint>'
    for i, (kind, source, multiplier) in enumerate(laws):
        text += (
            f'<link name="l{i}"/><joint name="f{i}" type="{kind}"><parent link="l"/><child link="l{i}"/>'
            f'<limit lower="-3" upper="3" effort="1" velocity="1"/><mimic joint="{source}" multiplier="{multiplier}"/>'
            "</joint>"
        )
    joint = load(UrdfText(text=f'<robot name="r">{text}</robot>')).joint("j")
    return joint.kind


@pytest.mark.parametrize(
    "laws",
    [
        [],
        [("continuous", "j", 1.0)],
        [("continuous", "j", -2.0), ("continuous", "j", 3.0)],
        [("prismatic", "j", 0.0), ("revolute", "j", 0.0)],
        [("continuous", "j", 2.0), ("continuous", "f0", 2.5)],
    ],
)
def test_an_angle_stays_periodic_where_a_turn_brings_all_back(laws: list) -> None:
    assert kind_of_source(*laws) is JointKind.CONTINUOUS


@pytest.mark.parametrize(
    "laws",
    [
        [("prismatic", "j", 0.2)],
        [("revolute", "j", 1.0)],
        [("continuous", "j", 0.5)],
        [("continuous", "j", 1.0), ("continuous", "j", -1.5)],
        [("continuous", "j", 1.0), ("prismatic", "f0", 0.1)],
        [("continuous", "f1", 0.5), ("continuous", "j", 3.0)],
    ],
)
def test_elsewhere_its_turns_count(laws: list) -> None:
    assert kind_of_source(*laws) is JointKind.REVOLUTE


def at_any(planned: PlanningGroup, rng: np.random.Generator) -> np.ndarray:
    """Local coordinates, shape (nv,), within limits; angles up to three turns from zero."""
    z = planned.to_local(planned.random(rng))
    for joint in planned.joints:
        turns_on = joint.kind is JointKind.CONTINUOUS or planned.winds[joint.idx_v]
        if turns_on:
            z[joint.idx_v] = rng.uniform(-6.0 * np.pi, 6.0 * np.pi)
    return z


@settings(max_examples=18)
@given(chains(most=8, kinds=WOUND), st.integers(0, 2**16))
def test_models_and_kernels_have_mimic_joints_where_the_formula_has_them(urdf: UrdfText, seed: int) -> None:
    robot = load(urdf)
    names = [joint.name for joint in robot.joints if joint.mimic is None]
    planned = select(robot, names, None, robot.rest, pin.SE3.Identity())
    z = at_any(planned, np.random.default_rng(seed))
    values = given_by(planned.position_names, planned.wire_positions(z))
    expected = ByFormula(urdf.text).placements(values)
    # a plan's local coordinates, the wire, and the kernels
    model, data, table = planned.model, planned.model.createData(), joint_table(planned.model)
    by_configuration = [planned.from_local(z), planned.part_of(configuration_from_wire(robot, values))]
    for q_model in (planned.expand_from_local(z), *map(planned.expand, by_configuration)):
        placements = np.empty((model.njoints, 3, 4))
        pin.forwardKinematics(model, data, q_model)
        joint_placements(table, q_model, placements)
        for index in range(1, model.njoints):
            np.testing.assert_allclose(data.oMi[index].homogeneous, expected[model.names[index]], atol=1e3 * EXACT)
            np.testing.assert_allclose(placements[index], expected[model.names[index]][:3], atol=1e3 * EXACT)
    whole = robot.model.createData()
    pin.forwardKinematics(robot.model, whole, configuration_from_wire(robot, values))
    for joint in robot.joints:
        np.testing.assert_allclose(whole.oMi[joint.index].homogeneous, expected[joint.name], atol=1e3 * EXACT)


@settings(max_examples=18)
@given(chains(most=8, kinds=(*KINDS, "mimic", "continuous")), st.integers(0, 2**16))
def test_the_chain_to_the_tip_ends_no_further_than_it_reaches(urdf: UrdfText, seed: int) -> None:
    planned = grouped(urdf) if load(urdf).joints else None
    if planned is None:
        return
    chain, formula, rng = chain_to_tip(planned), ByFormula(urdf.text), np.random.default_rng(seed)
    rest = configuration_to_wire(planned.robot.joints, planned.robot.rest)
    frame = planned.robot.model.frames[planned.robot.frame_id(planned.tip)]
    for _ in range(5):
        z = planned.to_local(planned.random(rng))
        at = formula.placements({**rest, **given_by(planned.position_names, planned.wire_positions(z))})
        tip = at[planned.robot.model.names[frame.parentJoint]] @ frame.placement.homogeneous
        assert np.linalg.norm(tip[:3, 3] - chain.table.first[3::4]) <= chain.reach + 1e-9


@pytest.mark.parametrize("turn", BEYOND)
def test_requests_are_answered_where_the_formula_has_the_tool(turn: float) -> None:
    urdf = winding()
    robot = load(urdf)
    asked = requests.ForwardKinematics(urdf, ["tool"], [{"turn": turn, "lift": 0.1}])
    (found,) = forward_kinematics(asked, robot).placements[0]
    np.testing.assert_allclose(found.position, place(turn, 0.1), atol=EXACT)
    near = Sphere(name="near", radius=0.05, position=tuple(place(turn, 0.2)))
    scene = Scene(name="near", obstacles=[near])
    told = clearance(requests.Clearance(urdf, scene, [{"turn": turn}]), robot, build(scene))
    assert told.minimum[0] == pytest.approx(0.11, abs=1e-9)
    assert told.minimum[0] == pytest.approx(
        nearest(urdf, [near], [{"turn": turn, "lift": 0.0, "elbow": 0.0}]), abs=1e-6
    )


@pytest.mark.parametrize("turn", BEYOND)
def test_a_source_joint_that_stands_still_keeps_its_turns(turn: float) -> None:
    robot = load(winding())
    q = configuration_from_wire(robot, {"turn": turn})
    planned = select(robot, ["lift"], "tool", q, pin.SE3.Identity())
    data = planned.model.createData()
    pin.framesForwardKinematics(planned.model, data, planned.expand(np.array([0.3])))
    np.testing.assert_allclose(data.oMf[planned.tip_id].translation, place(turn, 0.3), atol=EXACT)


def test_a_pose_is_met_by_the_formula() -> None:
    urdf = winding()
    robot, formula = load(urdf), ByFormula(urdf.text)
    for turn in BEYOND:
        position = tuple(place(turn, 0.2))
        quaternion = (0.0, 0.0, float(np.sin(turn / 2)), float(np.cos(turn / 2)))
        target = TargetPose(position=position, quaternion_xyzw=quaternion)
        request = requests.InverseKinematics(urdf, [target], start_configurations=[{"turn": turn - 0.8}])
        (solutions,) = inverse_kinematics(request, robot, build(Scene(name="empty"))).configurations
        assert solutions
        for solution in solutions:
            np.testing.assert_allclose(
                formula.placements({"elbow": 0.0, **solution})["slide"][:3, 3], position, atol=2e-4
            )


def plan(urdf: UrdfText, **request) -> PlanReply:
    return ENGINE.answer(PlanRequest(robot=urdf, sample_rate=200.0, recording="off", **request))


def rows_of(reply: PlanReply) -> list[dict]:
    return [given_by(reply.position_names, row) for row in reply.trajectory.positions]


def test_a_plan_to_a_pose_ends_there_by_the_formula() -> None:
    urdf = winding()
    quaternion = (0.0, 0.0, float(np.sin(1.8)), float(np.cos(1.8)))
    goal = PoseGoal(position=tuple(place(3.6, 0.2)), quaternion_xyzw=quaternion)
    reply = plan(urdf, scene=Scene(name="empty"), start={"turn": 2.9}, goal=goal, tip="tool", guide_planes=[])
    assert reply.status.name == "SUCCESS"
    end = rows_of(reply)[-1]
    assert end["turn"] == pytest.approx(3.6, abs=1e-2)
    np.testing.assert_allclose(
        ByFormula(urdf.text).placements({"elbow": 0.0, **end})["slide"][:3, 3], goal.position, atol=2e-4
    )


def gate(turn: float) -> GuidePlane:
    """A plane through the mast that the hand crosses at an angle."""
    out, up = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([0.0, 0.0, 0.5])
    corners = (0.3 * out - up, 1.0 * out - up, 1.0 * out + up, 0.3 * out + up)
    return GuidePlane(name="gate", vertices=[tuple(corner.tolist()) for corner in corners])


def guided(urdf: UrdfText, seed: int) -> bool:
    """Whether a guided motion across half a turn is found among spheres; what is found is free by the formula."""
    rng = np.random.default_rng(seed)
    at = [place(turn, rng.uniform(0.0, 0.25)) for turn in rng.uniform(3.3, 4.8, 3)]
    spheres = [Sphere(name=f"s{i}", radius=0.05, position=tuple(p.tolist())) for i, p in enumerate(at)]
    scene = Scene(name="spheres", obstacles=spheres, guide_planes=[gate(3.6)])
    reply = plan(
        urdf,
        scene=scene,
        start={"turn": 2.9, "elbow": -0.9},
        goal=GuidePlaneGoal(),
        tip="hand",
        planner="guided",
        seed=seed,
    )
    if reply.status.name != "SUCCESS":
        return False
    rows = rows_of(reply)
    assert rows[0]["turn"] == pytest.approx(2.9, abs=1e-9)
    assert nearest(urdf, spheres, rows) > 0.0
    hand = ByFormula(urdf.text).placements(rows[-1])["elbow"] @ [0.4, 0.0, 0.0, 1.0]
    assert abs(hand[:3] @ [-np.sin(3.6), np.cos(3.6), 0.0]) < 2e-3
    return True


def test_guided_motions_across_half_a_turn_are_free_by_the_formula() -> None:
    assert sum(guided(winding(), seed) for seed in range(12)) >= 9


def test_what_a_slide_adds_to_the_reach_counts() -> None:
    planned = grouped(winding(), "tool")
    base, reach = arm_reach(planned)
    turned = planned.to_local(planned.random(np.random.default_rng(0)))
    turned[1] = planned.upper[1]
    assert reach >= np.linalg.norm(place(*turned[::-1]) - base)


def test_a_slide_that_never_moves_is_in_reach_and_moves_nothing() -> None:
    robot = load(winding(multiplier=0.0))
    assert robot.joint("turn").kind is JointKind.CONTINUOUS
    planned = select(robot, ["turn"], "tool", robot.rest, pin.SE3.Identity())
    chain = chain_to_tip(planned)
    assert chain.reach == pytest.approx(OFFSET)
    assert chain.moving.tolist() == [True]
    other = select(load(BESIDE), ["j1", "j3"], "tool", load(BESIDE).rest, pin.SE3.Identity())
    assert chain_to_tip(other).moving.tolist() == [False, True]


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


def mimic(source: int, multiplier: float, offset: float) -> str:
    return f'<mimic joint="j{source}" multiplier="{multiplier}" offset="{offset}"/>'


def test_a_source_joint_goes_only_where_its_mimic_joint_keeps_its_limits():
    robot = load(arm(("revolute", -2, 2, ""), ("revolute", -0.5, 1, mimic(1, -2.0, 0.5))))
    assert robot.joints[0].lower == pytest.approx([-0.25])  # -2 x + 0.5 <= 1
    assert robot.joints[0].upper == pytest.approx([0.5])  # -2 x + 0.5 >= -0.5
    assert any("'j1', which 'j2' follows, only goes from -0.25 to 0.5" in warning for warning in robot.warnings)


def test_an_unlimited_source_joint_goes_where_its_mimic_joints_keep_their_limits():
    robot = load(
        arm(("continuous", 0, 0, ""), ("revolute", -1, 4, mimic(1, 0.5, 1.0)), ("prismatic", 0, 1, mimic(1, 0.1, 0)))
    )
    assert robot.joints[0].lower == pytest.approx([0.0])
    assert robot.joints[0].upper == pytest.approx([6.0])
    assert sum("only goes from" in warning for warning in robot.warnings) == 2


def test_a_source_joint_goes_no_further_than_can_be_asked_for():
    robot = load(arm(("continuous", 0, 0, ""), ("prismatic", -1, 1, mimic(1, 1e-6, 0.0))))
    assert (robot.joints[0].lower[0], robot.joints[0].upper[0]) == (-LARGEST_VALUE, LARGEST_VALUE)


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


def test_a_mimic_joint_of_a_fixed_joint_is_refused():
    fixed = arm(("fixed", 0, 0, ""), ("revolute", -1, 1, mimic(1, 1.0, 0.0)))
    with pytest.raises(RobotInvalid):
        load(fixed)


RANGE = st.tuples(st.floats(-3, 0), st.floats(0, 3))


@settings(max_examples=15)
@given(RANGE, RANGE, st.floats(-2, 2).filter(lambda m: m == 0.0 or abs(m) > 1e-3), st.floats(-1, 1), st.integers(0, 99))
def test_no_random_configuration_puts_a_mimic_joint_beyond_its_limits(first, second, multiplier, offset, seed):
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


def test_velocity_limits_of_mimic_joints_bind_the_joint_that_is_planned():
    robot = load(UrdfText(text=geared()["text"]))
    group = select(robot, ["a"], None, robot.rest, pin.SE3.Identity())
    assert group.velocity_limits == pytest.approx([1 / 2.4])
    assert group.acceleration_limits == pytest.approx([2 / 2.4])
    assert group.joints[0].velocity_owner == "b"
    assert any("joint 'a', which 'b' follows, moves at 0.416667 at most" in told for told in robot.warnings)
    velocity, _ = fastest()
    assert 0.9 / 2.4 < velocity <= 1 / 2.4 + 1e-9


def test_a_request_may_limit_a_mimic_joint():
    velocity, acceleration = fastest(limits={"b": {"velocity": 0.5, "acceleration": 0.3}})
    assert 0.9 * 0.5 / 2.4 < velocity <= 0.5 / 2.4 + 1e-9
    assert acceleration <= 0.3 / 2.4 + 1e-6
    assert fastest(limits={"b": {"velocity": 9.0}})[0] == pytest.approx(0.5, rel=1e-2)
    assert fastest(limits={"a": {"velocity": 9.0}})[0] <= 1 / 2.4 + 1e-9, "b keeps its own"
    assert fastest(limits={"c": {"velocity": 0.12}})[0] <= 0.1 + 1e-9, "mimic joints of mimic joints, too"
    steps = [{"goal": {"type": "joints", "positions": {"a": value}}} for value in (0.9, -0.5)]
    reply = answer({"robot": geared(), "scene": EMPTY, "steps": steps, "limits": {"b": {"velocity": 0.5}}})
    assert np.abs(reply.trajectory.velocities).max() <= 0.5 / 2.4 + 1e-9


def test_certify_judges_the_mimic_joint_and_names_it():
    ask = {"type": "certify", "robot": geared(), "scene": EMPTY, "position_names": ["a"], "velocity_names": ["a"]}
    for speed, status in ((0.41, "SUCCESS"), (0.43, "INVALID_MOTION_PLAN")):
        motion = {"times": [0, 1], "positions": [[0.0], [speed]], "velocities": [[speed], [speed]]}
        reply = answer({**ask, "trajectory": motion})
        assert reply.status.name == status
        assert reply.limits.velocity.joint == "b"
        assert reply.limits.velocity.share == pytest.approx(2.4 * speed)
    reply = answer({**ask, "trajectory": motion, "limits": {"b": {"velocity": 1.1}}})
    assert reply.status.name == "SUCCESS"


def test_a_stream_keeps_the_limits_of_mimic_joints():
    robot, scene = load(UrdfText(text=geared()["text"])), build(Scene("empty", obstacles=[]))
    for limits, velocity in (({}, 1 / 2.4), ({"b": JointLimits(velocity=0.5)}, 0.5 / 2.4)):
        request = StreamOpen(robot=UrdfText(text=geared()["text"]), scene="empty", start={"a": 0.0}, limits=limits)
        assert read_opening(request, robot, scene).group.velocity_limits == pytest.approx([velocity])


def test_a_mimic_joint_that_would_let_nothing_move_has_no_limits():
    """The sign of the multiplier is wrong in many a gripper's file."""
    robot = load(arm(("revolute", 0, 2, ""), ("revolute", 0, 1, mimic(1, -1.0, 0.0))))
    assert any(
        "joint 'j1', which 'j2' follows, can't move with 'j2' within its limits" in told for told in robot.warnings
    )
    assert robot.joints[0].upper == [2.0]
    assert robot.joints[1].upper == [np.inf]
