"""Work that nobody needs any more ends: it is cancelled, its time is up, or whoever asked is gone."""

import asyncio
import concurrent.futures
import json
import signal
import subprocess
import sys
from typing import Any

import pytest

from guidefield import AsyncClient, Client, Preempted, TimedOut
from tests.journeys.service import ANSWERED_WITHIN, CONNECTED_WITHIN, PlainClient, Service, await_that

MANY: dict[str, Any] = {
    "type": "clearance",
    "robot": "panda",
    "scene": "bookshelf",
    "configurations": [{"panda_joint1": 0.1}] * 100_000,
    "gradients": True,
    "allowed_time": 600.0,
}
"""Many seconds of work."""


def _busy(wire: PlainClient) -> int:
    return int(wire.ask("guidefield/local/info?brief")["busy"])


def _busy_and_waiting(wire: PlainClient) -> tuple[int, int]:
    told = wire.ask("guidefield/local/info?brief")
    return told["busy"], told["queue"]


def test_a_request_is_ended_by_its_name_while_it_is_worked_on_and_while_it_waits(wire: PlainClient) -> None:
    with concurrent.futures.ThreadPoolExecutor(2) as threads:
        asked = []
        for name, state in (("first", (1, 0)), ("second", (1, 1))):
            request = json.dumps({**MANY, "request_id": name}).encode()
            asked.append(threads.submit(wire.refusal, "guidefield/local/kinematics", request))
            await_that(lambda wanted=state: _busy_and_waiting(wire) == wanted)
        for name in ("second", "first"):  # else the second one begins once the first has ended
            assert wire.ask(f"guidefield/local/requests/{name}/cancel")["done"] == f"request {name!r} ends"
        told = {one.result(ANSWERED_WITHIN)["message"].rpartition("cancelled")[2][:6] for one in asked}
    assert told == {" befor", " after"}
    await_that(lambda: not _busy(wire))
    early = wire.ask("guidefield/local/requests/early/cancel")["done"]
    assert early.startswith("no request 'early' is under way; if it arrives")
    refused = wire.refusal("guidefield/local/kinematics", json.dumps({**MANY, "request_id": "early"}).encode())
    assert (refused["name"], refused["code"]) == ("PREEMPTED", -7)


def test_time_that_is_up_ends_a_request_and_what_waits_for_it(client: Client, wire: PlainClient) -> None:
    with concurrent.futures.ThreadPoolExecutor(2) as threads:
        running = threads.submit(client.kinematics, {**MANY, "allowed_time": 2.0})
        await_that(lambda: _busy(wire))
        with pytest.raises(TimedOut, match=r"all workers were busy for the 0\.5 s"):
            client.kinematics({**MANY, "configurations": [{}], "allowed_time": 0.5})
        with pytest.raises(TimedOut, match=r"the 2 s that `allowed_time` allows were up after \d+ of 100000") as ended:
            running.result(ANSWERED_WITHIN)
    assert 0 < ended.value.details["done"] < 100_000
    await_that(lambda: not _busy(wire))


ASKER = """
import asyncio
import sys
from guidefield import AsyncClient, Clearance
many = Clearance(robot="panda", scene="bookshelf", gradients=True, configurations=[{}] * 100_000, allowed_time=600.0)
async def ask():
    async with await AsyncClient.connect(sys.argv[1], wait=60.0) as client:
        await asyncio.gather(*(client.kinematics(many) for _ in range(4)))
asyncio.run(ask())
"""
"""More work than is done before a client that is gone is missed."""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_client_that_is_gone_ends_its_work(how: signal.Signals, service: Service, wire: PlainClient) -> None:
    before = wire.ask("guidefield/local/info?brief")["counters"]
    with subprocess.Popen([sys.executable, "-c", ASKER, service.endpoint], stderr=subprocess.DEVNULL) as asker:
        await_that(lambda: _busy(wire))
        asker.send_signal(how)
        asker.wait()
    await_that(lambda: not _busy(wire))
    counters = wire.ask("guidefield/local/info?brief")["counters"]
    assert counters["crashes"] == before["crashes"]
    forgotten = counters.get("forgotten", 0) - before.get("forgotten", 0)
    assert forgotten == (how == signal.SIGKILL), "whoever is interrupted cancels by itself"


def test_a_task_that_is_cancelled_ends_its_request(service: Service, wire: PlainClient) -> None:
    async def journey() -> None:
        async with await AsyncClient.connect(service.endpoint, wait=CONNECTED_WITHIN) as client:
            asked = asyncio.create_task(client.kinematics(MANY))
            await asyncio.to_thread(await_that, lambda: _busy(wire))
            asked.cancel()
            with pytest.raises(asyncio.CancelledError):
                await asked
            await asyncio.to_thread(await_that, lambda: not _busy(wire))

    asyncio.run(journey())


def test_a_client_ends_a_request_by_its_name(client: Client, wire: PlainClient) -> None:
    with concurrent.futures.ThreadPoolExecutor(1) as thread:
        asked = thread.submit(client.kinematics, {**MANY, "request_id": "mine"})
        await_that(lambda: _busy(wire))
        assert client.cancel_request("mine") == "request 'mine' ends"
        with pytest.raises(Preempted, match="cancelled after"):
            asked.result(ANSWERED_WITHIN)
