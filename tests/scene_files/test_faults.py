"""Files that are broken or hostile: an error that names the file and the part, soon, and never a traceback."""

import io
import os
import re
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from guidefield import Scene
from guidefield.errors import SceneInvalid
from guidefield.scene_files import sdf
from tests.robot.mesh_files import written
from tests.robot.mesh_files.written import part
from tests.scene_files import clouds, worlds

CUBE = [part((0, 0, 0), (1, 1, 1))]
POINTS = np.arange(30.0).reshape(10, 3)
BOMB = '<!DOCTYPE b [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;">]>'
LONG = "'" + 300 * "m" + "'"


def zipped(**files: bytes) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(f"{name}.npy", content)
    return packed.getvalue()


def npy(shape: str, body: bytes = b"", kind: str = "<f8") -> bytes:
    head = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + body


def link(inside: str) -> str:
    return f'<sdf version="1.9"><model name="m"><link name="l">\n{inside}</link></model></sdf>'


def collision(shape: str) -> str:
    return link(f'<collision name="c"><geometry>{shape}</geometry></collision>')


def scene(shape: str, count: str = "1") -> bytes:
    return f"s\n* a\n{count}\n{shape}\n0 0 0\n0 0 0 1\n0 0 0 0\n.\n".encode()


def pcd(form: str, change: tuple[bytes, bytes] = (b"", b"")) -> bytes:
    return clouds.pcd(POINTS, form).replace(*change, 1) if change[0] else clouds.pcd(POINTS, form)


