"""Make Rerun chunks from archetypes, and write and read files of them; names of timelines, frames and shared entities.

A recording's entities are read back by `stored.py` and laid out by `view.py`, to which timelines are given; users may
know both. Tools and tests write names here out, titles in `view.py` `STEP`. Kept drawings don't follow a change here.
"""

from __future__ import annotations

import colorsys
import contextlib
import functools
import logging
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun_bindings as bindings
from rerun.chunk import Chunk, LazyChunkStream, RrdReader

from guidefield.whole_file import write_whole

APPLICATION_ID = "guidefield"  # begin of the application id of all recordings

_log = logging.getLogger(__name__)


def write_recording(path: Path, recording_id: str, chunks: Iterable[Chunk], layout: Any) -> None:
    """Write a recording with its layout, a Rerun blueprint, by one rename; raises OSError and leaves what was there.

    The layout belongs to this file: its application id is unique, as viewers share a layout among the recordings of one
    application.
    """
    # Encoded in memory: Rerun's own file writer may wait for ever on a disk that is full.
    write_whole(path, encode_recording(recording_id, chunks, layout), durable=False)


def encode_recording(recording_id: str, chunks: Iterable[Chunk], layout: Any) -> bytes:
    """Return the content of a recording's file; the arguments are those of `write_recording`.

    The layout comes first, because the web viewer ignores one that comes after data. Rerun puts it first in files only,
    so this passes Rerun the end of a pipe as a file, which no full disk or limit cuts short.
    """
    application_id = f"{APPLICATION_ID}-{recording_id}"
    if layout is None:  # a file in memory takes half the time of a pipe with its two threads
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
    """Open a pipe: yield a path to write to, a function that closes our end, and one that waits for all the content."""
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
    """Read the meshes in a robot's file, as a recording takes them in; raises `UNREADABLE`."""
    return [chunk for chunk in read_chunks(file) if chunk.entity_path.startswith("/robot/")]


def read_chunks(file: Path) -> list[Chunk]:
    """Read all chunks of a file; raises `UNREADABLE`."""
    if not file.exists():
        raise FileNotFoundError(f"there is no {file}")
    return list(RrdReader(file).stream().to_chunks())


PATH_TIME = "path_time"  # timeline of the motion itself [s]
STEP = "step"  # timeline of the planner's accepted steps, counted
PLOTS = "/plots/"  # begin of the entities of curves over time
GHOST_ENTITY = "/ghosts"  # entity of the robot at some configurations along its path
PICTURE, PICTURE_AT_START = "/field/picture", "/field/picture_at_start"
"""Entities of the picture of the field: if all obstacles rest, and if it shows moving ones before they move."""


def entity(*parts: str) -> str:
    """Return the entity path of named parts, whatever characters the names have."""
    return "/" + "/".join(rr.escape_entity_path_part(part) for part in parts)


WORLD = "tf#/"  # name of the world's coordinate frame: the one that Rerun gives to the root of all entities


def link_frame(link: str) -> str:
    """Return the name of a link's coordinate frame."""
    return f"link {link}"


def joint_frame(joint: str) -> str:
    """Return the name of the coordinate frame that a joint moves."""
    return f"joint {joint}"


def make_columns(
    archetype: Any, lengths: Sequence[int] | np.ndarray | None = None, **components: Any
) -> list[rr.ComponentColumn]:
    """Make columns of an archetype, faster than its own `columns()`; rows have `lengths` (n,), by default 1."""
    columns = []
    for name, values in components.items():
        descriptor, batch = _component(archetype, name)
        column = batch(values)
        ends = np.arange(1, 1 + len(column)) if lengths is None else np.cumsum(lengths)
        columns.append(rr.ComponentColumn(descriptor, column, offsets=np.append(0, ends).astype(np.int32)))
    return columns


@functools.cache
def _component(archetype: Any, name: str) -> tuple[rr.ComponentDescriptor, type[Any]]:
    """Return the descriptor of a component, and the type that makes Arrow's array of its values."""
    batch = getattr(archetype.__attrs_attrs__, name).converter.__self__
    short, full = archetype.archetype_short_name(), archetype.archetype()
    return rr.ComponentDescriptor(f"{short}:{name}", archetype=full, component_type=batch._COMPONENT_TYPE), batch


def still(path: str, *archetypes: Any) -> Chunk:
    """Make a chunk of an entity that holds at all times, from Rerun's archetypes."""
    return Chunk.from_columns(path, [], _single_row(archetypes))


def from_time(path: str, time: float, *archetypes: Any) -> Chunk:
    """Make a chunk of an entity that holds from a time of `PATH_TIME` on [s]."""
    return Chunk.from_columns(path, [path_times(np.array([time]))], _single_row(archetypes))


def timed_chunk(path: str, times: Iterable[rr.TimeColumn], columns: Iterable[rr.ComponentColumn]) -> Chunk:
    """Make a chunk of an entity with one row for each of n times."""
    return Chunk.from_columns(path, times, columns)


Color = tuple[int, int, int, int]  # RGBA


def rgba(hue: float, lightness: float, saturation: float, alpha: int = 255) -> Color:
    """Return the colour of a hue, lightness and saturation from 0 to 1."""
    red, green, blue = (round(255 * part) for part in colorsys.hls_to_rgb(hue, lightness, saturation))
    return red, green, blue, alpha


def rgba32(color: Sequence[int]) -> np.uint32:
    """Pack a colour (RGBA) into a number, as Rerun does: arrays of numbers are made faster than of tuples."""
    red, green, blue, alpha = color
    return np.uint32(red << 24 | green << 16 | blue << 8 | alpha)


def path_times(times: np.ndarray) -> rr.TimeColumn:
    """Return the column of `PATH_TIME` for times (n,) [s]."""
    return rr.TimeColumn(PATH_TIME, duration=times)


def visible_entities(chunks: Iterable[Chunk]) -> frozenset[str]:
    """Return the entities that have something to show; a curve of a single point has not."""
    points = Counter[str]()
    for chunk in chunks:
        points[chunk.entity_path] += 0 if chunk.is_static else chunk.num_rows
    return frozenset(path for path, rows in points.items() if rows > 1 or not path.startswith(PLOTS))


def _single_row(archetypes: Iterable[Any]) -> list[rr.ComponentColumn]:
    batches = [batch for archetype in archetypes for batch in archetype.as_component_batches()]
    ends = [np.array([0, len(batch.as_arrow_array())], np.int32) for batch in batches]
    return [
        rr.ComponentColumn(one.component_descriptor(), one, offsets=offsets)
        for one, offsets in zip(batches, ends, strict=True)
    ]
