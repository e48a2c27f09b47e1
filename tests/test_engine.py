"""The engine: any request in any form, one reply; what is ill-posed raises, what is a bug is named."""

import logging
import pkgutil
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from guidefield.engine import Engine, LocalFiles
from guidefield.errors import InternalFailure, MalformedRequest, RobotInvalid, SceneInvalid, TimedOut, UnknownObject
from guidefield.handlers.recording import PlainMotion
from guidefield.messages import requests
from guidefield.messages.scene import GuidePlane, Scene, Sphere
from guidefield.robot.catalog import Catalog
from guidefield.stores.recordings import Recordings
from guidefield.stores.robots import RobotStore
from guidefield.stores.scenes import SceneStore
from tests.replies import plan_reply

BALL = Scene("ball", obstacles=[Sphere(name="ball", radius=0.1)])
MANY = Scene("many", obstacles=[Sphere(name=f"s{k}", radius=0.01, position=(9.0, 0.1 * k, 0.0)) for k in range(1000)])
FIELD = Scene("field", obstacles=[Sphere(name="s", radius=0.02, position=(9.0, 0.1, 0.0))])
TO_JOINTS = requests.PlanRequest(robot="panda", scene=MANY, goal=requests.JointsGoal({"panda_joint1": 0.8}))
PLAN = requests.PlanRequest(robot="panda", scene="bookshelf", goal=requests.GuidePlaneGoal())


@pytest.fixture(scope="module")
def engine() -> Engine:
    return Engine()


@pytest.fixture
def keeping(tmp_path: Path) -> Engine:
    return Engine("cell", recordings=Recordings(tmp_path / "recordings"), scenes=SceneStore(tmp_path / "scenes"))


def _potential(scene: str | Scene, *points: tuple[float, float, float]) -> requests.Potential:
    return requests.Potential(scene=scene, points=list(points))


@pytest.mark.parametrize(
    "asked",
    [
        {"goal": {"type": "joints", "positions": {"panda_joint1": 0.1}}, "guide_planes": []},
        {"steps": [{"goal": {"type": "joints", "positions": {"panda_joint1": 0.1}}}]},
        {"type": "certify", "path": [[0.0], [0.1]], "position_names": ["panda_joint1"]},
    ],
    ids=["plan", "steps", "certify"],
)
def test_the_time_that_a_request_waited_is_told(engine: Engine, asked: dict[str, Any]) -> None:
    request = {"robot": "panda", "scene": "table", "recording": "off", **asked}
    timing = engine.answer(request, received=time.monotonic() - 2.0).timing
    assert 2.0 <= timing.queue <= timing.total


