"""What goes on shows itself in a running viewer: a plan's steps and its recording, a stream, a client's runs."""

import asyncio
import os
import re
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from rerun.chunk import RrdReader

from guidefield.cli.serving import free_port
from guidefield.engine import Engine
from guidefield.messages.scene import Box
from guidefield.messages.streams import Observation, StreamObstacle, StreamOpen, StreamUpdate
from guidefield.messages.values import Placement
from guidefield.recorder import live_view
from guidefield.stream.journal import Journal
from guidefield.stream.shown import LiveStream
from guidefield.viewer import CannotShow, is_listening
from tests.journeys.service import running_service
from tests.recorder.receiver import TIME_S, Receiver, receiver

GUIDED = {"robot": "ur5", "scene": "table", "goal": {"type": "guide_plane"}, "allowed_planning_time": 120.0}
JOINTS = {
    "robot": "ur5",
    "scene": "table",
    "goal": {"type": "joints", "positions": {"elbow_joint": 1.2}},
    "guide_planes": [],
    "allowed_planning_time": 120.0,
}


def _entities(viewer: Receiver) -> dict[str, set[str]]:
    return {name: {chunk.entity_path for chunk in chunks} for name, chunks in viewer.chunks().items()}


def _finish_sending() -> None:
    live_view._sender().submit(bool).result()


def test_a_plan_shows_its_steps_and_then_its_recording(tmp_path: Path) -> None:
    with receiver(tmp_path) as viewer:
        engine = Engine(viewer=viewer.address)
        recording = tmp_path / "run.rrd"
        reply: Any = engine.answer({**GUIDED, "run_id": "shown"}, record_to=recording)
        _finish_sending()
    (shown,) = viewer.chunks().values()
    kept = RrdReader(str(recording)).stream().to_chunks()
    assert reply.status.name == "SUCCESS"
    assert {chunk.entity_path for chunk in kept} <= {chunk.entity_path for chunk in shown}
    moved = [chunk for chunk in shown if chunk.entity_path == "/robot/model/frames" and "step" in chunk.timeline_names]
    assert len(moved) > 1  # while it was planned, and in the end
    assert viewer.has_layout()


def test_a_stream_shows_itself_while_it_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("guidefield.stream.shown.SHOWN_INTERVAL_S", 0.0)
    box = StreamObstacle(Box(name="cart", size=(0.1, 0.1, 0.1)), 0.3)
    request = StreamOpen("ur5", "table", goal=JOINTS["goal"], obstacles=[box], stream_id="s1")
    with receiver(tmp_path) as viewer:
        journal = Journal(tmp_path / "s1", request, "plain", {})
        with Engine(viewer=viewer.address).stream(request, None, journal) as stream:
            for cycle in range(30):
                seen = Observation("cart", 0.02 * cycle, Placement((0.6, 0.5 - 0.002 * cycle, 0.9)))
                stream.update(StreamUpdate(0.02 * cycle, [seen]))
                _finish_sending()
        journal.close()
    shown = viewer.chunks()["s1"]
    rows = {chunk.entity_path: 0 for chunk in shown}
    for chunk in shown:
        rows[chunk.entity_path] += chunk.num_rows
    assert rows["/path/stop"] == rows["/plots/latency"] == 30
    assert any("cart" in path and count >= 30 for path, count in rows.items())


def test_a_service_and_both_clients_show_runs(tmp_path: Path) -> None:
    with (
        receiver(tmp_path) as viewer,
        running_service(tmp_path / "data", "--workers", "1", "--viewer", viewer.address) as service,
    ):
        from guidefield.client import Client

        with Client.connect(service.endpoint) as client:
            client.plan({**JOINTS, "run_id": "of-the-service"})
        with Client.connect(service.endpoint, show=viewer.address) as client:
            client.plan({**JOINTS, "run_id": "of-both", "recording": "summary"})
        asyncio.run(_plan_shown(service.endpoint, viewer.address))
        deadline = time.monotonic() + TIME_S
        while len(_entities(viewer)) < 3 and time.monotonic() < deadline:
            time.sleep(0.2)
    found = _entities(viewer)
    assert {"of-the-service", "of-both", "awaited"} == set(found)
    assert "/documents/summary" in set.intersection(*found.values())


async def _plan_shown(endpoint: str, viewer: str) -> None:
    from guidefield.client import AsyncClient

    async with await AsyncClient.connect(endpoint, show=viewer) as client:
        await client.plan({**JOINTS, "run_id": "awaited"})


