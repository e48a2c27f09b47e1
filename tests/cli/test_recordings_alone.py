"""A recording's file, with nothing kept beside it: read as arrays, compared, exported and planned again."""

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
from guidefield.cli.commands import app
from guidefield.errors import MalformedRequest, Status, UnknownObject
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import JointsGoal, PlanRequest
from guidefield.messages.scene import Scene, Sphere
from guidefield.recorder.stored import read_recording
from guidefield.versions import versions
from tests.recorder.runs import made_up

REQUEST = PlanRequest(
    robot="panda",
    scene=Scene("ball", obstacles=[Sphere(name="ball", radius=0.1, position=(0.5, 0.4, 0.5))]),
    goal=JointsGoal({"panda_joint1": 1.0}),
    allowed_planning_time=60.0,
)


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> tuple[PlanRequest, PlanReply, Path]:
    """A plan whose recording has gone to another folder."""
    folder = tmp_path_factory.mktemp("planned")
    reply = guidefield.answer(REQUEST, record_to=str(folder / "here.rrd"))
    assert reply.status.code == Status.SUCCESS, reply.status
    there = tmp_path_factory.mktemp("elsewhere") / "run.rrd"
    shutil.copy(folder / "here.rrd", there)
    return REQUEST, reply, there


@pytest.fixture(autouse=True)
def _wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("guidefield.cli.kept_runs.out", Console(width=300))


def _said(code: int, *arguments: object) -> str:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert done.exit_code == code, (done.output, done.exception)
    return done.output


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
    run = replace(made, request=msgspec.structs.replace(REQUEST, seed=3))
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
    run = replace(made, request=msgspec.structs.replace(REQUEST, seed=3))
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
