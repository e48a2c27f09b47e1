"""Whether there is time to read a large payload: nobody can interrupt who reads one, for some tenths of a second."""

from __future__ import annotations

import time

import msgspec

from guidefield.messages.codec import MAX_REQUEST_BYTES
from guidefield.messages.keys import CertifyHead, PlanHead, RunHead
from guidefield.messages.requests import CertifyRequest

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

SAYS = b'"allowed_planning_time"', b'"allowed_time"'
"""Who doesn't say how long a request may take allows longer than reading any takes."""

CERTIFY = CertifyRequest.__struct_config__.tag
"""The type of a request to judge a motion; that for a plan has none."""


class _Heads(PlanHead, frozen=True):
    """What a request says of its run, a plan or a judgement."""

    type: str | None = None
    allowed_time: float = CertifyHead().allowed_time


_HEADS = msgspec.json.Decoder(_Heads)


def is_of_many(payload: object) -> bool:
    """Whether a request in any form has a thousand objects or more, which are obstacles then.

    Long lists of numbers don't count: numbers are no garbage, and Python sees that at once.
    """
    if isinstance(payload, bytes):
        return len(payload) >= FEWEST_BYTES and payload.count(b"{") >= MANY
    scene = payload.get("scene") if isinstance(payload, dict) else getattr(payload, "scene", None)
    obstacles = scene.get("obstacles") if isinstance(scene, dict) else getattr(scene, "obstacles", None)
    return isinstance(obstacles, list | tuple) and len(obstacles) >= MANY


def too_long_to_read(payload: object, began: float) -> RunHead | None:
    """The head of a JSON request for a motion that can't be read within the time that it allows; else None.

    Args:
        payload: The request in any form.
        began: When its time began, on the clock of `time.monotonic` [s].
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
        head: RunHead = PlanHead(found.run_id, found.allowed_planning_time, found.planner, found.objective, found.seed)
    elif found.type == CERTIFY:
        head = CertifyHead(found.run_id, found.allowed_time)
    else:
        return None
    equal = PER_LIST * payload.count(b"[") + PER_OBJECT * payload.count(b"{")
    return head if now + (now - looked) * (LOOKS + equal / len(payload)) > began + head.allowed else None
