"""Links that are cut, or end while large answers are sent: runs go on, and nobody else is held up."""

import concurrent.futures
import itertools
import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from guidefield import Client, MalformedRequest
from guidefield.client.exchange import Exchange
from guidefield.client.questions import Question
from guidefield.endpoint.link import LEASE
from tests.journeys.links import Link
from tests.journeys.service import (
    ANSWERED_WITHIN,
    CONNECTED_WITHIN,
    LONG,
    Service,
    await_that,
    plain_client,
    running_service,
)

STANDS_STILL = 3.0  # how long a service is stopped: far less than a link lasts without a word [s]


@pytest.fixture
def link(service: Service, monkeypatch: pytest.MonkeyPatch) -> Iterator[Link]:
    monkeypatch.setattr("guidefield.client.exchange.RETURN_TIME_S", ANSWERED_WITHIN)
    link = Link(service.endpoint)
    yield link
    link.close()


def test_a_stream_whose_link_is_cut_goes_on(link: Link) -> None:
    asked = {"robot": "ur5", "scene": {"name": "empty", "obstacles": []}}
    with Client.connect(link.endpoint, wait=CONNECTED_WITHIN) as far, far.stream(asked) as stream:
        stream.update(time=0.0)
        assert stream.answer(ANSWERED_WITHIN) is not None
        assert link.cut(), "there is a connection to cut"
        times = itertools.count(1)

        def answered() -> bool:
            at = stream.update(time=0.02 * next(times))
            answer = stream.answer(0.1)
            return answer is not None and answer.update == at

        await_that(answered)
        assert stream.ended is None


@pytest.mark.parametrize("named", [False, True])
def test_a_plan_whose_link_is_cut_is_answered_by_its_own_run(service, client, link, named):
    run_id = f"cut-{named}"
    with (
        Client.connect(link.endpoint, instance=client.instance if named else None, wait=CONNECTED_WITHIN) as far,
        concurrent.futures.ThreadPoolExecutor(1) as threads,
    ):
        asked = threads.submit(far.plan, {**LONG, "run_id": run_id, "allowed_planning_time": 1.5})
        await_that(lambda: client.info().busy or asked.done())
        assert link.cut(), "there is a connection to cut"
        reply = asked.result(ANSWERED_WITHIN)
        assert reply.run_id == run_id
        assert client.run(run_id).reply == reply
        # The answer may get lost when the run has ended: it is there for who asks in the same words.
        assert far.plan({**LONG, "run_id": run_id, "allowed_planning_time": 1.5}) == reply
        with pytest.raises(MalformedRequest, match="is taken"):
            far.plan({**LONG, "run_id": run_id, "allowed_planning_time": 1.0})
        assert [run.run_id for run in client.runs().runs].count(run_id) == 1
        assert far.info().uptime > 0.0
    assert link.cuts == 1


def test_a_plan_whose_link_is_cut_again_and_again_is_answered(client, link, monkeypatch):
    """More often than an instance is asked again that was there all the time."""
    asked, begin = threading.Semaphore(0), Exchange.begin

    def noted(exchange: Exchange, question: Question[object], instance: str) -> None:
        begin(exchange, question, instance)
        if question.run_id == "often":
            asked.release()

    monkeypatch.setattr("guidefield.client.exchange.MAX_RETURNS", 2)
    monkeypatch.setattr(Exchange, "begin", noted)
    with (
        Client.connect(link.endpoint, wait=CONNECTED_WITHIN) as far,
        concurrent.futures.ThreadPoolExecutor(1) as threads,
    ):
        plan = threads.submit(far.plan, {**LONG, "run_id": "often"})
        for _ in range(4):
            assert asked.acquire(timeout=ANSWERED_WITHIN)
            await_that(lambda: client.info().busy)
            assert link.cut(), "there is a connection to cut"
        assert asked.acquire(timeout=ANSWERED_WITHIN)
        assert not plan.done()
        client.cancel("often")
        assert plan.result(ANSWERED_WITHIN).status.name == "PREEMPTED"
    assert link.cuts == 4


def test_what_ended_a_run_is_told_again(client: Client, service: Service) -> None:
    request = {**LONG, "run_id": "ended"}
    with concurrent.futures.ThreadPoolExecutor(2) as threads:
        asked = [threads.submit(client.plan, request) for _ in range(2)]  # the second waits for the first one's run
        await_that(lambda: client.info().busy)
        client.cancel("ended")
        first, second = (each.result(ANSWERED_WITHIN) for each in asked)
    assert first.status.name == "PREEMPTED"
    assert msgspec.to_builtins(first) == msgspec.to_builtins(second)


def test_a_service_that_gets_no_processor_for_seconds_keeps_its_links(service: Service) -> None:
    """On a busy machine too: whoever asks with Zenoh alone doesn't ask again."""
    with plain_client(service.endpoint) as wire, concurrent.futures.ThreadPoolExecutor(1) as threads:
        wire.ask("guidefield/local/info?brief")
        service.process.send_signal(signal.SIGSTOP)
        try:
            asked = threads.submit(wire.ask, "guidefield/local/info?brief")
            concurrent.futures.wait([asked], STANDS_STILL)
        finally:
            service.process.send_signal(signal.SIGCONT)
        assert asked.result(ANSWERED_WITHIN)["workers"] == 1


def test_questions_outlive_cuts_between_and_amid_them(client: Client, link: Link) -> None:
    with Client.connect(link.endpoint, wait=CONNECTED_WITHIN) as far:
        for _ in range(2):
            assert "bookshelf" in far.scenes()
            assert link.cut(), "there is a connection to cut"
    assert link.cuts == 2


COUNT, EACH = 8, 3
"""More links than Zenoh has threads that send where it isn't told, and more answers for each than a link holds."""
ENDED_AFTER = LEASE + 3.0  # by then a link has ended whose client was stopped [s]
PATIENT = {
    "transport": {"link": {"tx": {"queue": {"congestion_control": {"block": {"wait_before_close": 600_000_000}}}}}}
}
"""A service that waits for readers for ten minutes: what is held up until then is held up for the whole test."""
MANY = """
import json, sys, threading, zenoh
ball = {"name": "s", "obstacles": [{"type": "sphere", "name": "b", "radius": 0.1}]}
asked = json.dumps({"type": "potential", "scene": ball, "points": [[0.1, 0.0, 2.0]] * 50_000})
kept = []
for _ in range(int(sys.argv[2])):
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([sys.argv[1]]))
    config.insert_json5("scouting/multicast/enabled", "false")
    session = zenoh.open(config)
    kept.append(session)
    for _ in range(int(sys.argv[3])):
        session.get("guidefield/local/kinematics", lambda reply: None, payload=asked, timeout=600.0)
print("asked", flush=True)
threading.Event().wait()
"""


def test_links_that_end_while_they_are_sent_to_hold_up_no_other(tmp_path: Path) -> None:
    config = tmp_path / "patient.json5"
    config.write_text(json.dumps(PATIENT), encoding="utf-8")
    with (
        running_service(tmp_path / "data", "--workers", "1", "--config", str(config)) as service,
        plain_client(service.endpoint) as client,
        subprocess.Popen(
            [sys.executable, "-c", MANY, service.endpoint, str(COUNT), str(EACH)], stdout=subprocess.PIPE, text=True
        ) as stopped,
    ):
        try:
            assert stopped.stdout.readline() == "asked\n"
            stopped.send_signal(signal.SIGSTOP)
            until = time.monotonic() + ENDED_AFTER
            while time.monotonic() < until:
                assert client.ask("guidefield/local/robots")
                time.sleep(0.1)
        finally:
            stopped.kill()
