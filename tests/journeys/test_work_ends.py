"""Runs while they run: heard, ended by clients, by time or by nobody needing them any more."""

import ast
import asyncio
import concurrent.futures
import json
import signal
import subprocess
import sys
import uuid
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from guidefield import AsyncClient, Client, InvalidGoal, Preempted, Progress, RobotInvalid, TimedOut
from tests.journeys.service import ANSWERED_WITHIN, CONNECTED_WITHIN, LONG, PlainClient, Service, await_that

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


HOUSE = Path(__file__).resolve().parent.parent.parent


def test_a_run_is_watched_and_ended(client: Client) -> None:
    told: list[Progress] = []
    run_id = uuid.uuid4().hex
    with concurrent.futures.ThreadPoolExecutor(1) as thread:
        sentences: list[concurrent.futures.Future[str]] = []

        def hear(progress: Progress) -> None:
            told.append(progress)
            if progress.stage == "connect" and not sentences:  # in another thread: the answer comes through this one
                sentences.append(thread.submit(client.cancel, run_id))

        reply = client.plan({**LONG, "run_id": run_id}, progress=hear)
        assert sentences[0].result(ANSWERED_WITHIN) == f"run {run_id!r} ends"
    assert reply.status.name == "PREEMPTED", reply.status
    assert reply.counters.iterations < 1_000_000, "a search that nobody ends takes more than twice as many"
    assert {progress.run_id for progress in told} == {run_id}
    assert [progress.elapsed for progress in told] == sorted(progress.elapsed for progress in told)
    assert reply.path, "the best by then is sent along"
    assert client.run(run_id).reply == reply


def test_what_waits_is_ended_at_once_and_a_cancel_may_come_first(service: Service, wire: PlainClient) -> None:
    with concurrent.futures.ThreadPoolExecutor(2) as threads:
        running = threads.submit(wire.ask, "guidefield/local/plan", {**LONG, "run_id": "runs"})
        await_that(lambda: wire.ask("guidefield/local/info?brief")["busy"])
        waiting = threads.submit(wire.ask, "guidefield/local/plan", {**LONG, "run_id": "waits"})
        await_that(lambda: wire.ask("guidefield/local/info?brief")["queue"])
        assert wire.ask("guidefield/local/runs/waits/cancel")["done"] == "run 'waits' ends"
        withdrawn = waiting.result(ANSWERED_WITHIN)
        assert (withdrawn["status"]["name"], withdrawn["run_id"], withdrawn["path"]) == ("PREEMPTED", "waits", [])
        assert not running.done()
        assert "if it arrives" in wire.ask("guidefield/local/runs/withdrawn/cancel")["done"]
        early = wire.ask("guidefield/local/plan", {**LONG, "run_id": "withdrawn"})
        assert early["status"]["message"] == "the run was cancelled before it began"
        wire.ask("guidefield/local/runs/runs/cancel")
        assert running.result(ANSWERED_WITHIN)["status"]["name"] == "PREEMPTED"
    assert wire.refusal("guidefield/local/runs/..%2f/cancel")["name"] == "MALFORMED_REQUEST"
    assert wire.refusal("guidefield/local/runs/a/cancel", b"{}")["name"] == "MALFORMED_REQUEST"


def test_info_tells_what_was_done_and_how_long_it_took(wire: PlainClient) -> None:
    wire.ask("guidefield/local/runs/cancelled/cancel")
    wire.ask("guidefield/local/plan", {**LONG, "run_id": "cancelled"})
    full, brief = wire.ask("guidefield/local/info"), wire.ask("guidefield/local/info?brief")
    assert full["schemas"]["messages"]["Progress"]
    assert (brief["schemas"], brief["packages"]) == ({}, {})
    assert brief["memory"] > 50 * 2**20
    plans = brief["latency"]["plan"]
    assert len(plans["counts"]) == len(plans["bounds"]) + 1
    assert plans["bounds"] == sorted(plans["bounds"])
    counters = wire.ask("guidefield/local/info?brief")["counters"]
    assert counters["asked"] - 1 == counters["answered"] + counters["refused"], "this one is not answered yet"
    assert sum(brief["latency"]["info"]["counts"]) > 0


