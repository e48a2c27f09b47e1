"""What is found for a large mesh or cloud is kept on disk, and is the same to the last bit."""

import contextlib
import errno
import hashlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from guidefield.collision.batch import scene_tables
from guidefield.deadline import UNLIMITED, Deadline, DeadlineExpired
from guidefield.geometry import cache
from guidefield.handlers.preparation import prepare_plan
from guidefield.kernels.jit.cache import cache_folder
from guidefield.messages.scene import Mesh, Scene as Message
from guidefield.scene import distance_tables as of_scene, obstacle, obstacle_parts
from guidefield.scene.crop import Ball, crop
from guidefield.scene.scene import Scene, build
from tests.scene.test_mesh import box_mesh, room

SIDE = 40
FEWER = {(cache, "LARGE"): 1_000, (scene_tables, "MOST_TRIANGLES"): 500, (obstacle_parts, "PATCH"): 800}
"""A terrain of so many squares a side counts as large by these."""


def terrain() -> dict[str, Any]:
    """An open mesh that crosses itself."""
    u = np.linspace(-1.0, 1.0, SIDE + 1)
    x, y = (axis.ravel() for axis in np.meshgrid(u, u, indexing="ij"))
    corner = (np.arange(SIDE)[:, None] * (SIDE + 1) + np.arange(SIDE)).ravel()
    halves = [[corner, corner + SIDE + 1, corner + 1], [corner + 1, corner + SIDE + 1, corner + SIDE + 2]]
    vertices = np.column_stack([x, y, 0.1 * np.sin(3.0 * x)])
    vertices[0, 2] -= 3.0
    vertices[SIDE + 3] = 0.9, 0.9, -0.2
    return {"vertices": vertices.tolist(), "triangles": np.concatenate([np.column_stack(h) for h in halves]).tolist()}


def listed(vertices: np.ndarray, triangles: np.ndarray) -> dict[str, Any]:
    return {"vertices": np.asarray(vertices).tolist(), "triangles": np.asarray(triangles).tolist()}


MESHES = {
    "open": terrain(),
    "convex": listed(*box_mesh()),
    "hollow": listed(*room(2.0, 1.0)),
    "inside out": listed(room(2.0, 1.0)[0], np.asarray(room(2.0, 1.0)[1])[:, ::-1]),
}


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache_folder().parents[1]))  # the kernels' is full
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for (where, name), value in FEWER.items():
        monkeypatch.setattr(where, name, value)


def message() -> Message:
    return Message(
        name="kept",
        obstacles=[
            Mesh(name=name, position=[3.0 * k, 0.1, 0.2], quaternion_xyzw=[0.6, 0.0, 0.0, 0.8], **mesh)
            for k, (name, mesh) in enumerate(MESHES.items())
        ],
    )


def new_scene() -> Scene:
    """The scene, as a new process makes it."""
    obstacle._KNOWN.clear()
    return build(message())


def everything(scene: Scene) -> list[Any]:
    """All that is made of a scene, as bytes."""
    batch, distances = scene_tables.batch_scene(scene), of_scene.distance_tables(scene)
    arrays = [*batch.tables[0][1:], *batch.tables[1], batch.owners, *distances[:-2], *distances.surfaces]
    arrays += [array for one in scene.obstacles for array in (one.vertices, one.triangles, one.box)]
    told = [(one.solid, one.convex, one.warnings) for one in scene.obstacles]
    return [told, *((np.asarray(a).dtype, np.shape(a), np.asarray(a).tobytes()) for a in arrays)]


def met(scene: Scene) -> Scene:
    """What is met of it in a ball above the terrain."""
    part = crop(scene, Ball(0.2, 0.1, 0.5, 0.25))[0]
    assert part.obstacles[0].faces < 0.5 * scene.obstacles[0].faces
    return part


def kinds() -> set[str]:
    return {path.name.partition("-")[0] for path in cache.folder().glob("*-*")}


def nothing_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    for owner, name in ((cache, "write_arrays"), (cache.Draft, "allocate")):
        monkeypatch.setattr(owner, name, lambda *_: pytest.fail("it is there"))


def test_what_is_kept_is_what_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    found = everything(new_scene())
    assert kinds() == {"mesh", "surface", "lanes", "bodies"}
    assert len(list(cache.folder().glob("mesh-*"))) == 1, "small meshes are no files"
    monkeypatch.setattr(cache, "LARGE", 10**9)
    alone = everything(new_scene())
    monkeypatch.setattr(cache, "LARGE", 1)
    first, many = everything(new_scene()), len(list(cache.folder().glob("mesh-*")))
    nothing_is_written(monkeypatch)
    again = everything(new_scene())
    assert many == len(MESHES)
    assert alone == found
    assert first == found
    assert again == found
    assert any("cross" in warning for warning in new_scene().warnings)


def test_a_full_disk_costs_time_alone(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    scene = new_scene()
    found = everything(met(scene)), everything(scene)
    for path in cache.folder().glob("*-*"):
        path.unlink()

    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, "no space left")

    monkeypatch.setattr(cache, "write_whole", full)
    monkeypatch.setattr(cache.os, "posix_fallocate", full)
    for _ in range(2):
        scene = new_scene()
        assert (everything(met(scene)), everything(scene)) == found
    assert "no space left" in caplog.text
    assert kinds() == set()


def test_damaged_entries_are_made_again(caplog: pytest.LogCaptureFixture) -> None:
    found = everything(met(new_scene())), everything(new_scene())
    for path in cache.folder().glob("*-*"):
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    assert (everything(met(new_scene())), everything(new_scene())) == found
    assert caplog.text.count("is damaged and") == len(list(cache.folder().glob("*-*")))


def test_a_tree_is_whole_or_not_begun_whenever_time_is_up() -> None:
    """Where each request began it anew, and had less time than it takes, none was ever answered."""
    scene = new_scene()
    with pytest.raises(DeadlineExpired):
        scene_tables.prepare_scene(scene, Deadline(0.0))
    assert "lanes" not in kinds()
    with contextlib.suppress(DeadlineExpired):
        asked = iter([False])
        scene_tables.prepare_scene(scene, Deadline(is_cancelled=lambda: next(asked, True)))
    assert "lanes" in kinds()
    scene_tables.prepare_scene(scene, UNLIMITED)
    prepare_plan(None, scene, UNLIMITED)


OTHER = """
import hashlib
from tests.scene.test_large_meshes import FEWER, everything, met, new_scene
for (where, name), value in FEWER.items():
    setattr(where, name, value)
print("begins", flush=True)
scene = new_scene()
print(hashlib.sha256(repr([everything(met(scene)), everything(scene)]).encode()).hexdigest())
"""
"""Tells what it found, in short."""


def test_two_processes_at_once_find_the_same() -> None:
    with subprocess.Popen([sys.executable, "-c", OTHER], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "begins\n"
        scene = new_scene()
        own = repr([everything(met(scene)), everything(scene)]).encode()
        told = other.communicate(timeout=600)[0]
    assert (other.returncode, told) == (0, hashlib.sha256(own).hexdigest() + "\n")
    assert kinds() == {"mesh", "surface", "seen", "lanes", "bodies"}
