"""Motions as controllers execute them: certified, planned, and refused by name."""

import dataclasses
import json
from pathlib import Path

import msgspec
import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.interpolate import BPoly

from guidefield.collision.world import World
from guidefield.engine import answer
from guidefield.errors import InvalidConfiguration, MalformedRequest
from guidefield.messages import codec
from guidefield.messages.replies import CertifyReply, PlanReply
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion_certificate import certify_motion, choose_execution
from guidefield.planner.task.problem import ConfigurationGoal, ControllerModel, Interpolation
from guidefield.planner.task.stages import Stages
from guidefield.referee.case import Answer
from guidefield.referee.replay import replay_file
from guidefield.scene.scene import build
from guidefield.stores import scenes
from tests.examples import example
from tests.handlers.test_certify import NAMES, certify, motion_of, planned
from tests.handlers.test_plan import PATIENT, READY, ask as plan, joints
from tests.planner.problems import problem, scene_of
from tests.robots import group, rest

GOAL = {"start": READY, "goal": joints(panda_joint1=1.2, panda_joint4=-1.6), "guide_planes": []}


def executed(kind: str, **execution) -> PlanReply:
    return plan(**GOAL, execution={"interpolation": kind, **execution})


def judged(kind: str, **execution) -> CertifyReply:
    return certify(**motion_of(planned()), execution={"interpolation": kind, **execution})


@pytest.mark.parametrize(
    ("kind", "curve"),
    [
        ("linear", "linear"),
        ("cubic", "hermite"),
        ("quintic", "quintic"),
        ("first_order_hold", "linear"),
        ("zero_order_hold", "steps"),
    ],
)
def test_a_plan_certifies_what_a_controller_draws_of_it(kind: str, curve: str) -> None:
    made, given = executed(kind, rate=125.0, tolerance=0.002), judged(kind, rate=125.0, tolerance=0.002)
    assert made.status.name == given.status.name == "SUCCESS"
    assert given.curve == curve
    assert made.certificate.covers == "trajectory as executed"
    assert made.trajectory == planned().trajectory
    rows, planned_rows = made.execution, np.array(made.trajectory.positions)
    assert (rows.times, rows.positions, rows.velocities) == (
        given.execution.times,
        given.execution.positions,
        given.execution.velocities,
    )
    assert (rows.positions[0], rows.positions[-1]) == (planned_rows[0].tolist(), planned_rows[-1].tolist())
    assert np.diff(rows.times).min() > 0.0
    assert (rows.velocities is None, rows.accelerations is None) == (
        kind not in ("cubic", "quintic"),
        kind != "quintic",
    )
    assert rows.tolerance == [0.002] * 7
    assert rows.deviation.largest == max(rows.deviation.joints.values())
    assert rows.deviation.joints[rows.deviation.joint] == rows.deviation.largest
    fastest = np.abs(made.trajectory.velocities).max()
    bound = {"cubic": 1e-12, "quintic": 1e-12, "zero_order_hold": 2.0 * fastest / 125}.get(kind, 2e-4)
    assert rows.deviation.largest <= bound * 1.001
    assert rows.end == pytest.approx(rows.times[-1] + (kind == "zero_order_hold") / 125, abs=1e-12)


def test_a_jump_of_the_acceleration_makes_a_quintic_leave_the_plan_less_the_more_rows_there_are() -> None:
    rows = {"times": [0.0, 1.0, 2.0], "positions": [[0.0], [0.2], [0.4]], "velocities": [[0.0], [0.5], [0.0]]}
    motion = {"trajectory": rows, "position_names": NAMES[:1], "start": dict(list(READY.items())[1:])}
    found = [certify(**motion, execution={"interpolation": "quintic", "rate": rate}) for rate in (1.0, 10.0, 100.0)]
    leaves = [one.execution.deviation.largest for one in found]
    assert leaves[0] > 50.0 * leaves[1] > 2500.0 * leaves[2] > 0.0
    told = {**rows, "accelerations": [[0.0], [0.0], [0.0]]}
    other = certify(**{**motion, "trajectory": told}, execution={"interpolation": "quintic"})
    assert other.execution.accelerations == told["accelerations"]
    assert other.execution.deviation.largest > 0.0


def test_a_tolerance_that_is_too_large_is_said_with_the_pair() -> None:
    for reply in (executed("quintic", tolerance=0.5), judged("quintic", tolerance=0.5)):
        assert reply.status.name == "INVALID_MOTION_PLAN"
        assert "where the execution may be" in reply.status.message
        assert reply.certificate.collision_free is False
        pair = reply.status.details["pair"]
        assert " and ".join(pair) in reply.status.message
    assert executed("quintic", tolerance=0.5).execution is None


