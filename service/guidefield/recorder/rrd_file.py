"""Chunks and a layout as an `.rrd` file: written whole or not at all, without leaving threads behind, and read back."""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import rerun as rr
import rerun_bindings as bindings
from rerun.chunk import Chunk, LazyChunkStream, RrdReader

from guidefield.whole_file import write_whole

APPLICATION_ID = "guidefield"

_log = logging.getLogger(__name__)


def write_recording(path: Path, recording_id: str, chunks: Iterable[Chunk], layout: Any) -> None:
    """Write a recording with its layout, a Rerun blueprint, by one rename; raises OSError and leaves what was there.

    The layout belongs to this file: its application id is unique, as viewers share a layout among the recordings of one
    application.
    """
    # Encoded in memory: Rerun's own file writer may wait for ever on a disk that is full.
    write_whole(path, encode_recording(recording_id, chunks, layout), durable=False)


def encode_recording(recording_id: str, chunks: Iterable[Chunk], layout: Any) -> bytes:
    """The content of a recording's file; the arguments are those of `write_recording`.

    The layout comes first: the web viewer takes a recording that it has begun to show as one without a layout. Rerun
    puts it first in files only, so this is a file to Rerun: the end of a pipe, which no full disk or limit cuts short.
    """
    application_id = f"{APPLICATION_ID}-{recording_id}"
    if layout is None:  # in half the time of a pipe, whose ends are two threads
        with os.fdopen(os.memfd_create(recording_id), "rb") as file:
            stream = LazyChunkStream.from_iter(chunks)
            try:
                path = f"/proc/self/fd/{file.fileno()}"
                stream.write_rrd(path, application_id=application_id, recording_id=recording_id)
            except RuntimeError as error:
                if "os error" in f"{error}":  # of a limit to the size of files
                    raise OSError(f"{error}") from None
                raise
            return file.read()
    with _written_to_pipe() as (path, close, content):
        with (
            _disconnected_after(rr.RecordingStream(application_id, recording_id=recording_id)) as recording,
            _disconnected_after(_layout_stream(layout, application_id)) as layout_stream,
        ):
            bindings.save(path, layout_stream.memory_recording().storage, recording=recording.to_native())
            close()  # now Rerun alone can write, and the pipe ends when it does
            recording.send_chunks(chunks)
        return content()


@contextlib.contextmanager
def _written_to_pipe() -> Iterator[tuple[str, Callable[[], None], Callable[[], bytes]]]:
    """A path to write to, what ends our own hold of it, and what waits for all that was written."""
    reading, writing = os.pipe()
    with ThreadPoolExecutor(1) as thread, os.fdopen(reading, "rb") as end, os.fdopen(writing, "wb") as hold:
        written = thread.submit(end.read)
        try:
            yield f"/dev/fd/{writing}", hold.close, written.result
        finally:
            hold.close()


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
    try:
        yield stream
    finally:
        stream.disconnect()
        del stream
        try:
            bindings.flush_and_cleanup_orphaned_recordings()
        except RuntimeError as error:  # of another stream, whose viewer has gone: a pipe has no connection
            _log.debug("another recording can't be finished: %s", error)


UNREADABLE = (OSError, ValueError, KeyError, RuntimeError)  # exceptions of reading a file that is missing or damaged


def read_meshes(file: Path) -> list[Chunk]:
    """The meshes in a robot's file, as a recording takes them in; raises `UNREADABLE`."""
    return [chunk for chunk in read_chunks(file) if chunk.entity_path.startswith("/robot/")]


def read_chunks(file: Path) -> list[Chunk]:
    """All that a robot's file holds; raises as `read_meshes`."""
    if not file.exists():
        raise FileNotFoundError(f"there is no {file}")
    return list(RrdReader(file).stream().to_chunks())
