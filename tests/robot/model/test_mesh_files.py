"""Mesh files with numbers that a reader misreads, and with some that aren't numbers."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st

from guidefield.errors import RobotInvalid
from guidefield.messages.requests import UrdfFile
from guidefield.robot.catalog.catalog import Catalog
from guidefield.robot.model.mesh_files import FURTHEST_VERTEX, written_plainly
from guidefield.robot.model.shapes import triangulation

CUBE = trimesh.creation.box((0.2, 0.3, 0.4))
URDF = """<robot name="m"><link name="base"/><link name="arm"><collision><geometry><mesh filename="{file}"/></geometry>
</collision></link><joint name="j" type="continuous"><parent link="base"/><child link="arm"/></joint></robot>"""


def _obj(vertices: np.ndarray, number: str) -> bytes:
    written = [[_written(value, number) for value in vertex] for vertex in vertices.tolist()]
    lines = [f"v {' '.join(vertex)}" for vertex in written]
    return "\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in (CUBE.faces + 1).tolist()), ""]).encode()


def _written(value: float, number: str) -> str:
    return number.format(value).replace("0.", ".", 1) if abs(value) < 1.0 else number.format(value)


def _stl(vertices: np.ndarray) -> bytes:
    facets = [struct.pack("<12fH", 0, 0, 0, *vertices[face].ravel(), 0) for face in CUBE.faces]
    return b"\0" * 80 + struct.pack("<I", len(facets)) + b"".join(facets)


def _plain_text(kind: str, vertices: np.ndarray) -> bytes:
    mesh = trimesh.Trimesh(vertices, CUBE.faces, process=False, validate=False)
    content = mesh.export(file_type=kind)
    return content if isinstance(content, bytes) else content.encode()


def _robot(folder: Path, file: str, content: bytes):
    (folder / file).write_bytes(content)
    (folder / "robot.urdf").write_text(URDF.format(file=file))
    return Catalog().load(UrdfFile(str(folder / "robot.urdf")))


@pytest.mark.parametrize("number", ["{:.3f}", "{:+.3f}", "{:.4f}e0", "{:.3f}\t"])
def test_numbers_without_a_digit_before_their_point_are_read(number: str, tmp_path: Path) -> None:
    robot = _robot(tmp_path, "cube.obj", _obj(CUBE.vertices, number))
    vertices, _ = triangulation(robot.geometry.geometryObjects[0].geometry)
    by_trimesh = trimesh.load_mesh(tmp_path / "cube.obj").vertices
    assert np.allclose(np.unique(vertices, axis=0), np.unique(by_trimesh, axis=0), atol=1e-6)
    assert np.allclose(np.unique(vertices, axis=0), np.unique(CUBE.vertices, axis=0), atol=1e-6)


def test_a_vertex_that_no_face_needs_does_not_shift_the_others(tmp_path: Path) -> None:
    """Where it is left out, every index is still in range, and the robot another one."""
    unneeded = b"v .5 .5 .5\n"
    content = _obj(CUBE.vertices + 1.0, "{:.3f}")
    shifted = content.replace(b"f ", b"v 9 9 9\nf ", 1)
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in (CUBE.faces + 2).tolist()).encode()
    robot = _robot(tmp_path, "cube.obj", unneeded + shifted.partition(b"f ")[0] + faces)
    vertices, _ = triangulation(robot.geometry.geometryObjects[0].geometry)
    assert np.allclose(np.unique(vertices, axis=0), np.unique(CUBE.vertices + 1.0, axis=0), atol=1e-6)


@given(st.lists(st.floats(-10.0, 10.0).map(lambda x: round(x, 4)), min_size=3, max_size=3))
def test_what_is_written_plainly_means_the_same(vertex: list[float]) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "m.obj"
        short = " ".join(f"{value:.4f}".replace("0.", ".", 1) if abs(value) < 1 else f"{value:.4f}" for value in vertex)
        file.write_bytes(f"# .5\nv {short}\nvt .5 .5\n".encode())
        with written_plainly(URDF.format(file=file)) as (text, copied):
            read = Path(next(iter(copied), str(file))).read_text()
            assert all(copy in text for copy in copied)
        assert [float(word) for word in read.splitlines()[1].split()[1:]] == vertex
        assert not any(word.startswith(".") for word in read.splitlines()[1].split())
        assert (read.splitlines()[0], read.splitlines()[2]) == ("# .5", "vt .5 .5")


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 2.0 * FURTHEST_VERTEX])
@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "off"])
def test_a_vertex_that_is_nowhere_is_named_with_its_mesh_and_link(kind: str, bad: float, tmp_path: Path) -> None:
    vertices = CUBE.vertices.astype(np.float32)
    vertices[0, 0] = bad
    content = _stl(vertices) if kind == "stl" else _plain_text(kind, vertices)
    with pytest.raises(RobotInvalid, match=rf"mesh 'cube.{kind}' of link 'arm' has a vertex at \[") as refused:
        _robot(tmp_path, f"cube.{kind}", content)
    assert refused.value.details == {"link": "arm", "uri": f"cube.{kind}"}


def test_a_mesh_that_cannot_be_read_is_not_said_to_be_elsewhere(tmp_path: Path) -> None:
    with pytest.raises(RobotInvalid) as refused:
        _robot(tmp_path, "cube.stl", _stl(CUBE.vertices)[:-60])
    assert "STL" in refused.value.message
    assert "Hint" not in refused.value.message
