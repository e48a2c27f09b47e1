"""What is found for the shapes of a robot: on any number of processors, stopped anywhere, by two at a time."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from guidefield.collision import part_tables as trees
from guidefield.deadline import Deadline, DeadlineExpired
from guidefield.handlers.preparation import prepare
from guidefield.kernels.jit.cache import cache_folder
from guidefield.memory import MESH_TREES, TRIANGULATIONS, BoundedMap
from guidefield.messages.requests import UrdfFile
from guidefield.robot import link_bounds
from guidefield.robot.catalog import Catalog
from guidefield.robot.link_bounds import coverage, recall_coverage
from guidefield.robot.model import collision_shapes
from tests.geometry import solids
from tests.robot.odd_meshes import odd, stl

PATIENCE = 300.0


@pytest.fixture(autouse=True)
def _cold(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Nothing is known on disk or in memory; the kernels are."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache_folder().parents[1]))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(trees, "_KNOWN", BoundedMap(MESH_TREES))
    monkeypatch.setattr(collision_shapes, "_HULLS", BoundedMap(TRIANGULATIONS))


def many(folder: Path, count: int = 6) -> UrdfFile:
    """A robot of links with meshes of every kind: bent ones of several sizes, odd ones, the same one twice."""
    meshes = [odd(seed) for seed in range(count)]
    for scale in (1.0, 1.5, 1.0):
        vertices, triangles = solids.channel()
        meshes.append(scale * vertices[triangles])
    text = []
    for k, mesh in enumerate(meshes):
        (folder / f"{k}.stl").write_bytes(stl(mesh))
        text.append(
            f'<link name="l{k}"><collision><geometry><mesh filename="{k}.stl"/></geometry></collision></link>'
            + (f'<joint name="j{k}" type="revolute"><origin xyz="0 0 0.4"/><parent link="l{k - 1}"/>' if k else "")
            + (f'<child link="l{k}"/><axis xyz="0 1 0"/>' if k else "")
            + ('<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>' if k else "")
        )
    (folder / "many.urdf").write_text(f'<robot name="many">{"".join(text)}</robot>')
    return UrdfFile(path=str(folder / "many.urdf"))


def kept(folder: Path) -> dict[str, bytes]:
    """All that is on disk, by name."""
    return {path.name: path.read_bytes() for path in (folder / "cache/guidefield/geometry").iterdir()}


def emptied(folder: Path) -> None:
    for path in (folder / "cache/guidefield/geometry").iterdir():
        path.unlink()
    trees._KNOWN.clear()


def test_any_number_of_processors_finds_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    urdf, found = many(tmp_path), []
    for processors in (1, 7):
        monkeypatch.setattr(link_bounds, "usable_processors", lambda count=processors: count)
        told: list[str] = []
        prepare(Catalog().load(urdf), announce=told.append)
        found.append((kept(tmp_path), told))
        emptied(tmp_path)
    assert len(found[0][0]) > 20
    assert found[0] == found[1]


def test_stopped_anywhere_it_goes_on_from_there(tmp_path: Path) -> None:
    urdf, told = many(tmp_path, 2), []
    prepare(Catalog().load(urdf), announce=told.append)
    whole, pieces = kept(tmp_path), len(told)
    emptied(tmp_path)
    assert pieces >= 8
    for _ in range(pieces // 2 - 1):
        begun: list[str] = []
        with pytest.raises(DeadlineExpired) as stopped:
            prepare(Catalog().load(urdf), Deadline(is_cancelled=lambda begun=begun: len(begun) >= 2), begun.append)
        assert len(begun) == 2
        assert str(stopped.value) in told
    prepare(Catalog().load(urdf))
    assert kept(tmp_path) == whole


def test_a_fault_comes_through_and_what_was_found_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Catalog().load(many(tmp_path, 2))
    restored, found = link_bounds.find_or_compute, []

    def failing(*question: object) -> object:
        if len(found) == 2:
            raise MemoryError("no room")
        found.append(restored(*question))
        return found[-1]

    monkeypatch.setattr(link_bounds, "find_or_compute", failing)
    monkeypatch.setattr(link_bounds, "usable_processors", lambda: 1)
    with pytest.raises(MemoryError, match="no room"):
        prepare(robot)
    assert sum(one is not None for one in recall_coverage(robot)) >= 2
    monkeypatch.undo()


def test_two_at_a_time_find_the_same(tmp_path: Path) -> None:
    urdf = many(tmp_path, 2)
    robots, faults = [Catalog().load(urdf) for _ in range(2)], []
    barrier = threading.Barrier(2)

    def one(robot: object) -> None:
        try:
            barrier.wait(PATIENCE)
            prepare(robot)
        except BaseException as fault:
            faults.append(fault)

    threads = [threading.Thread(target=one, args=(robot,)) for robot in robots]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    assert not faults
    for first, second in zip(*(coverage(robot).shapes for robot in robots), strict=True):
        assert first.cover.spheres.tobytes() == second.cover.spheres.tobytes()
        assert first.inner.tobytes() == second.inner.tobytes()


CHILD = """
import sys
from guidefield.handlers.preparation import prepare
from guidefield.messages.requests import UrdfFile
from guidefield.robot.catalog import Catalog
prepare(Catalog().load(UrdfFile(path=sys.argv[1])), announce=lambda what: print(what, flush=True))
"""


def test_processes_that_are_killed_or_race_leave_what_is_right(tmp_path: Path) -> None:
    urdf = many(tmp_path, 2)
    prepare(Catalog().load(urdf))
    whole = kept(tmp_path)
    emptied(tmp_path)
    killed, racing = (
        subprocess.Popen([sys.executable, "-c", CHILD, urdf.path], stdout=subprocess.PIPE, text=True) for _ in range(2)
    )
    for child in (killed, racing):
        for _ in range(3):
            child.stdout.readline()
    os.kill(killed.pid, signal.SIGKILL)
    killed.communicate(timeout=PATIENCE)
    prepare(Catalog().load(urdf))
    racing.communicate(timeout=PATIENCE)
    assert racing.returncode == 0
    assert {name: content for name, content in kept(tmp_path).items() if not name.startswith(".")} == whole
