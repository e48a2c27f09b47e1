"""Runs and recordings on the command line: listed, read as arrays, compared, exported and planned again."""

import csv
import json
import platform
import shutil
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

import guidefield
from guidefield.arrays import run_arrays
from guidefield.cli.commands import app
from guidefield.cli.found_run import find_plan, find_run
from guidefield.engine import Engine
from guidefield.errors import MalformedRequest, Status, UnknownObject
from guidefield.messages.identities import PLAIN
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import JointsGoal, PlanRequest
from guidefield.messages.scene import Scene, Sphere
from guidefield.recorder.stored import read_recording
from guidefield.stores.runs import RunDatabase
from guidefield.stores.scenes import SceneStore
from guidefield.versions import versions
from tests.kept_runs import keep
from tests.recorder.runs import made_up
from tests.replies import plan_reply

REQUEST = PlanRequest(
    robot="panda",
    scene=Scene("ball", obstacles=[Sphere(name="ball", radius=0.1, position=(0.5, 0.4, 0.5))]),
    goal=JointsGoal({"panda_joint1": 1.0}),
    allowed_planning_time=60.0,
    recording="off",
)
RECORDED = msgspec.structs.replace(REQUEST, recording="summary")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    database = RunDatabase(folder)
    reply = Engine().answer(msgspec.structs.replace(REQUEST, run_id="good"))
    moved = [[x + 0.5 for x in row] for row in reply.path]
    for name, path in (("good", reply.path), ("moved", moved), ("same", reply.path)):
        keep(database, name, msgspec.structs.replace(reply, run_id=name, path=path), REQUEST)
    keep(database, "proved", reply, msgspec.structs.replace(REQUEST, proof=True))
    keep(database, "stuck", Status.STUCK_IN_MINIMUM, REQUEST)
    keep(database, "hers", reply, REQUEST, owner="alice")
    stored = SceneStore(folder / "users" / "alice" / "scenes")
    stored.write(msgspec.structs.replace(REQUEST.scene, name="cell"))
    keep(database, "in_her_cell", reply, msgspec.structs.replace(REQUEST, scene="cell"), owner="alice")
    database.close()
    return folder


@pytest.fixture(autouse=True)
def _wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables don't wrap, whatever the terminal."""
    monkeypatch.setattr("guidefield.cli.kept_runs.out", Console(width=300))


def _said(code: int, *arguments: object) -> str:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert done.exit_code == code, (done.output, done.exception)
    return done.output


def test_runs_are_listed_and_filtered(data: Path) -> None:
    def names(*options: str) -> set[str]:
        said = _said(0, "runs", "list", "--data", data, "--json", *options)
        return {run["run_id"] for run in json.loads(said)["runs"]}

    assert names() == {"good", "moved", "same", "proved", "stuck", "alice:hers", "alice:in_her_cell"}
    assert names("--status", "STUCK_IN_MINIMUM") == {"stuck"}
    assert names("--text", "BY HAND") == {"stuck"}
    assert names("--limit", "2") == {"alice:hers", "alice:in_her_cell"}
    assert names("--robot", "ur5") == names("--since", "2999-01-01") == set()
    assert "STUCK_IN_MINIMUM" in _said(0, "runs", "list", "--data", data)
    assert "must be one of SUCCESS" in _said(2, "runs", "list", "--data", data, "--status", "success")


def test_recordings_that_are_owed_are_rendered_when_they_are_asked_for(tmp_path: Path) -> None:
    database = RunDatabase(tmp_path)
    for owner, run_id in ((PLAIN, "r1"), (PLAIN, "r2"), ("alice", "a1")):
        engine = Engine(recordings=database.recordings(owner))
        keep(database, run_id, engine.answer(msgspec.structs.replace(RECORDED, run_id=run_id)), RECORDED, owner=owner)
    database.close()
    given = ("--data", str(tmp_path))
    assert _said(0, "runs", "list", *given).count(" owed") == 3
    assert find_run("r1", tmp_path, "local").versions == versions()
    _said(0, "runs", "export", "r1", tmp_path / "r1.rrd", *given)
    assert read_recording(tmp_path / "r1.rrd").reply.run_id == "r1"
    assert {
        run["run_id"]: run["recording"] for run in json.loads(_said(0, "runs", "list", "--json", *given))["runs"]
    } == {"alice:a1": "owed", "r2": "owed", "r1": "rendered"}
    assert _said(0, "runs", "render", *given).endswith("2 rendered\n")
    assert _said(0, "runs", "render", *given).endswith("0 rendered\n")
    assert " owed" not in _said(0, "runs", "list", *given)
    assert (tmp_path / "users" / "alice" / "recordings" / "a1.rrd").is_file()


