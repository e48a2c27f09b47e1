"""Judgements and proofs over a real session: kept as runs, watched, ended early, exported and checked afresh."""

import asyncio
import concurrent.futures
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest
from typer.testing import CliRunner

from guidefield import AsyncClient, Client, ForwardKinematics, NotAllowed, UnknownObject
from guidefield.cli.commands import app
from guidefield.messages.certify_request import CertifyRequest, GivenTrajectory
from guidefield.messages.replies import CertifyReply
from tests.journeys.service import ANSWERED_WITHIN, CONNECTED_WITHIN, PlainClient, Service, await_that

NAMES = ["panda_joint1", "panda_joint4"]
HOME = {"panda_joint2": -0.785398, "panda_joint4": -2.356194, "panda_joint6": 1.570796}
UNRECORDED = {"robot": "panda", "scene": "table", "start": HOME, "recording": "off"}
ASKED = {**UNRECORDED, "position_names": NAMES, "allowed_time": 60.0}
FREE = {**ASKED, "path": [[0.0, -2.3], [0.5, -2.0]]}
JUDGED = {**FREE, "run_id": "judged", "recording": "full"}
SWINGS = {**ASKED, "path": [[2.0, -2.0], [-2.0, -2.0]] * 30_000, "allowed_time": 600.0}
"""So long a motion that its judgement goes on until somebody ends it."""


def test_a_motion_is_judged_over_the_wire_and_kept(wire: PlainClient) -> None:
    reply = wire.ask("guidefield/local/certify", {**JUDGED, "type": "certify"})
    assert reply["status"]["name"] == "SUCCESS", reply["status"]
    assert (reply["curve"], reply["certificate"]["free_until"]) == ("linear", {"row": 1.0, "time": None})
    assert reply["recording"] == "guidefield/local/runs/judged/recording"
    kept = wire.ask("guidefield/local/runs/judged")
    assert kept["request"]["type"] == "certify"
    assert kept["reply"] == reply
    assert wire.ask("guidefield/local/certify", JUDGED) == reply, "asked for again"
    listed = {run["run_id"]: run for run in wire.ask("guidefield/local/runs")["runs"]}
    assert (listed["judged"]["robot"], listed["judged"]["status"]) == ("panda", "SUCCESS")
    assert wire.answer("guidefield/local/runs/judged/recording").payload[:4] == b"RRF2"
    assert wire.ask("guidefield/local/info?brief")["latency"]["certify"]


