"""The recording of a stream for a viewer: of the files of its journal, or live while the stream goes on.

A watcher of a stream mustn't hold it up: `LiveStream` gives up showing before it waits for a viewer.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import msgspec
import numpy as np

from guidefield.errors import GuidefieldError, MalformedRequest
from guidefield.messages.streams import Observation, Piece, StreamObstacle, StreamState, StreamUpdate
from guidefield.messages.values import Vector3
from guidefield.recorder.live_view import Channel, Part
from guidefield.recorder.stream_recorder import MovingBody, StreamMotion, stream_chunks, stream_recording, stream_scene
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.joints import LocalPoint
from guidefield.scene import obstacle as obstacles
from guidefield.stream.commit import Commit
from guidefield.stream.journal import Begun, Entry, Opens, Updated, read
from guidefield.stream.obstacles import in_its_frame
from guidefield.stream.path_planner import FixedDelay
from guidefield.stream.state import StreamWatcher
from guidefield.stream.stream import CertifiedStream
from guidefield.whole_file import write_whole


def record(files: Sequence[Path], opens: Opens, recording: Path) -> None:
    """Write the recording of a journal's files, for a viewer.

    Raises:
        MalformedRequest: as `render`.
        OSError: if a file can't be read, or the recording can't be written.
    """
    write_whole(recording, render(files, opens), durable=False)


def render(files: Sequence[Path], opens: Opens) -> bytes:
    """The recording of a journal's files: the content of an `.rrd` file, with all that a viewer needs.

    Files are read one after the other, so that no more than one is held in memory.

    Args:
        files: The files of one stream, the oldest first; files that are removed while it reads are left out.

    Raises:
        MalformedRequest: if one isn't such a file, or none holds an update, or the robot has other joints now.
        OSError: if one can't be read.
    """
    parts: list[StreamMotion] = []
    moved = SeenBodies()
    with contextlib.ExitStack() as stack:
        stream: CertifiedStream | None = None
        for file in files:
            try:
                begun, entries = read(file)
            except FileNotFoundError:
                continue
            if stream is None:
                request = msgspec.structs.replace(begun.request, goal=None, obstacles=[])
                stream = stack.enter_context(opens(request, FixedDelay()))
            moved.take(begun, entries)
            answered = [one for one in entries if isinstance(one, Updated) and (one.piece or one.state)]
            updated = [one for one in answered if one.state is None or one.state.reason != "late"]
            if updated:
                _require_same_joints(file, begun, updated, stream)
                motions = RobotMotions(stream.group, list(begun.snapshot.state.commits.values()))
                parts.append(motion_of(motions, updated, ()))
        if stream is None or not parts:
            raise MalformedRequest(f"{_name_files(files)} holds no update", file=files[-1].name)
        motion = StreamMotion(
            **{name: np.concatenate([getattr(one, name) for one in parts]) for name in ARRAYS},
            reasons=[reason for one in parts for reason in one.reasons],
            moving=moved.bodies(stream.origin),
        )
        return stream_recording(f"{files[-1].parent.name}-{_name_files(files)}", stream.group, stream.scene, motion)


def _name_files(files: Sequence[Path]) -> str:
    return files[0].stem if len(files) == 1 else f"{files[0].stem}-{files[-1].stem}"


ARRAYS = ("times", "rows", "stops", "horizon", "latency")
"""The fields of a `StreamMotion` with one row for each update."""


def motion_of(motions: RobotMotions, updated: Sequence[Updated], moving: Sequence[MovingBody]) -> StreamMotion:
    """Return the motion of a robot over updates, among the observed obstacles."""
    rows, stops, horizon = [], [], []
    for one in updated:
        now = one.update.time
        rows.append(motions.at(one, now))
        motions.add(one.piece)
        end = motions.end(one)
        stops.append(motions.at_end(end))
        horizon.append(max(0.0, motions.stops(end) - now))
    return StreamMotion(
        times=np.array([one.update.time for one in updated]),
        rows=np.array(rows),
        stops=np.array(stops),
        horizon=np.array(horizon),
        latency=np.array([one.seconds for one in updated]),
        reasons=[
            (one.update.time, one.state.reason + (f": {' - '.join(one.state.pair)}" if one.state.pair else ""))
            for one in updated
            if one.state is not None
        ],
        moving=moving,
    )


def _require_same_joints(file: Path, begun: Begun, updated: Sequence[Updated], stream: CertifiedStream) -> None:
    """Refuse a robot that was stored anew under its name, with other joints."""
    group = stream.group
    names = [one.piece.position_names for one in updated if one.piece is not None]
    sizes = [one.ends.shape for one in begun.snapshot.state.commits.values()]
    if any(one != group.position_names for one in names) or any(size != (group.nv,) for size in sizes):
        raise MalformedRequest(f"the robot of {file.name} has other joints now", file=file.name)


class RobotMotions:
    """Commits and pieces by number, and the robot's place along them."""

    def __init__(self, group: PlanningGroup, commits: Sequence[Commit]) -> None:
        self._group = group
        self._commits = {one.number: one for one in commits}
        self._pieces: dict[int, Piece] = {}
        self._last = max(self._commits)

    def add(self, piece: Piece | None) -> None:
        """Take the next piece, if there is one."""
        if piece is not None:
            self._pieces[piece.number] = piece
            self._last = piece.number

    def at(self, one: Updated, now: float) -> np.ndarray:
        """Position columns (k,) at a time [s], by the piece that is executed, as the client or the clock says."""
        number = one.update.executing if one.update.executing is not None else self._find_begun(now)
        piece = self._pieces.get(number)
        if piece is None:
            commit = self._commits.get(number, self._commits[max(self._commits)])
            return np.array(self._group.wire_positions(cast(LocalPoint, commit.state(now)[:, 0])))
        return _along(piece, now)

    def end(self, one: Updated) -> int:
        """Number of the piece that is executed to its end if nothing follows."""
        return self._last if one.state is None else one.state.executing

    def at_end(self, number: int) -> np.ndarray:
        """Position columns (k,) at the end of a piece."""
        piece = self._pieces.get(number)
        if piece is not None:
            return np.array(piece.trajectory.positions[-1])
        commit = self._commits.get(number, self._commits[max(self._commits)])
        return np.array(self._group.wire_positions(commit.ends))

    def stops(self, number: int) -> float:
        """The end of a piece [s]."""
        piece = self._pieces.get(number)
        return piece.stops if piece is not None else self._commits.get(number, self._commits[max(self._commits)]).stops

    def _find_begun(self, now: float) -> int:
        begun = [number for number, piece in self._pieces.items() if piece.begins <= now]
        return max(begun, default=max(self._commits))


