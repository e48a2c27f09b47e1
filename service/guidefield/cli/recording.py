"""Fetch a run's recording and proof from a service to files."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import msgspec

from guidefield.client import Client
from guidefield.messages.replies import CertifyReply, PlanReply
from guidefield.run import remove_earlier_proof

_R = TypeVar("_R", bound=PlanReply | CertifyReply)


def fetch_files(client: Client, reply: _R, recording: Path | None, proof: Path | None = None) -> _R:
    """Write the recording and proof of a reply to files, if it has them, and return the reply with their paths.

    Without a proof an earlier one in its file is removed.
    """
    if recording is not None and reply.recording is not None:
        recording.write_bytes(client.recording(reply.run_id))
        reply = msgspec.structs.replace(reply, recording=str(recording))
    if proof is not None and reply.proof is not None:
        proof.write_bytes(client.proof(reply.run_id))
        reply = msgspec.structs.replace(reply, proof=str(proof))
    elif proof is not None:
        reply = msgspec.structs.replace(reply, warnings=[*reply.warnings, *remove_earlier_proof(proof)])
    return reply
