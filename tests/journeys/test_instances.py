"""Several instances of the service on one network: a client is given a free one, and another one when that is gone."""

from __future__ import annotations

import concurrent.futures
import time
from pathlib import Path

import pytest

from guidefield import Client, NoService
from tests.journeys.service import ANSWERED_WITHIN, LONG, plain_client, running_service


def test_a_free_instance_is_found_and_another_one_when_it_dies(tmp_path: Path) -> None:
    with (
        running_service(tmp_path / "a", "--workers", "1", "--name", "a") as a,
        running_service(tmp_path / "b", "--workers", "1", "--name", "b") as b,
        concurrent.futures.ThreadPoolExecutor(4) as threads,
    ):
        services = {"a": a, "b": b}
        endpoints = (a.endpoint, b.endpoint)
        with Client.connect(*endpoints) as client, plain_client(a.endpoint) as wire:
            first = client.instance
            other = "b" if first == "a" else "a"
            running = threads.submit(client.plan, {**LONG, "run_id": "first", "allowed_planning_time": 3.0})
            # Whoever comes now is given the other one: the first is busy.
            while wire.ask("guidefield/a/info?brief")["busy"] == 0 and first == "a":
                time.sleep(0.02)
            while client.info().busy == 0:
                time.sleep(0.02)
            with Client.connect(*endpoints) as late:
                assert late.instance == other
            # The instance dies in the middle of the run: the other one makes it, and there is one answer.
            services[first].process.kill()
            services[first].process.wait()
            died = time.monotonic()
            while other not in {client.instance}:
                assert time.monotonic() - died < ANSWERED_WITHIN
                time.sleep(0.005)
            reply = running.result(ANSWERED_WITHIN)
            assert reply.run_id == "first"
            assert reply.status.name in {"TIMED_OUT", "PLANNING_FAILED"}  # as fast as the machine is
            assert reply.counters.iterations > 0
            assert client.run("first").reply == reply, "it is asked where it was made"
            assert [run.run_id for run in client.runs().runs] == ["first"]
        # A client that wants one instance and no other is told that it is gone.
        with Client.connect(*endpoints, instance=other) as faithful:
            services[other].process.kill()
            services[other].process.wait()
            with pytest.raises(NoService, match="answers any more"):
                faithful.info()
            while faithful.alive():  # the token follows
                time.sleep(0.02)
        with pytest.raises(NoService, match="no service is there"):
            Client.connect(*endpoints, wait=0.3)
