"""Proofs of certified motions of a slice of the fixed requests: the referee replays every one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from guidefield import CertifyRequest, PlanRequest
from guidefield.engine import Engine, motions_of
from guidefield.proof_file import write_proof
from guidefield.referee.replay import replay_file
from guidefield.referee.verdict import Answer
from tests.referee.cases import planned

TOOLS = Path(__file__).parents[2] / "tools"

SLICE = ["panda shelf tree as found", "panda shapes pose", "panda meshes", "panda cloud", "panda clearance"]
SLICE += ["panda held rod", "panda placed", "ur5 table", "lift prismatic continuous mimic", "followers turned"]
SLICE += ["wheeled planar", "balls", "floater", "moving door", "moving conveyor", "guided seed_b_tapered"]
SLICE += ["judged near", "judged among what moves", "judged samples"]


@pytest.fixture(scope="module")
def requests() -> Any:
    with pytest.MonkeyPatch.context() as patched:
        patched.syspath_prepend(str(TOOLS))
        from fixed.requests import REQUESTS
    return REQUESTS


@pytest.mark.parametrize("name", SLICE)
def test_the_proof_of_a_fixed_request_holds(name: str, requests: Any, tmp_path: Path) -> None:
    asked, engine, file = requests[name], Engine(), tmp_path / "proof.npz"
    if asked.get("type") == "certify":
        (motion,) = motions_of(msgspec.convert(asked, CertifyRequest))
    else:
        plan = msgspec.convert(asked, PlanRequest)
        plan = msgspec.structs.replace(plan, scene=engine._find_scene_message(plan.scene))
        motion = planned(plan, engine._load_robot(plan.robot))
    write_proof(file, motion)
    (verdict,) = replay_file(file)
    assert verdict.answer is Answer.FREE, verdict.finding
    assert verdict.kept > 0.0
    assert verdict.evaluations > 0
