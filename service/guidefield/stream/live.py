"""A stream shown in a running Rerun viewer while it goes on; neither waits for the other."""

from __future__ import annotations

import logging
import time

from guidefield.errors import GuidefieldError
from guidefield.messages.streams import Piece, StreamState, StreamUpdate
from guidefield.recorder.live_view import Channel, Part
from guidefield.recorder.stream_recorder import stream_chunks, stream_scene
from guidefield.stream.journal import Updated
from guidefield.stream.shown import RobotMotions, SeenBodies, motion_of
from guidefield.stream.state import StreamWatcher
from guidefield.stream.stream import CertifiedStream

SHOWN_INTERVAL_S = 0.1  # time between two parts of the recording that are sent [s]
MAX_WAITING = 2_000  # updates kept for a viewer that takes none: with more, the stream isn't shown any more

_log = logging.getLogger(__name__)


class LiveStream(StreamWatcher):
    """A watcher of a stream that shows it in a viewer.

    Args:
        address: The viewer's.
        stream: The stream, which has had no update yet.
    """

    def __init__(self, address: str, stream: CertifiedStream) -> None:
        self._stream, self._channel = stream, Channel(address, stream.request.stream_id or "stream")
        self._motions = RobotMotions(stream.group, [stream.executing])
        self._seen = SeenBodies(stream.request.obstacles)
        self._waiting: list[Updated] = []
        self._began = self._sent = time.monotonic()
        self._is_shown = self._has_given_up = False

    def begin_update(self) -> None:
        """An update came."""
        self._began = time.monotonic()

    def updated(
        self,
        update: StreamUpdate,
        answer: Piece | StreamState | None,
        refused: GuidefieldError | None,
        *,
        noted: bool,
        took: bool,
    ) -> None:
        """An update was worked on; a few times a second all of them are sent."""
        now = time.monotonic()
        if self._has_given_up:
            return
        if refused is None:
            worked = now - self._began
            entry = Updated.of(update, answer, refused, noted=noted, took=took, wall=0.0, seconds=worked)
            self._waiting.append(entry)
        if now - self._sent >= SHOWN_INTERVAL_S and not self._channel.is_busy:
            entries, self._waiting, self._sent = self._waiting, [], now
            self._channel.send(lambda: self._draw(entries))
        elif len(self._waiting) >= MAX_WAITING:
            _log.warning("the viewer takes nothing: the stream isn't shown any more")
            self._waiting, self._has_given_up = [], True

    def _draw(self, entries: list[Updated]) -> Part:
        self._seen.take_entries(entries)
        answered = [one for one in entries if one.piece or (one.state and one.state.reason != "late")]
        if not answered:
            return (), None
        group = self._stream.group
        motion = motion_of(self._motions, answered, self._seen.bodies(self._stream.origin))
        self._seen.forget()
        chunks = list(stream_chunks(group, motion))
        if self._is_shown:
            return chunks, None
        self._is_shown = True
        still, views = stream_scene(group, self._stream.scene, motion)
        return [*still, *chunks], views
