"""Streams over real Zenoh on loopback: a simulated robot follows pieces among obstacles that move, and what goes wrong.

The client's clock is the test's own: it goes on when an answer has come, however long that takes. So the robot's motion
is the same on any machine, and contacts are looked for with plain Pinocchio and Coal.
"""

import asyncio
import contextlib
import json
import os
import re
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coal
import msgspec
import numpy as np
import pytest
from rerun.chunk import RrdReader
from typer.testing import CliRunner

from guidefield import (
    AsyncClient,
    Client,
    GuidefieldError,
    MalformedRequest,
    NoService,
    NotAllowed,
    Piece,
    QuotaExceeded,
    ServerBusy,
    StreamState,
    StreamUnknown,
    UnknownObject,
    WorkerCrashed,
)
from guidefield.cli import app
from guidefield.client.streams import ServiceStream
from guidefield.messages.scene import Scene
from guidefield.messages.streams import MOST_UPDATE_BYTES, StreamOpen
from guidefield.scene.scene import build
from guidefield.stream.journal import Updated, read
from guidefield.stream.state import encode_part
from guidefield.stream.stream import CertifiedStream
from tests.journeys.service import (
    ANSWERED_WITHIN,
    CONNECTED_WITHIN,
    PlainClient,
    Service,
    await_that,
    plain_client,
    running_service,
)
from tests.robots import robot

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
from streaming.simulation import Bodies

PERIOD = 0.02
GOAL: dict[str, Any] = {"type": "joints", "positions": {"shoulder_pan_joint": 0.9, "elbow_joint": 1.0}}
BACK: dict[str, Any] = {"type": "joints", "positions": {"shoulder_pan_joint": -0.4, "elbow_joint": 0.9}}
EMPTY: dict[str, Any] = {"name": "empty", "obstacles": []}
ASKED: dict[str, Any] = {
    "robot": "ur5",
    "scene": EMPTY,
    "start": {"shoulder_lift_joint": -1.5, "elbow_joint": 0.5},
    "obstacles": [
        {"obstacle": {"type": "box", "name": name, "size": [0.12, 0.12, 0.12]}, "largest_speed": 0.2}
        for name in ("crate", "case")
    ],
}


class Clock:
    """A clock that the test sets."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def placed(name: str, now: float) -> np.ndarray:
    """Where an obstacle is: each drifts past the arm, slower than it may."""
    if name == "crate":
        return np.array([0.75 - 0.15 * now, 0.55, 0.5])
    return np.array([0.45, -0.9 + 0.15 * now, 0.6])


def seen(now: float) -> list[dict[str, Any]]:
    return [
        {"name": name, "time": now, "placement": {"position": placed(name, now).tolist()}} for name in ("crate", "case")
    ]


class Judge:
    """Looks for contacts of a robot that moves."""

    def __init__(self) -> None:
        scene = build(Scene("empty"))
        with CertifiedStream(StreamOpen("ur5", "empty"), robot("ur5"), scene) as stream:
            self._bodies = Bodies(stream)
        self._box = coal.Box(0.12, 0.12, 0.12)
        self.looks = 0

    def look(self, stream: ServiceStream, since: float, until: float) -> None:
        for now in np.arange(since, until, 0.005):
            motion = stream.at(float(now))
            if not np.abs(motion.velocities).max() > 0.0:
                continue
            self._bodies.place(np.array(motion.positions))
            self.looks += 1
            for name in ("crate", "case"):
                place = coal.Transform3s(np.eye(3), placed(name, now))
                touched = [
                    self._bodies.name(body)
                    for body, joint in enumerate(self._bodies.joints)
                    if joint and self._bodies.touches(body, self._box, place)
                ]
                assert not touched, f"{touched} met {name} at {now:.3f} s"
            assert self._bodies.touching_own() is None


def step(stream: ServiceStream, clock: Clock, judge: Judge | None = None) -> Piece | StreamState:
    """One update, its answer, and the robot's motion until the next one."""
    stream.update(obstacles=seen(clock.now))
    answer = stream.answer(ANSWERED_WITHIN)
    assert answer is not None
    if judge is not None:
        judge.look(stream, clock.now, clock.now + PERIOD)
    clock.now += PERIOD
    return answer


