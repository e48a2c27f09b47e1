"""Kept runs as clients meet them: there after any kill, one's own alone, and no recording that is owed is lost."""

import contextlib
import itertools
import json
import os
import random
import signal
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from guidefield import Client, GuidefieldError, JointsGoal, PlanRequest
from guidefield.cli.commands import app
from guidefield.errors import DiskRefused, MalformedRequest
from guidefield.messages.identities import PLAIN
from guidefield.messages.replies import PlanReply
from guidefield.recorder.stored import read_recording
from guidefield.stores.recordings import Recordings
from guidefield.stores.run_file import FILE
from guidefield.stores.runs import RunDatabase
from tests.journeys.service import (
    ANSWERED_WITHIN,
    CONNECTED_WITHIN,
    ENDED_WITHIN,
    LONG,
    SO_WITHIN,
    Service,
    await_death,
    await_that,
    plain_client,
    running_service,
)

QUICK: dict[str, Any] = {
    "robot": "ur5",
    "scene": "table",
    "goal": {"type": "joints", "positions": {"elbow_joint": 1.2}},
    "guide_planes": [],
    "recording": "off",
    "allowed_planning_time": 60.0,
}


def _ask_on(endpoint: str, user: str, answered: dict[str, PlanReply]) -> None:
    """Plan one thing after the other, until the service is gone."""
    with contextlib.suppress(GuidefieldError), Client.connect(endpoint, user=user, wait=CONNECTED_WITHIN) as client:
        for number in itertools.count():
            reply = client.plan({**QUICK, "run_id": f"{user}-{number}"})
            answered[reply.run_id] = reply


def test_what_was_answered_survives_that_the_service_is_killed(tmp_path: Path) -> None:
    answered: dict[str, dict[str, PlanReply]] = {user: {} for user in ("alice", "bob", "carol")}
    with running_service(tmp_path, "--workers", "1") as service:
        for user, replies in answered.items():
            threading.Thread(target=_ask_on, args=(service.endpoint, user, replies), daemon=True).start()
        await_that(lambda: all(len(replies) > 1 for replies in answered.values()))
        os.kill(service.workers()[0], signal.SIGKILL)
        before = sum(len(replies) for replies in answered.values())
        await_that(lambda: sum(len(replies) for replies in answered.values()) > before + 1)
        threading.Thread(target=_ask_long, args=(service.endpoint,), daemon=True).start()
        with Client.connect(service.endpoint, wait=CONNECTED_WITHIN) as operator:
            await_that(lambda: "long" in {run.run_id for run in operator.runs(status="RUNNING").runs})
            assert operator.run("long").reply is None
        service.process.kill()
        service.process.wait()
        known, killed = {user: dict(replies) for user, replies in answered.items()}, time.time()
        with running_service(tmp_path, "--workers", "1", port_of=service) as again:
            for user, replies in known.items():
                with Client.connect(again.endpoint, user=user, wait=CONNECTED_WITHIN) as client:
                    for run_id, reply in replies.items():
                        assert client.run(run_id).reply == reply
                    before_it = [run for run in client.runs().runs if run.began < killed]  # whoever asks on asks again
                    assert not {run.status for run in before_it} & {"RUNNING", "UNREADABLE"}
                    run_id, reply = next(iter(replies.items()))
                    assert client.plan({**QUICK, "run_id": run_id}) == reply, "whose link broke asks again"
                    with pytest.raises(MalformedRequest, match="is taken"):
                        client.plan({**QUICK, "run_id": run_id, "seed": 1})
            with Client.connect(again.endpoint, wait=CONNECTED_WITHIN) as operator:
                (run,) = [run for run in operator.runs().runs if run.run_id == "long"]
                assert (run.status, run.message) == ("CRASH", "the service stopped while it worked on this run")
                assert run.ended is not None


def _ask_long(endpoint: str) -> None:
    with contextlib.suppress(GuidefieldError), Client.connect(endpoint, wait=CONNECTED_WITHIN) as client:
        client.plan({**LONG, "run_id": "long"})


def test_a_list_comes_in_pages_over_the_wire_and_beside_it(service: Service, client: Client) -> None:
    for number in range(5):
        client.plan({**QUICK, "run_id": f"page{number}", "seed": number})
    (oldest,) = (run for run in client.runs(robot="ur5").runs if run.run_id == "page0")
    first = client.runs(limit=2, robot="ur5", since=oldest.began)
    rest = client.runs(robot="ur5", since=oldest.began, after=first.next)
    listed = [run.run_id for run in (*first.runs, *rest.runs)]
    assert listed == [f"page{number}" for number in (4, 3, 2, 1, 0)]
    assert (first.total, rest.next) == (5, None)
    assert [run.run_id for run in client.runs(text="NO SUCH SENTENCE / 10 % = ?").runs] == []
    done = CliRunner().invoke(app, ["runs", "list", "--data", str(service.data), "--robot", "ur5", "--json"])
    assert [run["run_id"] for run in json.loads(done.output)["runs"]][:5] == listed, "read while the service runs"
    with plain_client(service.endpoint) as wire:
        for words in ("after=x", "after=-1", f"after={10**30}", "limit=0", "limit=1001", "limit=many", "text="):
            assert wire.refusal(f"guidefield/local/runs?{words}")["name"] == "MALFORMED_REQUEST", words
        found = wire.ask("guidefield/local/runs?after=0")
        assert (found["runs"], found["next"]) == ([], None)
        injected = wire.ask("guidefield/local/runs?robot=' OR 1=1 --")
        assert (injected["runs"], injected["total"]) == ([], 0)


def test_a_service_whose_database_is_damaged_plans_says_so_and_ends_on_ctrl_c(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"no database" * 10_000)
    with (
        running_service(tmp_path, "--workers", "1") as service,
        Client.connect(service.endpoint, wait=CONNECTED_WITHIN) as client,
    ):
        assert [
            line for line in service.told if line.startswith("no run is kept, and each reply says so: the database")
        ]
        for run_id in ("r1", "r1"):
            reply = client.plan({**QUICK, "run_id": run_id, "recording": "full"})
            assert reply.status.name == "SUCCESS"
            assert reply.recording is None
            assert [text for text in reply.warnings if "not kept: the database of runs is damaged" in text]
        for ask in (client.runs, lambda: client.run("r1"), lambda: client.delete_run("r1")):
            with pytest.raises(DiskRefused, match="damaged"):
                ask()
        assert client.scenes()
        workers = service.workers()
        service.process.send_signal(signal.SIGINT)
        assert service.process.wait(ENDED_WITHIN) == 0
        for worker in workers:
            await_death(worker)
    assert (tmp_path / FILE).read_bytes() == b"no database" * 10_000


def test_answers_that_no_worker_gave_are_kept_too(service: Service, client: Client) -> None:
    asker = threading.Thread(target=_ask_long, args=(service.endpoint,))
    asker.start()
    await_that(lambda: client.info().busy)
    client.cancel("early")
    replies = [
        client.plan({**QUICK, "run_id": "early"}),
        client.plan({**QUICK, "run_id": "late", "allowed_planning_time": 0.05}),
    ]
    assert [reply.status.name for reply in replies] == ["PREEMPTED", "TIMED_OUT"]
    for reply in replies:
        assert client.run(reply.run_id).reply == reply
    client.cancel("long")
    asker.join(CONNECTED_WITHIN)
    assert client.run("long").reply is not None


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
