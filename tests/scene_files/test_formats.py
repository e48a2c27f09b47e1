"""Scenes from files of every format: the world of one is that of all others, and of the primitives in it."""

import math
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import guidefield
from guidefield import Scene
from guidefield.errors import SceneInvalid
from guidefield.messages import codec
from guidefield.messages.requests import UrdfFile
from guidefield.messages.values import Float32Array
from guidefield.robot.catalog import Catalog
from tests.robot.mesh_files import written
from tests.robot.mesh_files.written import part
from tests.robots import box_arm
from tests.scene_files import clouds, worlds

ARM = box_arm("y x y", 3)
CONFIGURATIONS = [
    {"j1": a, "j2": b, "j3": c} for a, b, c in np.random.default_rng(3).uniform(-1.5, 1.5, (4, 3)).tolist()
]
BOXES = {"table": part((0.3, -0.4, 0.0), (0.5, 0.75, 0.25)), "post": part((-0.5, 0.25, 0.0), (0.125, 0.125, 1.0))}
TURNED = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""From z up to y up."""


def clearances(scene: Scene) -> np.ndarray:
    """The smallest distance to an obstacle at each configuration of the arm, shape (n,)."""
    asked = {"type": "clearance", "robot": ARM, "scene": scene, "configurations": CONFIGURATIONS}
    return np.array(guidefield.answer(asked).minimum)


def save(folder: Path, suffix: str, content: bytes, stem: str = "cell") -> Path:
    path = folder / f"{stem}{suffix}"
    path.write_bytes(content)
    return path


def vertices_of(mesh: object) -> np.ndarray:
    """Corners of a mesh in the world, shape (v, 3)."""
    own = mesh.vertices
    points = np.frombuffer(own.float32, "<f4").reshape(-1, 3) if isinstance(own, Float32Array) else np.array(own)
    return points @ pin.Quaternion(*np.roll(mesh.quaternion_xyzw, 1)).matrix().T + mesh.position


@pytest.fixture(scope="module")
def expected() -> np.ndarray:
    return clearances(worlds.reference())


@pytest.mark.parametrize("kind", worlds.WRITERS)
def test_a_world_is_the_same_in_every_format(kind: str, tmp_path: Path, expected: np.ndarray) -> None:
    suffix, writer = worlds.WRITERS[kind]
    if suffix == ".xml":
        pytest.importorskip("mujoco", reason="the extra `mujoco` isn't installed")
    scene = Scene.read(save(tmp_path, suffix, writer(tmp_path)))
    assert scene.name == "cell"
    names = {one.name.partition("::")[0] if kind == "sdf" else one.name for one in scene.obstacles}
    assert names == ({"board", "arm", "post", "wedge"} if kind == "sdf" else set(worlds.PLACES))
    assert np.abs(clearances(scene) - expected).max() < 1e-9
    assert codec.decode(codec.encode(scene), Scene) == scene, "it travels as it is"


MESHES = {name: kind for name, kind in written.WRITERS.items() if name.split(maxsplit=1)[0] not in ("gltf", "glb")}
NAMES = {
    "stl text": ["part 0", "part 1"],
    "obj polygons": ["part0", "part1"],
    "dae skins": ["root0", "root1"],
    **{kind: ["n0", "n1"] for kind in ("dae library", "dae fans")},
    **{kind: ["cell/0", "cell/1"] for kind in ("dae nodes", "dae polygons", "3mf")},
}
"""Of the objects, where a file has several."""


@pytest.mark.parametrize("kind", MESHES)
def test_a_mesh_stands_as_its_file_has_it(kind: str, tmp_path: Path) -> None:
    suffix, writer = MESHES[kind]
    parts = list(BOXES.values())
    up = "z" if "skins" in kind or "polylist" in kind else None  # they say another one
    scene = Scene.read(save(tmp_path, suffix, writer(parts)), up=up)
    assert len(scene.obstacles) in (1, 2), "as one mesh or as objects"
    corners = np.concatenate([vertices_of(one) for one in scene.obstacles])
    wanted = np.concatenate([one.placed for one in parts])
    order, other = (np.lexsort(np.round(rows, 6).T) for rows in (corners, wanted))
    assert np.abs(corners[order] - wanted[other]).max() < (1e-6 if suffix == ".stl" else 1e-12)
    assert [one.name for one in scene.obstacles] == NAMES.get(kind, ["cell"])


def test_objects_of_a_mesh_are_obstacles_of_their_own_and_the_same_to_a_robot(tmp_path: Path) -> None:
    parts = list(BOXES.values())
    whole = Scene.read(save(tmp_path, ".ply", written.ply_binary(parts)))
    divided = Scene.read(save(tmp_path, ".stl", written.stl_text(parts)))
    boxes = [
        {"type": "box", "name": name, "size": one.size, "position": (np.add(one.low, one.size) + one.low) / 2}
        for name, one in BOXES.items()
    ]
    expected = clearances(codec.convert({"name": "boxes", "obstacles": boxes}, Scene))
    assert np.abs(clearances(divided) - expected).max() < 1e-9
    assert np.abs(clearances(whole) - np.maximum(expected, 0.0)).max() < 1e-9, "a depth has only a convex body"
    alone = Scene.read(tmp_path / "cell.stl", without=["part 1"])
    assert [one.name for one in alone.obstacles] == ["part 0"]


@pytest.mark.parametrize("binary", [False, True])
def test_a_gltf_file_has_y_up_unless_somebody_says_otherwise(binary: bool, tmp_path: Path) -> None:
    parts = [part(one.low, one.size, TURNED) for one in BOXES.values()]
    path = save(tmp_path, ".glb" if binary else ".gltf", written.gltf(parts, binary=binary))
    wanted = np.concatenate([one.placed for one in BOXES.values()])
    scene = Scene.read(path)
    assert len(scene.obstacles) == 2
    corners = np.concatenate([vertices_of(one) for one in scene.obstacles])
    assert np.abs(np.sort(corners, axis=0) - np.sort(wanted, axis=0)).max() < 1e-6
    as_written = np.concatenate([vertices_of(one) for one in Scene.read(path, up="z").obstacles])
    assert np.abs(np.sort(as_written, axis=0) - np.sort(wanted @ TURNED[:3, :3].T, axis=0)).max() < 1e-6


@pytest.mark.parametrize(
    ("up", "corner"), [("X_UP", (-0.2, -0.3, 0.1)), ("Y_UP", (0.1, -0.3, 0.2)), ("Z_UP", (0.1, 0.2, 0.3))]
)
def test_a_collada_file_says_its_axes_and_its_unit(up: str, corner: tuple[float, ...], tmp_path: Path) -> None:
    path = save(tmp_path, ".dae", written.dae([part((0, 0, 0), (10, 20, 30))], unit="0.01", up=up))
    corners = vertices_of(Scene.read(path).obstacles[0])
    assert np.abs(corners - corner).max(axis=1).min() < 1e-12
    path = save(tmp_path, ".3mf", written.three_mf([part((0, 0, 0), (1, 2, 3))], unit="inch"))
    assert (
        np.abs(vertices_of(Scene.read(path, scale=2.0).obstacles[0]).max(axis=0) - (0.0508, 0.1016, 0.1524)).max()
        < 1e-12
    )


@pytest.mark.parametrize("kind", clouds.WRITERS)
def test_a_cloud_is_the_same_in_every_format(kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    points = np.round(rng.uniform(-1.0, 1.0, (500, 3)), 2)
    points[40:90] = 0.25  # long runs for what packs them
    points[7, 1] = math.nan
    suffix, writer = clouds.WRITERS[kind]
    with pytest.warns(UserWarning, match=r"cell\.\w+: 1 points with coordinates that are NaN are left out"):
        (cloud,) = Scene.read(save(tmp_path, suffix, writer(points)), radius=0.02).obstacles
    assert (cloud.name, cloud.radius) == ("cell", 0.02)
    assert np.array_equal(cloud.points, np.delete(points, 7, axis=0))
    with pytest.raises(SceneInvalid, match=r"cell.*give their `radius`"):
        Scene.read(tmp_path / f"cell{suffix}")


def test_a_scale_and_an_axis_change_all_of_a_world(tmp_path: Path) -> None:
    path = save(tmp_path, ".scene", worlds.moveit(tmp_path))
    small, turned = Scene.read(path, scale=0.5), Scene.read(path, up="y")
    for one, half, other in zip(Scene.read(path).obstacles, small.obstacles, turned.obstacles, strict=True):
        assert np.allclose(half.position, np.multiply(one.position, 0.5), atol=1e-15)
        x, y, z = one.position
        assert np.allclose(other.position, (x, -z, y), atol=1e-15)
    assert np.allclose(small.obstacles[0].size, (0.2, 0.1, 0.025))
    cloud = Scene.read(save(tmp_path, ".xyz", b"1 2 3\n"), scale=0.001, radius=0.01).obstacles[0]
    assert (cloud.points, cloud.radius) == ([(0.001, 0.002, 0.003)], 0.01)


def test_names_are_those_of_the_file_and_numbered_where_they_are_not_one(tmp_path: Path) -> None:
    boxes = "1\nbox\n1 1 1\n0 0 0\n0 0 0 1\n0 0 0 0\n"
    text = f"scene\n* leg\n2\n{boxes[2:]}{boxes[2:]}* leg/0\n{boxes}* leg\n{boxes}* a b\n{boxes}.\n"
    path = save(tmp_path, ".scene", text.encode())
    assert [one.name for one in Scene.read(path, name="mine").obstacles] == ["leg/1", "leg/2", "leg/0", "leg/3", "a b"]
    assert [one.name for one in Scene.read(path, without=["leg"], prefix="my ").obstacles] == ["my leg/0", "my a b"]
    with pytest.raises(SceneInvalid, match="nothing called 'legs' can be left out: did you mean leg"):
        Scene.read(path, without=["legs"])


def test_planes_are_solid_below_their_normal(tmp_path: Path) -> None:
    plane = "* floor\n1\nplane\n0 3 4 -10\n0 0 0\n0 0 0 1\n0 0 0 0\n"
    wanted = ((0.0, 0.6, 0.8), 2.0)
    collision = (
        '<collision name="c"><pose>0 0 2.5 0 0 0</pose><geometry><plane><normal>0 3 4</normal></plane></geometry>'
    )
    model = f'<sdf version="1.6"><model name="m"><link name="l">{collision}</collision></link></model></sdf>'
    for suffix, text in ((".scene", f"s\n{plane}.\n"), (".world", model)):
        (floor,) = Scene.read(save(tmp_path, suffix, text.encode())).obstacles
        assert np.allclose((*floor.normal, floor.offset), (*wanted[0], wanted[1]), atol=1e-12)


def test_the_geoms_of_an_mjcf_stand_where_the_loader_of_robots_has_them(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="the extra `mujoco` isn't installed")
    text = """<mujoco><compiler angle="degree"/><asset><hfield name="hills" nrow="3" ncol="4" size="2 1 .5 .1"
      elevation="0 0 0 0  0 1 .5 0  0 0 0 0"/></asset><worldbody><geom name="ground" type="plane" size="1 1 .1"/>
      <geom name="hills" type="hfield" hfield="hills" pos="0 0 1"/><geom contype="0" conaffinity="0" size=".1"/>
      <body name="cart" pos=".4 .1 .2" euler="10 20 30"><joint name="roll" type="slide" axis="1 0 0" range="-1 1"/>
      <geom type="capsule" size=".05 .2"/><geom type="ellipsoid" size=".1 .2 .3"/>
      <body name="mast" pos="0 0 .3"><joint name="turn" axis="0 1 0" range="-90 90"/>
      <geom name="pole" type="box" size=".1 .2 .3" pos=".1 0 0" euler="5 6 7"/></body></body></worldbody>
      <keyframe><key name="home" qpos=".3 .5"/></keyframe></mujoco>"""
    path = save(tmp_path, ".xml", text.encode())
    found = {one.name: one for one in Scene.read(path).obstacles}
    assert list(found) == ["ground", "hills", "cart/0", "cart/1", "pole"]
    assert [one.name for one in Scene.read(path, without=["cart"]).obstacles] == ["ground", "hills"]
    robot = Catalog().load(UrdfFile(str(path)))
    data, shapes = robot.model.createData(), robot.geometry.createData()
    pin.updateGeometryPlacements(robot.model, data, robot.geometry, shapes, robot.rest)
    for name, at in zip(("cart/0", "cart/1", "pole"), shapes.oMg, strict=True):
        assert np.allclose(found[name].position, at.translation, atol=1e-9)
        turn = pin.Quaternion(*np.roll(found[name].quaternion_xyzw, 1)).matrix()
        assert np.allclose(turn, at.rotation, atol=1e-9)
    hills = vertices_of(found["hills"])
    triangles = np.frombuffer(found["hills"].triangles.uint32, "<u4").reshape(-1, 3)
    corners = hills[triangles]
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all(), "it is closed"
    assert 0.1 * 4 * 2 < volume < 0.6 * 4 * 2
    assert np.allclose((hills.min(axis=0), hills.max(axis=0)), ((-2, -1, 0.9), (2, 1, 1.5)))


def test_a_cell_of_xacro_takes_its_arguments_and_packages(tmp_path: Path) -> None:
    pytest.importorskip("xacro", reason="the extra `xacro` isn't installed")
    (tmp_path / "ws" / "parts").mkdir(parents=True)
    worlds.stl(tmp_path / "ws" / "parts")
    text = """<robot name="cell" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:arg name="high" default="1"/>
      <link name="table"><collision><geometry><box size="1 1 $(arg high)"/></geometry></collision>
      <collision><geometry><mesh filename="package://parts/wedge.stl" scale="1 -1 1"/></geometry></collision></link>
      <link name="lamp"><collision><geometry><sphere radius=".1"/></geometry></collision></link>
      <joint name="arm" type="revolute"><parent link="table"/><child link="lamp"/><origin xyz="0 0 2"/>
      <limit lower="0.5" upper="1" effort="1" velocity="1"/><axis xyz="0 1 0"/></joint></robot>"""
    path = save(tmp_path, ".xacro", text.encode())
    given = {"package_dirs": [tmp_path / "ws"], "xacro_args": {"high": 2.0}}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        table, wedge, lamp = Scene.read(path, **given).obstacles
    assert (table.name, wedge.name, lamp.name, table.size) == ("table/0", "table/1", "lamp", (1.0, 1.0, 2.0))
    assert np.allclose(np.sort(vertices_of(wedge), axis=0), np.sort(worlds.WEDGE * (1, -1, 1), axis=0), atol=1e-15)


def test_a_scene_in_json_is_read_as_everything_else(tmp_path: Path) -> None:
    path = save(tmp_path, ".json", codec.encode(worlds.reference()))
    assert Scene.read(path) == codec.convert(codec.replace_arrays(worlds.reference()), Scene)
    assert Scene.read(path, name="mine").name == "mine"
    with pytest.raises(SceneInvalid, match=r"cell.json: a scene in JSON is read as it is"):
        Scene.read(path, scale=2.0)
