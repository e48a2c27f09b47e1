"""As much of a Zenoh router's remote API as an example needs: queries, liveliness and subscriptions over a WebSocket.

It stands in for the plugin of a router that no package registry has. The other end is Zenoh's own TypeScript client,
whose messages are read and written here as its sources do: little-endian numbers, and bytes and texts after their
length as LEB128.
"""

import contextlib
import json
import struct
import threading
import uuid
from collections.abc import Iterator
from typing import Any

import zenoh
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import Server, ServerConnection, serve

from guidefield.cli.serving import LOOPBACK

SUBSCRIBE, UNSUBSCRIBE, GET, TOKENS, PING = 2, 3, 18, 20, 25  # messages of the client
PINGED, OK, SAMPLE, REPLY, LAST = 0, 1, 5, 7, 8  # messages to it
ASKED = 0x80  # set in the first byte of a message that wants a response, and of the response
ENCODINGS = {0: "zenoh/bytes", 1: "zenoh/string", 3: "application/octet-stream", 5: "application/json"}
ORDINARY = 0b0_0001_101  # priority and the rest of a sample, as they are unless somebody says otherwise


class Reading:
    """Bytes, read one value after the other."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def number(self, layout: str) -> int:
        (value,) = struct.unpack_from(f"<{layout}", self._data, self._at)
        self._at += struct.calcsize(layout)
        return int(value)

    def chunk(self) -> bytes:
        size = shift = 0
        while True:
            byte = self.number("B")
            size |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                break
        self._at += size
        return self._data[self._at - size : self._at]

    def text(self) -> str:
        return self.chunk().decode()

    def chunk_if_any(self) -> bytes | None:
        return self.chunk() if self.number("B") else None

    def encoding_if_any(self) -> str | None:
        if not self.number("B"):
            return None
        name = ENCODINGS[self.number("H")]
        self.chunk()  # the schema
        return name


def chunk(data: bytes) -> bytes:
    size, length = len(data), b""
    while size > 0x7F:
        length += bytes([size & 0x7F | 0x80])
        size >>= 7
    return length + bytes([size]) + data


def encoding(name: str) -> bytes:
    known = {words: number for number, words in ENCODINGS.items()}
    return struct.pack("<H", known[name]) + chunk(b"")


def sample(found: zenoh.Sample) -> bytes:
    kind = 0 if found.kind == zenoh.SampleKind.PUT else 1
    payload = chunk(str(found.key_expr).encode()) + chunk(found.payload.to_bytes()) + bytes([kind])
    return payload + encoding(str(found.encoding)) + b"\0\0" + bytes([ORDINARY])


class Link:
    """One client's WebSocket and what it has declared."""

    def __init__(self, socket: ServerConnection, session: zenoh.Session) -> None:
        self._socket = socket
        self._session = session
        self._sending = threading.Lock()
        self._subscribers: dict[int, Any] = {}

    def run(self) -> None:
        """Answer until the client is gone."""
        with contextlib.suppress(ConnectionClosed):
            for message in self._socket:
                assert isinstance(message, bytes)
                self._heard(Reading(message))
        for subscriber in self._subscribers.values():
            subscriber.undeclare()

    def _send(self, kind: int, body: bytes) -> None:
        with self._sending, contextlib.suppress(ConnectionClosed):
            self._socket.send(bytes([kind]) + body)

    def _heard(self, read: Reading) -> None:
        kind = read.number("B")
        sequence = read.number("I") if kind & ASKED else None
        what = kind & ~ASKED
        if what == PING:
            self._respond(sequence, PINGED, chunk(str(uuid.uuid4()).encode()))
        elif what == SUBSCRIBE:
            self._subscribe(read.number("I"), read.text())
            self._respond(sequence, OK, b"\0")
        elif what == UNSUBSCRIBE:
            self._subscribers.pop(read.number("I")).undeclare()
            self._respond(sequence, OK, b"\0")
        else:
            assert what in (GET, TOKENS), f"the example needs more of the remote API: message {what}"
            threading.Thread(target=self._ask, args=(what == TOKENS, read), daemon=True).start()

    def _subscribe(self, name: int, key: str) -> None:
        def heard(found: zenoh.Sample) -> None:
            self._send(SAMPLE, struct.pack("<I", name) + sample(found))

        self._subscribers[name] = self._session.declare_subscriber(key, heard)

    def _respond(self, sequence: int | None, kind: int, body: bytes) -> None:
        assert sequence is not None, "the client wants a response"
        self._send(kind | ASKED, struct.pack("<I", sequence) + body)

    def _ask(self, tokens: bool, read: Reading) -> None:
        name, key = struct.pack("<I", read.number("I")), read.text()
        if tokens:
            answers = self._session.liveliness().get(key, timeout=read.number("I") / 1000.0)
        else:
            parameters, payload, kind, attachment = (
                read.text(),
                read.chunk_if_any(),
                read.encoding_if_any(),
                read.chunk_if_any(),
            )
            read.number("H")  # quality of service, target and consolidation: as they are
            answers = self._session.get(
                f"{key}?{parameters}" if parameters else key,
                payload=payload,
                encoding=kind,
                attachment=attachment,
                timeout=read.number("I") / 1000.0,
            )
        for answer in answers:
            if answer.ok is not None:
                self._send(REPLY, name + b"\1" + sample(answer.ok))
            else:
                error = chunk(answer.err.payload.to_bytes()) + encoding(str(answer.err.encoding))
                self._send(REPLY, name + b"\0" + error)
        self._send(LAST, name)


@contextlib.contextmanager
def remote_api(endpoint: str) -> Iterator[str]:
    """A remote API whose other side is a service; yields where it listens, as the TypeScript client has it."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with (
        zenoh.open(config) as session,
        serve(lambda socket: Link(socket, session).run(), LOOPBACK, 0, max_size=None) as server,
    ):
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"ws/{LOOPBACK}:{_port(server)}"


def _port(server: Server) -> int:
    return int(server.socket.getsockname()[1])
