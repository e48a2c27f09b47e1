from pathlib import Path

import pytest

from guidefield.errors import MalformedRequest, RequestTooLarge, SceneInvalid
from guidefield.messages.scene import Box, PointCloud, Scene
from guidefield.messages.values import Float32Array
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