def test_a_curve_beyond_a_limit_is_refused_with_the_rate() -> None:
    rows = {"times": [0.0, 0.2, 0.4], "positions": [[0.0], [0.1], [0.2]], "velocities": [[0.0], [1.0], [0.0]]}
    rows["accelerations"] = [[0.0], [0.0], [0.0]]
    motion = {"trajectory": rows, "position_names": NAMES[:1], "start": dict(list(READY.items())[1:])}
    reply = certify(**motion, execution={"interpolation": "quintic"}, limits={"panda_joint1": {"acceleration": 2.0}})
    assert reply.status.name == "INVALID_MOTION_PLAN"
    assert "acceleration limit" in reply.status.message


@pytest.mark.parametrize(
    ("request_of", "error", "said"),
    [
        ({"execution": {"interpolation": "zero_order_hold"}}, MalformedRequest, "needs the `rate`"),
        ({"execution": {"interpolation": "cubic", "rate": -1.0}}, MalformedRequest, "rate"),
        ({"execution": {"interpolation": "septic"}}, MalformedRequest, "interpolation"),
        ({"execution": {"interpolation": "cubic", "tolerance": {"elbow": 0.1}}}, InvalidConfiguration, "'elbow'"),
    ],
)
def test_what_is_not_served_is_refused_by_name(request_of: dict, error: type, said: str) -> None:
    for asked in (lambda: plan(**GOAL, **request_of), lambda: certify(**motion_of(planned()), **request_of)):
        with pytest.raises(error, match=said):
            asked()


def test_an_execution_is_of_a_trajectory_with_velocities_and_of_a_goal() -> None:
    execution = {"interpolation": "cubic"}
    positions = {"times": [0.0, 1.0], "positions": [list(READY.values())] * 2}
    with pytest.raises(MalformedRequest, match="needs velocities"):
        certify(trajectory=positions, position_names=NAMES, interpolation="linear", execution=execution)
    with pytest.raises(MalformedRequest, match="has no times"):
        certify(path=[list(READY.values())], position_names=NAMES, execution=execution)


def test_a_reply_exports_what_it_is_certified_for() -> None:
    made, given = executed("quintic", rate=125.0), judged("quintic", rate=125.0)
    for reply in (made, given):
        message = yaml.safe_load(reply.export("yaml"))["trajectory"]
        first, last = message["points"][0], message["points"][-1]
        assert message["joint_names"] == NAMES
        np.testing.assert_allclose(first["positions"], list(READY.values()), atol=1e-9)
        np.testing.assert_allclose(last["positions"], made.trajectory.positions[-1], atol=1e-9)
    with pytest.raises(MalformedRequest, match="not certified for a controller"):
        planned().export("yaml")
    with pytest.raises(MalformedRequest, match="is not certified: where the execution may be"):
        judged("quintic", tolerance=0.5).export("csv")


def test_a_refusal_of_what_is_drawn_leads_to_where_the_plan_is_then() -> None:
    """What is drawn has more pieces than the plan: two fingers between books that no tolerance fits between."""
    columns = [f"panda_joint{k + 1}" for k in range(7)]
    start = (2.4477525, -0.4822559, 2.507003, -1.9026313, -0.5294257, 2.7783542, 0.7581467)
    goal = (-0.7317239, -0.2503417, 1.2483969, -2.0950782, 1.6822434, 3.0635226, -0.8047687)
    reply = plan(
        scene="bookshelf",
        guide_planes=[],
        goal=joints(**dict(zip(columns, goal, strict=True))),
        start=dict(zip(columns, start, strict=True)),
        execution={"interpolation": "linear", "rate": 125, "tolerance": 0.005},
        seed=85,
    )
    assert reply.status.name == "INVALID_MOTION_PLAN"
    assert "tolerance" in reply.status.message
    assert reply.status.details["pair"] == ["panda_leftfinger", "book4"]


@pytest.mark.filterwarnings("error")
def test_a_motion_that_goes_nowhere_is_refused_where_it_is() -> None:
    made = plan(
        start=READY, goal=joints(**READY), guide_planes=[], execution={"interpolation": "cubic", "tolerance": 1.0}
    )
    assert made.status.name == "INVALID_MOTION_PLAN"
    assert "where the execution may be" in made.status.message


def drawn_places(reply: PlanReply, kind: str, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Where a controller may have the joints at times (n,), by SciPy's curves through the rows that it is sent."""
    rows = reply.execution
    t, told = np.array(rows.times), [np.array(rows.positions)]
    told += [np.array(one) for one in (rows.velocities, rows.accelerations) if one is not None]
    beside = rng.choice([-1.0, 0.0, 1.0], (len(times), told[0].shape[1])) * rows.tolerance
    if kind == "zero_order_hold":  # anywhere between the command of the tick before and this one
        k = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 1)
        share = rng.uniform(0.0, 1.0, beside.shape)
        return told[0][np.maximum(k - 1, 0)] * (1.0 - share) + told[0][k] * share + beside
    if len(told) == 1:
        return np.array([np.interp(times, t, column) for column in told[0].T]).T + beside
    return BPoly.from_derivatives(t, np.stack(told, axis=1))(np.clip(times, t[0], t[-1])) + beside


