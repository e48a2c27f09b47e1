"""Requests that are read within the time that they allow.

Nobody can interrupt who reads a large payload of JSON, for some tenths of a second: whether there is time is known
before. What is given otherwise is read some at a time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import msgspec

from guidefield.errors import MalformedRequest
from guidefield.messages import codec, given_requests
from guidefield.messages.codec import MAX_REQUEST_BYTES
from guidefield.messages.keys import CertifyHead, PlanHead, RunHead, WorkHead
from guidefield.messages.requests import CertifyRequest, KinematicsRequest, Request

LARGE = 2**20
"""A payload of fewer bytes is read within some hundredths of a second."""

MANY, FEWEST_BYTES = 1000, 10_000
"""So many obstacles are many, and a payload has more bytes than that then."""

LOOKS = 2.0
"""Reading the characters of a payload takes so many times as long as looking through it."""

PER_LIST, PER_OBJECT = 270.0, 2000.0
"""As long as looking through so many bytes takes it to make a list of a few numbers, and an object, and to check it.

Measured with meshes and clouds as lists, and with boxes and spheres: they are read within 0.8 to 1.2 of what is
expected."""

PER_ROW = 600.0
"""The same of a list in a request to judge a motion, whose rows have a number for each joint."""

HASHED = 0.15
"""What is read is hashed before anything is built of it: so much of the time that reading took that takes at least."""

SAYS = b'"allowed_planning_time"', b'"allowed_time"'
"""Who doesn't say how long a request may take allows longer than reading any takes."""

CERTIFY = CertifyRequest.__struct_config__.tag
"""The type of a request to judge a motion; that for a plan has none."""


CERTIFIES = f'"{CERTIFY}"'.encode()


class _Heads(PlanHead, frozen=True):
    """What a request says of its run, a plan or a judgement, or of how long it may take."""

    type: str | None = None
    allowed_time: float = CertifyHead().allowed_time


_WORK = {kind.__struct_config__.tag for kind in KinematicsRequest.__args__}
"""The types of requests that make no run, but say how long they may take."""

_HEADS = msgspec.json.Decoder(_Heads)


Wait = Callable[[Callable[[], bool]], None]
"""Waits for something, or until what it is given says that it is too late."""


class TooLongToRead(Exception):
    """A request can't be read within the time that it allows; `head` is what it says of that."""

    def __init__(self, head: RunHead | WorkHead) -> None:
        super().__init__(f"reading takes longer than {head.allowed:g} s")
        self.head = head


def read_in_time(
    request: bytes | dict[str, Any] | Request,
    began: float,
    of_many: bool | None = None,
    wait: Wait = lambda _: None,
) -> Request:
    """A request in any of its forms; a Struct, which no decoder has seen, is checked.

    Args:
        request: The request.
        began: When its time began, on the clock of `time.monotonic` [s].
        of_many: Whether it `is_of_many`, where that is known.
        wait: As `too_long_to_read` takes it.

    Raises:
        TooLongToRead: if its time was up before it was read, or is certain to be.
        RequestTooLarge, MalformedRequest: as in `codec.decode_request`.
    """
    if (late := too_long_to_read(request, began, wait)) is not None:
        raise TooLongToRead(late)
    of_many = is_of_many(request) if of_many is None else of_many
    large = of_many and isinstance(request, dict | msgspec.Struct)
    head = _head_of(request) if large else None
    since = time.monotonic()

    def look() -> None:
        now = time.monotonic()
        if head is not None and now + (now - since) * HASHED >= began + head.allowed:
            raise TooLongToRead(head)

    return given_requests.checked(request, look, large)


def _head_of(request: Any) -> RunHead | WorkHead | None:
    """The head of a request in Python; None where it says nothing sound of its time, or has none."""
    said = request if isinstance(request, dict) else msgspec.structs.asdict(request)
    tag = said.get("type", request.__struct_config__.tag if isinstance(request, msgspec.Struct) else None)
    kind = PlanHead if tag is None else CertifyHead if tag == CERTIFY else WorkHead if tag in _WORK else None
    if kind is None:
        return None
    try:
        named = {name: said[name] for name in kind.__struct_fields__ if name in said}
        head: RunHead | WorkHead = codec.convert(named, kind)
    except MalformedRequest:
        return None
    return head


def is_of_many(payload: object) -> bool:
    """Whether a request in any form makes a thousand objects or more when it is read, which stay.

    Long lists of numbers in JSON don't count: numbers are no garbage, and Python sees that at once of a tuple. The rows
    of a motion are lists.
    """
    if isinstance(payload, bytes):
        if len(payload) < FEWEST_BYTES:
            return False
        return payload.count(b"{") >= MANY or (CERTIFIES in payload and payload.count(b"[") >= MANY)
    return given_requests.is_large(payload)


def too_long_to_read(payload: object, began: float, wait: Wait = lambda _: None) -> RunHead | WorkHead | None:
    """The head of a JSON request that can't be read within the time that it allows; else None.

    Args:
        payload: The request in any form.
        began: When its time began, on the clock of `time.monotonic` [s].
        wait: Waits until nobody works beside in this process, or it is too late.
    """
    if not isinstance(payload, bytes) or not LARGE <= len(payload) <= MAX_REQUEST_BYTES:
        return None
    if not any(name in payload for name in SAYS):
        return None
    looked = time.monotonic()
    try:
        found = _HEADS.decode(payload)
    except msgspec.DecodeError:
        return None
    now = time.monotonic()
    if found.type is None:
        head: RunHead | WorkHead = PlanHead(
            found.run_id, found.allowed_planning_time, found.planner, found.objective, found.seed
        )
    elif found.type == CERTIFY:
        head = CertifyHead(found.run_id, found.allowed_time)
    elif found.type in _WORK:
        head = WorkHead(allowed_time=found.allowed_time)
    else:
        return None
    took = now - looked
    if now + took * LOOKS > began + head.allowed:
        return head
    per_list = PER_ROW if isinstance(head, CertifyHead) else PER_LIST
    equal = per_list * payload.count(b"[") + PER_OBJECT * payload.count(b"{")
    return None if _is_left(took * (LOOKS + equal / len(payload)), began + head.allowed, wait) else head


def _is_left(seconds: float, until: float, wait: Wait) -> bool:
    """Whether so much time is left once nobody works beside, where it would take twice as long."""

    def is_too_late() -> bool:
        return time.monotonic() + seconds > until

    wait(is_too_late)
    return not is_too_late()
