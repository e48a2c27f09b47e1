"""Requests of ours to the engine: one identity in the same fair queue as everybody else's."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

import msgspec

from guidefield.endpoint.ros.options import IDENTITY
from guidefield.endpoint.ros.refusals import Refused, moveit_code
from guidefield.messages import codec, keys
from guidefield.messages.codec import Encoding
from guidefield.messages.replies import ErrorReply
from guidefield.messages.values import Reply
from guidefield.pool.waiting import Answer

Ask = Callable[[keys.Query, float], Future[Answer]]
"""Has a query answered that arrived at a time, by `time.monotonic()` [s]."""

_R = TypeVar("_R", bound=Reply)


class EngineDoor:
    """Asks the engine, and waits.

    Args:
        ask: Has a query answered.
    """

    def __init__(self, ask: Ask) -> None:
        self._ask = ask

    def __call__(self, key: str, request: msgspec.Struct, kind: type[_R], received: float) -> _R:
        """The reply to a request.

        Args:
            key: Below an instance's, where such a request is asked.
            request: What is asked.
            kind: Of the reply.
            received: When it came, by `time.monotonic()` [s].

        Raises:
            GuidefieldError: if it can't wait its turn.
            Refused: if it is answered by an error.
        """
        payload = codec.encode(request, Encoding.MSGPACK)
        query = keys.Query((key,), {}, payload, Encoding.MSGPACK, user=IDENTITY)
        is_reply, answer = self._ask(query, received).result()
        if not is_reply:
            error = msgspec.msgpack.decode(answer, type=ErrorReply)
            raise Refused(moveit_code(error.code), f"{error.name}: {error.message}")
        return msgspec.msgpack.decode(answer, type=kind)
