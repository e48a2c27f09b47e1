"""Files of a store that were cut short, at every length: each is told by itself, and everything else is there."""

from pathlib import Path

import pytest

from guidefield.errors import RobotInvalid, SceneInvalid, UnknownObject
from guidefield.handlers.robots import robots
from guidefield.messages.requests import RobotFiles
from guidefield.messages.scene import Box, Scene
from guidefield.rendering import whole_recording
from guidefield.robot.catalog import Catalog
from guidefield.stores.recordings import Recordings
from guidefield.stores.robots import RobotStore
from guidefield.stores.scenes import SceneStore
from tests.robots import box_arm

ARM = RobotFiles(urdf=box_arm("y", 2).text)


def _cut(file: Path) -> list[int]:
    """Lengths to cut a file to: those near its ends, and some between."""
    size = file.stat().st_size
    return sorted({0, 1, 2, size - 1, size - 2, *range(3, size, max(1, size // 12))})


def test_a_damaged_recording_is_told(tmp_path: Path) -> None:
    recordings = Recordings(tmp_path)
    for content in (b"", b"RRF2 and nothing that follows"):
        recordings.path("damaged").write_bytes(content)
        with pytest.raises(UnknownObject, match="recording of run 'damaged' is damaged"):
            whole_recording(recordings, "damaged")


@pytest.mark.parametrize("folder", ["names", "contents"])
def test_a_damaged_robot_is_told_in_the_list_and_stored_again(folder: str, tmp_path: Path) -> None:
    store, catalog = RobotStore(tmp_path / "robots"), Catalog()
    store.write("whole", ARM, catalog.load)
    store.write("damaged", RobotFiles(urdf=box_arm("y", 3).text), catalog.load)
    if folder == "names":
        file = tmp_path / "robots" / "names" / "damaged"
    else:
        content = (tmp_path / "robots" / "names" / "damaged").read_text()
        file = tmp_path / "robots" / "contents" / content / "robot.json"
    written = file.read_bytes()
    for length in (0, len(written) // 2):
        file.write_bytes(written[:length])
        lines = {line.name: line.problem for line in robots(catalog, store).robots if line.source == "stored"}
        assert set(lines) == {"whole", "damaged"}
        assert lines["whole"] is None
        assert "damaged" in (lines["damaged"] or "")
        with pytest.raises(RobotInvalid, match="store it again"):
            store.find("damaged")
    store.write("damaged", RobotFiles(urdf=box_arm("y", 3).text), catalog.load)
    assert catalog.load(store.find("damaged")).name == "damaged"


def test_a_name_that_leads_elsewhere_is_damaged(tmp_path: Path) -> None:
    store = RobotStore(tmp_path / "robots")
    store.write("mine", ARM, Catalog().load)
    (tmp_path / "robots" / "names" / "mine").write_bytes(b"../names\xff")
    with pytest.raises(RobotInvalid, match="damaged"):
        store.find("mine")
    store.delete("mine")
    assert store.names() == []


def test_a_damaged_scene_is_told_and_stored_again(tmp_path: Path) -> None:
    store = SceneStore(tmp_path)
    scene = Scene("shelf", obstacles=[Box(name="b", size=(0.1, 0.1, 0.1))])
    store.write(scene)
    file = tmp_path / "shelf.json"
    written = file.read_bytes()
    for length in _cut(file):
        file.write_bytes(written[:length])
        assert "shelf" in store.names()
        with pytest.raises(SceneInvalid, match="damaged"):
            store.read("shelf")
    store.write(scene)
    assert store.read("shelf")[0] == scene
