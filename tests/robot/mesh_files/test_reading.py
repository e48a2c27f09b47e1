"""Mesh files as triangles: every part of every kind of file, against what was written and against Assimp's reading."""

import math
from pathlib import Path

import numpy as np
import pytest

from guidefield.referee.shapes import read_mesh_file
from guidefield.robot.mesh_files.numbers import MeshFault
from guidefield.robot.mesh_files.reading import FARTHEST_VERTEX, READERS, companions, read_mesh
from tests.robot.mesh_files import written
from tests.robot.mesh_files.written import WRITERS, Part, corners_of, part


def turned(seed: int, mirrored: bool = False) -> np.ndarray:
    """A rotation, a stretch and a translation, shape (4, 4)."""
    rng = np.random.default_rng(seed)
    placement, turn = np.eye(4), np.linalg.qr(rng.normal(size=(3, 3)))[0]
    placement[:3, :3] = turn * np.sign(np.linalg.det(turn)) * rng.uniform(0.5, 2.0, 3)
    placement[:3, 3] = rng.uniform(-1.0, 1.0, 3)
    return placement @ np.diag([-1.0 if mirrored else 1.0, 1.0, 1.0, 1.0])


PARTS = {
    "two": [part((0, 0, 0), (0.1, 0.2, 0.3)), part((1, 0, 0), (0.1, 0.2, 0.3))],
    "moved": [part((0, 0, 0), (0.1, 0.2, 0.3), turned(k, mirrored=k == 1)) for k in range(3)],
}


def same(ours: np.ndarray, other: np.ndarray, single: float = 0.0) -> None:
    """Check that triangles (t, 3, 3) are others in any order, each with its own turn."""
    assert ours.shape == other.shape

    def sorted_rows(triangles: np.ndarray) -> np.ndarray:
        rows = np.round(triangles, 5) + 0.0
        first = np.lexsort(rows.transpose(2, 0, 1)[::-1], axis=1)[:, 0]
        rows = np.stack([triangles[k][np.roll(np.arange(3), -first[k])] for k in range(len(rows))])
        order = np.lexsort(np.round(rows, 5).reshape(len(rows), -1).T)
        return rows[order]

    assert np.abs(sorted_rows(ours) - sorted_rows(other)).max() <= 1e-12 + single


def volume(corners: np.ndarray) -> float:
    return float(np.linalg.det(corners).sum() / 6.0)


def file_of(folder: Path, kind: str, parts: list[Part]) -> Path:
    suffix, writer = WRITERS[kind]
    path = folder / f"mesh{suffix}"
    path.write_bytes(writer(parts))
    return path


@pytest.mark.parametrize("parts", PARTS.values(), ids=PARTS)
@pytest.mark.parametrize("kind", WRITERS)
def test_every_part_is_read_where_it_is_and_faces_outwards(kind: str, parts: list[Part], tmp_path: Path) -> None:
    single = 1e-6 if kind.split(maxsplit=1)[0] in ("stl", "gltf", "glb") and "text" not in kind else 0.0
    ours = read_mesh(file_of(tmp_path, kind, parts))
    corners = ours.vertices[ours.triangles]
    if kind not in ("obj polygons", "ply text", "dae polylist", "dae polygons", "dae fans", "dae strips"):
        same(corners, corners_of(parts), single)  # the others leave open how a side is halved
    expected = sum(math.prod(one.size) * abs(np.linalg.det(one.placement[:3, :3])) for one in parts)
    assert volume(corners) == pytest.approx(expected, abs=1e-6)
    assert len(ours.triangles) == 12 * len(parts)
    assert len(ours.vertices) == 8 * len(parts)


@pytest.mark.parametrize("kind", WRITERS)
def test_assimp_reads_the_same(kind: str, tmp_path: Path) -> None:
    path = file_of(tmp_path, kind, PARTS["moved"])
    ours, other = read_mesh(path), read_mesh_file(path)
    corners = ours.vertices[ours.triangles]
    assert len(corners) == len(other)
    for bound in (np.min, np.max):
        assert np.abs(bound(corners, axis=(0, 1)) - bound(other, axis=(0, 1))).max() < 1e-6
    assert volume(other) == pytest.approx(volume(corners), abs=1e-6)


@pytest.mark.parametrize("scale", [(2.0, 3.0, 0.5), (-1.0, 1.0, 1.0), (-1.0, -2.0, -1.0), (0.001, 0.001, 0.001)])
def test_a_scale_that_mirrors_keeps_triangles_outwards(scale: tuple[float, ...], tmp_path: Path) -> None:
    ours = read_mesh(file_of(tmp_path, "dae nodes", PARTS["two"]), np.array(scale))
    corners = ours.vertices[ours.triangles]
    assert volume(corners) == pytest.approx(2 * 0.006 * abs(math.prod(scale)))
    assert np.allclose(np.sort([corners[..., 0].min(), corners[..., 0].max()]), np.sort([0.0, 1.1 * scale[0]]))


