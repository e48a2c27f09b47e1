"""A reply doesn't wait for its recording: who asks gets it at once, and kills at any moment lose none."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from guidefield import Client, GuidefieldError, JointsGoal, PlanRequest
from guidefield.messages.identities import PLAIN
from guidefield.recorder.reading import read_recording
from guidefield.stores.recordings import Recordings
from guidefield.stores.runs import RunDatabase
from tests.journeys.service import ANSWERED_WITHIN, CONNECTED_WITHIN, ENDED_WITHIN, SO_WITHIN, Service, running_service

PLAN = PlanRequest(
    "panda", "bookshelf", JointsGoal({"panda_joint1": 0.8}), guide_planes=[], allowed_planning_time=ANSWERED_WITHIN
)


def await_that(so: Callable[[], bool]) -> None:
    until = time.monotonic() + SO_WITHIN
    while not so():
        assert time.monotonic() < until
        time.sleep(0.05)


def stopped(service: Service) -> list[int]:
    """The processes that render recordings, once there are some, stopped."""
    await_that(lambda: bool(service.renderers()))
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
        return recordings.owed() == []

    await_that(so)


def end_at_once(service: Service) -> None:
    service.process.kill()
    service.process.wait(ENDED_WITHIN)


def test_who_asks_gets_a_recording_at_once_and_a_later_service_renders_the_others(tmp_path: Path) -> None:
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
        assert recordings.kept(asked.run_id).kind == "owed"
        whole.write_bytes(client.recording(asked.run_id))
        assert read_recording(whole).reply.status == asked.status
        told = {run.run_id: run.recording for run in client.runs().runs}
        assert (told[asked.run_id], told[left.run_id]) == ("rendered", "owed")
        service.process.send_signal(signal.SIGTERM)
        service.process.wait(ENDED_WITHIN)
    assert recordings.kept(left.run_id).kind == "owed"
    with (
        running_service(tmp_path, "--workers", "1") as service,
        Client.connect(service.endpoint, wait=CONNECTED_WITHIN) as client,
    ):
        await_rendered(service, recordings)
        await_that(lambda: {run.recording for run in client.runs().runs} == {"rendered"})
        client.delete_run(left.run_id)
        assert list(recordings.folder.glob(f"{left.run_id}.*")) == []
    database = RunDatabase(tmp_path)
    kept = database.of(PLAIN).read(asked.run_id).reply
    database.close()
    assert kept == asked


def test_an_eager_service_renders_before_it_takes_the_next_query(tmp_path: Path) -> None:
    recordings = Recordings(tmp_path / "recordings")
    with (
        running_service(tmp_path, "--workers", "1", "--recordings", "eager") as service,
        Client.connect(service.endpoint, wait=CONNECTED_WITHIN) as client,
    ):
        first = client.plan(PLAN)
        client.plan(msgspec.structs.replace(PLAN, recording="off"))
        assert recordings.kept(first.run_id).kind == "rendered"
        last = client.plan(PLAN)
    assert recordings.kept(last.run_id).kind == "rendered", "a service that is stopped lets its workers do that"


def test_kills_at_any_moment_lose_no_recording(tmp_path: Path) -> None:
    draw, answered = random.Random(7), list[str]()

    def plan(endpoint: str, until: float) -> None:
        with contextlib.suppress(GuidefieldError), Client.connect(endpoint, wait=CONNECTED_WITHIN) as client:
            while time.monotonic() < until:
                with contextlib.suppress(GuidefieldError):  # its worker was killed
                    answered.append(client.plan(PLAN).run_id)

    for _ in range(2):
        with running_service(tmp_path, "--workers", "2") as service:
            before = len(answered)
            asking = threading.Thread(target=plan, args=(service.endpoint, time.monotonic() + 5.0), daemon=True)
            asking.start()
            await_that(lambda before=before: len(answered) > before)
            for pids in (service.renderers, service.workers, service.renderers):
                time.sleep(draw.uniform(0.1, 0.8))
                for pid in pids()[:1]:
                    os.kill(pid, signal.SIGKILL)
            time.sleep(draw.uniform(0.0, 0.5))
            end_at_once(service)
            asking.join(SO_WITHIN)
    recordings = Recordings(tmp_path / "recordings")
    with running_service(tmp_path, "--workers", "1") as service:
        await_rendered(service, recordings)
    assert len(answered) > 2
    assert {recordings.kept(run_id).kind for run_id in answered} == {"rendered"}
    assert {file.suffix for file in recordings.folder.iterdir()} == {".rrd"}
    read_recording(recordings.path(draw.choice(answered)))
