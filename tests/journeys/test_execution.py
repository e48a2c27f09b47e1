"""A motion is planned by a service, executed by a stand-in of ros2_control with its own interpolation, and judged."""

import csv
import functools
import json
import os
import runpy
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml
import zenoh
from typer.testing import CliRunner

import guidefield
from guidefield.cli import app
from guidefield.cli.serving import free_port
from guidefield.endpoint.ros.trajectory_action import (
    VERSIONS,
    ControllerClient,
    MotionToExecute,
    Version,
    action_types,
    controller_at,
)
from guidefield.errors import MalformedRequest, NoService, TimedOut, UnknownObject
from guidefield.messages.execution import SentMotion, trajectory_message
from guidefield.recorder.stored import read_recording
from tests.endpoint.ros.stand_in import ACTION, StandIn, controller_listening, interpolated
from tests.examples import example
from tests.handlers.test_executed import REQUEST
from tests.handlers.test_plan import READY

JOINTS = list(READY)
HOUSE = Path(__file__).resolve().parent.parent.parent
CONTROLLER = "arm/joint_trajectory_controller"


@pytest.fixture
def endpoint() -> Iterator[str]:
    with free_port() as port:
        yield f"tcp/127.0.0.1:{port}"


def request(kind: str = "quintic", tolerance: float = 0.004) -> guidefield.PlanRequest:
    execution = guidefield.ExecutionOptions(kind, rate=50, tolerance=tolerance)
    return guidefield.PlanRequest("panda", "table", REQUEST.goal, start=READY, guide_planes=[], execution=execution)


def ask(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, arguments)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        return 2, f"{done.output}{done.exception}"
    return done.exit_code, done.output


def motion(tolerance: float = 0.004) -> MotionToExecute:
    """A certified motion, with close places along it."""
    reply = guidefield.answer(request(tolerance=tolerance))
    plan, rows = reply.trajectory, reply.execution
    times = np.linspace(0.0, plan.times[-1], 700)
    message = trajectory_message(SentMotion("r", JOINTS, rows))
    types = action_types(VERSIONS[0])
    points = [types.new("trajectory_msgs/msg/JointTrajectoryPoint", **point) for point in message["points"]]
    return MotionToExecute(
        tuple(JOINTS), message, rows.tolerance, times, np.array([interpolated(points, t) for t in times])
    )


def test_a_plan_is_exported_executed_and_judged(client: guidefield.Client, endpoint: str, tmp_path: Path) -> None:
    file, plan_file = tmp_path / "motion.yaml", tmp_path / "plan.rrd"
    plan = client.plan(request())
    plan_file.write_bytes(client.recording(plan.run_id))
    assert plan.status.name == "SUCCESS"
    assert plan.execution.deviation.largest < 1e-12
    assert ask("runs", "export", str(plan_file), str(file))[0] == 0
    sent = yaml.safe_load(file.read_text())["trajectory"]
    states, record = tmp_path / "states.csv", tmp_path / "executed.rrd"
    with controller_listening(endpoint, JOINTS[::-1], list(READY.values())[::-1]) as stand_in:
        words = ("execute", str(plan_file), "--ros-controller", CONTROLLER, "--ros-connect", endpoint)
        code, said = ask(*words, "--states", str(states), "--record", str(record))
    assert code == 0, said
    assert f"{CONTROLLER}: succeeded" in said
    assert "left the tolerance" not in said
    assert "off the plan" in said
    (goal,) = stand_in.goals
    assert [*goal.trajectory.joint_names] == sent["joint_names"] == JOINTS
    assert [one.positions.tolist() for one in goal.trajectory.points] == [one["positions"] for one in sent["points"]]
    assert {one.name: one.position for one in goal.path_tolerance} == dict.fromkeys(JOINTS, 0.004)
    told = [*csv.DictReader(states.open())]
    assert len(told) > 10
    rows = [[float(row[joint]) for joint in JOINTS] for row in told]
    executed = guidefield.JointStates(JOINTS, [float(row["time"]) for row in told], rows)
    judged = client.certify(guidefield.judgement_of(request(), plan, executed))
    assert judged.certificate.collision_free
    assert judged.deviation.largest < 1e-3, "straight pieces between states, a hundredth of a second apart"
    assert read_recording(record).reply.deviation is not None
    assert "off the plan" in ask("certify", str(states), "--against", str(plan_file))[1]