@pytest.mark.parametrize("unit", ["0.01", "0.0254", "0.001", "1.0e-2", "1"])
def test_the_unit_of_a_collada_file_counts_and_its_upward_axis_does_not(unit: str, tmp_path: Path) -> None:
    size = tuple(value / float(unit) for value in (0.1, 0.2, 0.3))
    for up in ("X_UP", "Y_UP", "Z_UP"):
        path = tmp_path / "part.dae"
        path.write_bytes(written.dae([part((0, 0, 0), size)], unit=unit, up=up))
        ours, other = read_mesh(path), read_mesh_file(path)
        assert np.allclose(ours.vertices.max(axis=0), (0.1, 0.2, 0.3))
        assert np.allclose(other.max(axis=(0, 1)), (0.1, 0.2, 0.3))


def test_transformations_of_a_node_are_applied_in_their_order(tmp_path: Path) -> None:
    content = written.dae([part((0, 0, 0), (0.1, 0.2, 0.3))])
    for written_as, moved in (
        ("<translate>1 2 3</translate><rotate>0 0 1 90</rotate><scale>2 1 1</scale>", [1 - 0.2, 2, 3]),
        ("<rotate>0 0 1 90</rotate><translate>1 2 3</translate>", [-2 - 0.2, 1, 3]),
        ("<scale>2 1 1</scale><translate>1 2 3</translate>", [2, 2, 3]),
        ("<lookat>1 0 0 0 0 0 0 0 1</lookat>", [1, 0, 0]),
    ):
        start, end = content.index(b"<matrix>"), content.index(b"</matrix>") + len(b"</matrix>")
        path = tmp_path / "part.dae"
        path.write_bytes(content[:start] + written_as.encode() + content[end:])
        low = read_mesh(path).vertices.min(axis=0)
        assert np.allclose(low, moved), written_as
        assert np.allclose(read_mesh_file(path).min(axis=(0, 1)), moved, atol=1e-6), written_as


def test_concave_polygons_and_holes_are_filled_as_they_are(tmp_path: Path) -> None:
    outline = [(0, 0), (4, 0), (4, 3), (3, 1), (0, 3)]  # concave at its fourth corner
    quad = [(0, 0), (4, 0), (1, 1), (0, 4)]  # at its third
    rows = "".join(f"v {x} {y} 1\n" for x, y in [*outline, *quad])
    path = tmp_path / "flat.obj"
    path.write_text(rows + "f 1 2 3 4 5\nf 9 8 7 6\n")
    ours = read_mesh(path)
    edges = ours.vertices[ours.triangles]
    areas = 0.5 * np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0])[:, 2]
    assert sorted(np.sign(areas)) == [-1, -1, 1, 1, 1]
    assert areas[areas > 0].sum() == pytest.approx(_area(outline))
    assert -areas[areas < 0].sum() == pytest.approx(_area(quad))

    holed = written.dae([part((0, 0, 0), (1, 1, 1))], primitive="polygons")
    start, end = holed.index(b"<polygons"), holed.index(b"</polygons>")
    inputs = b'<polygons count="1"><input semantic="VERTEX" source="#g0v" offset="0"/>'
    face = b"<ph><p>0 4 6 2</p><h>8 9 10</h></ph>"
    more = holed[:start] + inputs + face + holed[end:]
    more = more.replace(b'count="24">', b'count="33">0.25 0.25 0 0.25 0.5 0 0.5 0.25 0 ', 1)
    more = more.replace(b'count="8" stride', b'count="11" stride', 1).replace(
        b"<p>0 4 6 2</p><h>8 9 10", b"<p>3 7 9 5</p><h>0 1 2", 1
    )
    path = tmp_path / "holed.dae"
    path.write_bytes(more)
    ours = read_mesh(path)
    edges = ours.vertices[ours.triangles]
    areas = 0.5 * np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0])[:, 2]
    assert (areas > 0.0).all()
    assert areas.sum() == pytest.approx(1.0 - 0.5 * 0.25**2)


def _area(corners: list[tuple[int, int]]) -> float:
    points = np.array(corners, float)
    after = np.roll(points, -1, axis=0)
    return float(0.5 * (points[:, 0] * after[:, 1] - points[:, 1] * after[:, 0]).sum())


def test_words_in_the_names_of_solids_are_no_vertices(tmp_path: Path) -> None:
    path = tmp_path / "m.stl"
    path.write_bytes(written.stl_text(PARTS["two"], "vertex facet of endsolid"))
    same(_corners(path), corners_of(PARTS["two"]))


