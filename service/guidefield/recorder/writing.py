"""Chunks and a layout to one `.rrd` file: whole or not at all, and without leaving threads behind."""

from __future__ import annotations

import contextlib
import uuid
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import rerun as rr
import rerun_bindings as bindings
from rerun.chunk import Chunk

APPLICATION_ID = "guidefield"


def write_recording(path: Path, recording_id: str, chunks: Iterable[Chunk], layout: Any) -> None:
    """Write a self-contained recording with its layout; the file appears by one rename, complete.

    The layout belongs to this file: its application id is unique, as viewers share a layout among the recordings of one
    application.

    Args:
        path: File to write; replaced if it exists.
        recording_id: Its identity in a viewer.
        chunks: What it holds.
        layout: How a viewer shows it at first, a Rerun blueprint; None: as it likes.

    Raises:
        OSError: if the file cannot be written; nothing is left of it, and an older one stays as it was.
    """
    # Encoded in memory: Rerun's own file writer may wait for ever on a disk that is full.
    write_atomically(path, encode_recording(recording_id, chunks, layout))


def write_atomically(path: Path, content: bytes) -> None:
    """A file by one rename: all of it or, if the disk refuses (OSError), nothing, and an older one as it was."""
    draft = path.with_name(f".{path.name}.{uuid.uuid4().hex}.draft")
    try:
        draft.write_bytes(content)
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def encode_recording(recording_id: str, chunks: Iterable[Chunk], layout: Any) -> bytes:
    """The content of a recording's file; the arguments are those of `write_recording`."""
    application_id = f"{APPLICATION_ID}-{recording_id}"
    with _disconnected_after(rr.RecordingStream(application_id, recording_id=recording_id)) as recording:
        memory = recording.memory_recording()
        if layout is not None:
            with _disconnected_after(_layout_stream(layout, application_id)) as layout_stream:
                storage = layout_stream.memory_recording().storage
                bindings.send_blueprint(storage, make_active=False, make_default=True, recording=recording.to_native())
        recording.send_chunks(chunks)
        content: bytes = memory.drain_as_bytes()
    return content


def _layout_stream(layout: Any, application_id: str) -> rr.RecordingStream:
    # What `RecordingStream.send_blueprint` does inside, but with a handle on the stream: left alone, its memory sink
    # keeps it alive for ever, two threads included.
    native = bindings.new_blueprint(
        application_id=application_id, make_default=False, make_thread_default=False, default_enabled=True
    )
    stream = rr.RecordingStream._from_native(native)
    stream.set_log_time_enabled(False)  # a second timeline would double the file's table of contents
    stream.set_time("blueprint", sequence=0)
    layout._log_to_stream(stream)
    return stream


@contextlib.contextmanager
def _disconnected_after(stream: rr.RecordingStream) -> Iterator[Any]:
    """Use a stream, then end its threads."""
    try:
        yield stream
    finally:
        stream.disconnect()
        del stream
        bindings.flush_and_cleanup_orphaned_recordings()
