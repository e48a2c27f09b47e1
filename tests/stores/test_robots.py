from pathlib import Path

import numpy as np
import pytest

from guidefield.errors import MalformedRequest, RequestTooLarge, RobotInvalid
from guidefield.messages.requests import RobotFiles
from guidefield.robot.catalog import Catalog
from guidefield.robot.library import SentRobot
from guidefield.stores.robots import NoRobots, RobotStore
from tests.robots import box_arm

PLAIN = RobotFiles(urdf=box_arm("y", 2).text, root_joint="planar")
CUBE = "\n".join(
    [
        *(f"v {x} {y} {z}" for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)),
        *("f 1 2 4 3", "f 5 7 8 6", "f 1 5 6 2", "f 3 4 8 7", "f 1 3 7 5", "f 2 6 8 4"),
    ]
).encode()
MESHED = RobotFiles(
    urdf='<robot name="m"><link name="base"/><link name="l"><collision><geometry>'
    '<mesh filename="package://mine/cube.obj"/></geometry></collision></link><joint name="j" type="continuous">'
    '<parent link="base"/><child link="l"/></joint></robot>',
    meshes={"package://mine/cube.obj": CUBE},
)


@pytest.fixture
def store(tmp_path: Path) -> RobotStore:
    return RobotStore(tmp_path / "robots")


def load(robot: SentRobot) -> object:
    return Catalog().load(robot)


def test_a_stored_robot_is_loaded_by_another_process_with_the_meshes_that_came(store: RobotStore, tmp_path: Path):
    store.write("mine", MESHED, load)
    found = RobotStore(tmp_path / "robots").find("mine")
    assert found is not None
    robot = Catalog().load(found)
    assert robot.name == "mine"
    box = robot.geometry.geometryObjects[0].geometry
    box.computeLocalAABB()
    assert np.allclose(box.aabb_local.max_, 0.1)
    assert np.allclose(box.aabb_local.min_, 0.0)
    assert store.names() == ["mine"]


def test_what_no_name_leads_to_is_removed(store: RobotStore, tmp_path: Path):
    contents = tmp_path / "robots" / "contents"
    store.write("a", MESHED, load)
    store.write("b", MESHED, load)
    assert len(list(contents.iterdir())) == 1
    store.delete("a")
    assert len(list(contents.iterdir())) == 1
    store.delete("b")
    assert not list(contents.iterdir())
    with pytest.raises(RobotInvalid, match="no robot 'b' is stored; stored are none"):
        store.delete("b")


def test_a_robot_that_cannot_be_loaded_leaves_what_was(store: RobotStore, tmp_path: Path):
    store.write("mine", PLAIN, load)
    broken = RobotFiles(urdf=MESHED.urdf, meshes={"package://mine/cube.obj": b"mtllib /etc/hostname\n" + CUBE})
    empty = RobotFiles(urdf=MESHED.urdf, meshes={"package://mine/cube.obj": b"v 0 0 0\n"})
    for files, words in (
        (broken, "which was not sent"),
        (empty, "cube.obj"),
        (RobotFiles(urdf="<robot/>"), "at least one <link>"),
    ):
        with pytest.raises(RobotInvalid, match=words) as refused:
            store.write("mine", files, load)
        told = f"{refused.value.message} {refused.value.details}"
        assert str(tmp_path) not in told
    found = store.find("mine")
    assert found.urdf == PLAIN.urdf
    assert len(list((tmp_path / "robots" / "contents").iterdir())) == 1


def test_a_missing_mesh_is_told_without_any_folder_of_the_service(store: RobotStore, tmp_path: Path):
    for uri in ("package://mine/lost.obj", "/etc/hostname.stl", "../../x.stl", "package://example-robot-data/../x.stl"):
        files = RobotFiles(urdf=MESHED.urdf.replace("package://mine/cube.obj", uri), meshes=MESHED.meshes)
        with pytest.raises(RobotInvalid, match="line 1: link 'l': mesh") as refused:
            store.write("mine", files, load)
        assert "/" not in f"{refused.value.message} {refused.value.details}".replace(uri, "").replace(
            "package://", ""
        ).replace("example-robot-data/", "")


def test_a_name_of_the_catalog_means_the_same_everywhere(store: RobotStore):
    with pytest.raises(RobotInvalid, match="comes with the package"):
        store.write("panda", PLAIN, load)


@pytest.mark.parametrize("name", ["../mine", ".mine", "a/b", "a\0b"])
def test_no_name_leads_out_of_the_folder(name: str, store: RobotStore, tmp_path: Path):
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "mine").write_text("x")
    for ask in (store.find, store.delete, lambda name: store.write(name, PLAIN, load)):
        with pytest.raises(MalformedRequest):
            ask(name)
    assert (tmp_path / "robots" / "mine").exists()


def test_the_store_is_bounded(tmp_path: Path):
    few = RobotStore(tmp_path / "few", limit=1)
    few.write("a", PLAIN, load)
    few.write("a", PLAIN, load)
    with pytest.raises(RequestTooLarge, match="1 robots"):
        few.write("b", PLAIN, load)
    with pytest.raises(RequestTooLarge, match="more than 100 bytes"):
        RobotStore(tmp_path / "small", limit_bytes=100).write("a", PLAIN, load)


def test_without_a_folder_nothing_is_stored():
    with pytest.raises(RobotInvalid, match="where there is a data folder"):
        NoRobots().write("mine", PLAIN, load)
    with pytest.raises(RobotInvalid, match="no robot 'mine' is stored"):
        NoRobots().delete("mine")