@pytest.mark.parametrize("forgotten", [False, True])
def test_a_viewer_that_has_gone_costs_no_recording(tmp_path: Path, *, forgotten: bool) -> None:
    with receiver(tmp_path) as viewer:
        channels = [live_view.Channel(viewer.address, "cut-off")]  # never ended, as of a run whose worker dies
        channels[0].send(lambda: ([], None))
        _finish_sending()
    if forgotten:
        channels.clear()
    for number in range(2):
        file = tmp_path / f"{number}.rrd"
        reply: Any = Engine().answer(JOINTS, record_to=file)
        assert reply.status.name == "SUCCESS"
        assert file.exists()


def _nobody_waits(port: int) -> None:
    reply: Any = Engine(viewer=f"rerun+http://127.0.0.1:{port}/proxy").answer(JOINTS)
    assert reply.status.name == "SUCCESS"
    began = time.monotonic()
    _finish_sending()
    assert time.monotonic() - began < 5.0


@pytest.mark.parametrize("viewer", [None, "rerun+http://127.0.0.1:9/proxy"])
def test_an_engine_that_shows_runs_loads_what_that_takes_before_the_first(viewer: str | None) -> None:
    code = f"""
import sys
from guidefield.engine import Engine
Engine(viewer={viewer!r}).warm_up()
loaded = {{"guidefield.recorder.live_view", "guidefield.recorder.recorder"}} & {{*sys.modules}}
sys.exit(len(loaded))
"""
    done = subprocess.run([sys.executable, "-c", code], check=False, timeout=TIME_S)
    assert done.returncode == (0 if viewer is None else 2)


def test_nobody_waits_for_a_viewer_that_is_not_there() -> None:
    _nobody_waits(9)


def test_nobody_waits_for_who_takes_connections_and_never_answers() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        _nobody_waits(silent.getsockname()[1])


def test_a_viewer_is_started_where_none_listens_and_outlives_who_started_it() -> None:
    environment = {name: value for name, value in os.environ.items() if "DISPLAY" not in name}
    with free_port() as port:
        code = f"from guidefield.viewer import find_viewer; print(find_viewer(print, {port}))"
        command = [sys.executable, "-c", code]
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True, timeout=TIME_S
        )  # what it started holds none of its outputs
    said, address = done.stdout.splitlines()
    ending = re.findall(r"`(kill -- -\d+)` ends it", said)[0]
    try:
        assert is_listening(address)
        assert address == f"rerun+http://127.0.0.1:{port}/proxy"
    finally:
        subprocess.run(ending, shell=True, check=True)
    deadline = time.monotonic() + TIME_S
    while is_listening(address):
        assert time.monotonic() < deadline, "the command that is told doesn't end the viewer"
        time.sleep(0.05)


def test_an_address_that_is_none_is_refused() -> None:
    with pytest.raises(CannotShow, match="written like rerun"):
        is_listening("localhost:9876")
    command = [sys.executable, "-m", "guidefield", "plan", "-", "--viewer", "rerun+http://127.0.0.1:9/proxy"]
    done = subprocess.run(command, input="{}", capture_output=True, text=True, check=False)
    assert done.returncode == 2


def test_what_a_viewer_that_takes_nothing_is_sent_is_bounded(caplog: pytest.LogCaptureFixture) -> None:
    taken = threading.Event()
    live_view._sender().submit(taken.wait, 60.0)  # a viewer that stopped after its greeting
    made: list[int] = []

    def make(number: int) -> live_view.Part:
        made.append(number)
        return (), None

    channels = [live_view.Channel("rerun+http://127.0.0.1:1/proxy", f"run{number}") for number in range(3)]
    sent = live_view.MAX_BACKLOG + 3
    for number in range(sent):
        channels[number % 3].send(lambda number=number: make(number), last=True)
    assert len([one for one in caplog.records if "takes nothing" in one.message]) == 3
    taken.set()
    _finish_sending()
    assert not any(channel.is_busy for channel in channels)
    assert live_view._backlog._value == live_view.MAX_BACKLOG  # all of it is free again
    assert made == []  # nobody listens there


def test_a_stream_keeps_no_more_than_some_updates_for_a_viewer_that_takes_nothing(monkeypatch, caplog):
    monkeypatch.setattr("guidefield.stream.shown.MAX_WAITING", 20)
    monkeypatch.setattr(live_view.Channel, "is_busy", True)
    request = StreamOpen("ur5", "table", goal=JOINTS["goal"], stream_id="s2")
    with Engine().stream(request) as stream:
        shown = LiveStream("rerun+http://127.0.0.1:1/proxy", stream)
        for cycle in range(50):
            shown.begin_update()
            shown.end_update(StreamUpdate(0.02 * cycle, []), None, None, noted=True, took=False)
            assert len(shown._waiting) < 20
    assert [one.message for one in caplog.records if "isn't shown any more" in one.message] != []
    assert shown._waiting == []