def arrive(stream: ServiceStream, clock: Clock, judge: Judge, within: float) -> list[Piece | StreamState]:
    """Go on until the robot stands at its goal, on its own clock."""
    answers, end = [step(stream, clock, judge)], clock.now + within
    while not (isinstance(answers[-1], StreamState) and answers[-1].reason == "at_goal"):
        assert clock.now < end, answers[-1]
        answers.append(step(stream, clock, judge))
    judge.look(stream, clock.now, answers[-1].stops)
    clock.now = max(clock.now, answers[-1].stops)
    return answers


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    folder = tmp_path_factory.mktemp("data")
    quotas = folder / "quotas.json"
    quotas.write_text(json.dumps({"users": {"anna": {"streams": 1}}}))
    options = ("--workers", "1", "--streams", "2", "--quota", str(quotas))
    with running_service(folder / "kept", *options) as service:
        yield service


@pytest.fixture
def client(service: Service) -> Iterator[Client]:
    with Client.connect(service.endpoint, wait=CONNECTED_WITHIN) as client:
        yield client
        await_that(lambda: not client.streams())


def test_pieces_lead_to_goals_that_change_and_what_is_wrong_is_told(service, client, tmp_path):
    clock, judge = Clock(), Judge()
    with client.stream(ASKED, clock=clock) as stream:
        assert client.streams() == [stream.stream_id]
        state = step(stream, clock, judge)
        assert state.reason == "standing"
        assert stream.aim_for(GOAL) == 1
        answers = [step(stream, clock, judge) for _ in range(15)]
        assert stream.aim_for(BACK) == 2
        answers += arrive(stream, clock, judge, 20.0)
        pieces = [one for one in answers if isinstance(one, Piece)]
        assert {piece.goal for piece in pieces} == {1, 2}
        assert judge.looks > 100
        taken = list(stream)
        assert 0 < len(taken) <= len(pieces)
        assert taken[-1].reaches_goal
        reached = dict(zip(stream.position_names, stream.at(clock.now).positions, strict=True))
        assert {name: reached[name] for name in BACK["positions"]} == pytest.approx(BACK["positions"], abs=1e-6)
        read = stream.read()
        assert (read.pieces, read.updates, read.goal) == (len(pieces), len(answers) + 1, 2)
        stream.aim_for(GOAL)
        moving = [step(stream, clock, judge) for _ in range(5)]
        assert any(isinstance(one, Piece) for one in moving)
        stream.stop()
        state = step(stream, clock, judge)
        assert state.reason == "stopped"
        assert stream.at(state.stops).velocities == (0.0,) * 6
        _attack(service, stream, clock)
        with kept_open(stream):
            shown = _shown(client.stream_recording(stream.stream_id))
        assert 0 < len(shown) <= stream.read().updates, "what is written by now, of a stream that goes on"
    assert client.streams() == []
    with pytest.raises(StreamUnknown):
        stream.read()
    with pytest.raises(GuidefieldError):
        stream.update()
    _has_a_recording(service, client, stream, tmp_path)
    _is_repeated(service, stream, client.info().version)


def test_a_client_asks_whether_what_it_executes_is_still_proven(client: Client) -> None:
    clock, judge = Clock(), Judge()
    with client.stream({**ASKED, "goal": GOAL}, clock=clock) as stream:
        pieces = [one for one in (step(stream, clock) for _ in range(8)) if isinstance(one, Piece)]
        last, before = pieces[-1], stream.read()
        told = stream.judged()
        assert (told.proven, told.pair, told.time) == (True, None, None)
        assert (told.executing, told.stops) == (last.number, last.stops)
        assert told.evaluations > 0
        place = judge._bodies.place(np.array(last.trajectory.positions[-1]))[-1]
        there = {"name": "crate", "time": clock.now, "placement": {"position": place.tolist()}}
        stream.update(obstacles=[there])
        assert stream.answer(ANSWERED_WITHIN) is not None
        told = stream.judged(clock.now)
        assert not told.proven
        assert told.pair[1] == "crate"
        assert clock.now <= told.time <= told.stops
        with pytest.raises(MalformedRequest, match="time"):
            stream.judged(float("nan"))
        read = stream.read()
        assert (read.goal, read.updates) == (before.goal, before.updates + 1), "to judge changes nothing"
    with pytest.raises(StreamUnknown):
        stream.judged()


def _shown(recording: bytes) -> list[float]:
    """When a stream's recording shows where the robot would stand [s]."""
    with tempfile.NamedTemporaryFile(suffix=".rrd") as file:
        Path(file.name).write_bytes(recording)
        (chunk,) = (one for one in RrdReader(file.name).stream().to_chunks() if one.entity_path == "/path/stop")
    nanoseconds = chunk.to_record_batch().column("path_time").to_numpy(zero_copy_only=False).astype(np.int64)
    return (1e-9 * nanoseconds).tolist()


