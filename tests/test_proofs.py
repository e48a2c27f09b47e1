"""Proofs through the door: where they go, what they are about, and why there is none."""

import json
import time
from pathlib import Path
from typing import Any

import pytest

import guidefield
from guidefield import case_file
from guidefield.engine import Engine
from guidefield.errors import MalformedRequest
from guidefield.prove import proof
from guidefield.referee.replay import replay_file
from guidefield.stores.recordings import PROOF, Recordings
from tests.examples import example

GOAL = {"type": "joints", "positions": {"panda_joint1": 0.3}}
PLAN: dict[str, Any] = {"robot": "panda", "scene": "table", "goal": GOAL, "guide_planes": [], "recording": "off"}
CONE = {"type": "orientation_cone", "frame": "panda_hand_tcp", "axis": [0, 0, 1], "target_axis": [0, 0, -1]}
LID = {"type": "box", "name": "lid", "size": [0.1, 0.1, 0.02]}


def answers(file: Path) -> list[str]:
    return [verdict.answer.value for verdict in replay_file(file)]


def test_a_proof_goes_where_it_is_said_to(tmp_path: Path) -> None:
    named = guidefield.answer(PLAN, proof_to=tmp_path / "one.npz")
    assert named.proof == str(tmp_path / "one.npz")
    assert answers(tmp_path / "one.npz") == ["free"]
    beside = guidefield.answer(PLAN | {"proof": True}, record_to=tmp_path / "run.rrd")
    assert beside.proof == str(tmp_path / "run.npz")
    assert answers(tmp_path / "run.npz") == ["free"]
    recordings = Recordings(tmp_path / "recordings")
    kept = Engine(recordings=recordings).answer(PLAN | {"proof": True, "run_id": "r"})
    assert kept.proof == "guidefield/local/runs/r/proof"
    assert recordings.describe("r").bytes == recordings.file("r", PROOF).stat().st_size
    recordings.drop("r")
    assert not list(recordings.folder.iterdir())
    assert guidefield.answer(PLAN).proof is None


def test_why_there_is_no_proof_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nowhere = guidefield.answer(PLAN | {"proof": True})
    assert nowhere.status.name == "SUCCESS"
    assert nowhere.warnings == ["no proof is kept: there is no place for it: name a file, or ask a service"]
    into = guidefield.answer(PLAN, proof_to=tmp_path / f"{'x' * 300}.npz")
    assert (into.status.name, into.proof) == ("SUCCESS", None)
    assert into.warnings[0].startswith("no proof is kept: ")
    with pytest.raises(MalformedRequest, match="only a plan or a judgement can be proved"):
        guidefield.answer({"type": "potential", "scene": "table", "points": [[0, 0, 1]]}, proof_to=tmp_path / "no.npz")
    real, asked = time.monotonic, proof.search

    def search_late(*given: Any, **named: Any) -> Any:
        monkeypatch.setattr(time, "monotonic", lambda: real() + 1e6)
        return asked(*given, **named)

    monkeypatch.setattr(proof, "search", search_late)
    reply = guidefield.answer(PLAN, proof_to=tmp_path / "late.npz")
    assert reply.warnings == ["no proof is kept: time was up before it was written down"]
    assert not (tmp_path / "late.npz").exists()


def test_a_proof_of_an_earlier_motion_does_not_stay(tmp_path: Path) -> None:
    guidefield.answer(PLAN, proof_to=tmp_path / "proof.npz")
    far = PLAN | {"goal": {"type": "joints", "positions": {"panda_joint1": 9.0}}}
    reply = guidefield.answer(far, proof_to=tmp_path / "proof.npz")
    assert (reply.status.name, reply.proof) == ("GOAL_STATE_INVALID", None)
    assert reply.warnings[-1] == "the file of the proof was of an earlier motion, and is removed"
    assert not (tmp_path / "proof.npz").exists()
    guidefield.answer(PLAN | {"proof": True}, record_to=tmp_path / "run.rrd")
    again = guidefield.answer(PLAN, record_to=tmp_path / "run.rrd")  # asks for none
    assert (again.warnings, (tmp_path / "run.npz").exists()) == ([], True)


def test_a_proof_that_would_make_its_answer_late_is_not_begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(case_file, "WRITING_S_PER_ITEM", 10.0)
    reply = guidefield.answer(PLAN, proof_to=tmp_path / "large.npz")
    assert (reply.status.name, reply.proof) == ("SUCCESS", None)
    assert [text.partition(" takes about ")[0] for text in reply.warnings] == ["no proof is kept: to write it down"]
    assert not list(tmp_path.iterdir())


def test_path_constraints_are_judged_with_a_proof(tmp_path: Path) -> None:
    file = tmp_path / "cone.npz"
    reply = guidefield.answer(PLAN | {"path_constraints": [CONE | {"half_angle": 1.2}]}, proof_to=file)
    assert reply.warnings == []
    assert answers(file) == ["free"]
    assert [one.answer.value for one in replay_file(file, seconds=0.0)] == ["undecided"]


@pytest.mark.parametrize("moves", [False, True])
def test_a_motion_that_leaves_a_contact_is_proved_in_two_parts(moves: bool, tmp_path: Path) -> None:
    at = guidefield.answer(
        {"type": "forward_kinematics", "robot": "panda", "frames": ["panda_leftfinger"], "configurations": [{}]}
    )
    tip = at.placements[0][0].position
    places = [[tip[0] + aside, tip[1], tip[2] - 0.06] for aside in (0.0, 0.2)]
    slides = {"times": [0.0, 3.0], "placements": [{"position": place} for place in places]}
    scene = {"name": "lid", "obstacles": [LID | {"position": places[0]} | ({"trajectory": slides} if moves else {})]}
    request = PLAN | {"scene": scene, "leave_start_contact": True}
    file = tmp_path / "leaving.npz"
    reply = guidefield.answer(request, proof_to=file)
    assert reply.status.name == "SUCCESS", reply.status.message
    assert reply.certificate.covers.startswith("trajectory after"), reply.certificate.covers
    assert answers(file) == ["free", "free"]
    given = {"times": reply.trajectory.times, "positions": reply.trajectory.positions}
    given["velocities"] = reply.trajectory.velocities
    asked = {"type": "certify", "robot": "panda", "scene": scene, "trajectory": given, "leave_start_contact": True}
    judged = guidefield.answer(asked | {"position_names": reply.position_names}, proof_to=file)
    assert judged.status.name == "SUCCESS", judged.status.message
    assert answers(file) == ["free", "free"]


def test_each_part_of_a_sequence_is_proved(tmp_path: Path) -> None:
    file = tmp_path / "kitchen.npz"
    reply = guidefield.answer(json.loads(example("kitchen")) | {"allowed_planning_time": 60.0}, proof_to=file)
    assert reply.proof == str(file)
    told = [warning for warning in reply.warnings if warning.startswith("the proof doesn't tell that ")]
    assert [warning.endswith("keeps to its straight way") for warning in told] == [True]
    assert set(answers(file)) == {"free"}
    assert len(answers(file)) >= len(reply.steps) - sum(step.begin == step.end for step in reply.steps)
