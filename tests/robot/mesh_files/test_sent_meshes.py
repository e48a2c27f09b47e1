"""Meshes that a client sent: what they name is among what was sent, or they are refused; no name becomes a path."""

import base64
import json
import re
from pathlib import Path

import coal
import pytest
from hypothesis import given, strategies as st

from guidefield.errors import RobotInvalid
from guidefield.referee.shapes import read_mesh_file
from guidefield.robot.mesh_files.kinds import recognize
from guidefield.robot.mesh_files.reading import plain_file, read_mesh
from guidefield.robot.mesh_files.sent_meshes import COMPANIONS, MAX_MESHES, MESHES, name_by_content
from tests.robot.mesh_files import written
from tests.robot.mesh_files.written import WRITERS, part

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
        ("a.obj", b"mtllib a.obj\n", "names 'a.obj'; a .obj may name .mtl"),
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
        ("a.glb", glb(b'{"uri": "../../x", "uri": "data:,x"}'), "has a key twice"),
        ("a.off", gltf("../../secret.bin"), "names '../../secret.bin', which was not sent"),
        ("a.stl", b"\xef\xbb\xbf" + gltf("/etc/passwd"), "names '/etc/passwd', which was not sent"),
        ("a.stl", DAE.format(image="/etc/passwd", scene="#s").encode(), "names '/etc/passwd', which was not sent"),
        ("a.stl", b"mtllib /etc/passwd\n" + TRIANGLE, "names '/etc/passwd', which was not sent"),
        ("a.ply", glb(gltf("b.bin")), "must hold all that it needs"),
        ("a.stl", b"PK\x03\x04", "'a.stl' has the content of a .3mf file, which can't be sent; those are .dae, .glb"),
        (
            "a.obj",
            b"\x1c" + DAE.format(image="/etc/passwd", scene="").encode(),
            "checked as .obj and would be read as .dae",
        ),
        ("a.off", 2 * b"\xef\xbb\xbf" + gltf("/etc/passwd"), "checked as .off and would be read as .gltf"),
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


@pytest.mark.parametrize(
    ("uri", "content"),
    [("a.stl", b"newmtl m\nmap_Kd /etc/passwd\n"), ("a.png", b"newmtl m\nmap_Kd /etc/passwd\n")],
)
def test_materials_are_read_from_no_file_that_is_not_checked_as_one(uri, content):
    with pytest.raises(RobotInvalid, match=f"names '{uri}'; a .obj may name .mtl"):
        name_by_content({"m.obj": b"mtllib " + uri.encode() + b"\n" + TRIANGLE, uri: content})


BOX = [part((0, 0, 0), (0.1, 0.2, 0.3))]


@pytest.mark.parametrize("suffix", MESHES)
@pytest.mark.parametrize("kind", WRITERS)
def test_a_file_under_the_suffix_of_another_kind_is_checked_and_read_as_what_it_is(kind, suffix, tmp_path):
    own, writer = WRITERS[kind][0].lower(), WRITERS[kind][1]
    content = writer(BOX).replace(b" \\\n", b"")  # lines that go on are refused
    sent = {f"m/a{suffix}": content, "m/m.mtl": b"newmtl m\n"}
    if own == ".3mf":
        with pytest.raises(RobotInvalid, match=r"content of a \.3mf file"):
            name_by_content(sent)
        return
    named = name_by_content(sent)
    path = tmp_path / named.names[f"m/a{suffix}"]
    path.write_bytes(named.files[path.name])
    assert path.suffix == own
    assert plain_file(path) == (path.name, named.files[path.name])
    (tmp_path / f"a{own}").write_bytes(content)
    expected = read_mesh(tmp_path / f"a{own}")
    for ours, other in zip(read_mesh(path), expected, strict=True):
        assert (ours == other).all()


def test_the_judge_reads_the_buffer_that_was_sent(tmp_path):
    named = name_by_content({"m/a.off": written.gltf(BOX, buffer="a.bin"), "m/a.bin": written.buffer_of(BOX)})
    for name, content in named.files.items():
        (tmp_path / name).write_bytes(content)
    read = read_mesh_file(tmp_path / plain_file(tmp_path / named.names["m/a.off"])[0])
    assert read.max(axis=(0, 1)) == pytest.approx([0.1, 0.2, 0.3])


PLACES = {
    ".dae": rb"<image id=\"i\"><init_from>([^<]*)<",
    ".glb": rb"\"uri\": \"([^\"]*)\"",
    ".gltf": rb"\"uri\": \"([^\"]*)\"",
    ".obj": rb"(?i)mtllib[ \t]+([^\r\n]*)",
    ".ply": rb"(?i)texturefile[ \t]+([^\r\n]*)",
}
"""Where a reader of each kind finds names of other files in `naming`."""


def naming(kind: str, name: str) -> bytes:
    """A file of a kind, with the name of another file where the kind has one."""
    return {
        ".3mf": written.three_mf(BOX),
        ".dae": DAE.format(image=name, scene="#s").encode(),
        ".glb": glb(gltf(name)),
        ".gltf": gltf(name),
        ".obj": f"mtllib {name}\n".encode() + TRIANGLE,
        ".off": written.off(BOX),
        ".ply": f"ply\nformat ascii 1.0\ncomment TextureFile {name}\nend_header\n".encode(),
        ".stl": written.stl_text(BOX),
    }[kind]


@given(
    st.sampled_from([".3mf", *MESHES]),
    st.sampled_from(MESHES),
    st.sampled_from(["/etc/passwd", "../t.png", "http://example.org/t.png", *(f"t{suffix}" for suffix in COMPANIONS)]),
    st.lists(
        st.sampled_from([b"\xef\xbb\xbf", b"\x1c", b"\0", b" ", b"\n", b"<!---->", b"OFF\n", b"ply\n", b"v 0 0 0\n"]),
        max_size=3,
    ),
)
def test_a_file_of_any_kind_under_any_suffix_is_refused_or_names_only_what_was_sent(kind, suffix, name, before):
    sent = {f"t{companion}": PNG for companion in COMPANIONS} | {f"a{suffix}": b"".join(before) + naming(kind, name)}
    try:
        named = name_by_content(sent)
    except RobotInvalid:
        return
    stored = named.names[f"a{suffix}"]
    read, content = recognize(named.files[stored], Path(stored).suffix)
    assert (read, content) == (Path(stored).suffix, named.files[stored])
    assert read in MESHES
    names = [found.decode() for found in re.findall(PLACES[read], content)] if read in PLACES else []
    assert set(names) <= {named.names[f"t{companion}"] for companion in COMPANIONS}
