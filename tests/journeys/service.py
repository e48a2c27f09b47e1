"""A service as its users meet it: a process started from the command line, and a client that knows only the wire."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zenoh

from guidefield.cli.serving import FORCED_EXIT_CODE, LOOPBACK, free_port

CONNECTED_WITHIN = 60.0  # how long a client tries to reach a service that is there [s]
ENDED_WITHIN = 60.0  # longer than any end takes, one by force too [s]
ANSWERED_WITHIN = 300.0  # longer than any answer takes on a busy machine that is waited for [s]
LOWEST_PRIORITY = 19
SO_WITHIN = 120.0  # longer than anything but an answer takes there [s]

BENT = {"panda_joint2": 0.6, "panda_joint4": -1.2, "panda_joint6": 1.8}
LONG: dict[str, Any] = {
    "robot": "panda",
    "scene": {
        "name": "walled",
        "obstacles": [
            {"type": "box", "name": "front", "size": [1.4, 0.02, 1.0], "position": [0.845, 0.0, 0.7]},
            {"type": "box", "name": "back", "size": [1.4, 0.02, 1.0], "position": [-0.845, 0.0, 0.7]},
            {"type": "box", "name": "lid", "size": [3.0, 0.02, 1.0], "position": [0.0, 0.0, 1.18]},
        ],
    },
    "start": {**BENT, "panda_joint1": 1.5708},
    "goal": {"type": "joints", "positions": {**BENT, "panda_joint1": -1.5708}},
    "guide_planes": [],
    "planner": "tree",
    "allowed_planning_time": 600.0,
    "recording": "off",
}
"""From one side of a wall to the other: a search that goes on, for most of a minute, until somebody ends it."""


@dataclass(frozen=True)
class Service:
    """A running service, and what it told while it started."""

    process: subprocess.Popen[str]
    endpoint: str
    data: Path
    told: tuple[str, ...] = ()

    def workers(self) -> list[int]:
        """Process ids of its workers."""
        return [pid for pid in self._spawned() if os.getpriority(os.PRIO_PROCESS, pid) < LOWEST_PRIORITY]

    def renderers(self) -> list[int]:
        """Process ids of what renders recordings, once it is at its low priority."""
        return [pid for pid in self._spawned() if os.getpriority(os.PRIO_PROCESS, pid) == LOWEST_PRIORITY]

    def _spawned(self) -> list[int]:
        return [pid for pid in _children(self.process.pid) if b"spawn_main" in _command_line(pid)]


@contextlib.contextmanager
def running_service(
    data: Path, *options: str, at: str = f"tcp/{LOOPBACK}", port_of: Service | None = None
) -> Iterator[Service]:
    """A service on a free loopback port, or on that of one that was killed.

    It ends with the block by itself when it is told to, if it hasn't ended.
    """
    command = [sys.executable, "-m", "guidefield", "serve", "--data", str(data), *options]
    with (
        free_port() if port_of is None else contextlib.nullcontext(int(port_of.endpoint.rpartition(":")[2])) as port,
        subprocess.Popen([*command, "--listen", f"{at}:{port}"], stdout=subprocess.PIPE, text=True) as process,
    ):
        try:
            told: list[str] = []
            while not (told and told[-1].startswith("ready")):
                told.append(process.stdout.readline())
                assert told[-1], "the service ended before it was ready"
            yield Service(process, f"{at}:{port}", data, tuple(told))
        finally:
            _end(process)


def _end(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGTERM)
    try:
        code = process.wait(ENDED_WITHIN)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    assert code not in (FORCED_EXIT_CODE, -signal.SIGALRM), "it had to be ended by force; its log says where it stood"


@dataclass(frozen=True)
class Answer:
    """One answer, as Zenoh brought it."""

    is_reply: bool
    key: str
    encoding: str
    payload: bytes

    def json(self) -> Any:
        return json.loads(self.payload)


class PlainClient:
    """Asks with Zenoh and JSON alone; sees every answer that comes."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session

    def answers(
        self, key: str, payload: bytes | None = None, encoding: str = "application/json", client: str | None = None
    ) -> list[Answer]:
        found = []
        for reply in self._session.get(
            key,
            payload=payload,
            encoding=encoding,
            attachment=client,
            timeout=ANSWERED_WITHIN,
            consolidation=zenoh.ConsolidationMode.NONE,
        ):
            found.append(_answer(reply))
        return found

    def answer(
        self, key: str, payload: bytes | None = None, encoding: str = "application/json", client: str | None = None
    ) -> Answer:
        (only,) = self.answers(key, payload, encoding, client)
        return only

    def flood(self, key: str, count: int) -> list[Answer]:
        """Ask something so often at once; the answers, as they come."""
        found: list[Answer] = []
        for _ in range(count):
            heard = zenoh.handlers.Callback(lambda reply: found.append(_answer(reply)), indirect=False)
            self._session.get(key, heard, timeout=ANSWERED_WITHIN, consolidation=zenoh.ConsolidationMode.NONE)
        return found

    def put(self, key: str, payload: bytes, encoding: str = "application/json") -> None:
        """Put something on a key; nobody answers."""
        self._session.put(key, payload, encoding=encoding, congestion_control=zenoh.CongestionControl.BLOCK)

    def ask(self, key: str, request: Any = None) -> Any:
        """The reply to a request that is answered well."""
        answer = self.answer(key, None if request is None else json.dumps(request).encode())
        assert answer.is_reply, answer.payload
        assert answer.encoding == "application/json"
        return answer.json()

    def refusal(self, key: str, payload: bytes | None = None, encoding: str = "application/json") -> dict[str, Any]:
        """The error to a request that is answered with one."""
        answer = self.answer(key, payload, encoding)
        assert not answer.is_reply, answer.payload
        error: dict[str, Any] = answer.json()
        assert set(error) >= {"code", "name", "message", "details"}
        return error


def _answer(reply: zenoh.Reply) -> Answer:
    sample = reply.ok if reply.ok is not None else reply.err
    return Answer(
        is_reply=reply.ok is not None,
        key="" if reply.ok is None else str(reply.ok.key_expr),
        encoding=str(sample.encoding),
        payload=sample.payload.to_bytes(),
    )


@contextlib.contextmanager
def plain_client(endpoint: str) -> Iterator[PlainClient]:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        yield PlainClient(session)


def await_that(what: Callable[[], object]) -> None:
    """Wait until something is so."""
    deadline = time.monotonic() + SO_WITHIN
    while not what():
        assert time.monotonic() < deadline, f"it is not so after {SO_WITHIN:g} s"
        time.sleep(0.02)


def await_death(pid: int) -> None:
    """Wait until a process is gone."""
    await_that(lambda: not Path(f"/proc/{pid}").exists() or _state(pid) == "Z")


def _state(pid: int) -> str:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    return "Z"


def _children(pid: int) -> list[int]:
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):  # a thread may end meanwhile
            found += map(int, (task / "children").read_text().split())
    return found


def _command_line(pid: int) -> bytes:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    return b""
