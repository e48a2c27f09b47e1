"""The recording of a stream for a viewer, made of a file of its journal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import msgspec
import numpy as np

from guidefield.errors import MalformedRequest
from guidefield.messages.streams import Observation, Piece, StreamObstacle
from guidefield.recorder.stream_recorder import MovingBody, StreamMotion, stream_recording
from guidefield.robot.model.spaces import ChartPoint
from guidefield.scene import obstacle as obstacles
from guidefield.stream.commit import Commit
from guidefield.stream.journal import Begun, Entry, Updated
from guidefield.stream.obstacles import in_its_frame
from guidefield.stream.replay import Opens, read
from guidefield.stream.snapshot import KeptObstacle
from guidefield.stream.stream import CertifiedStream
from guidefield.stream.takeover import Counted
from guidefield.whole_file import write_whole


def record(file: Path, opens: Opens, recording: Path) -> None:
    """Write the recording of a file of a journal, for a viewer.

    Args:
        file: The file.
        opens: Opens a stream in this process.
        recording: Where the recording goes.

    Raises:
        MalformedRequest: as `recorded`.
        OSError: if the file can't be read, or the recording can't be written.
    """
    write_whole(recording, recorded(file, opens), durable=False)


def recorded(file: Path, opens: Opens) -> bytes:
    """The recording of a file of a journal: the content of an `.rrd` file, with all that a viewer needs.

    Args:
        file: The file.
        opens: Opens a stream in this process.

    Raises:
        MalformedRequest: if it isn't such a file, or holds no update, or its robot has other joints now.
        OSError: if the file can't be read.
    """
    begun, entries = read(file)
    updated = [one for one in entries if isinstance(one, Updated) and (one.piece or one.state) and _counts(one)]
    if not updated:
        raise MalformedRequest(f"{file.name} holds no update", file=file.name)
    request = msgspec.structs.replace(begun.request, goal=None, obstacles=[])
    with opens(request, Counted()) as stream:
        _require_same_joints(file, begun, updated, stream)
        motions = _Motions(stream, [kept.commit() for kept in begun.snapshot.commits])
        rows, stops, horizon = [], [], []
        for one in updated:
            now = one.update.time
            rows.append(motions.at(one, now))
            motions.add(one.piece)
            end = motions.end(one)
            stops.append(motions.at_end(end))
            horizon.append(max(0.0, motions.stops(end) - now))
        motion = StreamMotion(
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
            moving=_moving(begun.snapshot.obstacles, entries),
        )
        return stream_recording(f"{file.parent.name}-{file.stem}", stream.group, stream.scene, motion)


def _require_same_joints(file: Path, begun: Begun, updated: Sequence[Updated], stream: CertifiedStream) -> None:
    """Refuse a robot that was stored anew under its name, with other joints."""
    group = stream.group
    names = [one.piece.position_names for one in updated if one.piece is not None]
    sizes = [kept.ends.shape for kept in begun.snapshot.commits]
    if any(one != group.position_names for one in names) or any(size != (group.nv,) for size in sizes):
        raise MalformedRequest(f"the robot of {file.name} has other joints now", file=file.name)


def _counts(one: Updated) -> bool:
    return one.state is None or one.state.reason != "late"


class _Motions:
    """Commits and pieces by number, and where the robot is along them."""

    def __init__(self, stream: CertifiedStream, commits: Sequence[Commit]) -> None:
        self._group = stream.group
        self._commits = {one.number: one for one in commits}
        self._pieces: dict[int, Piece] = {}
        self._last = max(self._commits)

    def add(self, piece: Piece | None) -> None:
        """Know a piece."""
        if piece is not None:
            self._pieces[piece.number] = piece
            self._last = piece.number

    def at(self, one: Updated, now: float) -> np.ndarray:
        """Position columns (k,) at a time [s]: as the client told, or as the piece has it that is executed."""
        number = one.update.executing if one.update.executing is not None else self._begun(now)
        piece = self._pieces.get(number)
        if piece is None:
            commit = self._commits.get(number, self._commits[max(self._commits)])
            return np.array(self._group.wire_positions(cast(ChartPoint, commit.state(now)[:, 0])))
        return _along(piece, now)

    def end(self, one: Updated) -> int:
        """Number of what is executed to its end if nothing follows."""
        return self._last if one.state is None else one.state.executing

    def at_end(self, number: int) -> np.ndarray:
        """Position columns (k,) where that ends."""
        piece = self._pieces.get(number)
        if piece is not None:
            return np.array(piece.trajectory.positions[-1])
        commit = self._commits.get(number, self._commits[max(self._commits)])
        return np.array(self._group.wire_positions(commit.ends))

    def stops(self, number: int) -> float:
        """When that ends [s]."""
        piece = self._pieces.get(number)
        return piece.stops if piece is not None else self._commits.get(number, self._commits[max(self._commits)]).stops

    def _begun(self, now: float) -> int:
        """The last piece that has begun."""
        begun = [number for number, piece in self._pieces.items() if piece.begins <= now]
        return max(begun, default=max(self._commits))


def _along(piece: Piece, now: float) -> np.ndarray:
    """Position columns (k,) of a piece at a time [s]."""
    told = piece.trajectory
    k = int(np.clip(np.searchsorted(told.times, now, side="right") - 1, 0, len(told.times) - 2))
    span = told.times[k + 1] - told.times[k]
    s = float(np.clip(now - told.times[k], 0.0, span))
    q, v, a, after = (np.array(row) for row in (*_knot(piece, k), told.accelerations[k + 1]))
    moved: np.ndarray = q + s * (v + s * (a / 2.0 + s * (after - a) / (6.0 * span)))
    return moved


def _knot(piece: Piece, k: int) -> tuple[list[float], list[float], list[float]]:
    told = piece.trajectory
    return told.positions[k], told.velocities[k], told.accelerations[k]


@dataclass
class _Seen:
    """An obstacle, as it was declared last, with what was seen of it.

    Attributes:
        declared: What it was declared as.
        there: Whether it is there.
        observations: What was seen.
        appears: When it was there and had not been before [s].
        gone: When it wasn't there any more [s].
    """

    declared: StreamObstacle
    there: bool = False
    observations: list[Observation] = field(default_factory=list)
    appears: list[float] = field(default_factory=list)
    gone: list[float] = field(default_factory=list)

    def lose(self, now: float) -> None:
        """It is gone from a time on [s]."""
        if self.there:
            self.gone.append(now)
        self.there = False

    def see(self, seen: Observation, now: float) -> None:
        """It is seen, as is told at a time [s]."""
        self.observations.append(seen)
        if self.there:
            return
        self.there = True
        if self.gone and self.gone[-1] == now:  # it was away for no time
            self.gone.pop()
        else:
            self.appears.append(now)


def _moving(kept: Sequence[KeptObstacle], entries: Sequence[Entry]) -> list[MovingBody]:
    """What was seen, each as it was declared last."""
    known: dict[str, _Seen] = {}
    for one in kept:
        known[one.declared.obstacle.name] = _Seen(one.declared)
        if one.seen is not None:
            known[one.seen.name].see(one.seen, one.seen.time)
    for entry in entries:
        if isinstance(entry, Updated) and entry.refused is None:
            update = entry.update
            for shape in update.declare:
                known.setdefault(shape.obstacle.name, _Seen(shape)).declared = shape
            for name in update.gone:
                known[name].lose(update.time)
            for observation in update.obstacles:
                known[observation.name].see(observation, update.time)
    return [_body(one) for one in known.values() if one.observations]


def _body(one: _Seen) -> MovingBody:
    there = sorted(one.observations, key=lambda seen: seen.time)
    placements = np.array([(*seen.placement.position, *seen.placement.quaternion_xyzw) for seen in there])
    built = obstacles.build(in_its_frame(one.declared.obstacle), 0)
    times = np.array([seen.time for seen in there])
    return MovingBody(built, times, placements, np.array(one.appears), np.array(one.gone))
