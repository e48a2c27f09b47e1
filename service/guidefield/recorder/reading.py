"""Read back a recording: its request, its reply and the versions that it was made with, from the file alone."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
from rerun.chunk import Chunk, RrdReader

from guidefield.errors import MalformedRequest, UnknownObject
from guidefield.messages.replies import CERTIFY, CertifyReply, MotionReply, PlanReply, RequestTag
from guidefield.messages.requests import CertifyRequest, MotionRequest, PlanRequest
from guidefield.messages.scene import Scene
from guidefield.recorder.documents import MADE_WITH, PROPERTIES, REPLY, REQUEST
from guidefield.recorder.packing import MESSAGE_COMPONENT, SCENE, unpacked
from guidefield.recorder.whole import LINK
from guidefield.versions import parse_versions


@dataclass(frozen=True)
class Recorded:
    """The messages and versions in a recording.

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
        judged = unpacked(request, RequestTag).type == CERTIFY
        asked: MotionRequest = unpacked(request, CertifyRequest) if judged else unpacked(request, PlanRequest)
        if "scene_apart" in found[REQUEST].to_record_batch().schema.names:
            apart = found[SCENE] if SCENE in found else _scene_beside(path)
            scene = unpacked(bytes(_values(apart, MESSAGE_COMPONENT)), Scene)
            asked = msgspec.structs.replace(asked, scene=scene)
        answered: MotionReply = unpacked(reply, CertifyReply) if judged else unpacked(reply, PlanReply)
        return Recorded(asked, answered, parse_versions(packages))
    except (RuntimeError, ValueError, LookupError) as error:
        why = f"it has no {error}" if isinstance(error, KeyError) else f"{error}"
        what = f"{path.name!r} is no whole recording of guidefield, or one of another version"
        raise MalformedRequest(f"{what}: {why}", path=str(path)) from None


def _scene_beside(path: Path) -> Chunk:
    """The message of a large scene, from the file that a recording in a store is linked to."""
    (chunk,) = RrdReader(str(path.with_suffix(LINK))).stream().filter(content=[SCENE])
    return chunk


def _values(chunk: Chunk, component: str) -> list[Any]:
    """The values of a component of a chunk of one row."""
    (row,) = chunk.to_record_batch().column(component).to_pylist()
    return list(row)