def _has_a_recording(service: Service, client: Client, stream: ServiceStream, tmp_path: Path) -> None:
    """A stream that is over is shown from a file that the service makes: each update that was answered."""
    shown = _shown(client.stream_recording(stream.stream_id))
    (file,) = (service.data / "streams" / stream.stream_id).iterdir()
    answered = [one for one in read(file)[1] if isinstance(one, Updated) and (one.piece or one.state)]
    worked_on = [one.update.time for one in answered if one.state is None or one.state.reason != "late"]
    assert shown == pytest.approx(worked_on, abs=1e-8)
    exported = tmp_path / "exported.rrd"
    done = CliRunner().invoke(app, ["runs", "export", stream.stream_id, str(exported), "--data", str(service.data)])
    assert done.exit_code == 0, done.output
    assert _shown(exported.read_bytes()) == shown
    with plain_client(service.endpoint) as wire:
        key = f"guidefield/local/streams/{stream.stream_id}/recording"
        answer = wire.answer(key)
        assert answer.encoding == "application/octet-stream"
        assert _shown(answer.payload) == shown
        assert wire.refusal("guidefield/local/streams/nowhere/recording")["name"] == "INVALID_OBJECT_NAME"
        assert wire.refusal("guidefield/local/streams/.lock/recording")["name"] == "MALFORMED_REQUEST"
        assert wire.refusal(f"{key}?delete")["name"] == "MALFORMED_REQUEST"
        assert wire.refusal(key, b"{}")["name"] == "MALFORMED_REQUEST"


def _is_repeated(service: Service, stream: ServiceStream, version: str) -> None:
    """What was kept of a stream is done again, in this process: the same pieces, to the last bit."""
    command = ["replay", stream.stream_id, "--data", str(service.data)]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    told = re.fullmatch(r"\w+/000001\.stream: bit-identical: (\d+) updates, (\d+) pieces\s", done.output)
    assert told, done.output
    assert int(told[1]) > int(told[2]) > 20
    (file,) = (service.data / "streams" / stream.stream_id).iterdir()
    begun, entries = read(file)
    assert begun.versions["guidefield"] == version
    piece = next(k for k, one in enumerate(entries) if isinstance(one, Updated) and one.piece is not None)
    changed = msgspec.structs.replace(entries[piece], took=True, piece=None)
    with file.open("wb") as write:
        for one in (begun, *entries[:piece], changed, *entries[piece + 1 :]):
            payload = msgspec.msgpack.encode(one, enc_hook=encode_part)
            write.write(len(payload).to_bytes(4, "little") + payload)
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 1
    assert "not the same: the answer to the update at" in done.output
    assert "then: nothing" in done.output


def test_a_worker_that_dies_says_so_and_a_client_that_comes_back_goes_on(service: Service, client: Client) -> None:
    clock, judge, others = Clock(), Judge(), set(service.workers())
    with client.stream({**ASKED, "goal": GOAL}, clock=clock) as stream:
        for _ in range(8):
            step(stream, clock, judge)
        (own,) = set(service.workers()) - others
        os.kill(own, signal.SIGKILL)
        await_that(lambda: stream.ended is not None)
        assert stream.ended.reason == "ended"
        with pytest.raises(WorkerCrashed, match="died"):
            stream.update()
        first, stops = stream.stream_id, stream.ended.stops
        judge.look(stream, clock.now, stops)
        clock.now = stops + PERIOD
        assert stream.at(clock.now).velocities == (0.0,) * 6
        stream.reopen(dict(zip(stream.position_names, stream.at(clock.now).positions, strict=True)))
        assert stream.stream_id != first
        assert stream.ended is None
        arrive(stream, clock, judge, 20.0)


