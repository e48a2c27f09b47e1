"""A reply doesn't wait for its recording: who asks gets it at once, and kills at any moment lose none."""

import contextlib
import os
import random
import signal
import threading
import time
from pathlib import Path

from guidefield import Client, GuidefieldError, JointsGoal, PlanRequest
from guidefield.messages.identities import PLAIN
from guidefield.recorder.stored import read_recording
from guidefield.stores.recordings import Recordings
from guidefield.stores.runs import RunDatabase
from tests.journeys.service import (
    ANSWERED_WITHIN,
    CONNECTED_WITHIN,
    ENDED_WITHIN,
    SO_WITHIN,
    Service,
    await_that,
    running_service,
)

PLAN = PlanRequest(
    "xarm7", "bookshelf", JointsGoal({"joint1": 0.8}), guide_planes=[], allowed_planning_time=ANSWERED_WITHIN
)


def stopped(service: Service) -> list[int]:
    """The processes that render recordings, once there are some, stopped."""
    await_that(service.renderers)
    for pid in service.renderers():
        os.kill(pid, signal.SIGSTOP)
    return service.renderers()


def await_rendered(service: Service, recordings: Recordings) -> None:
    """Wait until nothing is owed; what renders is given a processor, of which a busy machine leaves none otherwise."""

    def so() -> bool:
        for pid in service.renderers():
            with contextlib.suppress(OSError):  # only root may, and the process may be gone
                os.sched_setscheduler(pid, os.SCHED_OTHER, os.sched_param(0))
                os.setpriority(os.PRIO_PROCESS, pid, 0)
        return recordings.list_owed() == []

    await_that(so)


def test_no_recording_is_lost_by_an_end_or_by_kills_at_any_moment(tmp_path: Path) -> None:
    recordings, whole = Recordings(tmp_path / "recordings"), tmp_path / "whole.rrd"
    with (
        running_service(tmp_path, "--workers", "1") as service,
        Client.connect(service.endpoint, wait=CONNECTED_WITHIN) as client,
    ):
        client.plan(PLAN)
        (renderer,) = stopped(service)
        assert os.sched_getscheduler(renderer) == os.SCHED_IDLE
        asked, left = client.plan(PLAN), client.plan(PLAN)
        assert asked.recording == f"guidefield/local/runs/{asked.run_id}/recording"
        assert recordings.describe(asked.run_id).kind == "owed"
        whole.write_bytes(client.recording(asked.run_id))
        assert read_recording(whole).reply.status == asked.status
        told = {run.run_id: run.recording for run in client.runs().runs}
        assert (told[asked.run_id], told[left.run_id]) == ("rendered", "owed")
        service.process.send_signal(signal.SIGTERM)
        service.process.wait(ENDED_WITHIN)
    assert recordings.describe(left.run_id).kind == "owed"
    answered = [asked.run_id, left.run_id, *killed(tmp_path)]
    with (
        running_service(tmp_path, "--workers", "1") as service,
        Client.connect(service.endpoint, wait=CONNECTED_WITHIN) as client,
    ):
        await_rendered(service, recordings)
        await_that(lambda: {run.recording for run in client.runs(status="SUCCESS").runs} == {"rendered"})
        assert {recordings.describe(run_id).kind for run_id in answered} == {"rendered"}
        read_recording(recordings.path(answered[-1]))
        client.delete_run(left.run_id)
        assert list(recordings.folder.glob(f"{left.run_id}.*")) == []
    assert {file.suffix for file in recordings.folder.iterdir()} == {".rrd"}
    database = RunDatabase(tmp_path)
    kept = database.of(PLAIN).read(asked.run_id).reply
    database.close()
    assert kept == asked


def killed(data: Path) -> list[str]:
    """Runs of a service of which one process after the other was killed while it answered, and then itself."""
    draw, answered, over = random.Random(7), list[str](), threading.Event()

    def plan(endpoint: str) -> None:
        with contextlib.suppress(GuidefieldError), Client.connect(endpoint, wait=CONNECTED_WITHIN) as client:
            while not over.wait(0.5):
                with contextlib.suppress(GuidefieldError):  # its worker was killed
                    answered.append(client.plan(PLAN).run_id)

    with running_service(data, "--workers", "1") as service:
        asking = threading.Thread(target=plan, args=(service.endpoint,), daemon=True)
        asking.start()
        for pids in (service.renderers, service.workers, service.renderers):
            before = len(answered)
            await_that(lambda before=before, pids=pids: len(answered) > before and pids())
            time.sleep(draw.uniform(0.0, 0.3))
            os.kill(pids()[0], signal.SIGKILL)
        time.sleep(draw.uniform(0.0, 0.3))
        service.process.kill()
        service.process.wait(ENDED_WITHIN)
        over.set()
        asking.join(SO_WITHIN)
    assert len(answered) > 2
    return answered