KINDS = ("linear", "cubic", "quintic", "first_order_hold", "zero_order_hold")
STEPS = [
    {"goal": joints(panda_joint1=0.8)},
    {"goal": {"type": "relative", "frame": "world", "position": [0.0, 0.0, -0.05]}, "linear": True, "pause": 0.1},
    {"goal": joints(panda_joint1=0.2, panda_joint4=-1.8), "stop": False, "radius": 0.1},
    {"goal": joints(panda_joint1=-0.4, panda_joint4=-2.2), "max_velocity_scaling_factor": 0.5},
]


@pytest.mark.parametrize("kind", KINDS)
def test_steps_are_free_and_within_limits_as_a_controller_draws_them(kind: str, tmp_path: Path) -> None:
    """Against Coal, wherever the robot may be, and dense differences; and by the referee."""
    rng, proof = np.random.default_rng(0), tmp_path / "proof.npz"
    execution = {"interpolation": kind, "rate": 100.0, "tolerance": 0.002}
    request = {"robot": "panda", "scene": "table", "start": READY, "steps": STEPS, "execution": execution}
    reply = answer({**request, **PATIENT, "recording": "off"}, proof_to=proof)
    assert reply.status.name == "SUCCESS", reply.status.message
    assert reply.certificate.covers == "trajectory as executed"
    rows = reply.execution
    assert np.diff(rows.times).min() > 0.0
    assert rows.deviation.largest < {"zero_order_hold": 0.05}.get(kind, 5e-4)
    for column, wanted in (("panda_joint1", -0.4), ("panda_joint4", -2.2)):
        assert rows.positions[-1][reply.position_names.index(column)] == pytest.approx(wanted, abs=1e-9)
    if kind.endswith("hold"):
        ticks = np.array([time for step in reply.steps[1:] for time in (step.begin,)]) * 100.0
        np.testing.assert_allclose(ticks, np.round(ticks), atol=1e-6)
    arm = group("panda")
    world = World.build(arm, build(scenes.read_packaged("table")))
    times = np.append(rng.uniform(0.0, rows.end, 1500), [0.0, rows.end])
    assert not any(world.in_collision(arm.expand_from_local(z)) for z in drawn_places(reply, kind, times, rng))
    exact = np.linspace(0.0, rows.times[-1], 20001)
    followed = msgspec.structs.replace(reply, execution=msgspec.structs.replace(rows, tolerance=[0.0] * 7))
    places = drawn_places(followed, "linear" if kind == "zero_order_hold" else kind, exact, rng)
    speeds = np.abs(np.diff(places, axis=0)) / exact[1]
    assert (speeds <= arm.velocity_limits * (1.0 + 1e-6)).all()
    last = exact[1:] > reply.steps[-1].begin + 0.2
    assert (speeds[last] <= 0.5 * arm.velocity_limits * (1.0 + 1e-6)).all()
    assert {verdict.answer for verdict in replay_file(proof)} == {Answer.FREE}


def test_what_is_carried_is_proved_as_a_controller_draws_it(tmp_path: Path) -> None:
    file, execution = tmp_path / "proof.npz", {"interpolation": "zero_order_hold", "rate": 125.0, "tolerance": 0.0002}
    reply = answer({**json.loads(example("kitchen")), **PATIENT, "execution": execution}, proof_to=file)
    assert reply.status.name == "SUCCESS", reply.status.message
    assert any(step.held for step in reply.steps)
    verdicts = replay_file(file)
    assert len(verdicts) >= len([step for step in reply.steps if step.end > step.begin])
    assert {verdict.answer for verdict in verdicts} == {Answer.FREE}


@pytest.mark.parametrize(("kind", "rate"), [("first_order_hold", 20.0), ("first_order_hold", 5.0), ("linear", 2.0)])
def test_a_plan_is_slowed_until_what_is_drawn_keeps_a_limit_in_space(kind: str, rate: float) -> None:
    limit = {"frame": "panda_hand_tcp", "speed": 0.25}
    exact = plan(**GOAL, cartesian_limits=[limit])
    made = plan(**GOAL, cartesian_limits=[limit], execution={"interpolation": kind, "rate": rate})
    assert made.status.name == "SUCCESS", made.status.message
    assert made.metrics.duration < 1.2 * exact.metrics.duration
    arm, rows = group("panda"), made.execution
    times = np.linspace(0.0, rows.times[-1], 4001)
    data, index, tips = arm.model.createData(), arm.model.getFrameId("panda_hand_tcp"), []
    for z in drawn_places(made, kind, times, np.random.default_rng(0)):
        pin.framesForwardKinematics(arm.model, data, arm.expand_from_local(z))
        tips.append(data.oMf[index].translation.copy())
    fastest = np.linalg.norm(np.diff(tips, axis=0), axis=1).max() / times[1]
    assert 0.23 < fastest <= 0.25 * (1.0 + 1e-6)


