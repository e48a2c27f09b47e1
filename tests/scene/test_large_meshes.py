"""What is found for a large mesh or cloud is kept on disk, and is the same to the last bit."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from guidefield.collision.lanes import scene_tables
from guidefield.deadline import UNLIMITED, Deadline, DeadlineExpired
from guidefield.geometry import cache
from guidefield.handlers.preparation import prepare_plan
from guidefield.kernels.jit.cache import cache_folder
from guidefield.messages.scene import Mesh, PointCloud, Scene as Message
from guidefield.prove import tables
from guidefield.scene import distance_tables as of_scene, obstacle, recipe
from guidefield.scene.crop import Ball, crop
from guidefield.scene.scene import Scene, build
from tests.scene.test_mesh import box_mesh, room

SIDE = 40
FEWER = {(cache, "LARGE"): 1_000, (scene_tables, "MOST_TRIANGLES"): 500, (recipe, "PATCH"): 800}
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
    lanes, distances = scene_tables.lane_scene(scene), of_scene.distance_tables(scene)
    arrays = [*lanes.tables[0][1:], *lanes.tables[1], lanes.owners, *distances[:-2], *distances.surfaces]
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
    for owner, name in ((cache, "write_arrays"), (cache.Draft, "room")):
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


def test_patches_are_read_as_they_were_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def patches() -> list[bytes]:
        found = new_scene().obstacles[0].recipe.facets.patches
        return [array.tobytes() for array in (found._triangles, found._low, found._high)]

    first = patches()
    assert "patches" in kinds()
    nothing_is_written(monkeypatch)
    assert patches() == first
    monkeypatch.setattr(cache, "LARGE", 10**9)
    assert patches() == first, "without a file too"


def test_what_is_seen_is_read_alone_and_is_what_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    found, (whole, read) = everything(met(new_scene())), (everything(new_scene()), list[str]())
    reading = cache.read_arrays
    nothing_is_written(monkeypatch)
    monkeypatch.setattr(cache, "read_arrays", lambda path: (read.append(path.name.partition("-")[0]), reading(path))[1])
    part = met(new_scene())
    assert everything(part) == found
    assert {"mesh", "seen"} <= set(read)
    assert "surface" not in read, "most of it is met by nobody"
    vertices, triangles = part.obstacles[0].whole_surface
    assert "surface" in read
    alone = new_scene().obstacles[0]
    assert vertices.tobytes() == alone.whole_surface[0].tobytes()
    assert triangles.tobytes() == alone.whole_surface[1].tobytes()
    assert everything(new_scene()) == whole


def test_another_ball_or_shape_sees_something_else() -> None:
    scene = new_scene()
    parts = [crop(scene, Ball(x, 0.1, 0.5, 0.25))[0].obstacles[0] for x in (0.2, 0.3)]
    moved = msgspec.structs.replace(message().obstacles[0], position=[0.1, 0.1, 0.2])
    parts.append(crop(build(Message(name="kept", obstacles=[moved])), Ball(0.2, 0.1, 0.5, 0.25))[0].obstacles[0])
    assert len({part.recipe.content for part in parts}) == 3
    assert len(list(cache.folder().glob("seen-*"))) == 3
    assert len({part.recipe.surface(part.message)[0].tobytes() for part in parts}) == 3


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


def test_entries_that_go_one_by_one_are_made_again() -> None:
    scene = new_scene()
    found = everything(met(scene)), everything(scene)
    for kind in sorted(kinds()):
        known = new_scene()
        for path in cache.folder().glob(f"{kind}-*"):
            path.unlink()
        assert (everything(met(known)), everything(known)) == found, "it went after it was known to be there"
        again = new_scene()
        assert (everything(met(again)), everything(again)) == found


def test_a_mesh_without_area_is_refused_from_disk_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "LARGE", 1)
    for corners in ([0, 1, 2], [0, 0, 1]):
        flat = Mesh(name="flat", vertices=[[0, 0, 0], [1, 0, 0], [2, 0, 0]], triangles=[corners])
        for _ in range(2):
            with pytest.raises(obstacle.SceneInvalid, match="no triangle with an area"):
                build(Message(name="thin", obstacles=[flat]))
    assert kinds() == {"mesh"}


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
        assert other.stdout is not None
        assert other.stdout.readline() == "begins\n"
        scene = new_scene()
        own = repr([everything(met(scene)), everything(scene)]).encode()
        told = other.communicate(timeout=600)[0]
    assert (other.returncode, told) == (0, hashlib.sha256(own).hexdigest() + "\n")
    assert kinds() == {"mesh", "surface", "seen", "lanes", "bodies"}


def test_meshes_keep_the_folders_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    new = everything(new_scene())
    size = sum(path.stat().st_size for path in cache.folder().iterdir())
    monkeypatch.setattr(cache, "MOST_BYTES", size // 2)
    moved = msgspec.structs.replace(message().obstacles[0], position=[0.5, 0.5, 0.5])
    everything(build(Message(name="elsewhere", obstacles=[moved])))
    monkeypatch.setattr(cache, "LOOK_SHARE", 0.0)
    everything(build(Message(name="elsewhere", obstacles=[msgspec.structs.replace(moved, position=[0.7, 0.5, 0.5])])))
    assert sum(path.stat().st_size for path in cache.folder().iterdir()) <= size // 2
    assert everything(new_scene()) == new


POINTS = np.random.default_rng(3).uniform([-3.0, -3.0, -0.1], [3.0, 3.0, 0.0], (20_000, 3)).tolist()


def of_cloud(one: obstacle.Obstacle) -> list[bytes]:
    """What is made of a cloud, and of what is met of it, as bytes."""
    scene = build(Message(name="kept", obstacles=[one.message]))
    parts = [replace(scene, obstacles=(one,))]
    parts.append(crop(parts[0], Ball(0.2, 0.1, 0.5, 0.25))[0])
    assert parts[1].obstacles[0].faces < 0.7 * len(POINTS)
    made = [array for part in parts for array in tables._obstacle_parts(part)[1]]
    return [array.tobytes() for array in (*made, *(part.obstacles[0].cloud.points for part in parts))]


def test_a_cloud_is_kept_with_what_is_met_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    message = PointCloud(name="points", points=POINTS, radius=0.01)
    made = obstacle.build(message, 0)
    alone = of_cloud(replace(made, recipe=made.recipe._replace(content=b"")))
    assert kinds() == set()
    assert of_cloud(made) == alone
    assert kinds() == {"points", "balls"}
    obstacle._KNOWN.clear()
    again, wider = (obstacle.build(msgspec.structs.replace(message, radius=r), 0) for r in (0.01, 0.02))
    assert of_cloud(wider) != alone
    nothing_is_written(monkeypatch)
    assert of_cloud(again) == alone


def test_a_cloud_that_moves_is_not_known_by_its_points() -> None:
    pose = {"position": (0.1, 0.0, 0.0), "quaternion_xyzw": (0.0, 0.0, 0.0, 1.0)}
    declared = {"type": "point_cloud", "points": POINTS, "radius": 0.01}
    moving = {**declared, "name": "moving", "trajectory": {"times": [0.0, 1.0], "placements": [pose, pose]}}
    both = [{**declared, "name": "resting"}, moving]
    scene = build(msgspec.convert({"name": "kept", "obstacles": both}, Message, strict=False))
    assert scene.obstacles[0].recipe.content
    assert not scene.obstacles[1].recipe.content
