"""Meshes that a client sent: what they name is among what was sent, or they are refused; no name becomes a path."""

import base64
import json
import re
from pathlib import Path

import coal
import pytest
from hypothesis import given, strategies as st

from guidefield.errors import RobotInvalid
from guidefield.robot.mesh_files.sent_meshes import MAX_MESHES, name_by_content

TRIANGLE = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"
PNG = b"\x89PNG not really"
CONTENT_NAME = re.compile(r"[0-9a-f]{64}\.[a-z]+")

DAE = (
    '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><library_images>'
    '<image id="i"><init_from>{image}</init_from></image></library_images><library_effects><effect id="e">'
    "<profile_COMMON><newparam><surface><init_from>i</init_from></surface></newparam></profile_COMMON></effect>"
    '</library_effects><scene><instance_visual_scene url="{scene}"/></scene></COLLADA>'
)


def gltf(buffer: str) -> bytes:
    return json.dumps({"asset": {"version": "2.0"}, "buffers": [{"uri": buffer, "byteLength": 4}]}).encode()


def glb(document: bytes) -> bytes:
    length = len(document).to_bytes(4, "little")
    return (
        b"glTF" + (2).to_bytes(4, "little") + (20 + len(document)).to_bytes(4, "little") + length + b"JSON" + document
    )


def test_an_obj_its_materials_and_their_texture_find_each_other_under_new_names(tmp_path):
    named = name_by_content(
        {
            "package://arm/meshes/a.obj": b"mtllib ../looks/a b.mtl\n" + TRIANGLE,
            "package://arm/looks/a b.mtl": b"newmtl m\nKd 1 0 0\nmap_Kd -s 1 1 1 t.png\n",
            "package://arm/looks/t.png": PNG,
        }
    )
    assert all(CONTENT_NAME.fullmatch(name) for name in named.files)
    obj, mtl, png = (named.names[f"package://arm/{path}"] for path in ("meshes/a.obj", "looks/a b.mtl", "looks/t.png"))
    assert named.files[obj].startswith(f"mtllib {mtl}\n".encode())
    assert named.files[mtl].endswith(f"map_Kd -s 1 1 1 {png}\n".encode())
    assert named.files[png] == PNG
    for name, content in named.files.items():
        (tmp_path / name).write_bytes(content)
    assert coal.MeshLoader().load(str(tmp_path / obj)).num_tris == 2


def test_a_gltf_and_a_dae_find_what_they_name(tmp_path):
    named = name_by_content(
        {
            "a.gltf": gltf("b%20c.bin"),
            "b c.bin": b"1234",
            "d.dae": DAE.format(image="file://t.png", scene="#s").encode(),
            "t.png": PNG,
            "e.glb": glb(gltf("data:,x")),
        }
    )
    assert json.loads(named.files[named.names["a.gltf"]])["buffers"][0]["uri"] == named.names["b c.bin"]
    dae = named.files[named.names["d.dae"]].decode()
    assert f"<init_from>{named.names['t.png']}</init_from>" in dae
    assert "<surface><init_from>i</init_from></surface>" in dae


def test_a_ply_finds_a_texture_that_was_sent_and_loses_the_name_of_another():
    header = b"ply\nformat ascii 1.0\ncomment made by hand\ncomment TextureFile %s\nend_header\ntexturefile t.png\n"
    named = name_by_content({"m/a.ply": header % b"../t x.png", "t x.png": PNG, "m/b.ply": header % b"/etc/passwd"})
    assert named.files[named.names["m/a.ply"]] == header % named.names["t x.png"].encode()
    assert named.files[named.names["m/b.ply"]] == header.replace(b"comment TextureFile %s", b"comment")


@pytest.mark.parametrize(
    ("uri", "content", "words"),
    [
        ("a.obj", b"mtllib /etc/passwd\n" + TRIANGLE, "names '/etc/passwd', which was not sent"),
        ("a.obj", b"v 0 0 0\rmtllib /etc/passwd\r", "names '/etc/passwd', which was not sent"),
        ("a.obj", b"MTLLIB ../../x.mtl\n", "names '../../x.mtl', which was not sent"),
        ("a.obj", b"o mtllib /etc/passwd\n", "doesn't begin a line"),
        ("a.obj", b"mtllib a.obj mtllib /etc/passwd\n", "doesn't begin a line"),
        ("a.obj", b"mtl\\\nlib /etc/passwd\n", "after a backslash"),
        ("a.obj", b"mtllib a.obj\n", "files that name each other|names 'a.obj'"),
        ("a.mtl", b"map_Kd /etc/passwd\n", "names '/etc/passwd', which was not sent"),
        ("a.mtl", b"x map_Kd /etc/passwd\n", "doesn't begin a line"),
        ("a.gltf", gltf("/etc/passwd"), "names '/etc/passwd', which was not sent"),
        ("a.gltf", gltf("../../../etc/passwd"), "which was not sent"),
        ("a.gltf", gltf("http://example.org/a.bin"), "which was not sent"),
        ("a.gltf", b'{"extensions": {"X": [{"uri": "/etc/passwd"}]}}', "names '/etc/passwd', which was not sent"),
        ("a.gltf", b"[" * 100_000, "is no glTF document"),
        ("a.gltf", b"3", "is no glTF document"),
        ("a.glb", glb(gltf("b.bin")), "must hold all that it needs"),
        ("a.glb", b"glTF", "is no binary glTF"),
        ("a.glb", glb(b"{}")[:20], "is no binary glTF"),
        ("a.dae", DAE.format(image="/etc/passwd", scene="#s").encode(), "names '/etc/passwd', which was not sent"),
        ("a.dae", DAE.format(image="", scene="/etc/other.dae#s").encode(), "outside the document"),
        ("a.dae", b'<!DOCTYPE a [<!ENTITY x SYSTEM "/etc/passwd">]><a>&x;</a>', "must not have a <!DOCTYPE>"),
        ("a.dae", b"<a>", "is not XML"),
        ("a.3mf", b"PK", "is of no kind that can be sent"),
        ("a.sh", b"", "is of no kind that can be sent"),
        ("a", b"", "is of no kind that can be sent"),
        ("a.stl", b"0" * (32 * 2**20 + 1), "33554433 bytes, at most 33554432"),
    ],
)
def test_what_names_something_that_was_not_sent_or_is_odd_is_refused(uri, content, words):
    with pytest.raises(RobotInvalid, match=words) as refused:
        name_by_content({uri: content})
    assert refused.value.details["uri"] == uri


def test_files_are_bounded_in_number():
    with pytest.raises(RobotInvalid, match="1001 meshes were sent"):
        name_by_content({f"{index}.stl": b"" for index in range(MAX_MESHES + 1)})


@given(
    st.lists(st.sampled_from(["..", ".", "a", "b c", "%2e%2e", "x.mtl", "C:", "\\"]), max_size=6),
    st.sampled_from(["/", "\\", "//"]),
)
def test_no_name_in_a_file_leads_to_any_other_than_one_that_was_sent(parts, slash):
    reference = slash.join([*parts, "x.mtl"])
    sent = {"package://p/m/a.obj": f"mtllib {reference}\n".encode() + TRIANGLE, "package://p/m/x.mtl": b"newmtl m\n"}
    try:
        named = name_by_content(sent)
    except RobotInvalid:
        return
    first = named.files[named.names["package://p/m/a.obj"]].split(b"\n", 1)[0].decode()
    assert first == f"mtllib {named.names['package://p/m/x.mtl']}"
    assert Path(first.split()[1]).name == first.split()[1]
    assert base64.b16decode(first.split()[1].removesuffix(".mtl"), casefold=True)
