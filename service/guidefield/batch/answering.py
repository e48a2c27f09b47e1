"""One request of a batch, answered by the engine of the process that it came to."""

from __future__ import annotations

from pathlib import Path

from guidefield.engine import Engine
from guidefield.errors import GuidefieldError
from guidefield.messages import codec
from guidefield.messages.replies import error_reply
from guidefield.messages.requests import CertifyRequest, MotionRequest, PlanRequest
from guidefield.pool.waiting import BACKSTOP, LONGEST_WORK


class CannotWork(RuntimeError):
    """There is nobody to work on a batch; says why in one sentence."""


def answered(engine: Engine, request: bytes, record_to: Path | None, *, deferred: bool = False) -> tuple[bool, bytes]:
    """Whether there is a reply, or else an error; and its JSON.

    Args:
        engine: Answers it.
        request: JSON of a request of any kind.
        record_to: Where the recording of a plan goes, if anywhere.
        deferred: True if only the log of the recording is written, beside it.
    """
    try:
        decoded = codec.decode_request(request)
        if record_to is not None and isinstance(decoded, MotionRequest):
            record_to.parent.mkdir(parents=True, exist_ok=True)
            return True, codec.encode(engine.answer(decoded, record_to=record_to, deferred=deferred))
        return True, codec.encode(engine.answer(decoded))
    except GuidefieldError as error:
        return False, codec.encode(error_reply(error))


def seconds_for(request: bytes) -> float:
    """How long a worker may take for a request [s]."""
    try:
        decoded = codec.decode_request(request)
    except GuidefieldError:
        return LONGEST_WORK
    if isinstance(decoded, PlanRequest):
        return decoded.allowed_planning_time + BACKSTOP
    return decoded.allowed_time + BACKSTOP if isinstance(decoded, CertifyRequest) else LONGEST_WORK
