"""Torques as a client meets them: told of plans and motions, with what is held; bound; refused where nothing helps."""

import functools
import time

import numpy as np
import pytest

from guidefield.engine import answer
from guidefield.errors import MalformedRequest
from guidefield.messages.replies import PlanReply
from tests.handlers.test_certify import certify, motion_of
from tests.handlers.test_plan import PATIENT, READY, ask, joints

THERE = {"start": READY, "goal": joints(panda_joint1=1.2, panda_joint4=-1.6), "guide_planes": [], "recording": "off"}
NAMES = list(READY)


def load(mass: float | None, link: str = "panda_hand") -> dict:
    box = {"type": "box", "name": "load", "size": [0.05, 0.05, 0.05], "position": [0, 0, 0.14]}
    object_ = {"obstacle": box, "link": link, "touch_links": ["panda_leftfinger", "panda_rightfinger"]}
    return object_ if mass is None else {**object_, "mass": mass, "centre_of_mass": [0, 0, 0.01]}


def strongest(reply: PlanReply, payload: list[dict]) -> np.ndarray:
    """The largest torques at many samples, by a request about dynamics with a payload on the link."""
    sent = reply.trajectory
    rows = zip(sent.positions, sent.velocities, sent.accelerations, strict=True)
    q, v, a = zip(*[[dict(zip(NAMES, row, strict=True)) for row in one] for one in rows], strict=True)
    request = {"type": "dynamics", "robot": "panda", "configurations": q, "velocities": v, "accelerations": a}
    found = answer({**request, "quantities": ["inverse_dynamics"], "payload": payload})
    assert found.inverse_dynamics is not None
    return np.abs(found.inverse_dynamics)[:, [found.velocity_names.index(name) for name in NAMES]].max(axis=0)


@pytest.mark.parametrize("mass", [None, 3.0])
def test_a_plan_tells_the_largest_torques_with_what_is_held(mass) -> None:
    payload = [] if mass is None else [{"link": "panda_hand", "mass": mass, "centre_of_mass": [0, 0, 0.15]}]
    reply = ask(**THERE, attached_objects=[load(mass)], sample_rate=500)
    assert [use.joint for use in reply.effort.joints] == NAMES
    told = np.array([use.effort for use in reply.effort.joints])
    np.testing.assert_allclose(told, strongest(reply, payload), rtol=0.03, atol=0.05)
    assert [use.limit for use in reply.effort.joints] == [87.0] * 4 + [12.0] * 3
    shares = [use.share for use in reply.effort.joints]
    assert all(share is not None for share in shares)
    assert (told / np.array([87.0] * 4 + [12.0] * 3) <= np.array(shares)).all()
    assert reply.effort.energy > 1.0


def test_a_limit_binds_and_is_proved() -> None:
    held = [load(3.0)]
    free = ask(**THERE, attached_objects=held)
    most = 0.5 * (free.effort.joints[0].effort)
    bound = ask(**THERE, attached_objects=held, limits={"panda_joint1": {"effort": most}})
    assert bound.status.name == "SUCCESS"
    use = bound.effort.joints[0]
    assert use.limit == most
    assert 0.5 < use.share <= 1.0 + 1e-6
    assert 0.99 * free.metrics.duration < bound.metrics.duration < 2.0 * free.metrics.duration
    request = {"start": READY, "attached_objects": held, "limits": {"panda_joint1": {"effort": most}}}
    judged = certify(**motion_of(bound), **request)
    assert (judged.status.name, judged.effort) == ("SUCCESS", bound.effort)
    refused = certify(**motion_of(free), **request)
    assert refused.status.name == "INVALID_MOTION_PLAN"
    assert refused.status.details["limit"] == "effort"
    assert "joint panda_joint1 takes up to" in refused.status.message


def test_what_no_optimised_motion_keeps_is_kept_along_the_path_that_was_found() -> None:
    """Gravity alone takes more where the optimised motion leads; along the straight path all can be held."""
    most = {"panda_joint1": 0.01, "panda_joint2": 4.1, "panda_joint4": 22.3}
    asked = {
        **THERE,
        "robot": "panda",
        "scene": {"name": "air", "obstacles": []},
        "goal": joints(panda_joint1=0.7, panda_joint2=-0.7, panda_joint4=-1.8),
        "limits": {joint: {"effort": effort} for joint, effort in most.items()},
        "sample_rate": 500,
        **PATIENT,
    }
    reply = answer(asked)
    assert reply.status.name == "SUCCESS", reply.status
    assert (strongest(reply, [])[[0, 1, 3]] <= np.array(list(most.values())) * (1.0 + 1e-6)).all()