def _corners(path: Path) -> np.ndarray:
    ours = read_mesh(path)
    return ours.vertices[ours.triangles]


def test_doubled_and_degenerate_triangles_cost_no_others(tmp_path: Path) -> None:
    path = tmp_path / "mesh.obj"
    box = written.obj_materials([part((0, 0, 0), (0.1, 0.2, 0.3))])
    path.write_bytes(box + b"f 1 1 2\nf 3 3 3\nv nan nan nan\nv 0 0 0\nf 10 2 4\n")
    ours = read_mesh(path)
    assert len(ours.triangles) == 13
    assert len(ours.vertices) == 8


@pytest.mark.parametrize("number", ["{:.3f}", "{:+.3f}", "{:.4f}e0", "{:.3f}\t"])
def test_numbers_without_a_digit_before_their_point_are_read(number: str, tmp_path: Path) -> None:
    corners = part((-0.1, -0.15, -0.2), (0.2, 0.3, 0.4)).vertices
    rows = [" ".join(number.format(value).replace("0.", ".", 1) for value in corner) for corner in corners.tolist()]
    faces = [f"f {a + 2} {b + 2} {c + 2}" for a, b, c in written.HALVES.tolist()]
    path = tmp_path / "box.obj"
    path.write_text("\n".join(["v .5 .5 .5", *(f"v {row}" for row in rows), "v 9 9 9", *faces, ""]))
    assert np.allclose(np.unique(read_mesh(path).vertices, axis=0), np.unique(corners, axis=0))


def test_a_buffer_beside_a_file_is_read_from_its_folder_alone(tmp_path: Path) -> None:
    (tmp_path / "parts" / "data").mkdir(parents=True)
    path = tmp_path / "parts" / "mesh.gltf"
    path.write_bytes(written.gltf(PARTS["two"], buffer="data/my%20parts.bin"))
    (tmp_path / "parts" / "data" / "my parts.bin").write_bytes(written.buffer_of(PARTS["two"]))
    assert len(read_mesh(path).triangles) == 24
    assert companions(path) == ["data/my parts.bin"]
    (tmp_path / "outside.bin").write_bytes(written.buffer_of(PARTS["two"]))
    path.write_bytes(written.gltf(PARTS["two"], buffer="../outside.bin"))
    with pytest.raises(MeshFault, match="must be in its folder"):
        read_mesh(path)


CONTENTS = {
    ".stl": lambda: written.stl(BOX),
    " .stl": lambda: written.stl_text(BOX),
    ".obj": lambda: written.obj_polygons(BOX),
    ".off": lambda: written.off(BOX),
    ".ply": lambda: written.ply_text(BOX),
    ".dae": lambda: written.dae(BOX),
    ".gltf": lambda: written.gltf(BOX),
    ".glb": lambda: written.gltf(BOX, binary=True),
    ".3mf": lambda: written.three_mf(BOX),
}


@pytest.mark.parametrize("kind", CONTENTS)
def test_the_content_says_of_which_kind_a_file_is(kind: str, tmp_path: Path) -> None:
    content, right = CONTENTS[kind](), tmp_path / f"right{kind.strip()}"
    right.write_bytes(content)
    expected = read_mesh(right)
    for suffix in READERS:
        wrong = tmp_path / f"wrong{suffix}"
        wrong.write_bytes(content)
        read = read_mesh(wrong)
        assert (read.vertices == expected.vertices).all(), suffix
        assert (read.triangles == expected.triangles).all(), suffix


@pytest.mark.parametrize("kind", [" .stl", ".obj", ".off", ".ply", ".dae", ".gltf"])
@pytest.mark.parametrize("form", ["mark", "carriage returns"])
def test_text_may_have_a_byte_order_mark_and_any_ends_of_lines(kind: str, form: str, tmp_path: Path) -> None:
    content = CONTENTS[kind]()
    other = b"\xef\xbb\xbf" + content if form == "mark" else content.replace(b"\n", b"\r\n")
    for name, one in (("a", content), ("b", other)):
        (tmp_path / f"{name}{kind.strip()}").write_bytes(one)
    plain, odd = (read_mesh(tmp_path / f"{name}{kind.strip()}") for name in "ab")
    assert (plain.vertices == odd.vertices).all()


def test_an_stl_file_may_be_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(written.stl_text(BOX))
    (tmp_path / "b.stl").write_bytes(b" ".join(written.stl_text(BOX).split()))
    one, other = (read_mesh(tmp_path / name) for name in ("a.stl", "b.stl"))
    assert (one.vertices == other.vertices).all()
    assert (one.triangles == other.triangles).all()


