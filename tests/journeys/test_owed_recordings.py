"""A reply doesn't wait for its recording: who asks for it does, and a service that is stopped writes it first."""

from __future__ import annotations

import signal
from pathlib import Path

from guidefield import Client, JointsGoal, PlanRequest
from guidefield.messages.identities import PLAIN
from guidefield.recorder.reading import read_recording
from guidefield.stores.runs import RunDatabase
from tests.journeys.service import ANSWERED_WITHIN, CONNECTED_WITHIN, running_service

PLAN = PlanRequest("panda", "bookshelf", JointsGoal({"panda_joint1": 0.8}), guide_planes=[], recording="full")


def test_recordings_come_after_the_reply_and_before_the_end(tmp_path: Path) -> None:
    with (
        running_service(tmp_path, "--workers", "1") as service,
        Client.connect(service.endpoint, wait=CONNECTED_WITHIN) as client,
    ):
        first = client.plan(PLAN)
        assert first.recording == f"guidefield/local/runs/{first.run_id}/recording"
        whole = tmp_path / "first.rrd"
        whole.write_bytes(client.recording(first.run_id))
        assert read_recording(whole).reply.status == first.status
        last = client.plan(PLAN)
        service.process.send_signal(signal.SIGTERM)
        service.process.wait(ANSWERED_WITHIN)
        (kept,) = tmp_path.rglob(f"{last.run_id}.*")
        assert kept.name == f"{last.run_id}.rrd"
        database = RunDatabase(kept.parents[1])
        assert database.of(PLAIN).read(last.run_id).reply == last
        database.close()
