"""Requests from payloads: a large scene that one holds and that was read before is not read again."""

from __future__ import annotations

from typing import Any

import msgspec

from guidefield.messages import codec, requests
from guidefield.messages.checked_scenes import CheckedScenes
from guidefield.messages.codec import Encoding
from guidefield.messages.seen_payload import Payload

FEWEST_BYTES = 2**18
"""A shorter payload is read within some milliseconds."""

_KNOWN = CheckedScenes(2)


def read(data: bytes, kind: Any, encoding: Encoding) -> Any:
    """As `codec.decode`, of a request; a large scene in it is kept, and one that is kept isn't read again.

    Args:
        data: The payload.
        kind: A request's class, or a union of tagged ones.
        encoding: How the payload is written.

    Raises:
        RequestTooLarge, MalformedRequest: as `codec.decode`.
    """
    known = _read_again(data, kind, encoding)
    return _read_new(data, kind, encoding) if known is None else known


def read_again(request: bytes) -> requests.Request | None:
    """A request in JSON of a large scene that is kept; None of another.

    Raises:
        RequestTooLarge, MalformedRequest: as `codec.decode`.
    """
    known: requests.Request | None = _read_again(request, None, Encoding.JSON)
    return known


def read_new(request: bytes) -> requests.Request:
    """A request in JSON, whose scene is kept if it is large.

    Raises:
        RequestTooLarge, MalformedRequest: as `codec.decode_request`.
    """
    made: requests.Request = _read_new(request, codec.kind_of(request), Encoding.JSON)
    return made


def _read_again(data: bytes, kind: Any, encoding: Encoding) -> Any:
    if len(data) < FEWEST_BYTES or not _KNOWN:
        return None
    payload = Payload(data, encoding)
    scene = _KNOWN.of(payload)
    if scene is None:
        return None
    if kind is None:
        kind = requests.TaggedRequest if payload.has_type else requests.PlanRequest
    made = codec.decode(codec.encode(payload.fields | {"scene": {"name": scene.name}}, encoding), kind, encoding)
    msgspec.structs.force_setattr(made, "scene", scene)
    return made


def _read_new(data: bytes, kind: Any, encoding: Encoding) -> Any:
    made = codec.decode(data, kind, encoding)
    if type(data) is bytes and len(data) >= FEWEST_BYTES:
        _KNOWN.keep(Payload(data, encoding), getattr(made, "scene", None))
    return made