@pytest.mark.parametrize(
    "asked",
    [
        {"goal": {"type": "joints", "positions": {"panda_joint1": 0.1}}, "guide_planes": []},
        {"type": "certify", "path": [[0.0], [0.1]], "position_names": ["panda_joint1"]},
    ],
    ids=["plan", "certify"],
)
def test_a_robot_is_loaded_once_for_a_request(asked: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    loaded, load = [], Catalog.load

    def counted(catalog: Catalog, reference: Any) -> Any:
        loaded.append(reference)
        return load(catalog, reference)

    monkeypatch.setattr(Catalog, "load", counted)
    engine, request = Engine(), {"robot": "panda", "scene": "table", "recording": "off", **asked}
    for times in (1, 2):
        engine.answer(request)
        assert loaded == ["panda"] * times


@pytest.mark.parametrize("form", [None, 3, b"\x00", "[]", {"type": "nonsense"}, plan_reply("r1"), BALL])
def test_what_is_no_request_is_malformed(form: Any, engine: Engine) -> None:
    with pytest.raises(MalformedRequest):
        engine.answer(form)


@pytest.mark.parametrize("slow", ["guidefield.scene.scene.build", "guidefield.handlers.preparation.prepare_scene"])
def test_an_answer_is_late_by_one_call_at_most_and_what_that_made_is_kept(slow, monkeypatch):
    engine, calls = Engine(), []
    request = {**msgspec.to_builtins(TO_JOINTS), "allowed_planning_time": 0.6}
    sign = {"type": "polygon", "name": "sign", "vertices": [(9.0, 0.0, 0.0), (9.0, 1.0, 0.0), (9.0, 0.0, 1.0)]}
    request["scene"]["obstacles"].append(sign)  # primitives need no preparation
    engine.answer({"robot": "panda", "scene": "bookshelf", "goal": TO_JOINTS.goal, "allowed_planning_time": 60.0})
    room, _, name = slow.rpartition(".")
    call = getattr(pkgutil.resolve_name(room), name)

    def slowly(*asked: Any, **options: Any) -> Any:
        calls.append(name)
        made = call(*asked, **options)
        time.sleep(0.7)
        return made

    monkeypatch.setattr(slow, slowly)
    reply = engine.answer(request)
    assert (reply.status.name, reply.status.details["stage"]) == ("TIMED_OUT", "load")
    assert reply.status.details["preparing"]
    assert reply.trajectory is None
    engine.answer({**request, "allowed_planning_time": 60.0})
    assert calls == [name] if "build" in slow else len(calls) == 2
    with pytest.raises(TimedOut, match=r"1e-09 s that were allowed"):
        engine.answer(requests.Potential(scene=FIELD, points=[(0.0, 0.0, 1.0)], allowed_time=1e-9))


def test_a_robot_is_described(engine: Engine) -> None:
    reply = engine.answer(requests.ReadRobot("panda"))
    joint = next(joint for joint in reply.joints if joint.name == "panda_joint4")
    assert joint.kind == "revolute"
    assert joint.lower[0] == pytest.approx(-3.0718, abs=1e-3)
    assert joint.velocity_source == "urdf"
    assert joint.acceleration_source == "card"
    assert reply.tip == "panda_hand_tcp"
    assert reply.tip in reply.frames
    tested = {tuple(pair) for pair in reply.collision_pairs}
    left_out = {tuple(sorted(pair.links)) for pair in reply.pairs_left_out}
    assert tested
    assert not tested & left_out
    assert msgspec.json.encode(reply)


def test_unknown_names_are_answered_with_those_there_are(engine: Engine) -> None:
    with pytest.raises(RobotInvalid, match="no robot 'r2d2'") as robot:
        engine.answer(requests.ReadRobot("r2d2"))
    assert "panda" in robot.value.details["available"]
    with pytest.raises(SceneInvalid, match="no scene 'nowhere'") as scene:
        engine.answer(_potential("nowhere", (0.0, 0.0, 0.0)))
    assert "bookshelf" in scene.value.details["available"]
    with pytest.raises(UnknownObject):
        engine.answer(requests.ReadRun("r1"))


def test_a_bug_is_named_and_logged_with_its_trace(engine, monkeypatch, caplog):
    def bug(*_: object) -> None:
        raise ZeroDivisionError("there is a bug here")

    monkeypatch.setattr("guidefield.scene.scene.build", bug)
    with caplog.at_level(logging.ERROR), pytest.raises(InternalFailure, match="ZeroDivisionError: there is a bug here"):
        engine.answer(_potential(Scene("never built before"), (0.0, 0.0, 0.0)))
    assert "Traceback" in caplog.text
    assert "def bug" not in caplog.text
    assert "raise ZeroDivisionError" in caplog.text


def test_files_of_this_machine_are_read_only_where_that_is_allowed() -> None:
    guarded = Engine(local_files=LocalFiles.REFUSED)
    request = requests.ForwardKinematics(requests.UrdfFile("/etc/hostname"), ["base"], [{}])
    with pytest.raises(RobotInvalid, match="local file"):
        guarded.answer(request)


def test_a_scene_that_cannot_be_built_is_not_stored(keeping: Engine) -> None:
    bent = GuidePlane("bent", [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.5), (0.0, 1.0, 0.0)])
    with pytest.raises(SceneInvalid, match="bent"):
        keeping.answer(requests.StoreScene("bad", Scene("bad", guide_planes=[bent])))
    with pytest.raises(SceneInvalid, match="no scene 'bad'"):
        keeping.answer(requests.ReadScene("bad"))


FINISHED: list[str | None] = []  # the recordings that were written, by their names in replies


