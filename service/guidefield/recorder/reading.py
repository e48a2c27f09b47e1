"""A recording read back: what was asked, what was answered and what it was made with, from the file alone."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rerun.chunk import Chunk, RrdReader

from guidefield.errors import MalformedRequest, UnknownObject
from guidefield.messages.replies import CERTIFY, CertifyReply, MotionReply, PlanReply, RequestTag
from guidefield.messages.requests import CertifyRequest, MotionRequest, PlanRequest
from guidefield.recorder.documents import MADE_WITH, PROPERTIES, REPLY, REQUEST
from guidefield.recorder.packing import MESSAGE_COMPONENT, unpacked
from guidefield.versions import parsed


@dataclass(frozen=True)
class Recorded:
    """What a recording says of its run.

    Attributes:
        request: As it came.
        reply: As it was given, to the last bit.
        versions: Of each package that it was made with, by the package's name; of Python too, and under
            ``processor`` the kind that kernels were compiled for.
    """

    request: MotionRequest
    reply: MotionReply
    versions: dict[str, str]


def read_recording(path: Path) -> Recorded:
    """Read a recording's messages.

    Raises:
        UnknownObject: if there is no such file.
        MalformedRequest: if it is no whole recording of guidefield.
    """
    if not path.is_file():
        raise UnknownObject(f"there is no recording {str(path)!r}", path=str(path))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is wrong with a file is raised below, in one sentence
            chunks = RrdReader(str(path)).stream().filter(content=["/documents/**", "/__properties/**"])
            found = {chunk.entity_path: chunk for chunk in chunks}
        (packages,) = _values(found[PROPERTIES], MADE_WITH)
        request, reply = (bytes(_values(found[path], MESSAGE_COMPONENT)) for path in (REQUEST, REPLY))
        if unpacked(request, RequestTag).type == CERTIFY:
            return Recorded(unpacked(request, CertifyRequest), unpacked(reply, CertifyReply), parsed(packages))
        return Recorded(unpacked(request, PlanRequest), unpacked(reply, PlanReply), parsed(packages))
    except (RuntimeError, ValueError, LookupError) as error:
        why = f"it has no {error}" if isinstance(error, KeyError) else f"{error}"
        what = f"{path.name!r} is no whole recording of guidefield, or one of another version"
        raise MalformedRequest(f"{what}: {why}", path=str(path)) from None


def _values(chunk: Chunk, component: str) -> list[Any]:
    """What a component of a chunk of one row holds."""
    (row,) = chunk.to_record_batch().column(component).to_pylist()
    return list(row)