def test_a_group_is_told_the_limits_of_its_own_joints() -> None:
    """A planar joint before the one that moves, and the wrist of an arm."""
    reply = ask(**{**THERE, "goal": joints(panda_joint7=0.5)}, group=["panda_joint7"])
    assert [(use.joint, use.limit) for use in reply.effort.joints] == [("panda_joint7", 12.0)]
    links = "".join(
        f'<link name="{name}"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
        '</inertial><collision><geometry><sphere radius="0.1"/></geometry></collision></link>'
        for name in ("ground", "base", "arm")
    )
    limit = '<limit lower="-2" upper="2" velocity="1" effort="{}"/>'
    text = (
        f'<robot name="rover">{links}<joint name="drive" type="planar"><parent link="ground"/><child link="base"/>'
        f'<origin xyz="0 0 1"/>{limit.format(3)}</joint>'
        f'<joint name="lift" type="revolute"><parent link="base"/><child link="arm"/>'
        f'<origin xyz="0 0 1"/><axis xyz="0 1 0"/>{limit.format(7)}</joint></robot>'
    )
    robot = {"type": "urdf", "text": text}
    asked = {"robot": robot, "scene": {"name": "air", "obstacles": []}, "goal": joints(lift=0.5), "group": ["lift"]}
    rover = answer({**asked, "execution": {"interpolation": "cubic"}, "recording": "off", **PATIENT})
    assert rover.status.name == "SUCCESS", rover.status
    assert [(use.joint, use.limit) for use in rover.effort.joints] == [("lift", 7.0)]


def test_what_cannot_be_held_is_refused_with_joint_torque_and_limit() -> None:
    heavy = {**THERE, "attached_objects": [load(9.0)], "limits": {"panda_joint4": {"effort": 30.0}}}
    reply = ask(**heavy)
    assert reply.status.name == "START_STATE_INVALID"
    assert reply.status.details["joint"] == "panda_joint4"
    assert abs(reply.status.details["effort"]) > 30.0
    assert reply.status.details["limit"] == 30.0
    away = {"panda_joint2": 0.5, "panda_joint4": -1.0}
    stretched = ask(**{**THERE, "goal": joints(**away), "limits": {"panda_joint2": {"effort": 30.0}}})
    assert stretched.status.name == "GOAL_STATE_INVALID"
    assert "the goal can't be held: joint panda_joint2" in stretched.status.message


def test_what_a_step_picks_up_weighs_from_then_on() -> None:
    crate = {"type": "box", "name": "crate", "size": [0.04, 0.04, 0.04], "position": [0.7, 0.5, 0.5]}
    steps = [
        {"goal": joints(panda_joint1=0.3)},
        {"attach": {"object": "crate", "link": "panda_hand", "mass": 2.0}},
        {"goal": joints(panda_joint1=0.0)},
    ]
    scene = {"name": "air", "obstacles": [crate]}
    reply = answer({"robot": "panda", "scene": scene, "start": READY, "steps": steps, "recording": "off", **PATIENT})
    assert reply.status.name == "SUCCESS", reply.status
    before, _, after = (step.effort for step in reply.steps)
    assert after.joints[1].effort > before.joints[1].effort + 5.0


def test_what_a_step_picks_up_with_an_inertia_of_no_body_is_refused_before_anything_is_planned() -> None:
    attach = {"object": "crate", "link": "panda_hand", "mass": 1.0, "inertia": [1, 0, 0, 0.1, 0, 0.1]}
    with pytest.raises(MalformedRequest, match=r"`steps\[1\]`: `attach.inertia` is no body's") as refused:
        answer({"robot": "panda", "scene": "table", "steps": [{"goal": joints(panda_joint1=0.3)}, {"attach": attach}]})
    assert refused.value.details["path"] == "$.steps[1].attach.inertia"


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"limits": {"panda_joint1": {"effort": 0.0}}}, "effort"),
        ({"limits": {"panda_joint1": {"effort": 1e-12}}}, "`effort` must be at least 1e-09"),
        ({"attached_objects": [{**load(None), "inertia": [1, 0, 0, 1, 0, 1]}]}, "`inertia` needs a `mass`"),
        ({"attached_objects": [{**load(1.0), "inertia": [1, 0, 0, 0.1, 0, 0.1]}]}, "attached_objects.0..inertia"),
    ],
)
def test_what_has_no_answer_is_refused_by_name(fields, words) -> None:
    with pytest.raises(MalformedRequest, match=words):
        ask(**{**THERE, **fields})


LIMITED = {"limits": {"panda_joint1": {"effort": 6.0}}, "cartesian_limits": [{"frame": "panda_hand", "speed": 0.3}]}


