"""Recordings read back: their messages alone, or those of a store as files that anybody can open."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import rerun as rr
from rerun.chunk import Chunk, RrdReader

from guidefield.errors import MalformedRequest, UnknownObject
from guidefield.messages.replies import CERTIFY, CertifyReply, MotionReply, PlanReply, RequestTag
from guidefield.messages.requests import CertifyRequest, MotionRequest, PlanRequest
from guidefield.messages.scene import Scene
from guidefield.recorder.chunks import UNREADABLE, encode_recording, read_chunks, read_meshes, still, visible_entities
from guidefield.recorder.documents import (
    MADE_WITH,
    MESSAGE_COMPONENT,
    PROPERTIES,
    REPLY,
    REQUEST,
    SCENE,
    unpack,
    with_warning,
)
from guidefield.recorder.view import Eye, layout
from guidefield.versions import parse_versions

LEFT_OUT = "/left_out"  # entity with the names of the parts that a stored recording lacks
LINK = ".drawn"  # ending of a stored recording's link to the file of its scene; the store deletes it with the recording

_log = logging.getLogger(__name__)


def left_out(meshes: str, eye: Eye, timeline: str, *, scene_too: bool) -> Chunk:
    """Stand for what a stored recording lacks: the named file of meshes, the layout, perhaps its scene."""
    at = np.concatenate([eye.position, eye.target])
    return still(LEFT_OUT, rr.AnyValues(meshes=meshes, eye=at, timeline=timeline, scene_apart=[scene_too]))


def self_contained(recording: Path, folder: Path) -> bytes:
    """A run's recording with its scene, its robot's meshes, kept prepared in a folder, and its layout, as one file.

    Without the file of scene or meshes it is whole but for them: its summary and the log say so.

    Raises:
        OSError: if the recording can't be read.
        ValueError, KeyError, RuntimeError: if it isn't whole.
    """
    reader = RrdReader(recording)
    (store,) = reader.recordings()
    chunks = reader.stream().to_chunks()
    lacking = next((chunk for chunk in chunks if chunk.entity_path == LEFT_OUT), None)
    if lacking is None:
        return recording.read_bytes()
    batch = lacking.to_record_batch()
    (name,), at, (timeline,) = (batch.column(part).to_pylist()[0] for part in ("meshes", "eye", "timeline"))
    rest = [chunk for chunk in chunks if chunk.entity_path != LEFT_OUT]
    views = layout(Eye(np.array(at[:3]), np.array(at[3:]), frozenset()), timeline, visible_entities(rest))
    rest = _with(rest, "the robot's meshes are", lambda: read_meshes(folder / Path(name).name))
    if (
        "scene_apart" in batch.schema.names and batch.column("scene_apart").to_pylist()[0][0]
    ):  # those of old versions have none
        rest = _with(rest, "the scene is", lambda: read_chunks(recording.with_suffix(LINK)))
    return encode_recording(store.recording_id, rest, views)


def _with(chunks: Sequence[Chunk], what: str, read: Callable[[], list[Chunk]]) -> list[Chunk]:
    """Add what is read to the chunks of a recording, or a warning where it can't be read."""
    try:
        return [*chunks, *read()]
    except UNREADABLE as error:
        _log.warning("%s missing from a recording: %s", what, error)
        return with_warning(chunks, f"{what} not in this recording: the file is missing or damaged")


@dataclass(frozen=True)
class Recorded:
    """The messages in a recording, to the last bit, and the versions of packages, Python and ``processor``."""

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
        judged = unpack(request, RequestTag).type == CERTIFY
        asked: MotionRequest = unpack(request, CertifyRequest) if judged else unpack(request, PlanRequest)
        if "scene_apart" in found[REQUEST].to_record_batch().schema.names:
            if SCENE not in found:  # it is in the file that a recording in a store is linked to
                (found[SCENE],) = RrdReader(str(path.with_suffix(LINK))).stream().filter(content=[SCENE])
            scene = unpack(bytes(_values(found[SCENE], MESSAGE_COMPONENT)), Scene)
            asked = msgspec.structs.replace(asked, scene=scene)
        answered: MotionReply = unpack(reply, CertifyReply) if judged else unpack(reply, PlanReply)
        return Recorded(asked, answered, parse_versions(packages))
    except (RuntimeError, ValueError, LookupError) as error:
        why = f"it has no {error}" if isinstance(error, KeyError) else f"{error}"
        what = f"{path.name!r} is no whole recording of guidefield, or one of another version"
        raise MalformedRequest(f"{what}: {why}", path=str(path)) from None


def _values(chunk: Chunk, component: str) -> list[Any]:
    (row,) = chunk.to_record_batch().column(component).to_pylist()
    return list(row)
