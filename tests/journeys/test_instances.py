"""Several instances of the service on one network: a client is given a free one, and another one when that is gone."""

import concurrent.futures
import contextlib
from pathlib import Path

import pytest

from guidefield import Client, NoService, Potential, Scene, Sphere
from guidefield.errors import UnknownObject
from tests.journeys.service import (
    ANSWERED_WITHIN,
    CONNECTED_WITHIN,
    LONG,
    await_death,
    await_that,
    plain_client,
    running_service,
)


def test_a_free_instance_is_found_and_another_one_when_it_dies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("guidefield.client.exchange.REPORT_TIMEOUT_S", ANSWERED_WITHIN)
    with (
        running_service(tmp_path / "a", "--workers", "1", "--name", "a") as a,
        running_service(tmp_path / "b", "--workers", "1", "--name", "b") as b,
        concurrent.futures.ThreadPoolExecutor(4) as threads,
    ):
        services = {"a": a, "b": b}
        endpoints = (a.endpoint, b.endpoint)
        with Client.connect(*endpoints, wait=CONNECTED_WITHIN) as client:
            first = client.instance
            other = "b" if first == "a" else "a"
            known = client._exchange._instances
            await_that(lambda: len(known.living()) == 2)
            # A burst is spread over both, and each run is ended where it is made.
            burst = [threads.submit(client.plan, {**LONG, "run_id": f"burst-{number}"}) for number in range(4)]
            for name, service in services.items():
                with plain_client(service.endpoint) as wire:
                    key = f"guidefield/{name}/info?brief"
                    await_that(lambda: sum(wire.ask(key)[what] for what in ("busy", "queue")) == 2)  # noqa: B023
            for number, asked in enumerate(burst):
                assert client.cancel(f"burst-{number}") == f"run 'burst-{number}' ends"
                assert asked.result(ANSWERED_WITHIN).status.name == "PREEMPTED"
                with contextlib.suppress(UnknownObject):  # of one that had not begun nothing is kept
                    client.delete_run(f"burst-{number}")
            # What was stored is asked for where it is.
            client.store_scene(Scene("mine", obstacles=[Sphere(name="ball", radius=0.1)]))
            points = Potential(scene="mine", points=[(0.0, 0.0, 1.0)])
            assert len({tuple(reply.potential) for reply in threads.map(client.kinematics, [points] * 4)}) == 1
            running = threads.submit(client.plan, {**LONG, "run_id": "first"})
            await_that(lambda: client.info().busy)
            # Whoever comes now and sees both is given the other one: the first is busy.
            with Client.connect(*endpoints, wait=CONNECTED_WITHIN) as late:
                seen = late._exchange._instances
                await_that(lambda: len(seen.living()) == 2)
                assert seen.freest(frozenset(), 0.0) == other
            # The instance dies in the middle of the run: the other one makes it, and there is one answer.
            workers = services[first].workers()
            services[first].process.kill()
            services[first].process.wait()
            for worker in workers:
                await_death(worker)
            await_that(lambda: client.instance == other and client.info().busy)
            client.cancel("first")
            reply = running.result(ANSWERED_WITHIN)
            assert (reply.run_id, reply.status.name) == ("first", "PREEMPTED")
            assert client.run("first").reply == reply, "it is asked where it was made"
            assert [run.run_id for run in client.runs().runs] == ["first"]
        # A client that wants one instance and no other is told that it is gone.
        with Client.connect(*endpoints, instance=other, wait=CONNECTED_WITHIN) as faithful:
            services[other].process.kill()
            services[other].process.wait()
            await_that(lambda: other not in faithful._exchange._instances.living())
            with pytest.raises(NoService, match="answers any more"):
                faithful.info()
            await_that(lambda: not faithful.alive())  # the token follows
        with pytest.raises(NoService, match="nobody listens at"):
            Client.connect(*endpoints, wait=0.3)