def test_a_motion_that_begins_and_ends_at_speed_keeps_limits_of_the_whole() -> None:
    """Oracles: inverse dynamics of dense samples, and differences of the hand's places."""
    asked = {**THERE, "start_velocities": {"panda_joint4": 0.2}, "end_velocities": {"panda_joint1": 0.1}}
    free, made = ask(**asked), ask(**asked, **LIMITED, sample_rate=500)
    assert made.status.name == "SUCCESS", made.status
    assert not made.warnings
    sent = made.trajectory
    assert sent.velocities[0] == pytest.approx([0.0, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0])
    assert sent.velocities[-1] == pytest.approx([0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert 4.0 < strongest(made, [])[0] <= 6.0 * (1.0 + 1e-6)
    configurations = [dict(zip(NAMES, row, strict=True)) for row in sent.positions]
    request = {"type": "forward_kinematics", "robot": "panda", "configurations": configurations}
    found = answer({**request, "frames": ["panda_hand"]})
    places = np.array([row[0].position for row in found.placements])
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(sent.times)
    assert 0.2 < speeds.max() <= 0.3 * (1.0 + 1e-6)
    assert free.metrics.duration < made.metrics.duration < 4.0 * free.metrics.duration


@pytest.mark.parametrize(
    ("fields", "status", "words"),
    [
        ({"start_velocities": {"panda_joint1": 1.0}}, "START_STATE_INVALID", "move frame 'panda_hand' at"),
        ({"end_velocities": {"panda_joint1": 2.0}}, "GOAL_STATE_INVALID", "its limit is 0.3 m/s"),
        ({"start_accelerations": {"panda_joint1": 14.0}}, "START_STATE_INVALID", "joint panda_joint1 takes"),
    ],
)
def test_an_end_that_exceeds_limits_of_the_whole_is_refused(fields, status, words) -> None:
    reply = ask(**THERE, **LIMITED, **fields)
    assert reply.status.name == status
    assert words in reply.status.message


def test_a_proof_says_that_it_is_not_about_speeds_and_torques(tmp_path) -> None:
    limits = {
        "cartesian_limits": [{"frame": "panda_hand_tcp", "speed": 0.5}],
        "limits": {"panda_joint1": {"effort": 9.0}},
    }
    request = {"robot": "panda", "scene": "table", **THERE, **limits, **PATIENT, "proof": True}
    reply = answer(request, proof_to=tmp_path / "motion.npz")
    told = "the proof doesn't tell that panda_hand_tcp keeps its speed and joints keep their torques"
    assert told in reply.warnings


def test_straight_pieces_have_no_torques_to_limit() -> None:
    limits = {"panda_joint1": {"effort": 9.0}}
    path = {"path": [[0.0], [0.1]], "position_names": ["panda_joint1"]}
    assert certify(**path, start=READY).effort is None
    with pytest.raises(MalformedRequest, match="straight pieces have none"):
        certify(**path, start=READY, limits=limits)
    with pytest.raises(MalformedRequest, match="'linear' limits of effort are not served"):
        ask(**THERE, limits=limits, execution={"interpolation": "linear", "rate": 125})
    drawn = ask(**THERE, limits=limits, execution={"interpolation": "quintic", "rate": 125})
    assert drawn.status.name == "SUCCESS"
    assert drawn.effort.joints[0].effort <= 9.0


@functools.cache
def load_what_it_takes() -> None:
    """A plan with such a limit, whose time isn't looked at."""
    asked = {"robot": "panda", "scene": "table", **THERE, "limits": {"panda_joint1": {"effort": 1e-6}}}
    answer({**asked, "allowed_planning_time": 60.0, "optimization_iterations": 1})


@pytest.mark.parametrize("most", [1e-6, 1e-9])
def test_a_limit_that_nothing_keeps_ends_in_time(most) -> None:
    asked = {"robot": "panda", "scene": "table", **THERE, "limits": {"panda_joint1": {"effort": most}}}
    load_what_it_takes()
    begun = time.process_time()
    reply = answer({**asked, "allowed_planning_time": 0.3})
    assert time.process_time() - begun < 0.5
    assert reply.status.name == "INVALID_MOTION_PLAN"


def test_among_what_moves_a_limit_that_no_schedule_keeps_is_named() -> None:
    """The forearm passes where it lies level: there gravity takes more."""
    ball = {"type": "sphere", "name": "ball", "radius": 0.1}
    flies = {"times": [0.0, 2.0], "placements": [{"position": [0.5, y, 0.5]} for y in (-1.0, 1.0)]}
    asked = {
        "robot": "panda",
        "scene": {"name": "moving", "obstacles": [{**ball, "trajectory": flies}]},
        "group": ["panda_joint4"],
        "start": {**READY, "panda_joint2": 0.0, "panda_joint4": -0.3},
        "goal": joints(panda_joint4=-2.9),
        "guide_planes": [],
        "recording": "off",
        **PATIENT,
    }
    refused, made = (answer({**asked, "limits": {"panda_joint4": {"effort": most}}}) for most in (15.0, 20.0))
    assert refused.status.name == "INVALID_MOTION_PLAN"
    assert refused.status.details["joint"] == "panda_joint4"
    assert "its limit is 15 N m" in refused.status.message
    assert refused.trajectory is None
    assert made.status.name == "SUCCESS"
    assert 17.0 < made.effort.joints[0].effort <= 20.0
