"""Rerun chunks from archetypes, and the files they are written to: the vocabulary in which this room writes."""

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


PATH_TIME = "path_time"  # timeline of the motion itself [s]
STEP = "step"  # timeline of the planner's accepted steps, counted
PLOTS = "/plots/"  # below it are the curves
GHOST_ENTITY = "/ghosts"  # entity of the robot along its way, translucent
PICTURE, PICTURE_AT_START = "/field/picture", "/field/picture_at_start"
"""Entities of the picture of the field: where nothing moves, and where it is that of the obstacles before they do."""


def entity(*parts: str) -> str:
    """Entity path of named parts, whatever characters the names have."""
    return "/" + "/".join(rr.escape_entity_path_part(part) for part in parts)


WORLD = "tf#/"  # name of the world's coordinate frame: the one that Rerun gives to the root of all entities


def link_frame(link: str) -> str:
    """Name of a link's coordinate frame."""
    return f"link {link}"


def joint_frame(joint: str) -> str:
    """Name of the coordinate frame that a joint moves."""
    return f"joint {joint}"


def make_columns(
    archetype: Any, lengths: Sequence[int] | np.ndarray | None = None, **components: Any
) -> list[rr.ComponentColumn]:
    """Make columns of an archetype, sooner than its own `columns()`; rows have `lengths` (n,), by default 1."""
    columns = []
    for name, values in components.items():
        descriptor, batch = _component(archetype, name)
        column = batch(values)
        ends = np.arange(1, 1 + len(column)) if lengths is None else np.cumsum(lengths)
        columns.append(rr.ComponentColumn(descriptor, column, offsets=np.append(0, ends).astype(np.int32)))
    return columns


@functools.cache
def _component(archetype: Any, name: str) -> tuple[rr.ComponentDescriptor, type[Any]]:
    """The descriptor of a component, and the batch that makes Arrow's array of its values."""
    batch = getattr(archetype.__attrs_attrs__, name).converter.__self__
    short, full = archetype.archetype_short_name(), archetype.archetype()
    return rr.ComponentDescriptor(f"{short}:{name}", archetype=full, component_type=batch._COMPONENT_TYPE), batch


def still(path: str, *archetypes: Any) -> Chunk:
    """A chunk of an entity that holds at all times, from Rerun's archetypes."""
    return Chunk.from_columns(path, [], _single_row(archetypes))


def from_time(path: str, time: float, *archetypes: Any) -> Chunk:
    """A chunk of an entity that holds from a time of `PATH_TIME` on [s]."""
    return Chunk.from_columns(path, [path_times(np.array([time]))], _single_row(archetypes))


def timed(path: str, times: Iterable[rr.TimeColumn], columns: Iterable[rr.ComponentColumn]) -> Chunk:
    """A chunk of an entity with one row for each of n times."""
    return Chunk.from_columns(path, times, columns)


Color = tuple[int, int, int, int]  # RGBA


def rgba(hue: float, lightness: float, saturation: float, alpha: int = 255) -> Color:
    """The colour of a hue, lightness and saturation from 0 to 1."""
    red, green, blue = (round(255 * part) for part in colorsys.hls_to_rgb(hue, lightness, saturation))
    return red, green, blue, alpha


def rgba32(color: Sequence[int]) -> np.uint32:
    """A colour (RGBA) as Rerun packs it: of many that are alike, arrays of these are made sooner than of tuples."""
    red, green, blue, alpha = color
    return np.uint32(red << 24 | green << 16 | blue << 8 | alpha)


def path_times(times: np.ndarray) -> rr.TimeColumn:
    """The column of `PATH_TIME` for times (n,) [s]."""
    return rr.TimeColumn(PATH_TIME, duration=times)


def visible_entities(chunks: Iterable[Chunk]) -> frozenset[str]:
    """The entities that have something to show: curves of a single point have not."""
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
