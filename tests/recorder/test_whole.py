"""Recordings in a store, which share their robot's meshes, and what leaves it: one file with everything."""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from guidefield.recorder import bodies
from guidefield.recorder.reading import LEFT_OUT, self_contained
from guidefield.recorder.rrd_file import read_meshes
from guidefield.recorder.stored import Place
from guidefield.robot.bodies.sphere_cover import coverage
from tests.recorder.runs import MadeUp, Recording, made_up

MOST_STORED = 500_000
"""Bytes that a run may cost beside its robot's meshes."""


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
    run.record(folder / "run.rrd", Place(folder / "run.rrd", folder / "robots", whole=False))
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


def test_what_is_whole_leaves_as_it_is(run, tmp_path):
    run.record(tmp_path / "whole.rrd")
    assert self_contained(tmp_path / "whole.rrd", tmp_path) == (tmp_path / "whole.rrd").read_bytes()


def test_a_run_costs_little_beside_its_robots_meshes(stored):
    assert stored[0].stat().st_size < MOST_STORED
    assert len(self_contained(*stored)) < MOST_STORED + sum(file.stat().st_size for file in stored[1].iterdir())


def test_meshes_are_kept_once_and_made_again_when_they_are_gone(run, tmp_path):
    file, robots = tmp_path / "run.rrd", tmp_path / "robots"
    run.record(file, Place(file, robots, whole=False))
    (meshes,) = robots.iterdir()
    made = meshes.stat().st_mtime_ns
    run.record(file, Place(file, robots, whole=False))
    assert [(one, one.stat().st_mtime_ns) for one in robots.iterdir()] == [(meshes, made)]
    meshes.write_bytes(meshes.read_bytes()[:10_000])
    bodies._PREPARED.forget(run.group.robot, robots)
    run.record(file, Place(file, robots, whole=False))
    assert list(robots.iterdir()) == [meshes]
    assert len(read_meshes(meshes)) > 20
    meshes.unlink()
    run.record(file, Place(file, robots, whole=False))
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


def test_a_disk_that_refuses_the_meshes_is_told_in_the_summary(run, tmp_path):
    (tmp_path / "robots").write_text("no folder")
    file = tmp_path / "run.rrd"
    run.record(file, Place(file, tmp_path / "robots", whole=False))
    (summary,) = Recording(file).one("/documents/summary", "TextDocument:text")
    assert "the robot's meshes could not be kept" in summary


def test_so_many_robots_are_kept_and_the_one_used_longest_ago_is_dropped(run, tmp_path, monkeypatch):
    monkeypatch.setattr(bodies, "MOST_FILES", 3)
    robots, now = tmp_path / "robots", time.time()
    robots.mkdir()
    for name, age in (
        ("a.rrd", 50.0),
        ("b.rrd", 900.0),
        ("c.rrd", 100.0),
        (".d.draft", 9e3),
        (".e.draft", 9.0),
    ):
        (robots / name).write_text("")
        os.utime(robots / name, (now - age, now - age))
    drawn = bodies.prepared(run.group.robot, robots)
    assert {file.name for file in robots.iterdir()} == {"a.rrd", "c.rrd", drawn.file.name, ".e.draft"}


def test_what_a_service_needs_to_hand_recordings_out_is_there_quickly() -> None:
    heavy = "{'numba', 'pinocchio', 'coal', 'trimesh', 'scipy'}"
    code = f"import sys, guidefield.recorder.reading; print({heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "set()"
