"""Stored scenes that change: versions by number, files that are cut short or damaged, several processes."""

import json
import threading
from pathlib import Path

import pytest

from guidefield.errors import SceneInvalid
from guidefield.messages import codec
from guidefield.messages.scene import Scene, Sphere
from guidefield.messages.scene_changes import MAX_VERSIONS, SceneDiff
from guidefield.messages.values import Placement
from guidefield.stores import scenes
from guidefield.stores.scenes import SceneStore

BALL = Scene("s", obstacles=[Sphere(name="ball", radius=0.1)])


def to(x: float, version: int | None = None) -> SceneDiff:
    return SceneDiff(move={"ball": Placement((x, 0.0, 0.0))}, version=version)


def place(scene: Scene) -> float:
    (ball,) = scene.obstacles
    return ball.position[0]


@pytest.fixture
def store(tmp_path: Path) -> SceneStore:
    return SceneStore(tmp_path)


def test_each_change_is_a_version_and_the_last_ones_can_be_read(store: SceneStore, tmp_path: Path) -> None:
    assert store.write(BALL) == 1
    for version in range(2, 200):
        after, number = store.change("s", to(float(version)))
        assert (place(after), number) == (version, version)
        for reader in (store, SceneStore(tmp_path)) if version % 17 == 0 else ():
            assert place(reader.read("s")[0]) == version
            for back in range(min(MAX_VERSIONS, version - 1)):
                scene, number = reader.read("s", version - back)
                assert (place(scene), number) == (version - back, version - back)
            if version > MAX_VERSIONS:
                with pytest.raises(SceneInvalid, match=f"no version {version - MAX_VERSIONS}; the last") as gone:
                    reader.read("s", version - MAX_VERSIONS)
                assert gone.value.details["available"] == list(range(version - MAX_VERSIONS + 1, version + 1))
    with pytest.raises(SceneInvalid, match="no version 200"):
        store.read("s", 200)
    assert (tmp_path / "s.changes").stat().st_size < 20_000


def test_another_process_sees_what_changed(store: SceneStore, tmp_path: Path) -> None:
    other = SceneStore(tmp_path)
    store.write(BALL)
    assert other.read("s") == (BALL, 1)
    store.change("s", to(1.0))
    assert place(other.read("s")[0]) == 1.0
    other.change("s", to(2.0))
    assert (place(store.read("s")[0]), store.read("s")[1]) == (2.0, 3)


def test_a_change_of_another_version_than_is_meant_changes_nothing(store: SceneStore) -> None:
    store.write(BALL)
    store.change("s", to(1.0, version=1))
    with pytest.raises(SceneInvalid, match="has version 2, and version 1 was to be changed") as refused:
        store.change("s", to(2.0, version=1))
    assert refused.value.details["version"] == 2
    assert (place(store.read("s")[0]), store.read("s")[1]) == (1.0, 2)


def test_a_change_that_does_not_fit_changes_nothing(store: SceneStore) -> None:
    store.write(BALL)
    with pytest.raises(SceneInvalid, match="no obstacle 'post'"):
        store.change("s", SceneDiff(move={"ball": Placement((1.0, 0.0, 0.0))}, remove=["post"]))
    assert store.read("s") == (BALL, 1)


def test_a_scene_that_an_earlier_version_stored_can_be_read_and_changed(store: SceneStore, tmp_path: Path) -> None:
    (tmp_path / "s.json").write_bytes(codec.encode(BALL))
    assert store.read("s") == (BALL, 1)
    assert store.change("s", to(1.0))[1] == 2


def test_a_change_that_was_cut_short_never_was(store: SceneStore, tmp_path: Path) -> None:
    store.write(BALL)
    store.change("s", to(1.0))
    whole = (tmp_path / "s.changes").read_bytes()
    store.change("s", to(2.0))
    more = (tmp_path / "s.changes").read_bytes()
    for end in range(len(whole), len(more)):
        (tmp_path / "s.changes").write_bytes(more[:end])
        cut = SceneStore(tmp_path)
        assert (place(cut.read("s")[0]), cut.read("s")[1]) == (1.0, 2)
    assert cut.change("s", to(3.0))[1] == 3
    assert place(SceneStore(tmp_path).read("s")[0]) == 3.0
    json.loads((tmp_path / "s.changes").read_bytes().splitlines()[-1])


@pytest.mark.parametrize("file", ["s.json", "s.changes"])
def test_a_damaged_file_is_told_and_can_be_stored_again(store: SceneStore, tmp_path: Path, file: str) -> None:
    store.write(BALL)
    for x in (1.0, 2.0):
        store.change("s", to(x))
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

    def changing(store: SceneStore) -> None:
        for _ in range(40):
            versions.append(store.change("s", SceneDiff(add=[], move={"ball": Placement()}))[1])

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


def test_a_change_that_the_disk_refuses_is_no_version(
    store: SceneStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.write(BALL)
    store.change("s", to(1.0))

    def refused(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(scenes.os, "fsync", refused)
        with pytest.raises(OSError, match="No space"):
            store.change("s", to(2.0))
    for reader in (store, SceneStore(tmp_path)):
        assert (place(reader.read("s")[0]), reader.read("s")[1]) == (1.0, 2)
    assert store.change("s", to(3.0))[1] == 3