def test_a_plan_is_judged_in_a_scene_that_has_changed(client: Client) -> None:
    goal = {"type": "joints", "positions": {"panda_joint1": 2.0}}
    made = client.plan(**UNRECORDED, goal=goal, guide_planes=[])
    motion = {"trajectory": made.trajectory, "position_names": made.position_names}
    same = client.certify(**UNRECORDED, **motion)
    assert same.clearance.minimum == made.clearance.minimum
    assert isinstance(same, CertifyReply)
    middle = made.trajectory.positions[len(made.trajectory.times) // 2]
    pose = dict(zip(made.position_names, middle, strict=True))
    asked = ForwardKinematics("panda", frames=["panda_hand_tcp"], configurations=[{**HOME, **pose}])
    ((hand,),) = client.kinematics(asked).placements
    ball = {"type": "sphere", "name": "new", "radius": 0.05, "position": list(hand.position)}
    blocked = {"name": "changed", "obstacles": [ball]}
    changed = client.certify({**UNRECORDED, "scene": blocked, **motion})
    assert (changed.status.name, changed.certificate.reason) == ("INVALID_MOTION_PLAN", "contact")
    assert "new" in changed.certificate.pair
    assert 0.0 < changed.certificate.free_until.time < made.trajectory.times[-1]
    kept = client.run(changed.run_id)
    assert kept.reply == changed


def test_what_is_ill_posed_is_refused_by_name(wire: PlainClient) -> None:
    refused = wire.answer(
        "guidefield/local/certify",
        msgspec.msgpack.encode({**ASKED, "path": [[0.0, 0.0], [0.0, float("nan")]]}),
        "application/msgpack",
    )
    error = msgspec.msgpack.decode(refused.payload)
    assert error["name"] == "MALFORMED_REQUEST"
    assert "path[1][1]" in error["message"]
    local = {**FREE, "robot": {"type": "urdf_file", "path": "robot.urdf"}}
    assert wire.refusal("guidefield/local/certify", msgspec.json.encode(local))["name"] == "ROBOT_INVALID"


def test_a_judgement_is_ended_early_and_one_that_waits_too_long_is_answered(wire: PlainClient) -> None:
    with concurrent.futures.ThreadPoolExecutor(2) as threads:
        running = threads.submit(wire.ask, "guidefield/local/certify", {**SWINGS, "run_id": "swings"})
        await_that(lambda: wire.ask("guidefield/local/info?brief")["busy"])
        waited = wire.ask("guidefield/local/certify", {**FREE, "run_id": "late-judgement", "allowed_time": 0.05})
        assert (waited["status"]["name"], waited["curve"]) == ("TIMED_OUT", "none")
        assert waited["status"]["details"] == {"stage": "queue", "allowed_time": 0.05}
        assert wire.ask("guidefield/local/runs/swings/cancel")["done"] == "run 'swings' ends"
        ended = running.result(ANSWERED_WITHIN)
    assert ended["status"]["name"] == "PREEMPTED"
    assert ended["certificate"]["collision_free"] is False or ended["warnings"]


def test_an_asyncio_client_judges(service: Service) -> None:
    async def journey() -> None:
        async with await AsyncClient.connect(service.endpoint, wait=CONNECTED_WITHIN) as client:
            several = await asyncio.gather(*(client.certify(**FREE) for _ in range(3)))
            assert {reply.status.name for reply in several} == {"SUCCESS"}
            assert len({reply.run_id for reply in several}) == 3

    asyncio.run(journey())


PLAN: dict[str, Any] = {
    "robot": "panda",
    "scene": "bookshelf",
    "goal": {"type": "joints", "positions": {"panda_joint1": 0.4}},
    "guide_planes": [],
    "allowed_planning_time": ANSWERED_WITHIN,
    "recording": "off",
    "proof": True,
}
STEPS = {key: value for key, value in PLAN.items() if key not in ("goal", "guide_planes")} | {
    "steps": [{"goal": PLAN["goal"]}, {"goal": {"type": "joints", "positions": {"panda_joint1": 0.1}}}]
}


def check(content: bytes, folder: Path) -> list[str]:
    """What the referee says of proofs in a process of its own, a line for each motion."""
    (folder / "proof.npz").write_bytes(content)
    command = [sys.executable, "-m", "guidefield.referee", str(folder / "proof.npz")]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    return [line for line in told.stdout.splitlines() if line.startswith("referee: ")]


def test_a_proof_is_kept_with_its_run_and_checked_elsewhere(service: Service, client: Client, tmp_path: Path) -> None:
    reply = client.plan(PLAN)
    assert reply.proof == f"guidefield/local/runs/{reply.run_id}/proof"
    content = client.proof(reply.run_id)
    assert check(content, tmp_path) == ["referee: free"]
    listed = next(run for run in client.runs().runs if run.run_id == reply.run_id)
    assert listed.bytes > len(content)
    exported = tmp_path / "exported.proof.npz"
    command = ["runs", "export", reply.run_id, str(exported), "--data", str(service.data)]
    assert CliRunner().invoke(app, command).exit_code == 0
    assert exported.read_bytes() == content
    client.delete_run(reply.run_id)
    assert not list(service.data.rglob(f"{reply.run_id}*"))
    with pytest.raises(UnknownObject):
        client.proof(reply.run_id)


def test_a_judgement_a_sequence_and_a_plan_among_movers_have_proofs(client: Client, tmp_path: Path) -> None:
    planned = client.plan(PLAN | {"proof": False})
    assert planned.proof is None
    given = GivenTrajectory(
        planned.trajectory.positions, times=planned.trajectory.times, velocities=planned.trajectory.velocities
    )
    asked = CertifyRequest("panda", "bookshelf", trajectory=given, proof=True, recording="off")
    assert check(client.proof(client.certify(asked).run_id), tmp_path) == ["referee: free"]
    assert check(client.proof(client.plan(STEPS).run_id), tmp_path) == ["referee: free"] * 2
    drifting = {"times": [0.0, 9.0], "placements": [{"position": [0.9, y, 0.9]} for y in (-1.0, 1.0)]}
    box = {"type": "box", "name": "box", "size": [0.2, 0.2, 0.2], "trajectory": drifting}
    moving = client.plan(PLAN | {"scene": {"name": "drift", "obstacles": [box]}})
    assert check(client.proof(moving.run_id), tmp_path) == ["referee: free"]


def test_a_run_without_a_proof_says_what_to_ask_for(client: Client) -> None:
    without = client.plan(PLAN | {"proof": False})
    with pytest.raises(UnknownObject, match="a request with `proof` true keeps one"):
        client.proof(without.run_id)
    refused = client.plan(PLAN | {"goal": {"type": "joints", "positions": {"panda_joint4": 1.0}}})
    assert refused.proof is None
    assert refused.warnings == ["no proof is kept: no motion is certified free and within its limits"]
    with pytest.raises(UnknownObject, match="has no proof"):
        client.proof(refused.run_id)
    with pytest.raises(UnknownObject):
        client.proof("nothing-of-that-name")


def test_a_proof_is_its_users_own_until_it_is_shared(service: Service) -> None:
    with (
        Client.connect(service.endpoint, user="alice", wait=CONNECTED_WITHIN) as alice,
        Client.connect(service.endpoint, user="bob", wait=CONNECTED_WITHIN) as bob,
    ):
        run = alice.plan(PLAN).run_id
        with pytest.raises(NotAllowed):
            bob.proof(f"alice:{run}")
        alice.share("runs", run)
        assert bob.proof(f"alice:{run}") == alice.proof(run)
