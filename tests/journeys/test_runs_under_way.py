"""Runs while they run: their progress is heard, they can be ended, by a client that waits or by one that doesn't."""

import ast
import asyncio
import concurrent.futures
import json
import subprocess
import sys
import uuid
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from guidefield import AsyncClient, Client, InvalidGoal, Progress, RobotInvalid
from tests.journeys.service import ANSWERED_WITHIN, CONNECTED_WITHIN, LONG, PlainClient, Service, await_that

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