def test_another_users_run_is_named_with_its_owner(data: Path, tmp_path: Path) -> None:
    _said(0, "runs", "export", "alice:hers", tmp_path / "motion.json", "--data", data)
    assert json.loads((tmp_path / "motion.json").read_text())["path"]
    with pytest.raises(UnknownObject, match="no run 'hers'"):
        find_plan("hers", data, "local")


def test_another_users_run_is_planned_and_judged_in_its_owners_scenes(data: Path) -> None:
    assert "bit-identical" in _said(0, "replay", "alice:in_her_cell", "--data", data)
    assert "free" in _said(0, "certify", "alice:in_her_cell", "--data", data)


def test_what_looks_at_runs_makes_no_folder(data: Path) -> None:
    before = {path for path in data.rglob("*") if path.is_dir()}
    _said(0, "replay", "good", "--data", data)
    _said(0, "certify", "good", "--data", data)
    _said(0, "replay", "alice:hers", "--data", data)
    assert {path for path in data.rglob("*") if path.is_dir()} == before


def test_runs_of_the_first_version_are_taken_over_by_a_service(tmp_path: Path) -> None:
    (tmp_path / "runs" / "r1").mkdir(parents=True)
    done = CliRunner().invoke(app, ["runs", "list", "--data", str(tmp_path)])
    assert isinstance(done.exception, UnknownObject)
    assert f"`guidefield serve --data {tmp_path}` takes them over" in str(done.exception)


def test_two_runs_are_compared(data: Path) -> None:
    said = _said(0, "runs", "compare", "good", "moved", "--data", data)
    assert "path" in said.splitlines()[-2]
    assert "waypoints by at most 0.5" in said
    assert "the same plan to the last bit" in _said(0, "runs", "compare", "good", "same", "--data", data)


def test_a_motion_is_exported_to_the_last_digit(data: Path, tmp_path: Path) -> None:
    reply = RunDatabase(data).of(PLAIN).read("good").reply
    for ending in ("csv", "json", "npz"):
        _said(0, "runs", "export", "good", tmp_path / f"motion.{ending}", "--data", data)
    with np.load(tmp_path / "motion.npz", allow_pickle=False) as file:
        assert file["positions"].tolist() == reply.trajectory.positions
        assert file["position_names"].tolist() == reply.position_names
    assert json.loads((tmp_path / "motion.json").read_text())["velocities"] == reply.trajectory.velocities
    with (tmp_path / "motion.csv").open(newline="") as text:
        rows = list(csv.DictReader(text))
    assert [float(row["time"]) for row in rows] == reply.trajectory.times
    joint = reply.position_names[0]
    assert [float(row[f"position:{joint}"]) for row in rows] == [row[0] for row in reply.trajectory.positions]


def test_what_cannot_be_exported_is_said(data: Path, tmp_path: Path) -> None:
    with pytest.raises(UnknownObject, match="'stuck' has no motion: STUCK_IN_MINIMUM"):
        run_arrays(plan_reply("stuck", Status.STUCK_IN_MINIMUM))
    done = CliRunner().invoke(app, ["runs", "export", "good", str(tmp_path / "motion.bag"), "--data", str(data)])
    assert isinstance(done.exception, MalformedRequest)
    assert "must end with one of .csv" in str(done.exception)


