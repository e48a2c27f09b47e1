"""A Zenoh query that waits for its one answer: its key, user, encoding and payload read, its answer sent once."""

from __future__ import annotations

import functools
import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial

import msgspec
import zenoh

from guidefield.errors import GuidefieldError, MalformedRequest, ServerBusy, convert_exception
from guidefield.messages import codec, keys
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import PLAIN, Asker, split_owner, split_user
from guidefield.messages.replies import make_error_reply
from guidefield.pool.waiting import Answer

JSON_NAMES = ("", "zenoh/bytes", "zenoh/string", "application/json", "text/json")
"""Zenoh encodings that mean JSON: its own default ones too."""
FILE = "application/octet-stream"  # the Zenoh encoding of a recording or proof
RETRY_AFTER = 1.0  # time after which a client with too many unread answers may ask again [s]
LONGEST_CLIENT = 64  # length of a client's name; the rest is ignored [bytes]
REMEMBERED_KEYS = 1_000  # size of the caches of parsed keys

_log = logging.getLogger(__name__)

Post = Callable[[Asker, int, Callable[[], None]], bool]
"""Has an answer of a size [bytes] sent to a client; returns whether it will be: `Outbox.post`."""


def encoding_of(declared: object) -> Encoding:
    """Return the encoding of a payload by Zenoh's name of it, None: the default; raises MalformedRequest if unknown."""
    name = str(declared or "").partition(";")[0]
    if name in JSON_NAMES:
        return Encoding.JSON
    if name == Encoding.MSGPACK:
        return Encoding.MSGPACK
    raise MalformedRequest(
        f"encoding {name!r} is not understood; use {' or '.join(Encoding)}", encoding=name, available=list(Encoding)
    )


@functools.lru_cache(REMEMBERED_KEYS)
def _split(key: str) -> tuple[str, tuple[str, ...]]:
    chunks = key.split("/")
    if "**" in chunks or any("*" in chunk for chunk in chunks[2:]):
        raise MalformedRequest(f"ask one key at a time: {key!r} has wildcards", key=key)
    return split_user(chunks[2:])


class PendingQuery:
    """A query that waits for its one answer; `count` takes the outcome: answered, refused or dropped."""

    def __init__(self, query: zenoh.Query, key: str, instance: str, count: Callable[[str], None], post: Post) -> None:
        self._query, self._key, self._instance, self._count, self._post = query, key, instance, count, post
        attachment = query.attachment
        client = "" if attachment is None else attachment.to_bytes()[:LONGEST_CLIENT].decode(errors="replace")
        self._asker = Asker(PLAIN, client)
        self._encoding = Encoding.JSON
        self._is_file = False
        self._open = threading.Lock()

    def read(self, let_in: Callable[[keys.Query, int], None]) -> keys.Query:
        """Read the query.

        Args:
            let_in: Takes the query without its payload, and the payload's size [bytes]; raises the error with which it
                is refused. The payload is copied only after that, because nothing else is answered meanwhile.

        Raises:
            MalformedRequest: if its encoding is unknown, or its key has wildcards or an invalid user.
            RequestTooLarge: if its payload is too large.
        """
        query = self._query
        self._encoding = encoding_of(query.encoding)
        user, below = _split(self._key)
        self._asker = asker = Asker(user, self._asker.client)
        owner, key = split_owner(user, below)
        parameters = dict(query.parameters)
        read = keys.Query(key, parameters, b"", self._encoding, user, owner, asker.client, key != below)
        self._is_file = keys.is_file(read)
        payload = query.payload
        size = 0 if payload is None else len(payload)
        let_in(read, size)
        codec.require_size(size)
        return read if payload is None else msgspec.structs.replace(read, payload=payload.to_bytes())

    def settle(self, future: Future[Answer]) -> None:
        """Answer with the result of a future, or its error."""
        try:
            answer = future.result()
        except Exception as error:
            self.fail(error)
        else:
            self.answer(answer)

    def answer(self, answer: Answer) -> None:
        """Have the answer sent, unless one was sent; an error instead if too many bytes wait for this client."""
        if not self._open.acquire(blocking=False):
            return
        outcome = "answered" if answer[0] else "refused"
        if not self._post(self._asker, len(answer[1]), partial(self._send, answer)):
            outcome, busy = "refused", "too much waits to be read by this client already; read that first"
            unread = self._encode_error(ServerBusy(busy, retry_after=RETRY_AFTER))
            if not self._post(self._asker, 0, partial(self._send, unread)):
                outcome = "dropped"
                self._query.drop()
        self._count(outcome)

    def fail(self, error: Exception) -> None:
        """Answer with an error, which is logged unless it is one of ours."""
        converted = convert_exception(error)
        if converted is not error:
            _log.error("a query failed by itself", exc_info=error)
        try:
            self.answer(self._encode_error(converted))
        except Exception:  # Zenoh refuses to send: there is nobody to tell
            _log.exception("an error could not be sent")

    def _encode_error(self, error: GuidefieldError) -> Answer:
        return False, codec.encode(make_error_reply(error), self._encoding)

    def _send(self, answer: Answer) -> None:
        is_reply, payload = answer
        with self._query as query:
            if is_reply:
                key = f"guidefield/{self._instance}/{self._key.split('/', 2)[2]}"
                query.reply(key, payload, encoding=FILE if self._is_file else self._encoding.value)
            else:
                query.reply_err(payload, encoding=self._encoding.value)
