"""Runs that earlier versions kept: every later one reads them, shows them, and says who planned them."""

import json
import re
import shutil
import tarfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from rerun.chunk import RrdReader
from rich.console import Console
from typer.testing import CliRunner

import guidefield
from guidefield.cli.commands import app
from guidefield.engine import Engine
from guidefield.errors import SceneInvalid, Status
from guidefield.messages import codec
from guidefield.messages.identities import PLAIN
from guidefield.messages.replies import ErrorReply, PlanReply
from guidefield.messages.requests import PlanRequest, ReadRobot, ReadScene
from guidefield.messages.scene import Scene
from guidefield.recorder.stored import read_recording
from guidefield.stores.robots import RobotStore
from guidefield.stores.runs import RunDatabase, answered_before
from guidefield.stores.scenes import SceneStore

ARCHIVES = {path.name.removesuffix(".tar.xz"): path for path in sorted(Path(__file__).parent.glob("*.tar.xz"))}
RUNS = {
    "interrupted": ("CRASH", "panda", "walled"),
    "sent": ("SUCCESS", "urdf", "empty"),
    "pose": ("SUCCESS", "lift_arm", "cell"),
    "constrained": ("SUCCESS", "lift_arm", "rich"),
    "refused": ("GOAL_IN_COLLISION", "lift_arm", "cell"),
    "joints": ("SUCCESS", "lift_arm", "cell"),
    "conveyor": ("SUCCESS", "chain_moving_3x260_r20", "conveyor"),
    "guided": ("SUCCESS", "chain_planar_3x260_r25", "seed_e_L_3"),
}
"""Status, robot and scene of each, newest first."""
MOVING = [name for name, (status, *_) in RUNS.items() if status == "SUCCESS"]
RECORDED = ("guided", "joints", "refused")


