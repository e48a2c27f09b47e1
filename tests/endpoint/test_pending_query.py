"""A query is answered once and only once, whatever happens to it."""

import json
import threading
from collections.abc import Callable
from typing import Self

import pytest

from guidefield.endpoint.under_way import PendingQuery
from guidefield.errors import MalformedRequest, QuotaExceeded, RequestTooLarge, ServerBusy
from guidefield.messages import codec, keys
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import Asker


class _Payload:
    def __init__(self, data: bytes) -> None:
        self._data = data

    def __len__(self) -> int:
        return len(self._data)

    def to_bytes(self) -> bytes:
        return self._data


class _Query:
    """Stands in for Zenoh's query: keeps what it is answered with."""

    def __init__(
        self, key: str, payload: bytes | None = None, encoding: str | None = None, parameters: str = ""
    ) -> None:
        self.key_expr = key
        self.payload = None if payload is None else _Payload(payload)
        self.encoding = encoding
        self.attachment: _Payload | None = None
        self.parameters = [tuple(pair.split("=")) for pair in parameters.split(";") if pair]
        self.replies: list[tuple[str, bytes, str]] = []
        self.errors: list[tuple[bytes, str]] = []
        self.dropped = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_about: object) -> None:
        self.dropped += 1

    def drop(self) -> None:
        self.dropped += 1

    def reply(self, key: str, payload: bytes, *, encoding: str) -> None:
        self.replies.append((key, payload, encoding))

    def reply_err(self, payload: bytes, *, encoding: str) -> None:
        self.errors.append((payload, encoding))


def _asked(query: _Query, counted: list[str] | None = None) -> PendingQuery:
    return PendingQuery(query, query.key_expr, "local", (counted if counted is not None else []).append, _send_at_once)


def _send_at_once(_asker: Asker, _size: int, send: Callable[[], None]) -> bool:
    send()
    return True


def _let_in(_read: keys.Query, _size: int) -> None:
    pass


def test_a_query_is_read_as_it_came() -> None:
    read = _asked(_Query("guidefield/local/scenes/a", b"{}", "application/msgpack", "delete=")).read(_let_in)
    assert (read.key, read.parameters, read.payload) == (("scenes", "a"), {"delete": ""}, b"{}")
    assert read.encoding is Encoding.MSGPACK


@pytest.mark.parametrize(
    "name", [None, "", "zenoh/bytes", "zenoh/string", "application/json", "application/json;utf-8", "text/json"]
)
def test_json_is_what_is_meant_unless_something_else_is_said(name: str | None) -> None:
    assert _asked(_Query("guidefield/local/info", b"{}", name)).read(_let_in).encoding is Encoding.JSON


@pytest.mark.parametrize(
    ("query", "says"),
    [
        (_Query("guidefield/local/info", encoding="image/png"), "image/png"),
        (_Query("guidefield/local/*"), "wildcards"),
        (_Query("guidefield/**"), "wildcards"),
        (_Query("guidefield/local/scenes/a$*"), "wildcards"),
    ],
)
def test_what_cannot_be_read_is_refused(query: _Query, says: str) -> None:
    with pytest.raises(MalformedRequest, match=says):
        _asked(query).read(_let_in)


def test_only_the_first_answer_is_sent() -> None:
    query, counted = _Query("guidefield/local/info"), []
    asked = _asked(query, counted)
    threads = [threading.Thread(target=asked.answer, args=((True, b"x"),)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    asked.answer((False, b"y"))
    assert len(query.replies) + len(query.errors) == 1
    assert counted == ["answered"]


@pytest.mark.parametrize(
    ("raised", "name", "code"),
    [
        (ServerBusy("full", queue=3), "SERVER_BUSY", -106),
        (ZeroDivisionError("a bug"), "FAILURE", 99999),
        (PermissionError(13, "Permission denied", "/srv/data/runs"), "DISK_REFUSED", -112),
        (FileNotFoundError(2, "No such file or directory", "/srv/data/runs"), "FAILURE", 99999),
        (MemoryError(), "CRASH", -29),
        (MalformedRequest("a detail that is no JSON", value=object()), "MALFORMED_REQUEST", -107),
    ],
)
def test_an_error_is_an_answer(raised: Exception, name: str, code: int) -> None:
    query = _Query("guidefield/local/info")
    _asked(query).fail(raised)
    ((payload, encoding),) = query.errors
    error = json.loads(payload)
    assert (error["name"], error["code"], encoding) == (name, code, "application/json")
    assert "/srv" not in payload.decode()


def test_a_client_with_too_much_unread_is_told_so_and_at_last_nothing() -> None:
    for most, name, dropped in ((0, "SERVER_BUSY", 1), (-1, "", 1)):
        query, counted = _Query("guidefield/local/info"), []

        def post(_asker: Asker, size: int, send: Callable[[], None], most: int = most) -> bool:
            if size <= most:
                send()
            return size <= most

        PendingQuery(query, query.key_expr, "local", counted.append, post).answer((True, b"large"))
        assert query.replies == []
        assert [json.loads(payload)["name"] for payload, _ in query.errors] == ([name] if name else [])
        assert counted == ["refused" if name else "dropped"]
        assert query.dropped == dropped


@pytest.mark.parametrize("refuses", [True, False])
def test_a_payload_that_is_refused_is_not_copied(refuses: bool) -> None:
    """While a long one was copied, nobody else was answered."""

    class Uncopied(_Payload):
        def __len__(self) -> int:
            return codec.MAX_REQUEST_BYTES + 1

        def to_bytes(self) -> bytes:
            raise AssertionError("it is copied")

    def let_in(told: keys.Query, size: int) -> None:
        assert (told.key, told.user, size) == (("plan",), "alice", codec.MAX_REQUEST_BYTES + 1)
        if refuses:
            raise QuotaExceeded("enough")

    query = _Query("guidefield/local/as/alice/plan", b"")
    query.payload = Uncopied(b"")
    with pytest.raises(QuotaExceeded if refuses else RequestTooLarge):
        _asked(query).read(let_in)
