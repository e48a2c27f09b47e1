"""`guidefield certify`: motions from every kind of file, from recordings and kept runs; what is wrong with a file."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import guidefield
from guidefield import run_arrays
from guidefield.arrays import write_motion
from guidefield.cli import app
from guidefield.cli.certifying import read_fields
from guidefield.engine import Engine
from guidefield.errors import GuidefieldError, MalformedRequest, UnknownObject
from guidefield.messages import codec
from guidefield.messages.identities import PLAIN
from guidefield.messages.requests import PlanRequest
from guidefield.referee.case import Answer, Finding, Verdict
from guidefield.referee.judge import judge
from guidefield.referee.loading import load
from guidefield.stores.runs import RunDatabase
from tests.kept_runs import keep

PLAN = {
    "robot": "ur5", "scene": "table", "goal": {"type": "joints", "positions": {"elbow_joint": 1.2}},
    "guide_planes": [], "min_clearance": 0.001, "allowed_planning_time": 60.0,
}  # fmt: skip
HERE = ["--robot", "ur5", "--scene", "table"]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder with a plan's run, and the plan in every kind of file beside it."""
    data = tmp_path_factory.mktemp("data")
    database = RunDatabase(data)
    request = codec.convert({**PLAN, "run_id": "planned", "recording": "summary"}, PlanRequest)
    reply = Engine(recordings=database.recordings(PLAIN)).answer(request)
    keep(database, "planned", reply, request)
    database.close()
    for ending in ("csv", "json", "npz"):
        write_motion(run_arrays(reply), data / f"motion.{ending}")
    (data / "reply.json").write_bytes(codec.encode(reply))
    guidefield.answer(PLAN, record_to=data / "run.rrd")
    return data


def run(*words: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["certify", *words])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        assert isinstance(done.exception, GuidefieldError), done.exception
        return 2, str(done.exception)
    return done.exit_code, done.output


@pytest.mark.parametrize("name", ["motion.csv", "motion.json", "motion.npz", "reply.json"])
def test_a_motion_in_a_file_is_judged(name: str, kept: Path, tmp_path: Path) -> None:
    output = tmp_path / "verdict.json"
    code, told = run(str(kept / name), *HERE, "-o", str(output))
    assert code == 0, told
    planned = json.loads((kept / "reply.json").read_bytes())
    verdict = json.loads(output.read_bytes())
    assert verdict["curve"] == "hermite"
    assert verdict["clearance"]["minimum"] == planned["clearance"]["minimum"]
    assert "collision-free" in told
    assert "velocity limit" in told


def test_a_recording_and_a_kept_run_bring_their_robot_and_scene(kept: Path, tmp_path: Path) -> None:
    record = tmp_path / "judged.rrd"
    assert run(str(kept / "run.rrd"), "--record", str(record))[0] == 0
    assert read_fields(kept / "run.rrd")["min_clearance"] == PLAN["min_clearance"]
    again = run("planned", "--data", str(kept))
    assert again[0] == 0, again[1]
    assert run(str(record), "--min-clearance", "0.5")[0] == 1
    replayed = CliRunner().invoke(app, ["replay", str(record)])
    assert replayed.exit_code == 0, replayed.output
    assert "judged as before: SUCCESS" in replayed.output
    compared = CliRunner().invoke(app, ["runs", "compare", str(record), str(kept / "run.rrd")])
    assert isinstance(compared.exception, MalformedRequest)


def test_a_proof_is_written_and_replayed(kept: Path, tmp_path: Path) -> None:
    proof = tmp_path / "proof.npz"
    code, told = run(str(kept / "motion.csv"), *HERE, "--proof", str(proof))
    assert code == 0, told
    code, told = run("--replay", str(proof))
    assert code == 0, told
    assert told.startswith("referee: free\n")
    assert " slabs; each keeps at least " in told
    alone = subprocess.run(
        [sys.executable, "-m", "guidefield.referee", str(proof)], capture_output=True, text=True, check=True
    )
    assert alone.stdout == told
    proof.write_bytes(proof.read_bytes()[:-100])
    assert run("--replay", str(proof))[0] == 2
    refused = tmp_path / "none.npz"
    code, told = run(str(kept / "motion.csv"), *HERE, "--min-clearance", "0.5", "--proof", str(refused))
    assert (code, refused.exists()) == (1, False)
    assert "no proof is kept" in " ".join(told.split())


def test_a_refusal_is_exit_code_1_and_tells_the_place(kept: Path, tmp_path: Path) -> None:
    wall = {"name": "s", "obstacles": [{"type": "box", "name": "wall", "size": [2, 2, 0.1], "position": [0, 0, 0.3]}]}
    (tmp_path / "wall.json").write_text(json.dumps(wall))
    code, told = run(str(kept / "motion.csv"), "--robot", "ur5", "--scene", str(tmp_path / "wall.json"))
    assert code == 1
    assert "INVALID_MOTION_PLAN" in told
    assert "free until" in told
    assert "wall" in told