def test_a_quintic_beyond_a_limit_is_slowed_down() -> None:
    """Of a plan whose accelerations jump; what is drawn of a motion that somebody else made is judged as it is."""
    arm = group("panda")
    posed = problem(arm, scene_of(), ConfigurationGoal((rest(arm),)), rest(arm))
    z, turn = posed.z_start, np.eye(arm.nv)[0]
    times = np.array([0.0, 0.2, 0.4])
    jumps = Trajectory(times, np.array([z, z + 0.1 * turn, z + 0.2 * turn]), np.array([0.0 * z, turn, 0.0 * z]))
    tight = dataclasses.replace(arm, acceleration_limits=np.full(arm.nv, 5.0))
    execution = ControllerModel(Interpolation.QUINTIC, None, np.zeros(arm.nv))
    posed = dataclasses.replace(posed, group=tight, execution=execution)
    assert choose_execution(posed, jumps).stretch > 1.0
    made = certify_motion(posed, jumps, {}, Stages(posed))
    assert made.verdict.free
    assert 1.0 < made.trajectory.duration / jumps.duration < 1.5
    rows = choose_execution(posed, made.trajectory).drawn
    curve = BPoly.from_derivatives(rows.times, np.stack([rows.positions, rows.velocities, rows.accelerations], axis=1))
    dense = np.abs(curve.derivative(2)(np.linspace(0.0, rows.times[-1], 10001))).max()
    assert 0.95 * 5.0 < dense <= 5.0 * (1.0 + 1e-6)


@pytest.mark.parametrize(("kind", "tolerance"), [*((kind, 0.003) for kind in KINDS), ("cubic", 0.0)])
def test_a_contact_is_left_as_a_controller_draws_it(kind: str, tolerance: float, tmp_path: Path) -> None:
    at = answer(
        {"type": "forward_kinematics", "robot": "panda", "frames": ["panda_leftfinger"], "configurations": [READY]}
    )
    x, y, z = at.placements[0][0].position
    lid = {"type": "box", "name": "lid", "size": [0.05, 0.2, 0.02], "position": [x, y, z - 0.063]}
    request = {**GOAL, **PATIENT, "robot": "panda", "scene": {"name": "lid", "obstacles": [lid]}, "recording": "off"}
    execution = {"interpolation": kind, "rate": 125.0, "tolerance": tolerance}
    file = tmp_path / "proof.npz"
    reply = answer({**request, "leave_start_contact": True, "execution": execution}, proof_to=file)
    assert reply.status.name == "SUCCESS", reply.status.message
    since = float(reply.certificate.covers.removeprefix("trajectory as executed after ").removesuffix(" s"))
    assert [one.answer for one in replay_file(file)] == [Answer.FREE, Answer.FREE]
    arm, rng = group("panda"), np.random.default_rng(1)
    world = World.build(arm, build(codec.decode_request(request).scene))
    times = rng.uniform(since, reply.execution.end, 400)
    assert not any(world.in_collision(arm.expand_from_local(z)) for z in drawn_places(reply, kind, times, rng))
    given = {"times": reply.trajectory.times, "positions": reply.trajectory.positions}
    given |= {"velocities": reply.trajectory.velocities} if kind in ("cubic", "quintic") else {}
    judged = answer(
        {
            **{name: request[name] for name in ("robot", "scene", "start")},
            "type": "certify",
            "trajectory": given,
            "position_names": NAMES,
            "leave_start_contact": True,
            "execution": execution,
        },
        proof_to=file,
    )
    assert judged.status.name == "SUCCESS", judged.status.message
    assert [one.answer for one in replay_file(file)] == [Answer.FREE, Answer.FREE]


@pytest.mark.parametrize("kind", KINDS)
def test_a_motion_that_begins_and_ends_in_motion_is_executed(kind: str) -> None:
    moving = {"start_velocities": {"panda_joint1": 0.5}, "end_velocities": {"panda_joint4": 0.2}}
    reply = plan(**GOAL, **moving, execution={"interpolation": kind, "rate": 125.0, "tolerance": 0.002})
    assert reply.status.name == "SUCCESS", reply.status.message
    if kind in ("cubic", "quintic"):
        assert reply.execution.velocities[0][0] == pytest.approx(0.5)
        assert reply.execution.velocities[-1][3] == pytest.approx(0.2)
