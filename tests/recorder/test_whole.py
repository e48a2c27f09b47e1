"""Recordings in a store share meshes and scenes; what leaves it is one file with everything."""

import dataclasses
import errno
import logging
import os
import shutil
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from guidefield.messages import scene as messages
from guidefield.recorder import bodies
from guidefield.recorder.chunks import read_meshes
from guidefield.recorder.stored import FOLDER, LEFT_OUT, LINK, RecordingPlace, read_recording, self_contained
from guidefield.robot.link_bounds import coverage
from guidefield.scene.scene import build
from guidefield.stores.recordings import SCENE_LINK
from tests.recorder.runs import MadeUp, Recording, every_kind, made_up


@pytest.fixture(scope="module")
def run() -> MadeUp:
    """A plan of a robot whose balls are known: were they found meanwhile, by other tests, drawings would differ."""
    run = made_up("xarm7")
    coverage(run.group.robot)
    return run


@pytest.fixture(scope="module")
def first(run: MadeUp, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording in a store."""
    folder = tmp_path_factory.mktemp("store")
    run.record(folder / "run.rrd", RecordingPlace(folder / "run.rrd", folder / "robots", whole=False))
    return folder


@pytest.fixture
def stored(first: Path, tmp_path: Path) -> tuple[Path, Path]:
    """A copy of that recording, and of the folder of the meshes."""
    shutil.copytree(first, tmp_path, dirs_exist_ok=True)
    return tmp_path / "run.rrd", tmp_path / "robots"


def test_what_leaves_a_store_holds_what_a_whole_recording_does(run, stored, tmp_path):
    file, robots = stored
    kept = Recording(file)
    assert not any(path.startswith(("/robot/visual", "/robot/collision")) for path in kept.entities)
    assert kept.stores()[1] == []
    (tmp_path / "left.rrd").write_bytes(self_contained(file, robots))
    run.record(tmp_path / "whole.rrd")
    left, whole = Recording(tmp_path / "left.rrd"), Recording(tmp_path / "whole.rrd")
    assert left.entities == whole.entities
    assert left.entities > kept.entities - {LEFT_OUT}
    (store,), (layout,) = left.stores()
    assert (store.recording_id, layout.application_id) == ("run-1", store.application_id)
    command = [str(Path(sys.executable).with_name("rerun")), "rrd", "verify", str(tmp_path / "left.rrd")]
    subprocess.run(command, check=True, capture_output=True)


def test_meshes_are_kept_once_and_made_again_when_they_are_gone(run, tmp_path):
    file, robots = tmp_path / "run.rrd", tmp_path / "robots"
    run.record(file, RecordingPlace(file, robots, whole=False))
    (meshes,) = robots.iterdir()
    made = meshes.stat().st_mtime_ns
    run.record(file, RecordingPlace(file, robots, whole=False))
    assert [(one, one.stat().st_mtime_ns) for one in robots.iterdir()] == [(meshes, made)]
    meshes.write_bytes(meshes.read_bytes()[:10_000])
    bodies._PREPARED.forget(run.group.robot, robots)
    run.record(file, RecordingPlace(file, robots, whole=False))
    assert list(robots.iterdir()) == [meshes]
    assert len(read_meshes(meshes)) > 20
    meshes.unlink()
    run.record(file, RecordingPlace(file, robots, whole=False))
    assert list(robots.iterdir()) == [meshes]


@pytest.mark.parametrize("how", ["gone", "cut"])
def test_a_recording_whose_meshes_are_missing_leaves_without_them_and_says_so(stored, tmp_path, how, caplog):
    file, robots = stored
    (meshes,) = robots.iterdir()
    if how == "gone":
        meshes.unlink()
    else:
        meshes.write_bytes(meshes.read_bytes()[:10_000])
    with caplog.at_level(logging.WARNING):
        content = self_contained(file, robots)
    assert "meshes are missing from a recording" in caplog.text
    (tmp_path / "left.rrd").write_bytes(content)
    left = Recording(tmp_path / "left.rrd")
    (summary,) = left.one("/documents/summary", "TextDocument:text")
    assert "the robot's meshes are not in this recording" in summary
    assert "the tip reaches GP 2" in summary
    assert {"/ghosts", "/obstacles/boxes", "/robot/model/frames"} <= left.entities


OBSTACLES = {"/obstacles/boxes", "/obstacles/walls", "/obstacles/single/wedge"}


def crowd(count: int) -> messages.Scene:
    """One obstacle of every kind, and many boxes far away."""
    boxes = [messages.Box(name=f"b{k}", size=(0.1, 0.1, 0.1), position=(5.0, 0.01 * k, 0.0)) for k in range(count)]
    scene = every_kind()
    return msgspec.structs.replace(scene, obstacles=[*scene.obstacles, *boxes])


@pytest.fixture(scope="module")
def crowded() -> MadeUp:
    made, message = made_up("xarm7"), crowd(600)
    request = msgspec.structs.replace(made.request, scene=message)
    return dataclasses.replace(made, scene=build(message), request=request)


def record(crowded: MadeUp, data: Path, name: str) -> Path:
    """Write a recording into a store's folder."""
    file = data / "recordings" / f"{name}.rrd"
    file.parent.mkdir(exist_ok=True)
    crowded.record(file, RecordingPlace(file, data / "runs-robots", whole=False))
    return file


def test_recordings_share_the_file_of_their_scene_and_leave_with_it(crowded: MadeUp, tmp_path: Path) -> None:
    first, second = (record(crowded, tmp_path, name) for name in ("one", "two.and"))
    (drawn,) = (tmp_path / FOLDER).iterdir()
    assert [one.with_suffix(LINK).samefile(drawn) for one in (first, second)] == [True, True]
    assert OBSTACLES.isdisjoint(Recording(first).entities)
    (tmp_path / "left.rrd").write_bytes(self_contained(first, tmp_path / "runs-robots"))
    crowded.record(tmp_path / "whole.rrd")
    left, whole_one = Recording(tmp_path / "left.rrd"), Recording(tmp_path / "whole.rrd")
    assert OBSTACLES < left.entities == whole_one.entities
    for column in ("Boxes3D:half_sizes", "Boxes3D:centers", "Boxes3D:labels"):
        assert left.one("/obstacles/boxes", column) == whole_one.one("/obstacles/boxes", column)
    for file in (first, tmp_path / "left.rrd", tmp_path / "whole.rrd"):
        assert read_recording(file).request == crowded.request


def test_a_scene_of_others_has_a_file_of_its_own_and_goes_when_nothing_needs_it(crowded, tmp_path):
    file = record(crowded, tmp_path, "one")
    (first,) = (tmp_path / FOLDER).iterdir()
    os.utime(first, (0.0, 0.0))
    other = dataclasses.replace(crowded, scene=build(crowd(601)))
    record(other, tmp_path, "two")
    assert first.exists()  # a recording is linked to it
    file.with_suffix(LINK).unlink()
    os.utime(first, (0.0, 0.0))
    record(dataclasses.replace(crowded, scene=build(crowd(602))), tmp_path, "three")
    assert not first.exists()
    assert len(list((tmp_path / FOLDER).iterdir())) == 2
    assert LINK == SCENE_LINK


def test_a_recording_whose_scene_is_missing_leaves_without_it_and_says_so(crowded: MadeUp, tmp_path: Path) -> None:
    file = record(crowded, tmp_path, "one")
    file.with_suffix(LINK).unlink()
    (tmp_path / "left.rrd").write_bytes(self_contained(file, tmp_path / "runs-robots"))
    left = Recording(tmp_path / "left.rrd")
    assert "the scene is not in this recording" in left.one("/documents/summary", "TextDocument:text")[0]
    assert {"/ghosts", "/robot/model/frames"} <= left.entities


def test_where_a_disk_has_no_links_the_scene_is_in_the_recording(crowded, tmp_path, monkeypatch):
    def refused(*_: object) -> None:
        raise OSError(errno.EPERM, "no links here")

    monkeypatch.setattr(Path, "hardlink_to", refused)
    file = record(crowded, tmp_path, "one")
    assert Recording(file).entities > OBSTACLES
    assert read_recording(file).request == crowded.request
