"""Proofs of certified motions of a slice of the fixed requests: the referee replays every one."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from guidefield import CertifyRequest, PlanRequest
from guidefield.case_file import write_proof
from guidefield.engine import Engine, motions_of
from guidefield.referee.case import Answer
from guidefield.referee.replay import replay_file
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


ARM = """<robot name="arm">
<link name="base"><collision><origin xyz="0 0 0.075"/><geometry><sphere radius="0.002"/></geometry></collision></link>
<link name="upper"><collision><origin xyz="0 0 0.075"/><geometry><sphere radius="0.04"/></geometry></collision></link>
<link name="side"><collision><origin xyz="0 0 0.1"/><geometry><sphere radius="0.02"/></geometry></collision></link>
<link name="lower"><collision><origin xyz="0 0 0.14"/>
<geometry><box size="0.1 0.02 0.08"/></geometry></collision></link>
<joint name="first" type="revolute"><origin xyz="0 0 0.15" rpy="0.1 -1.2 3.1"/>
<parent link="base"/><child link="upper"/>
<axis xyz="0 0 1"/><limit lower="-1.3" upper="1.1" effort="1" velocity="2"/></joint>
<joint name="fixed" type="fixed"><origin xyz="0 0 0.067"/><parent link="base"/><child link="side"/></joint>
<joint name="universe" type="revolute"><origin xyz="0 0 0.15" rpy="0 0.7 -0.2"/><parent link="upper"/>
<child link="lower"/><axis xyz="1 0 0"/><limit lower="-0.9" upper="2.6" effort="1" velocity="2"/></joint></robot>"""


MOVES = {
    "trajectory": {
        "positions": [[0.36 - 0.04 * k, 0.9 + 0.07 * k] for k in range(20)],
        "times": [0.1 * k for k in range(20)],
    }
}
RESTS = {"path": [[0.1, 0.9]] * 3}


@pytest.mark.parametrize("motion", [MOVES, RESTS], ids=["a joint called universe", "a path that goes nowhere"])
def test_proofs_of_odd_robots_and_motions_hold(motion: dict[str, Any], tmp_path: Path) -> None:
    asked = {
        "type": "certify",
        "robot": {"type": "urdf", "text": ARM},
        "scene": {"name": "none", "obstacles": []},
        **motion,
    }
    file = tmp_path / "proof.npz"
    reply = Engine().answer(msgspec.convert(asked, CertifyRequest), proof_to=file)
    assert reply.certificate.collision_free
    (verdict,) = replay_file(file)
    assert verdict.answer is Answer.FREE, verdict.finding