@pytest.fixture(params=ARCHIVES)
def version(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def kept(version: str, tmp_path: Path) -> Path:
    """What a version kept, in folders that may be changed: `before`, and `data` as this version took it over."""
    with tarfile.open(ARCHIVES[version]) as file:
        file.extractall(tmp_path, filter="data")
    shutil.copytree(tmp_path / "data", tmp_path / "before")
    database = RunDatabase(tmp_path / "data")
    database.take_over(lambda _: None)
    database.close()
    return tmp_path


@pytest.fixture(autouse=True)
def _wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("guidefield.cli.kept_runs.out", Console(width=300))


def _ran(*arguments: object) -> tuple[int, str]:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    return done.exit_code, done.output


def _said(*arguments: object) -> str:
    code, output = _ran(*arguments)
    assert code == 0, output
    return output


def _lost(old: Any, new: Any, at: str = "$") -> Iterator[str]:
    """Where a message no longer says what it said; what is added is none of it."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key, value in old.items():
            if key in new:
                yield from _lost(value, new[key], f"{at}.{key}")
            else:
                yield f"{at}.{key}"
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for i, (one, other) in enumerate(zip(old, new, strict=True)):
            yield from _lost(one, other, f"{at}[{i}]")
    elif old != new or type(old) is not type(new):
        yield at


def test_the_archives_are_there() -> None:
    assert "0.1.0" in ARCHIVES


def test_messages_mean_what_they_meant(kept: Path) -> None:
    data = kept / "before"
    kinds = {
        "runs/*/request.json": partial(codec.decode, kind=PlanRequest),
        "runs/*/reply.json": partial(msgspec.json.decode, type=PlanReply),
        "runs/*/error.json": partial(msgspec.json.decode, type=ErrorReply),
        "scenes/*.json": partial(codec.decode, kind=Scene),
    }
    for pattern, decode in kinds.items():
        files = list(data.glob(pattern))
        assert files, pattern
        for file in files:
            message = decode(file.read_bytes())
            assert getattr(message, "schema", 1) == 1
            assert list(_lost(json.loads(file.read_bytes()), json.loads(codec.encode(message)))) == [], file


def test_runs_are_listed(kept: Path) -> None:
    listed = json.loads(_said("runs", "list", "--data", kept / "data", "--json"))["runs"]
    assert {run["run_id"]: (run["status"], run["robot"], run["scene"]) for run in listed} == RUNS
    assert [run["run_id"] for run in listed] == list(RUNS)
    only = json.loads(_said("runs", "list", "--data", kept / "data", "--json", "--status", "GOAL_IN_COLLISION"))["runs"]
    assert [run["run_id"] for run in only] == ["refused"]
    assert all(name in _said("runs", "list", "--data", kept / "data") for name in RUNS)


def test_runs_are_compared(kept: Path) -> None:
    data = kept / "data"
    assert "the same plan to the last bit" in _said("runs", "compare", "guided", "guided", "--data", data)
    said = _said("runs", "compare", "refused", kept / "recordings" / "refused.rrd", "--data", data)
    assert "the same plan to the last bit" in said
    assert "trajectory" in _said("runs", "compare", "joints", "pose", "--data", data)


def test_motions_are_exported(kept: Path) -> None:
    for name in MOVING:
        reply = json.loads((kept / "before" / "runs" / name / "reply.json").read_bytes())
        _said("runs", "export", name, kept / f"{name}.json", "--data", kept / "data")
        written = json.loads((kept / f"{name}.json").read_bytes())
        assert written["path"] == reply["path"]
        for part, rows in reply["trajectory"].items():
            assert written[part] == rows, (name, part)
    for ending in ("csv", "npz"):
        _said("runs", "export", "joints", kept / f"joints.{ending}", "--data", kept / "data")


def test_recordings_leave_the_store_whole(kept: Path) -> None:
    for name in RECORDED:
        _said("runs", "export", name, kept / f"{name}.rrd", "--data", kept / "data")
        reply = json.loads((kept / "before" / "runs" / name / "reply.json").read_bytes())
        recorded = read_recording(kept / f"{name}.rrd").reply
        assert list(_lost(reply, json.loads(codec.encode(recorded)))) == []
    entities = {chunk.entity_path for chunk in RrdReader(kept / "refused.rrd").stream().to_chunks()}
    before = {chunk.entity_path for chunk in RrdReader(kept / "recordings/refused.rrd").stream().to_chunks()}
    assert entities == before, "as they left it then, the robot's meshes among them"


def test_recordings_are_shown(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = []

    def show(recording: Path, _err: Console) -> int:
        shown.append(read_recording(recording).reply.run_id)
        return 0

    monkeypatch.setattr("guidefield.cli.showing.show_in_window", show)
    _said("show", "guided", "--data", kept / "data")
    _said("show", kept / "recordings" / "refused.rrd")
    assert shown == ["guided", "refused"]


def test_recordings_are_arrays(kept: Path, version: str) -> None:
    motion = guidefield.run_arrays(kept / "recordings" / "alone.rrd")
    assert motion.position_names == ("root_joint.x", "root_joint.y", "root_joint.theta", "turn")
    assert motion.positions.shape == (len(motion.times), 4)
    assert motion.velocities.shape == motion.accelerations.shape == motion.positions.shape
    assert np.allclose(motion.positions[-1], [-0.1, 0.9, 0.5, 0.5], atol=1e-9)
    stored = guidefield.run_arrays(kept / "data" / "recordings" / "joints.rrd")
    reply = RunDatabase(kept / "data").of(PLAIN).read("joints").reply
    assert reply is not None
    assert stored.positions.tobytes() == guidefield.run_arrays(reply).positions.tobytes()
    assert read_recording(kept / "recordings" / "alone.rrd").versions["guidefield"] == version


def test_a_service_goes_on_with_them(kept: Path) -> None:
    data = kept / "data"
    runs, robots, scenes = RunDatabase(data).of(PLAIN), RobotStore(data / "robots"), SceneStore(data / "scenes")
    engine = Engine(runs=runs, robots=robots, scenes=scenes)
    assert engine.answer(ReadRobot("lift_arm")).tip
    assert {obstacle.name for obstacle in engine.answer(ReadScene("cell")).scene.obstacles} == {"post", "ball"}
    read = runs.read("joints")
    assert answered_before(runs, read.request, "joints") == read.reply, "whose link broke asks again"
    assert runs.read("interrupted").error is not None


def test_a_run_is_planned_again(kept: Path, version: str) -> None:
    """The same plan, or else it is said which version planned it."""
    for run in ("refused", kept / "recordings" / "refused.rrd"):
        code, said = _ran("replay", run, "--data", kept / "data")
        assert code in (0, 1), said
        assert (": bit-identical: " if code == 0 else f": not the same: {_by(version)}the plan differs in ") in said


def test_a_plan_that_differs_says_who_planned_it(kept: Path, version: str) -> None:
    """Clients stored another scene under the name since then."""
    SceneStore(kept / "data" / "scenes").write(Scene("cell"))
    code, said = _ran("replay", "refused", "--data", kept / "data")
    assert code == 1, said
    assert said.startswith(f"refused: not the same: {_by(version)}the plan differs in status, path, trajectory")
    assert re.search(r"then: GOAL_IN_COLLISION.*\nnow:  SUCCESS", said)
    assert said.count(version) == 1, "the last line is about the other packages"


def test_a_request_that_is_refused_now_says_who_planned_it(kept: Path, version: str) -> None:
    SceneStore(kept / "data" / "scenes").delete("cell")
    done = CliRunner().invoke(app, ["replay", "refused", "--data", str(kept / "data")])
    assert isinstance(done.exception, SceneInvalid), "which is exit code 2"
    assert done.output == f"refused: {_by(version)}its request is refused now\n"


def _by(version: str) -> str:
    return f"planned by guidefield {version}, this is {guidefield.__version__}: "


def test_the_statuses_are_still_known() -> None:
    assert {status for status, *_ in RUNS.values()} <= {status.name for status in Status}
