"""A run's recording and proof, fetched from a service to files."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import msgspec

from guidefield.client import Client
from guidefield.messages.replies import CertifyReply, PlanReply

_R = TypeVar("_R", bound=PlanReply | CertifyReply)


def fetch_files(client: Client, reply: _R, recording: Path | None, proof: Path | None = None) -> _R:
    """The reply, with its recording and proof in files here, where it has them and a file is named for them."""
    if recording is not None and reply.recording is not None:
        recording.write_bytes(client.recording(reply.run_id))
        reply = msgspec.structs.replace(reply, recording=str(recording))
    if proof is not None and reply.proof is not None:
        proof.write_bytes(client.proof(reply.run_id))
        reply = msgspec.structs.replace(reply, proof=str(proof))
    return reply