def test_a_panda_in_mujoco_stays_within_its_tolerance(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mujoco", reason="the extra `mujoco` isn't installed")
    example = runpy.run_path(str(HOUSE / "tools" / "examples" / "mujoco_panda.py"))
    example["main"](str(tmp_path / "executed.rrd"))
    certified, beyond, executed = capsys.readouterr().out.splitlines()
    assert "certified it free" in certified
    assert 0.0 < float(beyond.split()[0]) < example["TOLERANCE"]
    assert executed.startswith("executed: free")
    assert read_recording(tmp_path / "executed.rrd").reply.deviation.largest < 0.03


def test_leaving_the_tube_and_coming_back_is_told(endpoint: str) -> None:
    said = list[str]()
    bend = lambda time: 0.02 if 0.2 < time < 0.3 else 0.001  # noqa: E731
    with (
        controller_listening(
            endpoint, JOINTS, list(READY.values()), bend=bend, version=Version(effort=True, index=True)
        ),
        controller_at(endpoint, 0, f"/{CONTROLLER}/", 5.0) as controller,
    ):
        outcome = controller.follow(motion(), said.append)
    assert outcome.ended == "succeeded"
    assert not outcome.is_fine
    assert {round(apart, 3) for _, _, apart in outcome.violations} == {0.02}
    assert all(0.15 < time < 0.35 for time, _, _ in outcome.violations)
    assert any(one.startswith("left the tolerance at 0.2") for one in said)
    assert any(one.startswith("back within the tolerance at 0.3") for one in said)
    assert outcome.off_curve < 1e-3


def test_another_curve_than_the_certified_one_is_told(endpoint: str) -> None:
    said, certified = list[str](), motion()
    points = [{**one, "velocities": [], "accelerations": []} for one in certified.message["points"][::6]]
    coarse = MotionToExecute(
        certified.joints,
        {**certified.message, "points": points},
        certified.tolerance,
        certified.times,
        certified.places,
    )
    with (
        controller_listening(endpoint, JOINTS, list(READY.values())),
        controller_at(endpoint, 0, CONTROLLER, 5.0) as controller,
    ):
        outcome = controller.follow(coarse, said.append)
    assert outcome.off_curve > 1e-3
    assert any("draws another curve" in one for one in said)


def test_an_interrupt_cancels(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    said, watch = list[str](), ControllerClient._watch

    def interrupted(*given: object) -> None:
        monkeypatch.setattr(ControllerClient, "_watch", watch)
        time.sleep(0.1)
        raise KeyboardInterrupt

    with controller_listening(endpoint, JOINTS, list(READY.values()), speed=0.2) as stand_in:
        with controller_at(endpoint, 0, CONTROLLER, 5.0) as controller:
            monkeypatch.setattr(ControllerClient, "_watch", interrupted)
            outcome = controller.follow(motion(), said.append)
        assert stand_in.canceled.is_set()
    assert outcome.ended == "canceled"
    assert "canceling" in said


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_before_the_goal_is_accepted_cancels(endpoint: str, tmp_path: Path, number: signal.Signals) -> None:
    plan_file, start = tmp_path / "plan.rrd", list(READY.values())
    guidefield.answer(request(), record_to=plan_file)
    words = ("execute", str(plan_file), "--ros-controller", CONTROLLER, "--ros-connect", endpoint)
    tell_to_end = functools.partial(os.kill, os.getpid(), number)
    with controller_listening(endpoint, JOINTS, start, late=0.5, on_goal=tell_to_end, speed=0.2) as stand_in:
        code, said = ask(*words)
    assert stand_in.canceled.is_set(), said
    assert code == 1
    assert f"{CONTROLLER}: canceled" in said


def test_no_motion_goes_on_that_nobody_watches(endpoint: str) -> None:
    certified = motion()

    def end(error: type[BaseException], say: Callable[[str], None] = lambda _: None, **how: Any) -> None:
        with (
            controller_listening(endpoint, JOINTS, list(READY.values()), speed=0.1, **how) as stand_in,
            controller_at(endpoint, 0, CONTROLLER, 1.0) as controller,
            pytest.raises(error),
        ):
            controller.follow(certified, say)
        assert stand_in.canceled.is_set()

    def refuse_to_write(_: str) -> None:
        raise BrokenPipeError

    end(TimedOut, late=1.5)
    end(MalformedRequest, unreadable=True)
    end(BrokenPipeError, say=refuse_to_write)


def test_a_motion_whose_result_cannot_be_asked_for_is_canceled(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    get = zenoh.Session.get

    def fail(session: zenoh.Session, key: str, *given: Any, **how: Any) -> Any:
        if "/get_result/" in str(key):
            raise zenoh.ZError("the link is cut")
        return get(session, key, *given, **how)

    certified = motion()
    with (
        controller_listening(endpoint, JOINTS, list(READY.values()), speed=0.1) as stand_in,
        controller_at(endpoint, 0, CONTROLLER, 1.0) as controller,
    ):
        monkeypatch.setattr(zenoh.Session, "get", fail)
        with pytest.raises(NoService, match="the link is cut"):
            controller.follow(certified, lambda _: None)
    assert stand_in.canceled.is_set()


def test_it_is_said_that_a_motion_could_not_be_canceled(endpoint: str) -> None:
    said = list[str]()
    with (
        controller_listening(endpoint, JOINTS, list(READY.values()), late=60.0),
        controller_at(endpoint, 0, CONTROLLER, 0.3) as controller,
        pytest.raises(TimedOut, match="didn't answer the goal"),
    ):
        controller.follow(motion(), said.append)
    assert any("the robot may be moving" in one for one in said)


def test_what_is_wrong_with_a_controller_is_said_by_name(endpoint: str) -> None:
    there, start = motion(), list(READY.values())

    def refused(error: type, match: str, joints: list[str] = JOINTS, at: list[float] = start, **how: object) -> StandIn:
        with (
            controller_listening(endpoint, joints, at, **how) as stand_in,
            controller_at(endpoint, 0, CONTROLLER, 1.0) as controller,
            pytest.raises(error, match=match),
        ):
            controller.follow(there, lambda _: None)
        return stand_in

    assert not refused(MalformedRequest, "refuses the motion", accepts=False).canceled.is_set()
    refused(MalformedRequest, "joint 'panda_joint1' is at 0.5, not at 0", at=[0.5, *start[1:]])
    refused(TimedOut, "no joint states of panda_joint1", joints=[*JOINTS[1:], "other"])
    refused(MalformedRequest, "feedback has no joint 'panda_joint7'", told=[*JOINTS[:6], "other"])
    refused(MalformedRequest, "joint 'panda_joint1' is at nan, not at 0", at=[float("nan"), *start[1:]])
    stand_in = refused(MalformedRequest, "isn't a finite position", bend=lambda time: np.nan if time > 0.1 else 0.0)
    assert stand_in.canceled.is_set(), "nobody watches what goes on moving"
    refused(TimedOut, "is silent: neither feedback nor a result within 1 s; the robot was last at", silent_after=0.2)
    with (
        controller_listening(endpoint, JOINTS, start),
        pytest.raises(UnknownObject, match=f"no controller 'hand' .* there are: {CONTROLLER}"),
        controller_at(endpoint, 0, "hand", 0.3),
    ):
        pass
    with pytest.raises(NoService, match="nothing is reached at"), controller_at(endpoint, 0, CONTROLLER, 0.3):
        pass


def test_only_what_is_certified_for_a_controller_is_sent(endpoint: str, tmp_path: Path) -> None:
    words = ("--ros-controller", CONTROLLER, "--ros-connect", endpoint)
    guidefield.answer(REQUEST, record_to=tmp_path / "plain.rrd")
    code, said = ask("execute", str(tmp_path / "plain.rrd"), *words)
    assert code == 2
    assert "is not certified for a controller" in said
    given = {"times": [0.0, 1.0], "positions": [[*READY.values()], [3.5, *[*READY.values()][1:]]]}
    beyond = {"type": "certify", "robot": "panda", "scene": "table", "position_names": JOINTS, "trajectory": given}
    beyond |= {"interpolation": "linear", "execution": {"interpolation": "linear"}}
    failed = guidefield.answer(beyond, record_to=tmp_path / "failed.rrd")
    assert failed.execution is not None
    still = {**beyond, "trajectory": {"times": [0.0, 1.0], "positions": [[*READY.values()]] * 2}}
    guidefield.answer(still, record_to=tmp_path / "still.rrd")
    code, said = ask("execute", str(tmp_path / "still.rrd"), *words, "--record", str(tmp_path / "judged.rrd"))
    assert code == 2
    assert "only a plan's execution is judged, so leave out --record" in said
    code, said = ask("execute", str(tmp_path / "failed.rrd"), *words)
    assert code == 2
    assert "is not certified: " in said
    tight = msgspec.structs.replace(request(), execution=guidefield.ExecutionOptions("cubic", tolerance=1.0))
    assert guidefield.answer(tight, record_to=tmp_path / "tight.rrd").status.name == "INVALID_MOTION_PLAN"
    code, said = ask("runs", "export", str(tmp_path / "tight.rrd"), str(tmp_path / "tight.csv"))
    assert code == 2
    assert "is not certified: the certificate refused" in said
    assert not (tmp_path / "tight.csv").exists()
    guidefield.answer(request("zero_order_hold"), record_to=tmp_path / "held.rrd")
    assert "certified for 'zero_order_hold'" in ask("execute", str(tmp_path / "held.rrd"), *words)[1]
    picking = {**json.loads(example("kitchen")), "allowed_planning_time": 60.0, "execution": {"interpolation": "cubic"}}
    assert guidefield.answer(picking, record_to=tmp_path / "picking.rrd").status.name == "SUCCESS"
    code, said = ask("execute", str(tmp_path / "picking.rrd"), *words)
    assert code == 2
    assert "picks up or puts down" in said


def test_each_version_has_a_hash_of_its_own() -> None:
    parts = ("SendGoal", "FeedbackMessage")
    hashes = {action_types(one).type_hash(f"{ACTION}_{part}") for one in VERSIONS for part in parts}
    assert len(hashes) == 4, "tolerances are of goals, indices of feedback"
    for types in map(action_types, VERSIONS):
        told = types.new(f"{ACTION}_SendGoal_Request", goal={"path_tolerance": [{"name": "a", "position": 0.5}]})
        read = types.read(types.write(told, f"{ACTION}_SendGoal_Request"), f"{ACTION}_SendGoal_Request")
        assert read.goal.path_tolerance[0].position == 0.5