def test_an_asyncio_client_asks_many_things_at_once(service: Service) -> None:
    async def journey() -> None:
        async with await AsyncClient.connect(service.endpoint, wait=CONNECTED_WITHIN) as client:
            robot, scenes, info, *_ = await asyncio.gather(
                client.robot("panda"), client.scenes(), client.info(), *(client.robots() for _ in range(8))
            )
            assert (robot.tip, "bookshelf" in scenes, info.workers) == ("panda_hand_tcp", True, 1)
            with pytest.raises(RobotInvalid, match="r2d2"):
                await client.robot("r2d2")
            with pytest.raises(InvalidGoal):
                await client.plan(robot="panda", scene="table", goal={"type": "guide_plane"}, guide_planes=[])

    asyncio.run(journey())


def test_a_task_that_is_cancelled_ends_its_run(service: Service, wire: PlainClient) -> None:
    async def journey() -> None:
        async with await AsyncClient.connect(service.endpoint, wait=CONNECTED_WITHIN) as client:
            heard = asyncio.Event()
            task = asyncio.create_task(client.plan({**LONG, "run_id": "dropped"}, progress=lambda _: heard.set()))
            await asyncio.wait_for(heard.wait(), ANSWERED_WITHIN)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task

    asyncio.run(journey())
    await_that(lambda: wire.ask("guidefield/local/runs/dropped")["reply"])
    assert wire.ask("guidefield/local/runs/dropped")["reply"]["status"]["name"] == "PREEMPTED"


def test_one_client_does_not_hold_up_another(service: Service) -> None:
    """With one worker, whoever asks one thing is served after one of the many things that another asked before."""
    ball = {"type": "sphere", "name": "ball", "radius": 0.1, "position": [0.0, 0.0, 2.0]}
    scene = {"schema": 1, "name": "ball", "obstacles": [ball]}
    asked = {"type": "clearance", "robot": "panda", "scene": scene, "configurations": [{}] * 50}
    done: list[str] = []
    with (
        Client.connect(service.endpoint, wait=CONNECTED_WITHIN) as greedy,
        Client.connect(service.endpoint, wait=CONNECTED_WITHIN) as modest,
        concurrent.futures.ThreadPoolExecutor(10) as threads,
    ):
        from guidefield.messages import codec

        request = codec.decode_request(json.dumps(asked).encode())

        def ask(client: Client, name: str) -> None:
            client.kinematics(request)
            done.append(name)

        before = threads.submit(greedy.plan, {**LONG, "run_id": "before"})  # while it goes on, all others wait
        await_that(lambda: modest.info().busy)
        many = [threads.submit(ask, greedy, "greedy") for _ in range(8)]
        await_that(lambda: modest.info().queue == 8)
        one = threads.submit(ask, modest, "modest")
        await_that(lambda: modest.info().queue == 9)
        modest.cancel("before")
        concurrent.futures.wait([before, *many, one])
        assert not [future.exception() for future in [before, *many, one] if future.exception()]
    assert done.index("modest") < 5, "it is second; the threads that wait may be woken in another order"


def test_the_example_that_uses_nothing_of_ours(service: Service, tmp_path: Path) -> None:
    example = HOUSE / "tools" / "examples" / "plain_zenoh.py"
    assert "import guidefield" not in example.read_text()
    done = subprocess.run(
        [sys.executable, str(example), service.endpoint, str(tmp_path / "run.rrd")],
        check=False,
        capture_output=True,
        text=True,
        timeout=ANSWERED_WITHIN,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "SUCCESS" in done.stdout
    assert "certify" in done.stdout
    assert (tmp_path / "run.rrd").read_bytes()[:4] in (b"RRF2", b"RRF3", b"RRF4")
    middle = done.stdout.partition("half-way: ")[2].partition("\n")[0]
    with Client.connect(service.endpoint, wait=CONNECTED_WITHIN) as client:
        (run,) = [run for run in client.runs(robot="panda").runs if run.scene == "post"]
        reply = client.run(run.run_id).reply
    times, q, v = (
        np.array(rows) for rows in (reply.trajectory.times, reply.trajectory.positions, reply.trajectory.velocities)
    )
    expected = CubicHermiteSpline(times, q, v)(0.5 * times[-1])
    assert dict(zip(reply.position_names, expected, strict=True)) == pytest.approx(ast.literal_eval(middle), abs=1e-3)
