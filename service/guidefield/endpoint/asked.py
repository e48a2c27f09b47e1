"""A query that waits for its one answer."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from functools import partial

import msgspec
import zenoh

from guidefield.errors import MalformedRequest, ServerBusy, convert_exception
from guidefield.messages import codec, keys
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN, Asker, split_owner, split_user
from guidefield.messages.replies import make_error_reply
from guidefield.pool.waiting import Answer

JSON_NAMES = ("", "zenoh/bytes", "zenoh/string", "application/json", "text/json")
"""Zenoh encodings that mean JSON: its own default ones too."""
FILE = "application/octet-stream"
"""The Zenoh encoding of a recording or proof."""
RETRY_AFTER = 1.0
"""Time after which a client may ask again whose answers wait to be read [s]."""
LONGEST_CLIENT = 64
"""Part of a client's name that counts [bytes]."""

_log = logging.getLogger(__name__)


Post = Callable[[Asker, int, Callable[[], None]], bool]
"""Has an answer sent to who asked, of a size [bytes]; whether it will be."""


def _unread() -> ServerBusy:
    return ServerBusy("too much waits to be read by this client already; read that first", retry_after=RETRY_AFTER)


def encoding_of(told: object) -> Encoding:
    """Return the encoding of a payload, by Zenoh's name of it; None: Zenoh's default.

    Raises MalformedRequest if that isn't understood.
    """
    name = str(told or "").partition(";")[0]
    if name == Encoding.MSGPACK:
        return Encoding.MSGPACK
    if name in JSON_NAMES:
        return Encoding.JSON
    raise MalformedRequest(
        f"encoding {name!r} is not understood; use {' or '.join(Encoding)}", encoding=name, available=list(Encoding)
    )


class Asked:
    """A query that waits for its one answer."""

    def __init__(self, query: zenoh.Query, instance: str, count: Callable[[str], None], post: Post) -> None:
        self._query = query
        self._prefix = f"guidefield/{instance}"
        self._key = str(query.key_expr)
        self._asker = Asker(PLAIN, self._client())
        self._encoding = Encoding.JSON
        self._is_file = False
        self._count = count
        self._post = post
        self._open = threading.Lock()

    def read(self, let_in: Callable[[keys.Query, int], None]) -> keys.Query:
        """Read the query.

        Args:
            let_in: Is told all but the payload, and how long that is [bytes], and raises what the query is refused
                with. The payload is copied after that: while a long one is, nobody else is answered.

        Raises:
            MalformedRequest: if its encoding is unknown, or its key has wildcards or names nobody who can be a user.
            RequestTooLarge: if its payload is too long to be looked at.
        """
        self._encoding = encoding_of(self._query.encoding)
        chunks = self._key.split("/")
        if "**" in chunks or any("*" in chunk for chunk in chunks[2:]):
            raise MalformedRequest(f"ask one key at a time: {self._key!r} has wildcards", key=self._key)
        user, below = split_user(chunks[2:])
        owner, key = split_owner(user, below)
        self._asker = Asker(user, self._asker.client)
        told = keys.Query(
            key=key,
            parameters=dict(self._query.parameters),
            payload=b"",
            encoding=self._encoding,
            user=user,
            owner=owner,
            client=self._asker.client,
            names_owner=key != below,
        )
        self._is_file = keys.is_file(told)
        payload = self._query.payload
        size = 0 if payload is None else len(payload)
        let_in(told, size)
        codec.require_size(size)
        return told if payload is None else msgspec.structs.replace(told, payload=payload.to_bytes())

    def _client(self) -> str:
        """Return the name that the client gave itself: the query's attachment."""
        attachment = self._query.attachment
        return "" if attachment is None else attachment.to_bytes()[:LONGEST_CLIENT].decode(errors="replace")

    def settle(self, future: Future[Answer]) -> None:
        """Answer with what a future holds."""
        with self.answering_failures():
            self.answer(future.result())

    def answer(self, answer: Answer) -> None:
        """Have the answer sent, unless one was sent; an error in its place where too much waits for this client."""
        if not self._open.acquire(blocking=False):
            return
        told = "answered" if answer[0] else "refused"
        if not self._post(self._asker, len(answer[1]), partial(self._send, answer)):
            told = "refused"
            unread = False, codec.encode(make_error_reply(_unread()), self._encoding)
            if not self._post(self._asker, 0, partial(self._send, unread)):
                told = "dropped"
                self._query.drop()
        self._count(told)

    def _send(self, answer: Answer) -> None:
        is_reply, payload = answer
        with self._query as query:
            if is_reply:
                key = "/".join([self._prefix, *self._key.split("/")[2:]])
                query.reply(key, payload, encoding=FILE if self._is_file else self._encoding.value)
            else:
                query.reply_err(payload, encoding=self._encoding.value)

    @contextlib.contextmanager
    def answering_failures(self) -> Iterator[None]:
        """Answer with whatever error escapes the block."""
        try:
            yield
        except Exception as error:
            told = convert_exception(error)
            if told is not error:
                _log.exception("a query failed by itself")
            try:
                self.answer((False, codec.encode(make_error_reply(told), self._encoding)))
            except Exception:  # Zenoh refuses to send: there is nobody to tell
                _log.exception("an error could not be sent")
