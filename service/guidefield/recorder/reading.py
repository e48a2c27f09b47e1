"""A recording read back: what was asked, what was answered and what it was made with, from the file alone."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from rerun.chunk import Chunk, RrdReader

from guidefield.errors import MalformedRequest, UnknownObject
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import PlanRequest

_M = TypeVar("_M", bound=msgspec.Struct)


@dataclass(frozen=True)
class Recorded:
    """What a recording says of its run.

    Attributes:
        request: As it came.
        reply: As it was given, to the last bit.
        versions: Of each package that it was made with, by the package's name; of Python too.
    """

    request: PlanRequest
    reply: PlanReply
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
        return Recorded(
            request=_message(found["/documents/request"], PlanRequest),
            reply=_message(found["/documents/reply"], PlanReply),
            versions={name.replace("_", "-"): str(text) for name, text in _values(found["/__properties/versions"])},
        )
    except (RuntimeError, ValueError, LookupError, msgspec.DecodeError) as error:
        why = f"it has no {error}" if isinstance(error, KeyError) else f"{error}"
        raise MalformedRequest(f"{path.name!r} is no whole recording of guidefield: {why}", path=str(path)) from None


def _message(document: Chunk, kind: type[_M]) -> _M:
    """The message beside a document's text (documents.message_document)."""
    return msgspec.json.decode(dict(_values(document))["json"], type=kind)


def _values(chunk: Chunk) -> list[tuple[str, Any]]:
    """Components of a chunk of one row that have one value."""
    batch = chunk.to_record_batch()
    rows = {name: batch.column(name)[0].as_py() for name in batch.schema.names if ":" not in name and "." not in name}
    return [(name, row[0]) for name, row in rows.items()]