def test_a_run_with_a_proof_is_planned_again_without_one(data: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert "proved: bit-identical: SUCCESS" in _said(0, "replay", "proved", "--data", data)
    assert [record.message for record in caplog.records if "no proof" in record.message] == []


def test_a_run_is_planned_again(data: Path) -> None:
    assert "good: bit-identical: SUCCESS" in _said(0, "replay", "good", "--data", data)
    said = _said(1, "replay", "moved", "--data", data)
    assert "not the same: the plan differs in path; waypoints by at most 0.5" in said
    assert "the versions that it was made with were not recorded" in said


BARE = PlanRequest(
    robot="panda",
    scene=Scene("ball", obstacles=[Sphere(name="ball", radius=0.1, position=(0.5, 0.4, 0.5))]),
    goal=JointsGoal({"panda_joint1": 1.0}),
    allowed_planning_time=60.0,
)


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> tuple[PlanRequest, PlanReply, Path]:
    """A plan whose recording has gone to another folder."""
    folder = tmp_path_factory.mktemp("planned")
    reply = guidefield.answer(BARE, record_to=str(folder / "here.rrd"))
    assert reply.status.code == Status.SUCCESS, reply.status
    there = tmp_path_factory.mktemp("elsewhere") / "run.rrd"
    shutil.copy(folder / "here.rrd", there)
    return BARE, reply, there


def test_the_messages_are_read_to_the_last_bit(planned: tuple[PlanRequest, PlanReply, Path]) -> None:
    request, reply, file = planned
    recorded = read_recording(file)
    assert recorded.request == request
    assert msgspec.json.encode(recorded.reply.path) == msgspec.json.encode(reply.path)
    assert recorded.reply.trajectory == reply.trajectory
    assert recorded.versions == versions()
    assert recorded.versions["numpy"] == np.__version__


def test_arrays_are_those_of_the_reply(planned: tuple[PlanRequest, PlanReply, Path]) -> None:
    _, reply, file = planned
    read, given = guidefield.run_arrays(str(file)), guidefield.run_arrays(reply)
    assert read.positions.tolist() == reply.trajectory.positions
    assert read.position_names == given.position_names == tuple(reply.position_names)
    for name in ("times", "positions", "velocities", "accelerations", "path"):
        assert getattr(read, name).tobytes() == getattr(given, name).tobytes()
    assert read.positions.shape == (len(read.times), len(read.position_names))
    with pytest.raises(ValueError, match="read-only"):
        read.positions[0, 0] = 1.0


def test_a_file_is_compared_and_exported(planned: tuple[PlanRequest, PlanReply, Path], tmp_path: Path) -> None:
    _, reply, file = planned
    assert "the same plan to the last bit" in _said(0, "runs", "compare", file, file)
    _said(0, "runs", "export", file, tmp_path / "motion.json")
    assert json.loads((tmp_path / "motion.json").read_text())["path"] == reply.path


def test_a_plan_that_comes_out_otherwise_tells_what_it_was_made_with(tmp_path: Path) -> None:
    made = made_up("panda")
    run = replace(made, request=msgspec.structs.replace(BARE, seed=3))
    run.record(tmp_path / "run.rrd")
    said = _said(1, "replay", tmp_path / "run.rrd", "--data", tmp_path / "none")
    assert "not the same: the plan differs in status, path, trajectory" in said
    assert "it was made with the same versions as are here" in said
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        ("pdp11 01234567", "made on pdp11, this is {here}: the plan differs in status, path, trajectory"),
        ("{here} none", "made on another kind of {here}: the plan differs in status, path, trajectory"),
    ],
)
def test_a_plan_of_another_processor_says_so(kind: str, told: str, tmp_path: Path) -> None:
    here = platform.machine()
    made = made_up("panda")
    run = replace(made, request=msgspec.structs.replace(BARE, seed=3))
    there = {**versions(), "processor": kind.format(here=here)}
    made_with = ", ".join(" ".join(one) for one in there.items())
    run.record(tmp_path / "run.rrd", made_with=made_with)
    said = _said(1, "replay", tmp_path / "run.rrd", "--data", tmp_path / "none")
    assert told.format(here=here) in said
    assert "not the same" not in said
    assert f"it was made with processor {kind.format(here=here)} (here {here} " in said


def test_what_is_no_recording_is_said(planned: tuple[PlanRequest, PlanReply, Path], tmp_path: Path) -> None:
    with pytest.raises(UnknownObject, match="there is no recording"):
        guidefield.run_arrays(tmp_path / "none.rrd")
    (tmp_path / "text.rrd").write_text("hello")
    whole = planned[2].read_bytes()
    (tmp_path / "cut.rrd").write_bytes(whole[: len(whole) // 2])
    for name in ("text", "cut"):
        with pytest.raises(MalformedRequest, match=f"'{name}.rrd' is no whole recording of guidefield"):
            guidefield.run_arrays(tmp_path / f"{name}.rrd")
