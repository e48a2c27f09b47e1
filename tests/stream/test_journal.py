"""A stream's journal: each of its files gives the same pieces again, and the oldest are dropped."""

import contextlib
import os
from itertools import count
from pathlib import Path

import msgspec
import numpy as np
import pytest

from guidefield.cli.found_run import replay_stream
from guidefield.engine import Engine
from guidefield.errors import GuidefieldError, InvalidGoal, MalformedRequest, UnknownObject
from guidefield.messages.scene import Scene, Sphere
from guidefield.messages.streams import Observation, Piece, StreamObstacle, StreamOpen, StreamUpdate
from guidefield.messages.values import JointsGoal, Placement, PoseGoal
from guidefield.scene.scene import build
from guidefield.stream import journal as journals
from guidefield.stream.journal import (
    FILE_BYTES,
    MOST_FILES,
    MOST_KEPT,
    Journal,
    begin,
    file_bytes,
    files_of,
    kept_files,
    read,
    replay,
)
from guidefield.stream.path_planner import TakeOver, WhenReady
from guidefield.stream.shown import render
from guidefield.stream.state import encode_part
from guidefield.stream.stream import CertifiedStream
from tests.journeys.service import await_that
from tests.robots import robot

EMPTY = build(Scene("empty"))
BALLS = [StreamObstacle(Sphere(name=name, radius=0.1), 0.4) for name in ("ball", "puck")]
ASKED = StreamOpen(
    "ur5",
    "empty",
    JointsGoal({"shoulder_pan_joint": 1.6, "elbow_joint": 1.0}),
    start={"shoulder_lift_joint": -1.0, "elbow_joint": 1.0},
    obstacles=BALLS,
)
GOALS = [
    JointsGoal({"shoulder_pan_joint": -0.5, "elbow_joint": 1.2}),
    PoseGoal((0.4, 0.3, 0.5), (1.0, 0.0, 0.0, 0.0)),
    None,
    JointsGoal({"elbow_joint": 9.0}),
    JointsGoal({"shoulder_pan_joint": 1.2, "elbow_joint": 1.0}),
]


def opens(request: StreamOpen, taking: TakeOver) -> CertifiedStream:
    return CertifiedStream(request, robot("ur5"), EMPTY, taking)


def seen(name: str, now: float, rng: np.random.Generator) -> Observation:
    angle = 0.7 * now + (1.0 if name == "ball" else 4.0)
    place = (0.55 * np.cos(angle), 0.55 * np.sin(angle), 0.4 + 0.1 * np.sin(3.0 * now))
    velocity = tuple(rng.normal(0.0, 0.1, 3).tolist())
    return Observation(name, now, Placement(place), velocity)


