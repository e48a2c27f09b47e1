import contextlib
import errno
import json
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import zenoh

from guidefield import Client, NoService
from guidefield.cli.serving import free_port
from guidefield.endpoint import service
from guidefield.endpoint.service import ServiceSettings, claim_name, serve, session_config
from guidefield.errors import MalformedRequest
from guidefield.first_start import CannotStart
from tests.journeys.service import ANSWERED_WITHIN, ENDED_WITHIN, await_that, plain_client


def test_it_listens_on_loopback_and_scouts_nobody_unless_told(tmp_path: Path) -> None:
    config = session_config(ServiceSettings(tmp_path))
    assert json.loads(config.get_json("listen/endpoints")) == ["tcp/127.0.0.1:7447"]
    assert config.get_json("scouting/multicast/enabled") == config.get_json("scouting/gossip/enabled") == "false"


def test_a_configuration_file_has_its_way(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text('{ listen: { endpoints: ["tcp/10.0.0.1:1"] }, scouting: { multicast: { enabled: true } } }')
    config = session_config(ServiceSettings(tmp_path, config=file))
    assert json.loads(config.get_json("listen/endpoints")) == ["tcp/10.0.0.1:1"]
    assert config.get_json("scouting/multicast/enabled") == "true"
    assert config.get_json("scouting/gossip/enabled") == "false"
    named = session_config(ServiceSettings(tmp_path, config=file, listen=("tcp/127.0.0.1:2",)))
    assert json.loads(named.get_json("listen/endpoints")) == ["tcp/127.0.0.1:2"]


def test_a_mistake_in_a_configuration_file_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{ lisen: {} }")
    with pytest.raises(CannotStart, match="lisen"):
        session_config(ServiceSettings(tmp_path, config=file))


def test_a_name_that_is_no_chunk_of_a_key_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MalformedRequest, match="instance"):
        serve(ServiceSettings(tmp_path, instance="a/b"), threading.Event())


def test_of_services_that_claim_a_name_at_the_same_time_one_gets_it() -> None:
    at_once = threading.Barrier(4)

    def claim(session: zenoh.Session, name: str) -> zenoh.LivelinessToken | None:
        at_once.wait()
        try:
            return claim_name(session, name)
        except CannotStart:
            return None

    with contextlib.ExitStack() as opened, free_port() as port, ThreadPoolExecutor(4) as threads:
        sessions = []
        for way, mode in (("listen", "peer"), *(3 * [("connect", "client")])):
            config = zenoh.Config()
            config.insert_json5("mode", json.dumps(mode))
            for key in ("listen", "connect"):
                there = [f"tcp/127.0.0.1:{port}"] if key == way else []
                config.insert_json5(f"{key}/endpoints", json.dumps(there))
            config.insert_json5("scouting/multicast/enabled", "false")
            sessions.append(opened.enter_context(zenoh.open(config)))
        for name in map(str, range(8)):
            tokens = list(threads.map(claim, sessions, 4 * [name]))
            (got,) = [one for one in tokens if one is not None]
            for session in sessions:
                with pytest.raises(CannotStart, match=f"named '{name}' is alive"):
                    claim_name(session, name)
            got.undeclare()
            await_that(lambda name=name: not _is_claimed(sessions[1], name))
            claim_name(sessions[1], name)


def _is_claimed(session: zenoh.Session, name: str) -> bool:
    return any(reply.ok is not None for reply in session.liveliness().get(f"guidefield/{name}/**"))


def test_what_it_does_while_it_starts_is_told_and_lists_are_read(tmp_path, monkeypatch):
    stop, seen = threading.Event(), threading.Event()

    def compiled(told: Callable[[str], None], _stopped: Callable[[], bool]) -> None:
        told("compiling kernels: 26 of 66")
        seen.wait(ANSWERED_WITHIN)
        stop.set()

    monkeypatch.setattr("guidefield.endpoint.service.compile_kernels", compiled)
    with free_port() as port, ThreadPoolExecutor(1) as thread:
        endpoint = f"tcp/127.0.0.1:{port}"
        served = thread.submit(serve, ServiceSettings(tmp_path, listen=(endpoint,)), stop)
        try:
            await_that(lambda: "compiling" in _health(endpoint).get("doing", ""))
            with plain_client(endpoint) as wire:
                assert _health(endpoint) == {"state": "starting", "doing": "compiling kernels: 26 of 66"}
                assert "table" in wire.ask("guidefield/local/scenes")["scenes"]
                refused = wire.refusal("guidefield/local/kinematics", b"{}")
                assert refused["name"] == "SERVER_BUSY"
                assert "compiling kernels: 26 of 66" in refused["message"]
                assert refused["details"]["retry_after"] > 0.0
            with pytest.raises(NoService, match="'local' is starting: compiling kernels: 26 of 66"):
                Client.connect(endpoint, wait=0.5)
        finally:
            seen.set()
        served.result(ENDED_WITHIN)


def _health(endpoint: str) -> dict[str, Any]:
    """How a service is that may not listen yet."""
    try:
        with plain_client(endpoint) as wire:
            answers = wire.answers("guidefield/local/info?brief")
    except zenoh.ZError:
        return {}
    return answers[0].json()["health"] if answers else {}


def test_a_data_folder_without_locks_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_locks(*_arguments: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(service.fcntl, "flock", no_locks)
    told: list[str] = []
    with service._alone_in(tmp_path, told.append):
        assert told == [
            f"the data folder can't be locked (No locks available): start no second service on {str(tmp_path)!r}"
        ]


def test_a_data_folder_has_one_service(tmp_path: Path) -> None:
    import fcntl

    with (tmp_path / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(CannotStart, match="alive on the data folder"):
            serve(ServiceSettings(tmp_path), threading.Event())