@contextlib.contextmanager
def kept_open(stream: ServiceStream) -> Iterator[None]:
    """Updates go on, however long something else takes: a stream without any ends."""
    over = threading.Event()

    def send() -> None:
        while not over.wait(0.5):
            stream.update()

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def test_streams_beyond_what_there_may_be_are_refused_and_those_of_who_vanishes_end(service, client):
    with pytest.raises(MalformedRequest, match="piece"):
        client.stream({**ASKED, "piece": 0.01})
    with Client.connect(service.endpoint, user="anna", wait=CONNECTED_WITHIN) as anna, anna.stream(ASKED) as first:
        with pytest.raises(QuotaExceeded, match="1 streams at once"), anna.stream(ASKED):
            pass
        with Client.connect(service.endpoint, user="ben", wait=CONNECTED_WITHIN) as ben:
            with Client.connect(service.endpoint, wait=CONNECTED_WITHIN) as vanishing:
                left = vanishing.stream(ASKED)
                with kept_open(first):
                    left.__enter__()
                left.update(time=0.0)
                assert left.answer(ANSWERED_WITHIN) is not None
                assert set(client.streams()) == {left.stream_id, f"anna:{first.stream_id}"}
                with pytest.raises(ServerBusy, match=r"2 streams are open.*--streams"), ben.stream(ASKED):
                    pass
                assert ben.streams() == []
            _cannot_use(service, ben, first)
            while len(client.streams()) > 1:  # until it is noticed that its client is gone
                first.update()
                assert first.answer(ANSWERED_WITHIN) is not None


def _cannot_use(service: Service, ben: Client, first: ServiceStream) -> None:
    """Another user neither sees, aims, ends nor feeds a stream."""
    name = first.stream_id
    with plain_client(service.endpoint) as wire:
        key = f"guidefield/local/as/ben/streams/anna:{name}"
        for what in ("", "?delete", "/stop", "/recording"):
            assert wire.refusal(f"{key}{what}")["name"] == "NOT_ALLOWED"
        assert wire.refusal(f"{key}/goal", b'{"goal": null}')["name"] == "NOT_ALLOWED"
        assert wire.refusal(f"guidefield/local/as/ben/streams/{name}")["name"] == "STREAM_UNKNOWN"
        before = first.read().updates
        astray = ben.info().counters["updates_astray"]
        for user in ("as/ben/", ""):
            wire.put(f"guidefield/local/{user}streams/{name}/update", b'{"time": 1.0}')
        wire.put("guidefield/local/as/plain/streams/x/update", b"")
        await_that(lambda: ben.info().counters["updates_astray"] == astray + 3)
        assert first.read().updates == before
    assert NotAllowed.code == -110


HOSTILE: list[tuple[bytes, str]] = [
    (b"", "MALFORMED_REQUEST"),
    (b"\xff\x00", "MALFORMED_REQUEST"),
    (b'{"time": NaN}', "MALFORMED_REQUEST"),
    (b'{"time": 1e400}', "MALFORMED_REQUEST"),
    (b'{"time": @, "joints": {"elbow_joint": 1e999}}', "MALFORMED_REQUEST"),
    (b'{"time": @, "velocity": 1}', "MALFORMED_REQUEST"),
    (b'{"schema": 2, "time": @}', "MALFORMED_REQUEST"),
    (b'{"time": @, "executing": 77}', "MALFORMED_REQUEST"),
    (b'{"time": @, "joints": {"elbow_joint": 1.0}}', "INVALID_ROBOT_STATE"),
    (b'{"time": @, "joints": {"nose": 1.0}}', "INVALID_ROBOT_STATE"),
    (b'{"time": @, "obstacles": [{"name": "ghost", "time": @}]}', "INVALID_OBJECT_NAME"),
    (b'{"time": @, "obstacles": [{"name": "crate", "time": 900.0}]}', "MALFORMED_REQUEST"),
    (b'{"time": @, "gone": ["ghost"]}', "INVALID_OBJECT_NAME"),
    (b'{"time": @, "gone": [' + b",".join([b'"ghost"'] * 10_001) + b"]}", "MALFORMED_REQUEST"),
    (
        b'{"time": @, "declare": [{"obstacle": {"type": "sphere", "name": "wrist_1_link", "radius": 1},'
        b' "largest_speed": 1}]}',
        "SCENE_INVALID",
    ),
    (b"[" * 100_000, "MALFORMED_REQUEST"),
    (b" " * (MOST_UPDATE_BYTES + 1), "REQUEST_TOO_LARGE"),
]


