"""Large scenes, drawn and written once for all recordings in them: linked, joined on, and gone with the last one."""

import dataclasses
import errno
import os
from pathlib import Path

import msgspec
import pytest

from guidefield.messages import scene as messages
from guidefield.recorder.stored import FOLDER, LINK, RecordingPlace, read_recording, self_contained
from guidefield.scene.scene import build
from guidefield.stores.recordings import SCENE_LINK
from tests.recorder.runs import MadeUp, Recording, every_kind, made_up

OBSTACLES = {"/obstacles/boxes", "/obstacles/walls", "/obstacles/single/wedge"}


def crowd(count: int) -> messages.Scene:
    """One obstacle of every kind, and many boxes far away."""
    boxes = [messages.Box(name=f"b{k}", size=(0.1, 0.1, 0.1), position=(5.0, 0.01 * k, 0.0)) for k in range(count)]
    scene = every_kind()
    return msgspec.structs.replace(scene, obstacles=[*scene.obstacles, *boxes])


@pytest.fixture(scope="module")
def run() -> MadeUp:
    made, message = made_up("xarm7"), crowd(600)
    request = msgspec.structs.replace(made.request, scene=message)
    return dataclasses.replace(made, scene=build(message), request=request)


def record(run: MadeUp, data: Path, name: str) -> Path:
    """Write a recording into a store's folder."""
    file = data / "recordings" / f"{name}.rrd"
    file.parent.mkdir(exist_ok=True)
    run.record(file, RecordingPlace(file, data / "runs-robots", whole=False))
    return file


def test_recordings_share_the_file_of_their_scene_and_leave_with_it(run: MadeUp, tmp_path: Path) -> None:
    first, second = (record(run, tmp_path, name) for name in ("one", "two.and"))
    (drawn,) = (tmp_path / FOLDER).iterdir()
    assert [one.with_suffix(LINK).samefile(drawn) for one in (first, second)] == [True, True]
    assert OBSTACLES.isdisjoint(Recording(first).entities)
    (tmp_path / "left.rrd").write_bytes(self_contained(first, tmp_path / "runs-robots"))
    run.record(tmp_path / "whole.rrd")
    left, whole_one = Recording(tmp_path / "left.rrd"), Recording(tmp_path / "whole.rrd")
    assert OBSTACLES < left.entities == whole_one.entities
    for column in ("Boxes3D:half_sizes", "Boxes3D:centers", "Boxes3D:labels"):
        assert left.one("/obstacles/boxes", column) == whole_one.one("/obstacles/boxes", column)
    for file in (first, tmp_path / "left.rrd", tmp_path / "whole.rrd"):
        assert read_recording(file).request == run.request


def test_a_scene_of_others_has_a_file_of_its_own_and_goes_when_nothing_needs_it(run: MadeUp, tmp_path: Path) -> None:
    file = record(run, tmp_path, "one")
    (first,) = (tmp_path / FOLDER).iterdir()
    os.utime(first, (0.0, 0.0))
    other = dataclasses.replace(run, scene=build(crowd(601)))
    record(other, tmp_path, "two")
    assert first.exists()  # a recording is linked to it
    file.with_suffix(LINK).unlink()
    os.utime(first, (0.0, 0.0))
    record(dataclasses.replace(run, scene=build(crowd(602))), tmp_path, "three")
    assert not first.exists()
    assert len(list((tmp_path / FOLDER).iterdir())) == 2
    assert LINK == SCENE_LINK


def test_a_recording_whose_scene_is_missing_leaves_without_it_and_says_so(run: MadeUp, tmp_path: Path) -> None:
    file = record(run, tmp_path, "one")
    file.with_suffix(LINK).unlink()
    (tmp_path / "left.rrd").write_bytes(self_contained(file, tmp_path / "runs-robots"))
    left = Recording(tmp_path / "left.rrd")
    assert "the scene is not in this recording" in left.one("/documents/summary", "TextDocument:text")[0]
    assert {"/ghosts", "/robot/model/frames"} <= left.entities


def test_where_a_disk_has_no_links_the_scene_is_in_the_recording(
    run: MadeUp, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise OSError(errno.EPERM, "no links here")

    monkeypatch.setattr(Path, "hardlink_to", refused)
    file = record(run, tmp_path, "one")
    assert Recording(file).entities > OBSTACLES
    assert read_recording(file).request == run.request