def eventful(stream: CertifiedStream, cycles: int, journal: Journal | None = None, files: int = 0) -> int:
    """Updates, goals, stops and faults of all kinds, until there are so many files; how many pieces came of it."""
    rng, pieces = np.random.default_rng(3), 0
    for cycle in range(cycles):
        if journal is not None and journal._index == files:
            break
        now = 0.02 * cycle
        update = StreamUpdate(now, [seen(name, now, rng) for name in ("ball", "puck") if rng.random() < 0.8])
        if cycle % 23 == 7:
            stream.note(update)
            continue
        if cycle % 41 == 13:
            with pytest.raises(UnknownObject):
                stream.update(msgspec.structs.replace(update, gone=["nobody"]))
        if cycle % 37 == 5:
            stream.stop()
        if cycle % 19 == 11:
            with contextlib.suppress(InvalidGoal):
                stream.aim_for(GOALS[(cycle // 19) % len(GOALS)])
        if cycle % 29 == 3:
            gone = StreamUpdate(now, update.obstacles, declare=[BALLS[1]], gone=["puck"])
            update = msgspec.structs.replace(gone, obstacles=[one for one in gone.obstacles if one.name == "ball"])
        if cycle % 31 == 30:
            update = msgspec.structs.replace(update, time=now - 0.05)
        await_that(lambda: journal is None or journal._entries.empty())
        try:
            pieces += isinstance(stream.update(update), Piece)
        except GuidefieldError:
            continue
    return pieces


def test_every_file_is_repeated_to_the_bit_and_the_oldest_are_dropped(tmp_path: Path) -> None:
    journal = Journal(tmp_path, ASKED, "plain", {"guidefield": "1"}, file_bytes=100_000, most_files=4)
    taking = WhenReady()
    with CertifiedStream(ASKED, robot("ur5"), EMPTY, taking, journal) as stream:
        pieces = eventful(stream, 3_000, journal, 6)
    journal.close()
    assert pieces > 0
    files = files_of(tmp_path)
    assert [file.stem for file in files] == [f"{7 - k:06}" for k in range(len(files), 0, -1)], "the oldest are gone"
    assert 1 < len(files) <= 4
    updates = 0
    for file in files:
        done = replay(file, opens)
        assert done.same, (file, done)
        updates += done.updates
        assert file.stat().st_size < 1_000_000
    assert updates > 20
    begun, _ = read(files[-1])
    assert (begun.request, begun.user, begun.index) == (ASKED, "plain", int(files[-1].stem))


def test_who_replays_is_told_from_where_on_a_stream_is_kept(tmp_path: Path) -> None:
    asked = msgspec.structs.replace(ASKED, scene="table", goal=None, obstacles=[])
    journal = Journal(tmp_path / "s", asked, "plain", {}, file_bytes=1, most_files=1)
    clock = count()
    with Engine().stream(asked, None, journal) as stream:

        def another_file() -> bool:  # who writes may be behind
            stream.update(StreamUpdate(0.02 * next(clock)))
            return journal._index > 2

        await_that(another_file)
    journal.close()
    (file,) = files_of(tmp_path / "s")
    begun, entries = read(file)
    assert begun.index > 1
    told: list[str] = []
    assert replay_stream([file], tmp_path, (), told.append, lambda _: "") == 0
    assert told[-2:] == [  # before them it may say that kernels are compiled
        f"s is kept from {begun.snapshot.state.now} s of its client's clock on:"
        f" {begun.index - 1} files before made room",
        f"s/{file.name}: bit-identical: {len(entries)} updates, 0 pieces",
    ]


def test_a_piece_that_is_another_one_is_found(tmp_path: Path) -> None:
    journal = Journal(tmp_path, ASKED, "plain", {})
    with CertifiedStream(ASKED, robot("ur5"), EMPTY, None, journal) as stream:
        rng = np.random.default_rng(0)
        for cycle in range(5):
            stream.update(StreamUpdate(0.02 * cycle, [seen("ball", 0.02 * cycle, rng)]))
    journal.close()
    (file,) = files_of(tmp_path)
    assert replay(file, opens).pieces == 5
    begun, entries = read(file)
    third = entries[2]
    changed = msgspec.structs.replace(
        third, piece=msgspec.structs.replace(third.piece, stops=third.piece.stops + 1e-12)
    )
    with file.open("wb") as write:
        for one in (begun, *entries[:2], changed, *entries[3:]):
            payload = msgspec.msgpack.encode(one, enc_hook=encode_part)
            write.write(journals._LENGTH.pack(len(payload)) + payload)
    done = replay(file, opens)
    assert (done.same, done.first, done.updates) == (False, 0.04, 3)
    file.write_bytes(file.read_bytes()[:-100])  # whoever wrote it died
    assert len(read(file)[1]) == len(entries) - 1
    file.write_bytes(b"nothing of ours")
    with pytest.raises(MalformedRequest, match="no file of a stream"):
        read(file)


def test_a_file_of_another_version_is_told_from_one_that_is_none(tmp_path: Path) -> None:
    """Such as one from before it was kept when a path was planned last."""
    journal = Journal(tmp_path, ASKED, "plain", {})
    with CertifiedStream(ASKED, robot("ur5"), EMPTY, None, journal) as stream:
        stream.update(StreamUpdate(0.0))
    journal.close()
    (file,) = files_of(tmp_path)
    first, *others = journals.entries_of(file)
    older = msgspec.to_builtins(first, builtin_types=(bytes,), enc_hook=encode_part)
    del older["snapshot"]["state"]["planned"]
    with file.open("wb") as write:
        for one in (older, *others):
            payload = msgspec.msgpack.encode(one, enc_hook=encode_part)
            write.write(journals._LENGTH.pack(len(payload)) + payload)
    for ask in (read, lambda path: replay(path, opens), lambda path: render([path], opens)):
        with pytest.raises(
            MalformedRequest, match=r"000001\.stream hasn't the fields .* `planned` - at `\$\.snapshot\.state`"
        ):
            ask(file)


def test_a_disk_that_refuses_costs_the_journal_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "taken").write_text("")  # where the folder should be
    journal = Journal(tmp_path / "taken", ASKED, "plain", {})
    with CertifiedStream(ASKED, robot("ur5"), EMPTY, None, journal) as stream:
        for cycle in range(3):
            assert isinstance(stream.update(StreamUpdate(0.02 * cycle)), Piece)
    journal.close()
    assert files_of(tmp_path) == []


def test_what_can_not_be_written_in_time_goes_on_in_another_file(tmp_path, monkeypatch):
    monkeypatch.setattr(journals, "MOST_WAITING", 1)
    journal = Journal(tmp_path, ASKED, "plain", {})
    with CertifiedStream(ASKED, robot("ur5"), EMPTY, WhenReady(), journal) as stream:
        eventful(stream, 60)
    journal.close()
    for file in files_of(tmp_path):
        assert replay(file, opens).same


def test_the_oldest_make_room_and_a_name_begins_anew(tmp_path: Path) -> None:
    streams = tmp_path / "streams"
    for index in range(MOST_KEPT + 2):
        folder = begin(streams, f"s{index}")
        (folder / "000001.stream").write_bytes(b"x")
        os.utime(folder / "000001.stream", (index, index))
        os.utime(folder, (index, index))
    assert {folder.name for folder in streams.iterdir()} == {f"s{index}" for index in range(2, MOST_KEPT + 2)}
    again = begin(streams, "s5")
    assert list(again.iterdir()) == []
    assert len(list(streams.iterdir())) == MOST_KEPT


def test_all_streams_of_a_user_keep_its_quota() -> None:
    assert file_bytes(None) == FILE_BYTES
    assert MOST_KEPT * MOST_FILES * file_bytes(2**20) <= 2**20
    assert file_bytes(2**40) == FILE_BYTES


def test_files_are_asked_for_by_the_name_of_its_stream(tmp_path: Path) -> None:
    folder = begin(tmp_path / "streams", "s")
    with pytest.raises(UnknownObject, match="nothing is kept of a stream 's'"):
        kept_files(tmp_path / "streams", "s")
    for number in (1, 2):
        (folder / f"{number:06}.stream").write_bytes(b"x")
    assert [file.stem for file in kept_files(tmp_path / "streams", "s")] == ["000001", "000002"]
    for name in ("..", "../streams/s", ".", "", "s/../s"):
        with pytest.raises(MalformedRequest, match="stream_id"):
            kept_files(tmp_path / "streams", name)
    with pytest.raises(UnknownObject):
        kept_files(tmp_path / "nowhere", "s")
    assert not (tmp_path / "nowhere").exists(), "looking leaves no folder behind"