FAULTS: dict[str, tuple[str, bytes | str, str]] = {
    # meshes
    "stl, cut": (".stl", written.stl(CUBE)[:-20], "is cut short or no STL: it states 12 facets"),
    "stl, huge": (".stl", bytes(80) + b"\xff\xff\xff\xff" + bytes(50), "states 4294967295 facets and holds 1"),
    "stl, nan": (".stl", written.stl_text(CUBE).replace(b"1.0", b"nan", 1), "has a vertex at .*nan"),
    "obj, no vertex": (".obj", "v 0 0 0\nf 1 2 3\n", "a face with the vertex 2"),
    "obj, infinite": (".obj", "v 0 0 1e999\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "has a vertex at .*inf"),
    "obj, empty": (".obj", "# nothing\n", "has no triangles"),
    "ply, huge": (".ply", written.ply_text(CUBE).replace(b"vertex 8", b"vertex 999999999"), "is cut short"),
    "ply, huge lists": (".ply", written.ply_binary(CUBE).replace(b"face 13", b"face 999999999"), "is cut short"),
    "off, huge": (".off", "OFF\n999999999 1 0\n0 0 0\n", "is cut short: it states 999999999 vertices"),
    "dae, bomb": (".dae", BOMB + "<COLLADA>&c;</COLLADA>", "cell.dae"),
    "dae, outside": (".dae", '<!DOCTYPE a [<!ENTITY x SYSTEM "/etc/passwd">]><COLLADA>&x;</COLLADA>', "cell.dae"),
    "dae, axis": (".dae", written.dae(CUBE, up="W_UP"), "must be X_UP, Y_UP or Z_UP"),
    "gltf, cut": (".glb", written.gltf(CUBE, binary=True)[:-9], "is cut short"),
    "gltf, huge": (
        ".gltf",
        '{"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"attributes":'
        ' {"POSITION": 0}}]}], "accessors": [{"type": "VEC3", "componentType": 5126, "count": 1000000000000}]}',
        "count",
    ),
    "gltf, circle": (
        ".gltf",
        '{"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"children": [0, 0]}]}',
        "nested more than|more than .* nodes",
    ),
    "3mf, no archive": (".3mf", b"PK\x03\x04 and no more", "is no 3MF archive"),
    # clouds
    "pcd, cut": (".pcd", pcd("binary")[:-1], "is cut short: it states 10 points of 40 bytes and holds 399 bytes"),
    "pcd, text cut": (".pcd", pcd("ascii").rpartition(b"0 0 0")[0], "is cut short: it states 10 points and holds"),
    "pcd, huge": (".pcd", pcd("binary", (b"POINTS 10", b"POINTS 99999999999")), "a header that can't be"),
    "pcd, many": (".pcd", pcd("binary", (b"POINTS 10", b"POINTS 9999999")), "is cut short"),
    "pcd, width": (".pcd", pcd("binary", (b"SIZE 4 8 8", b"SIZE 4 3 8")), "a header that can't be"),
    "pcd, no y": (".pcd", pcd("ascii", (b"x y z", b"x w z")), "doesn't say where x, y and z"),
    "pcd, no data": (".pcd", "VERSION 0.7\nFIELDS x y z\n", "its header has no line DATA"),
    "pcd, form": (".pcd", pcd("binary", (b"DATA binary", b"DATA odd")), "has DATA 'odd'"),
    "pcd, damaged": (".pcd", pcd("binary_compressed")[:-30] + bytes([255] * 30), "can't be unpacked"),
    "pcd, bomb": (".pcd", pcd("binary_compressed", (b"POINTS 10", b"POINTS 9999999")), "is cut short"),
    "pcd, words": (".pcd", pcd("ascii", (b"27.0", b"none")), "is malformed: .*none"),
    "xyz, words": (".xyz", "1 2 3\n1 two 3\n", "is malformed: .*two"),
    "xyz, narrow": (".xyz", "1 2\n3 4\n", "is malformed"),
    "xyz, no points": (".xyz", "nan nan nan\n", "has no points"),
    "xyz, infinite": (".xyz", "1 inf 3\n", r"obstacle 'cell': `points\[0\]` must be finite"),
    "npz, no archive": (".npz", b"PK\x03\x04 and no more", "is no npz archive"),
    "npz, pickle": (".npz", clouds.npz(np.array([{"a": 1}], object)), "is malformed: .*pickle|Object arrays"),
    "npz, flat": (".npz", clouds.npz(np.arange(9.0)), r"has 'points' of shape \(9,\)"),
    "npz, two": (".npz", zipped(a=npy("(1, 3)", bytes(24)), b=npy("(1, 3)", bytes(24))), "no array 'points', but a, b"),
    "npz, huge": (".npz", zipped(points=npy("(1000000000000, 3)")), "cell.npz"),
    "npz, too many": (".npz", clouds.npz(np.zeros((1_000_001, 3), np.float32)), "has 1000001 points, at most 1000000"),
    # MoveIt
    "scene, cut": (".scene", worlds.moveit(Path())[:300], r"line \d+: the file ends before"),
    "scene, huge": (".scene", scene("mesh\n999999999 1"), "line 5: the mesh of 'a' must have 1 to 1000000 vertices"),
    "scene, count": (".scene", scene("box\n1 1 1", "999999999"), "line 3: the number of shapes of 'a'"),
    "scene, octree": (".scene", scene("octree\n1 1"), "line 4: the shape 'octree' of 'a' can't be judged"),
    "scene, flat": (".scene", scene("box\n1 0 1"), "line 4: obstacle 'a': `size` must be positive"),
    "scene, nan": (".scene", scene("sphere\nnan"), "line 5: the sizes of the sphere of 'a' must be 1 finite numbers"),
    "scene, index": (".scene", scene("mesh\n3 1\n0 0 0\n1 0 0\n0 1 0\n0 1 3"), "a triangle that names no vertex"),
    "scene, turn": (".scene", scene("sphere\n1").replace(b"0 0 0 1", b"0 0 0 0"), "the quaternion of 'a' is zero"),
    "scene, other": (".scene", b"\x00\x01\x02\n\xff\n", "an object begins with"),
    # SDF
    "sdf, bomb": (".sdf", f'{BOMB}<sdf version="1.9">&c;</sdf>', "must not have a <!DOCTYPE>"),
    "sdf, cut": (".sdf", '<sdf version="1.9"><world name="w">', "line 1: the SDF is not XML"),
    "sdf, other": (".sdf", "<svg/>", "the root element must be <sdf>, <robot> or <mujoco>, it is <svg>"),
    "sdf, nothing": (".sdf", '<sdf version="1.9"><world name="w"/></sdf>', "it has no obstacle"),
    "sdf, itself": (".sdf", '<sdf version="1.9"><world name="w">\n<include><uri>cell.sdf</uri></include></world></sdf>',
                    "line 2: the includes form a circle: cell.sdf includes cell.sdf"),
    "sdf, model": (".sdf", '<sdf version="1.9"><include><uri>model://lost</uri></include></sdf>',
                   "line 1: file 'model://lost/model.sdf' was not found .*--package-dir"),
    "sdf, outside": (".sdf", '<sdf version="1.9"><include><uri>/etc/passwd.sdf</uri></include></sdf>',
                     "lies outside what is allowed"),
    "sdf, above": (".sdf", collision("<mesh><uri>../../../../../../../etc/a.stl</uri></mesh>"), "lies outside"),
    "sdf, server": (".sdf", '<sdf version="1.9"><include><uri>https://a.b/c</uri></include></sdf>', "is on a server"),
    "sdf, heights": (".sdf", collision("<heightmap/>"), "the <heightmap> of collision 'm::l::c' can't be judged"),
    "sdf, size": (".sdf", collision("<box><size>1 1</size></box>"), "line 2: .*<size> must be 3 finite numbers"),
    "sdf, negative": (".sdf", collision("<sphere><radius>-1</radius></sphere>"), "`radius` must be positive, got -1.0"),
    "sdf, no size": (".sdf", collision("<box/>"), "<box> must have <size>"),
    "sdf, nan": (".sdf", link("<pose>0 0 nan 0 0 0</pose><collision name='c'/>"), "<pose> must be 6 finite numbers"),
    "sdf, frame": (".sdf", link("<pose relative_to='desk'/>"), "line 1: .*there is no frame 'desk'; there are l"),
    "sdf, frames": (".sdf", link("<pose relative_to='l'/>"), "the frames are relative to each other: l to l"),
    "sdf, worlds": (".sdf", "<sdf><world name='a'/><world name='b'/></sdf>", "has the worlds 'a', 'b'"),
    "sdf, long": (".sdf", collision("<sphere><radius>1</radius></sphere>").replace('"m"', LONG),
                  "a name must have 1 to 256 characters"),
    "sdf, deep": (".sdf", "<sdf>" + "<model name='m'>" * 40 + "</model>" * 40 + "</sdf>", "nested more than 32 deep"),
    "sdf, many": (".sdf", "<sdf>" + "<model name='m'/>" * 300_000 + "</sdf>", "characters, at most 4000000 are read"),
    # robots
    "urdf, cut": (".urdf", "<robot name='r'><link", "line 1: .* is not XML"),
    "urdf, mesh": (".urdf", "<robot name='r'><link name='l'><collision><geometry><mesh filename='a.stl'/></geometry>"
                   "</collision></link></robot>", "link 'l': mesh 'a.stl' was not found"),
    "urdf, nothing": (".urdf", "<robot name='r'><link name='l'/></robot>", "it has no obstacle"),
    "mjcf, cut": (".xml", "<mujoco><worldbody>", "MuJoCo can't compile|is not XML"),
    "mjcf, many": (".xml", '<mujoco><worldbody><replicate count="1000000000"><geom size="1"/></replicate></worldbody>'
                   "</mujoco>", "expands to more than 100000 elements"),
    "mjcf, nothing": (".xml", "<mujoco/>", "it has no obstacle"),
    # all
    "json": (".json", '{"name": "a",\n "obstacles": [{"type": "bux"}]}', "cell.json: .*box"),
    "empty": (".stl", "", "is empty: it has 0 bytes"),
    "pointer": (".sdf", "version https://git-lfs.github.com/spec/v1\n", "is a pointer of git-LFS"),
    "kind": (".step", "ISO-10303-21;", "'cell.step' is no scene file; one ends in .json, .scene, .sdf"),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_names_the_file_and_the_part(name: str, tmp_path: Path) -> None:
    suffix, content, said = FAULTS[name]
    if suffix == ".xml":
        pytest.importorskip("mujoco", reason="the extra `mujoco` isn't installed")
    (tmp_path / ".git").mkdir()  # where a search ends
    path = tmp_path / f"cell{suffix}"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(SceneInvalid) as raised:
        Scene.read(path, radius=0.1)
    message = raised.value.message
    assert path.name in message
    assert re.search(said, message), message
    assert len(message) < 1000
    assert raised.value.details["path"] == str(path)


def test_a_file_that_is_not_there_or_a_wrong_option_is_said(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.stl")
    for path, given, said in (
        (tmp_path / "pipe.stl", {}, "pipe.stl: only a regular file of at most 1073741824 bytes is read"),
        (tmp_path / "lost.sdf", {}, "lost.sdf can't be opened: No such file"),
        (tmp_path, {}, "is no scene file"),
        (tmp_path / "a.stl", {"scale": float("nan")}, "`scale` and `radius` must be positive, got nan"),
        (tmp_path / "a.stl", {"up": "w"}, "`up` must be one of x, y, z, got 'w'"),
    ):
        with pytest.raises(SceneInvalid, match=said):
            Scene.read(path, **given)


def test_includes_that_double_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sdf, "MAX_INCLUDES", 200)
    for k in range(30):
        twice = f"<include><uri>m{k + 1}.sdf</uri></include>" * 2 if k < 29 else ""
        (tmp_path / f"m{k}.sdf").write_text(f'<sdf version="1.9"><model name="m">{twice}</model></sdf>')
    with pytest.raises(SceneInvalid, match="more than 200 includes"):
        Scene.read(tmp_path / "m0.sdf")
