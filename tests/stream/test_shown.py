"""The recording of a stream for a viewer, and the demonstration that makes one."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from rerun.chunk import RrdReader
from typer.testing import CliRunner

from guidefield.cli import app, demonstration
from guidefield.errors import MalformedRequest
from guidefield.messages.scene import Box
from guidefield.messages.streams import Observation, Piece, StreamObstacle, StreamOpen, StreamUpdate
from guidefield.messages.values import JointsGoal, Placement
from guidefield.scene.scene import Scene as BuiltScene
from guidefield.stream.journal import Journal, files_of, read
from guidefield.stream.path_planner import TakeOver
from guidefield.stream.shown import record, render
from guidefield.stream.stream import CertifiedStream
from tests.journeys.service import await_that
from tests.robots import robot
from tests.stream.test_journal import EMPTY

ASKED = StreamOpen(
    "ur5",
    "empty",
    start={"shoulder_lift_joint": -1.5, "elbow_joint": 0.5},
    obstacles=[StreamObstacle(Box(name="crate", size=(0.2, 0.1, 0.1)), 0.2)],
)


def opens(request: StreamOpen, taking: TakeOver) -> CertifiedStream:
    scene: BuiltScene = EMPTY
    return CertifiedStream(request, robot("ur5"), scene, taking)


def opens_another(request: StreamOpen, taking: TakeOver) -> CertifiedStream:
    return CertifiedStream(msgspec.structs.replace(request, start={}), robot("panda"), EMPTY, taking)


def test_it_shows_what_moved_where_the_robot_would_stand_and_why_there_was_no_piece(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "s", ASKED, "plain", {})
    pieces = []
    with CertifiedStream(ASKED, robot("ur5"), EMPTY, None, journal) as stream:
        for cycle in range(12):
            now = 0.02 * cycle
            if cycle == 2:
                stream.aim_for({"type": "joints", "positions": {"shoulder_pan_joint": 1.2, "elbow_joint": 0.9}})
            seen = Observation("crate", now, Placement((1.2 - now, 0.1, 0.5)))
            answer = stream.update(StreamUpdate(now, [seen]))
            pieces += [answer] if isinstance(answer, Piece) else []
    journal.close()
    (file,) = files_of(tmp_path / "s")
    recording = tmp_path / "s.rrd"
    record([file], opens, recording)
    written = [chunk for chunk in RrdReader(recording).stream().to_chunks() if not chunk.is_static]
    chunks = {chunk.entity_path: chunk for chunk in written if not _has(chunk, "vertex_positions")}
    drawn = [chunk for chunk in written if _has(chunk, "vertex_positions") and "crate" in chunk.entity_path]
    assert [chunk.num_rows for chunk in drawn] == [1], "it is there from when it is seen, and isn't drawn before"
    assert {"/obstacles/single/crate", "/path/stop", "/path/to_stop", "/stream/log"} <= set(chunks)
    moved = _column(chunks["/obstacles/single/crate"], "translation")
    assert np.allclose([row[0][0] for row in moved], [1.2 - 0.02 * k for k in range(12)], atol=1e-6)
    assert [row[0] for row in _column(chunks["/stream/log"], "text")] == ["standing", "standing"]
    horizon = [row[0] for row in _column(chunks["/plots/horizon"], "scalars")]
    assert len(horizon) == 12
    assert horizon[2:] == pytest.approx([piece.stops - piece.update for piece in pieces])
    assert all(row[0] > 0.0 for row in _column(chunks["/plots/latency"], "scalars"))
    with pytest.raises(MalformedRequest, match=r"the robot of 000001\.stream has other joints now"):
        render([file], opens_another)
    kept = file.read_bytes()
    file.write_bytes(kept[: 4 + int.from_bytes(kept[:4], "little")])  # the beginning alone
    with pytest.raises(MalformedRequest, match="holds no update"):
        record([file], opens, recording)


def test_all_files_of_a_stream_are_one_recording(tmp_path: Path) -> None:
    """It shows what the recordings of the files show, one after the other."""
    journal = Journal(tmp_path / "s", ASKED, "plain", {}, file_bytes=4_000, most_files=100)
    goal = JointsGoal({"shoulder_pan_joint": 1.2, "elbow_joint": 0.9})
    with CertifiedStream(msgspec.structs.replace(ASKED, goal=goal), robot("ur5"), EMPTY, None, journal) as stream:
        for cycle in range(12):
            now = 0.02 * cycle
            seen = [] if cycle == 5 else [Observation("crate", now, Placement((1.2 - now, 0.1, 0.5)))]
            stream.update(StreamUpdate(now, seen, gone=["crate"] if cycle == 5 else []))
            await_that(journal._entries.empty)
    journal.close()
    files = files_of(tmp_path / "s")
    assert len(files) > 1
    chunks = _drawn(render(files, opens), tmp_path)
    crate = chunks["/obstacles/single/crate"]
    assert _times([one for one in crate if _has(one, "vertex_positions")]) == pytest.approx([0.0, 0.12])
    assert _times([one for one in crate if _has(one, "is_recursive")]) == pytest.approx([0.1])
    moved = [one for one in crate if _has(one, "translation")]
    assert _times(moved) == pytest.approx([0.02 * cycle for cycle in range(12) if cycle != 5])
    held = [path for path in files if len(read(path)[1])]
    each = [_drawn(render([path], opens), tmp_path) for path in held]
    for entity, column in (("/plots/horizon", "scalars"), ("/plots/latency", "scalars"), ("/path/stop", "positions")):
        together = [row for chunk in chunks[entity] for row in _column(chunk, column)]
        assert len(together) == 12
        assert together == [row for one in each for chunk in one[entity] for row in _column(chunk, column)]
    held[0].unlink()
    left = _drawn(render(files, opens), tmp_path)
    assert _times(left["/plots/horizon"]) == _times(chunks["/plots/horizon"])[len(_times(each[0]["/plots/horizon"])) :]


def _drawn(recording: bytes, folder: Path) -> dict[str, list[Any]]:
    """The chunks of a recording that change, by entity."""
    (folder / "read.rrd").write_bytes(recording)
    found: dict[str, list[Any]] = {}
    for chunk in RrdReader(folder / "read.rrd").stream().to_chunks():
        if not chunk.is_static:
            found.setdefault(chunk.entity_path, []).append(chunk)
    return found


def _has(chunk: Any, name: str) -> bool:
    """Whether a chunk has a component of that name."""
    return any(column.endswith(name) for column in chunk.to_record_batch().schema.names)


def _times(chunks: Sequence[Any]) -> list[float]:
    """When the rows of some chunks are, in order [s]."""
    times = [time for chunk in chunks for time in chunk.to_record_batch().column("path_time").to_pylist()]
    return sorted(time.total_seconds() for time in times)


def _column(chunk: object, name: str) -> list[object]:
    """The rows of a component by the end of its name."""
    batch = chunk.to_record_batch()
    (column,) = (one for one in batch.schema.names if one.endswith(name))
    return batch.column(column).to_pylist()


def test_the_demonstration_serves_and_can_be_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demonstration, "LASTS", 0.6)
    told = CliRunner().invoke(app, ["demo", "--stream", "--folder", str(tmp_path)])
    assert told.exit_code == 1, "no place is reached so soon"
    assert "done again: the same, to the last bit" in told.output
    assert (tmp_path / "demo-stream.rrd").read_bytes()[:3] == b"RRF"
    command = ["replay", str(tmp_path / "demo-stream" / "000001.stream"), "--record", str(tmp_path / "again.rrd")]
    told = CliRunner().invoke(app, command)
    assert told.exit_code == 0
    assert "bit-identical: 30 updates" in told.output
    assert (tmp_path / "again.rrd").read_bytes()[:3] == b"RRF"
    for number in range(3):
        path = np.array([demonstration.box_at(number, 0.01 * k) for k in range(1_700)])
        assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() < 0.01 * demonstration.FASTEST