def _record(place: Any, run: Any, _log: object) -> None:
    """Stand in for the recorder."""
    FINISHED.append(run.reply.recording)
    place.file.write_bytes(b"recording")


def _refuse_to_record(*_: object) -> None:
    raise OSError(28, "No space left on device")


CONDITIONS: Any = SimpleNamespace(group=None)


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Plans without planning; returns what the planner was asked with."""
    asked: list[dict[str, Any]] = []

    def answer_plan(request: Any, robot: Any, scene: Any, **about: Any) -> Any:
        asked.append(about)
        reply = plan_reply(about["run_id"])
        if (recording := about["record"](None, scene)) is not None:
            recording.finish(reply, PlainMotion(scene, CONDITIONS, None))
        return reply

    monkeypatch.setattr("guidefield.handlers.plan.answer_plan", answer_plan)
    monkeypatch.setattr("guidefield.recorder.recorder.record_plan", _record)
    FINISHED.clear()
    return asked


def test_the_log_of_a_run_is_kept_or_its_recording_where_no_log_can_be(keeping, planned, tmp_path, monkeypatch):
    received = time.monotonic()
    reply = keeping.answer(msgspec.structs.replace(PLAN, run_id="r1"), received=received)
    assert reply.recording == "guidefield/cell/runs/r1/recording"
    assert planned[0]["received"] == received
    assert received <= planned[0]["began"] <= time.monotonic()
    assert [file.name for file in (tmp_path / "recordings").iterdir()] == ["r1.log"]
    assert FINISHED == []
    monkeypatch.setattr(Recordings, "store_log", _refuse)
    assert keeping.answer(msgspec.structs.replace(PLAN, run_id="r2")).recording == "guidefield/cell/runs/r2/recording"
    assert FINISHED == ["guidefield/cell/runs/r2/recording"]
    assert (tmp_path / "recordings" / "r2.rrd").read_bytes() == b"recording"


def _refuse(*_: object) -> None:
    raise OSError(1, "Operation not permitted")


def test_a_full_disk_is_a_warning_and_the_plan_is_answered(keeping, planned, monkeypatch):
    monkeypatch.setattr("guidefield.recorder.recorder.record_plan", _refuse_to_record)
    monkeypatch.setattr(Recordings, "store_log", _refuse)
    reply = keeping.answer(PLAN)
    assert reply.recording is None
    assert any("No space left" in warning for warning in reply.warnings)


def test_a_recording_that_is_too_large_is_dropped(engine, planned, tmp_path, monkeypatch):
    monkeypatch.setattr("guidefield.rendering.LARGEST_RECORDING", len(b"recording") - 1)
    reply = engine.answer(PLAN, record_to=tmp_path / "large.rrd")
    assert reply.recording is None
    assert any("at most 8 are kept" in warning for warning in reply.warnings)
    assert list(tmp_path.iterdir()) == []


def test_two_of_one_name_in_a_change_of_a_stored_scene_are_refused(tmp_path: Path) -> None:
    store = SceneStore(tmp_path)
    keeps = Engine(scenes=store)
    keeps.answer({"type": "store_scene", "name": "cell", "scene": {"name": "cell", "obstacles": []}})
    twin = {"type": "sphere", "name": "a", "radius": 0.1}
    with pytest.raises(SceneInvalid, match="two obstacles 'a'") as refused:
        keeps.answer({"type": "change_scene", "name": "cell", "diff": {"type": "scene_diff", "add": [twin, twin]}})
    assert refused.value.details["path"] == "$.diff.add[1].name"
    assert store.read("cell") == (Scene("cell"), 1)


@pytest.mark.parametrize(
    "request_",
    [
        {"type": "forward_kinematics", "frames": ["a"], "configurations": [{}]},
        {"scene": "table", "goal": {"type": "joints", "positions": {}}},
    ],
)
def test_a_robots_name_that_no_file_can_have_is_refused_at_its_place(request_: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(MalformedRequest, match="robot 'bad name!' must be") as refused:
        Engine(robots=RobotStore(tmp_path)).answer({**request_, "robot": "bad name!"})
    assert refused.value.details["path"] == "$.robot"
