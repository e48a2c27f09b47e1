"""A run's recording, fetched from a service to a file."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import msgspec

from guidefield.client import Client
from guidefield.messages.replies import CertifyReply, PlanReply

_R = TypeVar("_R", bound=PlanReply | CertifyReply)


def fetch_recording(client: Client, reply: _R, file: Path) -> _R:
    """The reply, with its recording in a file here; as it was, where the run has none."""
    if reply.recording is None:
        return reply
    file.write_bytes(client.recording(reply.run_id))
    return msgspec.structs.replace(reply, recording=str(file))