def _along(piece: Piece, now: float) -> np.ndarray:
    trajectory = piece.trajectory
    k = int(np.clip(np.searchsorted(trajectory.times, now, side="right") - 1, 0, len(trajectory.times) - 2))
    span = trajectory.times[k + 1] - trajectory.times[k]
    s = float(np.clip(now - trajectory.times[k], 0.0, span))
    q, v, a, after = (np.array(row) for row in (*_knot(piece, k), trajectory.accelerations[k + 1]))
    moved: np.ndarray = q + s * (v + s * (a / 2.0 + s * (after - a) / (6.0 * span)))
    return moved


def _knot(piece: Piece, k: int) -> tuple[list[float], list[float], list[float]]:
    trajectory = piece.trajectory
    return trajectory.positions[k], trajectory.velocities[k], trajectory.accelerations[k]


@dataclass
class _TrackedBody:
    """An obstacle, as it was declared last, with what was seen of it."""

    declared: StreamObstacle
    there: bool = False
    observations: list[Observation] = field(default_factory=list)
    appears: list[float] = field(default_factory=list)  # times at which it appeared [s]
    gone: list[float] = field(default_factory=list)  # times at which it disappeared [s]

    def lose(self, now: float) -> None:
        if self.there:
            self.gone.append(now)
        self.there = False

    def see(self, seen: Observation, now: float) -> None:
        self.observations.append(seen)
        if self.there:
            return
        self.there = True
        if self.gone and self.gone[-1] == now:  # it was away for no time
            self.gone.pop()
        else:
            self.appears.append(now)


class SeenBodies:
    """The observed obstacles, each as it was declared last, from file to file."""

    def __init__(self, declared: Sequence[StreamObstacle] = ()) -> None:
        self._known: dict[str, _TrackedBody] = {}
        for shape in declared:
            self._declare(shape)

    def take(self, begun: Begun, entries: Sequence[Entry]) -> None:
        """Take the entries of a file."""
        self._go_on(begun)
        self.take_entries(entries)

    def take_entries(self, entries: Sequence[Entry]) -> None:
        """Take entries that follow those before."""
        for entry in entries:
            if isinstance(entry, Updated) and entry.refused is None:
                update = entry.update
                for shape in update.declare:
                    self._declare(shape)
                for name in update.gone:
                    self._known[name].lose(update.time)
                for observation in update.obstacles:
                    self._known[observation.name].see(observation, update.time)

    def forget(self) -> None:
        """Forget all observations, but not which obstacles are there."""
        for one in self._known.values():
            one.observations.clear()
            one.appears.clear()
            one.gone.clear()

    def bodies(self, origin: Vector3) -> list[MovingBody]:
        """List the observed obstacles, in the frame of an origin [m, world]."""
        return [_body(one, origin) for one in self._known.values() if one.observations or one.gone]

    def _declare(self, shape: StreamObstacle) -> _TrackedBody:
        known = self._known.setdefault(shape.obstacle.name, _TrackedBody(shape))
        known.declared = shape
        return known

    def _go_on(self, begun: Begun) -> None:
        """Take the snapshot of a file: the one before may have ended sooner."""
        there = set()
        for one in begun.snapshot.obstacles:
            known = self._declare(one.declared)
            if one.seen is not None:
                there.add(one.declared.obstacle.name)
                if not known.there or one.seen.time > known.observations[-1].time:
                    known.see(one.seen, one.seen.time)
        for name in self._known.keys() - there:
            self._known[name].lose(now if np.isfinite(now := begun.snapshot.state.now) else 0.0)


def _body(one: _TrackedBody, origin: Vector3) -> MovingBody:
    there = sorted(one.observations, key=lambda seen: seen.time)
    placements = np.array([(*seen.placement.position, *seen.placement.quaternion_xyzw) for seen in there])
    placements = placements.reshape(-1, 7)
    placements[:, :3] -= origin
    built = obstacles.build(in_its_frame(one.declared.obstacle), 0)
    times = np.array([seen.time for seen in there])
    return MovingBody(built, times, placements, np.array(one.appears), np.array(one.gone))


SHOWN_INTERVAL_S = 0.1  # between parts drawn, beside the stream, and sent [s]: less than `MAX_WAITING` updates take
MAX_WAITING = 2_000  # updates that wait for it, or for a viewer: with more, the stream isn't shown any more

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

    def end_update(
        self,
        update: StreamUpdate,
        answer: Piece | StreamState | None,
        refused: GuidefieldError | None,
        *,
        noted: bool,
        took: bool,
    ) -> None:
        """Take the outcome of an update; a few times a second all of them are sent."""
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
