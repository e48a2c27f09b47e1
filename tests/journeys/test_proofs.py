"""Proofs over Zenoh: asked for with a request, kept with its run, fetched, exported and checked in a fresh process."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from guidefield import Client, NotAllowed, UnknownObject
from guidefield.cli.commands import app
from guidefield.messages.certify_request import CertifyRequest, GivenTrajectory
from tests.journeys.service import ANSWERED_WITHIN, CONNECTED_WITHIN, Service

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
