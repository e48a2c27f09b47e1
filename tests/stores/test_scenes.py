"""Stored scenes: by name and version, damaged ones too, seen alike by several processes."""

import json
import threading
from pathlib import Path

import pytest

from guidefield.errors import MalformedRequest, RequestTooLarge, SceneInvalid
from guidefield.messages import codec
from guidefield.messages.scene import Box, PointCloud, Scene, Sphere
from guidefield.messages.scene_changes import MAX_VERSIONS, SceneDiff
from guidefield.messages.values import Float32Array, Placement
from guidefield.stores import scenes
from guidefield.stores.scenes import PackagedScenes, SceneStore

BLOCK = Scene("block", obstacles=[Box(name="b", size=(0.1, 0.2, 0.3))])


@pytest.fixture
def store(tmp_path: Path) -> SceneStore:
    return SceneStore(tmp_path / "scenes")


def test_the_packaged_scenes_are_there_from_the_start(store: SceneStore) -> None:
    assert store.names() == PackagedScenes().names() == sorted(scenes.list_packaged())
    assert store.read("bookshelf")[0] == PackagedScenes().read("bookshelf")[0] == scenes.read_packaged("bookshelf")


def test_a_stored_scene_is_read_back_by_another_process_store(store: SceneStore, tmp_path: Path) -> None:
    cloud = Scene("cloud", obstacles=[PointCloud(name="c", points=Float32Array(bytes(24)), radius=0.01)])
    for scene in (BLOCK, cloud):
        store.write(scene)
        assert SceneStore(tmp_path / "scenes").read(scene.name)[0] == scene
    assert (tmp_path / "scenes" / "block.json").exists()
    assert {"block", "cloud"} <= set(store.names())


def test_a_deleted_scene_is_gone(store: SceneStore) -> None:
    store.write(BLOCK)
    store.delete("block")
    assert "block" not in store.names()
    with pytest.raises(SceneInvalid, match="no scene 'block'"):
        store.delete("block")


def test_an_unknown_scene_is_named_with_those_there_are(store: SceneStore) -> None:
    for ask in (store.read, PackagedScenes().read, PackagedScenes().delete):
        with pytest.raises(SceneInvalid, match="no scene 'nowhere'") as unknown:
            ask("nowhere")
        assert "bookshelf" in unknown.value.details["available"]


@pytest.mark.parametrize("name", ["../block", ".block", "a/b"])
def test_no_name_leads_out_of_the_folder(name: str, store: SceneStore, tmp_path: Path) -> None:
    (tmp_path / "block.json").write_text("{}")
    for ask in (store.read, store.delete):
        with pytest.raises(MalformedRequest):
            ask(name)
    with pytest.raises(MalformedRequest):
        store.write(Scene(name))
    assert (tmp_path / "block.json").exists()


def test_the_store_is_bounded(tmp_path: Path) -> None:
    store = SceneStore(tmp_path, limit=1)
    store.write(BLOCK)
    store.write(BLOCK)
    with pytest.raises(RequestTooLarge, match="1 scenes"):
        store.write(Scene("another"))


def test_without_a_folder_nothing_is_stored() -> None:
    with pytest.raises(SceneInvalid, match="send the scene inside the request"):
        PackagedScenes().write(BLOCK)


BALL = Scene("s", obstacles=[Sphere(name="ball", radius=0.1)])


def to(x: float, version: int | None = None) -> SceneDiff:
    return SceneDiff(move={"ball": Placement((x, 0.0, 0.0))}, version=version)


def place(scene: Scene) -> float:
    (ball,) = scene.obstacles
    return ball.position[0]


@pytest.fixture
def versioned(tmp_path: Path) -> SceneStore:
    return SceneStore(tmp_path)


def test_each_change_is_a_version_and_the_last_ones_can_be_read(versioned: SceneStore, tmp_path: Path) -> None:
    assert versioned.write(BALL) == 1
    for version in range(2, 200):
        after, number = versioned.change("s", to(float(version)))
        assert (place(after), number) == (version, version)
        for reader in (versioned, SceneStore(tmp_path)) if version % 17 == 0 else ():
            assert place(reader.read("s")[0]) == version
            for back in range(min(MAX_VERSIONS, version - 1)):
                scene, number = reader.read("s", version - back)
                assert (place(scene), number) == (version - back, version - back)
            if version > MAX_VERSIONS:
                with pytest.raises(SceneInvalid, match=f"no version {version - MAX_VERSIONS}; the last") as gone:
                    reader.read("s", version - MAX_VERSIONS)
                assert gone.value.details["available"] == list(range(version - MAX_VERSIONS + 1, version + 1))
    with pytest.raises(SceneInvalid, match="no version 200"):
        versioned.read("s", 200)
    assert (tmp_path / "s.changes").stat().st_size < 20_000