BOX = [part((0, 0, 0), (0.1, 0.2, 0.3))]
PAGE = b"\n<!DOCTYPE html><html><body>404</body></html>"
POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1284\n"


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("m.stl", b"", "is empty: it has 0 bytes"),
        ("m.stl", PAGE, "is an HTML page"),
        ("m.dae", PAGE, "is an HTML page"),
        ("m.obj", POINTER, "is a pointer of git-LFS"),
        ("m.stl", written.stl(BOX)[:-30], "states 12 facets and holds 11"),
        ("m.stl", written.stl(BOX)[:50], "has 50 bytes, and a binary one at least 84"),
        ("m.stl", written.stl_text(BOX)[:-9], "a solid has no 'endsolid'"),
        ("m.stl", written.stl_text(BOX)[:-400], "is cut short or malformed: it has"),
        ("m.stl", written.stl_text(BOX).replace(b"0.1", b"0,1", 1), "has '0,1' among its vertices"),
        ("m.stl", bytes(84), "has no triangles"),
        ("m.stl", b"solid nothing\nendsolid nothing\n", "has no triangles"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "vertex 3 .counted from 0., but only 3"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nf 0 1 2\n", "counts from 1"),
        ("m.obj", b"v 0 0\n", "fewer than three numbers"),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nl 1 2\n", "has no triangles"),
        ("m.off", written.off(BOX)[:-60], "is cut short"),
        ("m.ply", written.ply_binary(BOX)[:-9], "is cut short"),
        ("m.ply", written.ply_text(BOX)[:-9], "is cut short"),
        ("m.dae", written.dae(BOX)[:-9], "is not XML"),
        ("m.dae", written.dae(BOX, unit="0"), "must be a positive number"),
        ("m.dae", written.dae(BOX, unit="inch"), "must be a positive number"),
        ("m.dae", written.dae(BOX).replace(b"#g0v", b"#gone"), "refers to '#gone', which is no <vertices>"),
        ("m.dae", written.dae(BOX).replace(b'url="#g0"', b'url="other.dae#g0"'), "refers to 'other.dae#g0'"),
        ("m.gltf", written.gltf(BOX).replace(b'"count": 8', b'"count": 9'), "beyond its buffer"),
        ("m.gltf", written.gltf(BOX).replace(b'"mesh": 0', b'"mesh": 3'), "names the mesh 3, of 1"),
        ("m.gltf", written.gltf(BOX).replace(b'"2.0"', b'"1.0"'), "version 2 is read"),
        ("m.gltf", written.gltf(BOX, buffer="gone.bin"), "names the buffer 'gone.bin', which is not there"),
        ("m.glb", written.gltf(BOX, binary=True)[:-9], "is cut short"),
        ("m.3mf", written.three_mf(BOX)[:-9], "is no 3MF archive"),
    ],
)
def test_a_file_that_cannot_be_read_says_why(name: str, content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MeshFault, match=words):
        read_mesh(tmp_path / name)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 2.0 * FARTHEST_VERTEX])
@pytest.mark.parametrize("kind", ["stl", "obj materials", "ply binary", "off", "dae nodes", "glb nodes", "3mf"])
def test_a_vertex_that_is_nowhere_is_refused(kind: str, bad: float, tmp_path: Path) -> None:
    with np.errstate(invalid="ignore"):
        path = file_of(tmp_path, kind, [part((0, 0, 0), (bad, 1, 1))])
    with pytest.raises(MeshFault, match=r"has a vertex at \["):
        read_mesh(path)


@pytest.mark.parametrize(
    "nodes",
    [
        b'<node id="a"><instance_node url="#a"/></node>',
        b'<node id="a"><instance_node url="#b"/></node><node id="b"><instance_node url="#a"/></node>',
        b"".join(
            b'<node id="n%d">' % k + 2 * (b'<instance_node url="#n%d"/>' % (k - 1)) + b"</node>" for k in range(1, 40)
        )
        + b'<node id="n0"/>',
    ],
)
def test_nodes_that_contain_themselves_or_double_are_refused(nodes: bytes, tmp_path: Path) -> None:
    content = written.dae(BOX)
    start, end = content.index(b'<visual_scene id="s">') + 21, content.index(b"</visual_scene>")
    path = tmp_path / "m.dae"
    path.write_bytes(content[:start] + nodes + content[end:])
    with pytest.raises(MeshFault, match=r"contain themselves|instances counted"):
        read_mesh(path)


@pytest.mark.parametrize("piece", ["<!---->", "<!--", "\nv 1 1", "facet \n", "solid ", '{"asset', "<?xml ?>", "  "])
def test_the_kind_of_a_hostile_file_is_told_at_once(piece: str, tmp_path: Path) -> None:
    for suffix in READERS:
        path = tmp_path / f"m{suffix}"
        path.write_text(piece * (2**16 // len(piece)))
        with pytest.raises(MeshFault):
            read_mesh(path)