def test_columns_by_their_bare_names_and_a_time_step(tmp_path: Path) -> None:
    file = tmp_path / "m.csv"
    file.write_text("elbow_joint,shoulder_pan_joint\n1.0,0.0\n1.1,0.1\n1.2,0.4\n")
    assert read_fields(file) == {
        "path": [[1.0, 0.0], [1.1, 0.1], [1.2, 0.4]], "position_names": ["elbow_joint", "shoulder_pan_joint"]
    }  # fmt: skip
    assert "curve linear" in run(str(file), *HERE)[1]
    code, told = run(str(file), *HERE, "--time-step", "0.5")
    assert (code, "curve spline" in told) == (0, True), told
    assert "acceleration limit" in told


def test_a_certify_request_in_a_file_is_taken_whole(tmp_path: Path) -> None:
    request = {"type": "certify", "robot": "ur5", "scene": "table", "path": [[0.1]], "position_names": ["elbow_joint"]}
    (tmp_path / "m.json").write_text(json.dumps(request))
    assert run(str(tmp_path / "m.json"))[0] == 0


BROKEN: dict[str, tuple[str, Any, str]] = {
    "no numbers": ("m.csv", "time,a\n0.0,x\n", "line 2: column 'a' has 'x', which is no number"),
    "semicolons": ("m.csv", "time;a\n0;0\n", "column 'time;a' has '0;0', which is no number; columns"),
    "a comma at the end": ("m.csv", "a,\n0,\n", "column '' has ''"),
    "a short line": ("m.csv", "time,a\n0.0\n", "line 2 has 1 values, the head names 2 columns"),
    "no rows": ("m.csv", "time,a\n", "a row at least"),
    "no positions": ("m.csv", "time,velocity:a\n0.0,1.0\n", "neither `positions` nor a `path`"),
    "an unknown kind": ("m.csv", "force:a\n0.0\n", "'force:a'"),
    "no JSON": ("m.json", "{", "holds no motion"),
    "a list": ("m.json", "[]", "it is a list"),
    "nothing": ("m.json", "{}", "neither `positions` nor a `path`"),
    "no archive": ("m.npz", "x", "holds no motion"),
    "another ending": ("m.txt", "x", "must end with one of .csv, .json, .npz, .rrd"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_what_is_wrong_with_a_file_is_told(case: str, tmp_path: Path) -> None:
    name, text, why = BROKEN[case]
    (tmp_path / name).write_text(text)
    with pytest.raises(MalformedRequest) as refusal:
        read_fields(tmp_path / name)
    assert why in refusal.value.message
    assert name in refusal.value.message


@pytest.mark.parametrize("head", ["time,j0", " time, j0 ", 'time, "j0"', "time,position: j0 "])
def test_blanks_in_a_head_are_no_part_of_names(head: str, tmp_path: Path) -> None:
    file = tmp_path / "motion.csv"
    file.write_text(f"{head}\n0, 0.0\n1, 0.5\n", encoding="utf-8")
    fields = read_fields(file)
    assert fields["position_names"] == ["j0"]
    assert fields["trajectory"] == {"times": [0.0, 1.0], "positions": [[0.0], [0.5]]}


def test_what_is_missing_is_told(tmp_path: Path) -> None:
    with pytest.raises(UnknownObject, match="no file"):
        read_fields(tmp_path / "m.csv")
    np.savez(tmp_path / "m.npz", path=np.zeros((2, 1)), position_names=np.array(["elbow_joint"]))
    code, told = run(str(tmp_path / "m.npz"), "--robot", "ur5")
    assert (code, "give --scene" in told) == (2, True)


def test_the_referee_judges_as_well(kept: Path, tmp_path: Path) -> None:
    """A file of the motion is judged alone, too: the one that the command writes."""
    case = tmp_path / "case.json.xz"
    code, told = run(str(kept / "motion.csv"), *HERE, "--referee", "--case", str(case))
    assert code == 0, told
    assert "referee: free" in told
    assert "collision-free" in told
    assert [judge(one).answer for one in load(case)] == [Answer.FREE]
    code, told = run(str(kept / "motion.csv"), *HERE, "--referee", "--min-clearance", "0.3")
    assert code == 1
    assert "referee: closer than required" in told
    assert "contradict" not in told


def test_certifiers_that_contradict_each_other_are_told(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    contact = Verdict(Finding(Answer.CONTACT, ("forearm_link", "board"), 0.5, 0.0))
    monkeypatch.setattr("guidefield.referee.judge.judge", lambda case, seconds: contact)
    code, told = run(str(kept / "motion.csv"), *HERE, "--referee")
    assert code == 1
    assert "referee: contact: forearm_link and board at 0.5, 0" in told
    assert "contradict each other" in told


def test_columns_of_joints_with_odd_names_are_told_apart(tmp_path: Path) -> None:
    file = tmp_path / "motion.csv"
    file.write_text(
        "time,position:time,position:left:elbow,velocity:time,velocity:left:elbow,arm\n0,1,2,3,4,5\n1,1,2,3,4,5\n"
    )
    fields = read_fields(file)
    assert fields["position_names"] == ["time", "left:elbow", "arm"]
    assert fields["velocity_names"] == ["time", "left:elbow"]
    assert fields["trajectory"]["times"] == [0, 1]
    assert fields["trajectory"]["positions"][0] == [1, 2, 5]
    assert fields["trajectory"]["velocities"][0] == [3, 4]