def test_another_process_sees_what_changed(versioned: SceneStore, tmp_path: Path) -> None:
    other = SceneStore(tmp_path)
    versioned.write(BALL)
    assert other.read("s") == (BALL, 1)
    versioned.change("s", to(1.0))
    assert place(other.read("s")[0]) == 1.0
    other.change("s", to(2.0))
    assert (place(versioned.read("s")[0]), versioned.read("s")[1]) == (2.0, 3)


def test_a_change_of_another_version_than_is_meant_changes_nothing(versioned: SceneStore) -> None:
    versioned.write(BALL)
    versioned.change("s", to(1.0, version=1))
    with pytest.raises(SceneInvalid, match="has version 2, and version 1 was to be changed") as refused:
        versioned.change("s", to(2.0, version=1))
    assert refused.value.details["version"] == 2
    assert (place(versioned.read("s")[0]), versioned.read("s")[1]) == (1.0, 2)


def test_a_change_that_does_not_fit_changes_nothing(versioned: SceneStore) -> None:
    versioned.write(BALL)
    with pytest.raises(SceneInvalid, match="no obstacle 'post'"):
        versioned.change("s", SceneDiff(move={"ball": Placement((1.0, 0.0, 0.0))}, remove=["post"]))
    assert versioned.read("s") == (BALL, 1)


def test_a_scene_that_an_earlier_version_stored_can_be_read_and_changed(versioned: SceneStore, tmp_path: Path) -> None:
    (tmp_path / "s.json").write_bytes(codec.encode(BALL))
    assert versioned.read("s") == (BALL, 1)
    assert versioned.change("s", to(1.0))[1] == 2


def test_a_change_that_was_cut_short_never_was(versioned: SceneStore, tmp_path: Path) -> None:
    versioned.write(BALL)
    versioned.change("s", to(1.0))
    whole = (tmp_path / "s.changes").read_bytes()
    versioned.change("s", to(2.0))
    more = (tmp_path / "s.changes").read_bytes()
    for end in range(len(whole), len(more)):
        (tmp_path / "s.changes").write_bytes(more[:end])
        cut = SceneStore(tmp_path)
        assert (place(cut.read("s")[0]), cut.read("s")[1]) == (1.0, 2)
    assert cut.change("s", to(3.0))[1] == 3
    assert place(SceneStore(tmp_path).read("s")[0]) == 3.0
    json.loads((tmp_path / "s.changes").read_bytes().splitlines()[-1])


@pytest.mark.parametrize("file", ["s.json", "s.changes"])
def test_a_damaged_file_is_told_and_can_be_stored_again(versioned: SceneStore, tmp_path: Path, file: str) -> None:
    versioned.write(BALL)
    for x in (1.0, 2.0):
        versioned.change("s", to(x))
    data = bytearray((tmp_path / file).read_bytes())
    data[10] = 0
    (tmp_path / file).write_bytes(data)
    damaged = SceneStore(tmp_path)
    with pytest.raises(SceneInvalid, match="'s' can't be read: its file is damaged"):
        damaged.read("s")
    assert damaged.write(BALL) == 1
    assert damaged.read("s") == (BALL, 1)


def test_many_who_change_at_once_change_one_after_another(tmp_path: Path) -> None:
    SceneStore(tmp_path).write(BALL)
    stores = [SceneStore(tmp_path) for _ in range(3)]
    versions: list[int] = []
    seen: list[bool] = []

    def changing(versioned: SceneStore) -> None:
        for _ in range(40):
            versions.append(versioned.change("s", SceneDiff(add=[], move={"ball": Placement()}))[1])

    def reading() -> None:
        reader = SceneStore(tmp_path)
        last = 0
        while len(versions) < 120:
            version = reader.read("s")[1] or 0
            seen.append(version >= last)
            last = version

    threads = [*(threading.Thread(target=changing, args=(one,)) for one in stores), threading.Thread(target=reading)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(versions) == list(range(2, 122))
    assert seen
    assert all(seen)


def test_a_change_that_the_disk_refuses_is_no_version(versioned, tmp_path, monkeypatch):
    versioned.write(BALL)
    versioned.change("s", to(1.0))

    def refused(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(scenes.os, "fsync", refused)
        with pytest.raises(OSError, match="No space"):
            versioned.change("s", to(2.0))
    for reader in (versioned, SceneStore(tmp_path)):
        assert (place(reader.read("s")[0]), reader.read("s")[1]) == (1.0, 2)
    assert versioned.change("s", to(3.0))[1] == 3
