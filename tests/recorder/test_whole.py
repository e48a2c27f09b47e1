"""Recordings in a store, which share their robot's meshes, and what leaves it: one file with everything."""

import logging
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from guidefield.recorder import bodies
from guidefield.recorder.chunks import read_meshes
from guidefield.recorder.stored import LEFT_OUT, RecordingPlace, self_contained
from guidefield.robot.link_bounds import coverage
from tests.recorder.runs import MadeUp, Recording, made_up


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
