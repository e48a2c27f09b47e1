"""Recordings in a store and those that leave it: without what all runs share, and with it.

A stored recording lacks its robot's meshes, which lie once beside all runs, a large scene, which lies once for all runs
in it, and its layout, which follows from it. `self_contained` adds them: one file that anybody can open.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
from rerun.chunk import Chunk, RrdReader

from guidefield.recorder.chunks import shown, still
from guidefield.recorder.documents import with_warning
from guidefield.recorder.rrd_file import UNREADABLE, encode_recording, read_chunks, read_meshes
from guidefield.recorder.view import Eye, layout

LEFT_OUT = "/left_out"
"""The entity that stands for what a stored recording lacks."""
LINK = ".drawn"
"""Ending of a stored recording's link to the file of its scene; the store deletes it with the recording."""

_log = logging.getLogger(__name__)


def left_out(meshes: str, eye: Eye, timeline: str, *, scene_too: bool) -> Chunk:
    """Stand for the parts that a stored recording lacks.

    Args:
        meshes: Name of the file of its robot's meshes, in their folder.
        eye: What `view.layout` is given.
        timeline: The same.
        scene_too: Whether it lacks its scene, to whose file it is linked.
    """
    at = np.concatenate([eye.position, eye.target])
    return still(LEFT_OUT, rr.AnyValues(meshes=meshes, eye=at, timeline=timeline, scene_apart=[scene_too]))


def self_contained(recording: Path, folder: Path) -> bytes:
    """A run's recording with its scene, its robot's meshes and its layout, as the content of one file.

    Without the file of scene or meshes it is whole but for them: its summary and the log say so.

    Args:
        recording: A recording that may lack them.
        folder: Where robots are kept prepared.

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
    views = layout(Eye(np.array(at[:3]), np.array(at[3:]), frozenset()), timeline, shown(rest))
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
