"""SDF: includes by every way, submeshes, old files; placements that MuJoCo, Pinocchio or a hand computed otherwise."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from guidefield import Scene
from guidefield.errors import SceneInvalid
from tests.robot.mesh_files import written
from tests.robot.mesh_files.written import part
from tests.scene_files.worlds import placement, words

BOX = '<collision name="c"><geometry><box><size>1 2 3</size></box></geometry></collision>'


def save(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def model(name: str, inside: str = f'<link name="l">{BOX}</link>', version: str = "1.9", attributes: str = "") -> str:
    return f'<sdf version="{version}"><model name="{name}" {attributes}>{inside}</model></sdf>'


def pose(place: pin.SE3, relative_to: str = "") -> str:
    said = f'relative_to="{relative_to}"' if relative_to else ""
    return f"<pose {said}>{words(place.translation)} {words(pin.rpy.matrixToRpy(place.rotation))}</pose>"


def test_a_chain_of_frames_is_composed_in_any_order(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    places = [placement(seed) for seed in range(8)]
    frames = [
        f'<frame name="f{k}" attached_to="{f"f{k - 1}" if k else "l"}">{pose(p)}</frame>' for k, p in enumerate(places)
    ]
    frames = [frames[k] for k in rng.permutation(8)]
    tip = f'<link name="tip">{pose(places[0], "f7")}{BOX}</link>'
    text = model("m", f'{tip}{"".join(frames)}<link name="l">{pose(places[1])}</link>{pose(places[2])}')
    (box,) = Scene.read(save(tmp_path / "m.sdf", text)).obstacles
    expected = places[2] * places[1]
    for one in (*places, places[0]):
        expected = expected * one
    assert box.name == "m::tip::c"
    assert np.allclose(box.position, expected.translation, atol=1e-12)
    assert np.allclose(pin.Quaternion(*np.roll(box.quaternion_xyzw, 1)).matrix(), expected.rotation, atol=1e-12)


def test_poses_are_in_degrees_or_quaternions_where_they_say_so(tmp_path: Path) -> None:
    said = (
        'degrees="true">0 0 0 30 0 90',
        'rotation_format="quat_xyzw">0 0 0 0 0 2 2',
        ">0 0 0 0 0 1.5707963267948966",
    )
    for text, turn in zip(said, ((30, 90), (0, 90), (0, 90)), strict=True):
        (box,) = Scene.read(
            save(tmp_path / "m.sdf", model("m", f'<link name="l"><pose {text}</pose>{BOX}</link>'))
        ).obstacles
        expected = pin.Quaternion(pin.rpy.rpyToMatrix(*np.radians((turn[0], 0, turn[1])))).coeffs()
        assert np.allclose(box.quaternion_xyzw, expected, atol=1e-12)


def test_models_are_included_by_every_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GZ_SIM_RESOURCE_PATH", raising=False)
    inner = model("inner", f'<link name="l">{BOX}</link>{pose(placement(1))}')
    save(tmp_path / "cell" / "inner" / "model.sdf", inner)
    save(tmp_path / "cell" / "named" / "model.config", '<model><sdf version="1.9">one.sdf</sdf></model>')
    save(tmp_path / "cell" / "named" / "one.sdf", model("outer", "<include><uri>../inner/model.sdf</uri></include>"))
    save(tmp_path / "far" / "remote" / "model.sdf", inner)
    uris = ("inner", "inner/model.sdf", "model://inner", "named", "model://named", "model://remote/model.sdf")
    includes = "".join(f"<include><uri>{uri}</uri><name>m{k}</name></include>" for k, uri in enumerate(uris))
    world = save(tmp_path / "cell" / "w.world", f'<sdf version="1.9"><world name="w">{includes}</world></sdf>')
    for folders, variable in (([tmp_path / "far"], ""), ((), str(tmp_path / "far"))):
        monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", variable)
        scene = Scene.read(world, package_dirs=folders)
        names = [f"m{k}::inner::l::c" if "named" in uri else f"m{k}::l::c" for k, uri in enumerate(uris)]
        assert [one.name for one in scene.obstacles] == names
        assert all(np.allclose(one.position, placement(1).translation, atol=1e-12) for one in scene.obstacles)
    assert len(Scene.read(world, package_dirs=[tmp_path / "far"], without=["m3", "m0::l"]).obstacles) == 4


def test_a_submesh_is_read_alone_and_about_its_middle(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_bytes(written.obj_polygons([part((1, 2, 3), (2, 2, 2)), part((5, 5, 5), (1, 1, 1))]))
    for centre, low in (("", (5, 5, 5)), ("<center>true</center>", (-0.5, -0.5, -0.5))):
        mesh = f"<mesh><uri>m.obj</uri><submesh><name>part1</name>{centre}</submesh></mesh>"
        link = f'<link name="l"><collision name="c"><geometry>{mesh}</geometry></collision></link>'
        (one,) = Scene.read(save(tmp_path / "m.sdf", model("m", link))).obstacles
        assert np.frombuffer(one.vertices.float32, "<f4").reshape(-1, 3).min(axis=0).tolist() == list(low)
    wrong = save(tmp_path / "m.sdf", model("m", link.replace("part1", "lid")))
    with pytest.raises(
        SceneInvalid, match=r"m.sdf: line 1: link 'l': mesh 'm.obj' has no <submesh> 'lid'; it has part0, part1"
    ):
        Scene.read(wrong)


@pytest.mark.parametrize(("shape", "inside", "height"), [("cone", 1.0, 0.5), ("ellipsoid", 1.0, 2.0)])
def test_round_shapes_are_meshes_that_contain_them(shape: str, inside: float, height: float, tmp_path: Path) -> None:
    sizes = {"cone": "<radius>1</radius><length>1</length>", "ellipsoid": "<radii>1 1 2</radii>"}[shape]
    link = f'<link name="l"><collision name="c"><geometry><{shape}>{sizes}</{shape}></geometry></collision></link>'
    (mesh,) = Scene.read(save(tmp_path / "m.sdf", model("m", link))).obstacles
    vertices, triangles = np.array(mesh.vertices), np.frombuffer(mesh.triangles.uint32, "<u4").reshape(-1, 3)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    turns = np.linspace(0.0, 2.0 * np.pi, 200)
    for z in np.linspace(-height, height, 50):
        radius = 0.5 - z if shape == "cone" else np.sqrt(1.0 - (z / 2.0) ** 2)
        rim = np.column_stack([radius * np.cos(turns), radius * np.sin(turns), np.full(200, z)])
        assert (np.einsum("ij,ikj->ik", normals, rim[None] - a[:, None]) < 1e-12).all(), "it is on no side outside"
    assert np.linalg.norm(vertices[:, :2], axis=1).max() < 1.02 * inside