def _attack(service: Service, stream: ServiceStream, clock: Clock) -> None:
    """What is wrong with an update is told, and the stream goes on."""
    offset = clock.now
    with plain_client(service.endpoint) as wire:
        key = f"guidefield/local/streams/{stream.stream_id}/update"
        for index, (payload, name) in enumerate(HOSTILE):
            when = b"%.3f" % (offset + 1.0 + 0.1 * index)
            told = _told(stream, wire, key, payload.replace(b"@", when), "application/json")
            assert told.reason == "refused", payload[:80]
            assert told.error.name == name, (payload[:80], told)
        assert _told(stream, wire, key, b"{}", "image/png").error is not None
        late = _told(stream, wire, key, b'{"time": -3.0}', "application/json")
        assert late.reason == "late"
        with pytest.raises(GuidefieldError, match="positions"):
            stream.aim_for({"type": "joints"})
        with pytest.raises(GuidefieldError, match="limits"):
            stream.aim_for({"type": "joints", "positions": {"elbow_joint": 9.0}})
        clock.now += 6.0
        stream.aim_for(GOAL)
        assert isinstance(step(stream, clock), Piece)


def _told(stream: ServiceStream, wire: PlainClient, key: str, payload: bytes, encoding: str) -> StreamState:
    """What is told of an update."""
    before = stream.state
    wire.put(key, payload, encoding)
    await_that(lambda: stream.state is not before)
    assert stream.state is not None
    return stream.state


def test_the_same_for_asyncio(service: Service) -> None:
    async def go() -> list[Piece]:
        clock = Clock()
        async with await AsyncClient.connect(service.endpoint, wait=CONNECTED_WITHIN) as client:
            asked = {**ASKED, "obstacles": [], "recording": "off"}
            async with client.stream(asked, clock=clock) as stream:
                await stream.update()
                state = await stream.answer(ANSWERED_WITHIN)
                assert isinstance(state, StreamState)
                assert await stream.aim_for(GOAL) == 1
                pieces = []
                clock.now += PERIOD
                ball = {"obstacle": {"type": "sphere", "name": "ball", "radius": 0.1}, "largest_speed": 0.1}
                far = {"name": "ball", "time": clock.now, "placement": {"position": [2.0, 0.0, 0.5]}}
                await stream.update(declare=[ball], obstacles=[far])
                async for piece in stream:
                    pieces.append(piece)
                    if len(pieces) == 4:
                        break
                    clock.now += PERIOD
                    await stream.update(obstacles=[{**far, "time": clock.now}])
                assert await client.streams() == [stream.stream_id]
                assert (await stream.judged()).proven
                await stream.stop()
                assert (await stream.read()).pieces == 4
            assert await client.streams() == []
            with pytest.raises(UnknownObject, match="nothing is kept"):
                await client.stream_recording(stream.stream_id)
            return pieces

    pieces = asyncio.run(go())
    assert [piece.follows for piece in pieces] == [0, 1, 2, 3]


async def _hears_that_its_service_was_killed(service: Service) -> None:
    asked = {**ASKED, "obstacles": [], "goal": GOAL}
    async with (
        await AsyncClient.connect(service.endpoint, wait=CONNECTED_WITHIN) as client,
        client.stream(asked, clock=Clock()) as stream,
    ):
        await stream.update()
        assert await stream.answer(ANSWERED_WITHIN) is not None
        service.process.kill()
        async with asyncio.timeout(ANSWERED_WITHIN):
            async for _ in stream:  # waits until the stream has ended
                pass
        assert stream.ended is not None
        with pytest.raises(NoService, match="is gone"):
            await stream.update()


def test_a_service_that_is_killed_ends_its_streams_and_one_that_is_started_anew_goes_on(service: Service) -> None:
    """The last of this file: its service is gone then."""
    clock, judge = Clock(), Judge()
    with (
        Client.connect(service.endpoint, wait=CONNECTED_WITHIN) as client,
        client.stream({**ASKED, "goal": GOAL}, clock=clock) as stream,
    ):
        for _ in range(8):
            step(stream, clock, judge)
        service.process.kill()
        await_that(lambda: stream.ended is not None)
        assert stream.ended.reason == "ended"
        assert stream.answer(0.0) == stream.ended
        with pytest.raises(NoService, match="is gone"):
            stream.update(obstacles=seen(clock.now))
        judge.look(stream, clock.now, stream.ended.stops)
        clock.now = stream.ended.stops + PERIOD
        stands = stream.at(clock.now)
        assert stands.velocities == (0.0,) * 6
        with running_service(service.data, "--workers", "1", port_of=service) as again:
            await_that(client.alive)
            stream.reopen(dict(zip(stream.position_names, stands.positions, strict=True)))
            assert stream.ended is None
            arrive(stream, clock, judge, 20.0)
            asyncio.run(_hears_that_its_service_was_killed(again))
