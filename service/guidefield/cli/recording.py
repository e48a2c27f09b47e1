"""A run's recording, fetched from a service to a file."""

from __future__ import annotations

from pathlib import Path

import msgspec

from guidefield.client import Client
from guidefield.messages.replies import PlanReply


def fetch_recording(client: Client, reply: PlanReply, file: Path) -> PlanReply:
    """The reply, with its recording in a file here; as it was, where the run has none."""
    if reply.recording is None:
        return reply
    file.write_bytes(client.recording(reply.run_id))
    return msgspec.structs.replace(reply, recording=str(file))
