"""Links of mesh files: all parts are judged, in the link's metres; a mesh that can't be read is named with its link."""

from pathlib import Path

import numpy as np
import pytest

import guidefield
from guidefield.errors import RobotInvalid
from guidefield.messages.requests import UrdfFile
from guidefield.robot.catalog import Catalog
from guidefield.robot.model.collision_shapes import triangulation
from guidefield.robot.model.model import RobotModel
from tests.robot.mesh_files import written
from tests.robot.mesh_files.written import WRITERS, part

TWO = [part((0, 0, 0), (0.1, 0.2, 0.3)), part((1, 0, 0), (0.1, 0.2, 0.3))]
URDF = """<robot name="m"><link name="w"/>
<link name="b"><collision><origin xyz="0 0 1"/><geometry><mesh filename="{file}"{scale}/></geometry></collision></link>
<joint name="s" type="prismatic"><parent link="w"/><child link="b"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def urdf_of(folder: Path, file: str, content: bytes, scale: str = "") -> Path:
    """A robot whose only link that moves is a mesh a metre above its frame."""
    (folder / file).write_bytes(content)
    path = folder / "m.urdf"
    path.write_text(URDF.format(file=file, scale=f' scale="{scale}"' if scale else ""))
    return path


def robot_of(folder: Path, file: str, content: bytes, scale: str = "") -> RobotModel:
    return Catalog().load(UrdfFile(str(urdf_of(folder, file, content, scale))))


def asked(path: Path, at: tuple[float, float, float]) -> dict:
    """A motion of half a metre in which the second box drives through a crate at a place."""
    crate = {"type": "box", "name": "crate", "size": [0.05, 0.05, 0.05], "position": at}
    return {
        "type": "certify",
        "robot": {"type": "urdf_file", "path": str(path)},
        "scene": {"name": "s", "obstacles": [crate]},
        "path": [[-0.5], [0.5]],
        "position_names": ["s"],
        "recording": "off",
    }


@pytest.mark.parametrize("kind", WRITERS)
def test_a_part_that_drives_through_a_crate_is_seen(kind: str, tmp_path: Path) -> None:
    suffix, writer = WRITERS[kind]
    path = urdf_of(tmp_path, f"mesh{suffix}", writer(TWO))
    hit = guidefield.answer(asked(path, (1.05, 0.1, 1.15)))
    assert not hit.certificate.collision_free
    assert hit.status.name == "INVALID_MOTION_PLAN"
    assert hit.clearance.pair == ["b", "crate"]
    free = guidefield.answer(asked(path, (1.05, 0.1, 1.35)))
    assert free.certificate.collision_free
    assert free.clearance.minimum == pytest.approx(0.025, abs=1e-4)


@pytest.mark.parametrize(("unit", "scale"), [("0.01", "1"), ("0.0254", "1"), ("0.001", "10"), ("1", "0.01")])
def test_a_unit_and_a_scale_both_count(unit: str, scale: str, tmp_path: Path) -> None:
    robot = robot_of(tmp_path, "m.dae", written.dae([part((0, 0, 0), (10, 20, 30))], unit=unit), f"{scale} " * 3)
    vertices, _ = triangulation(robot.geometry.geometryObjects[0].geometry)
    assert np.allclose(vertices.max(axis=0), np.array([10, 20, 30]) * float(unit) * float(scale))


def test_links_share_a_file_at_different_scales(tmp_path: Path) -> None:
    path = urdf_of(tmp_path, "m.obj", written.obj_materials(TWO))
    more = '<collision><geometry><mesh filename="m.obj" scale="-2 1 1"/></geometry></collision><collision>'
    path.write_text(path.read_text().replace("<collision>", more, 1))
    shapes = Catalog().load(UrdfFile(str(path))).geometry.geometryObjects
    boxes = [triangulation(one.geometry)[0] for one in shapes]
    assert [one.name for one in shapes] == ["b_0", "b_1"]
    assert np.allclose([boxes[0].min(axis=0), boxes[0].max(axis=0)], [(-2.2, 0, 0), (0, 0.2, 0.3)])
    assert np.allclose([boxes[1].min(axis=0), boxes[1].max(axis=0)], [(0, 0, 0), (1.1, 0.2, 0.3)])
    assert np.allclose([one.placement.translation[2] for one in shapes], [0, 1])


@pytest.mark.parametrize(
    ("content", "cause"),
    [
        (b"", "is empty: it has 0 bytes"),
        (b"<!DOCTYPE html><html></html>", "is an HTML page"),
        (written.stl(TWO)[:-60], "is cut short or no STL: it states 24 facets and holds 22"),
        (written.stl([part((0, 0, 0), (float("nan"), 1, 1))]), "has a vertex at ["),
    ],
)
def test_a_mesh_that_cannot_be_read_is_told_with_line_link_and_cause(content, cause, tmp_path):
    with pytest.raises(RobotInvalid) as refused:
        robot_of(tmp_path, "cube.stl", content)
    assert refused.value.message.startswith(f"line 2: mesh 'cube.stl' of link 'b' {cause}")
    assert refused.value.details == {"link": "b", "uri": "cube.stl", "line": 2}


def test_the_unit_of_a_3mf_file_is_told_and_not_applied(tmp_path: Path) -> None:
    metres = robot_of(tmp_path, "m.3mf", written.three_mf(TWO))
    assert not any("unit" in warning for warning in metres.warnings)
    told = robot_of(tmp_path, "m.3mf", written.three_mf(TWO, unit="millimeter"))
    assert any("link 'b': mesh 'm.3mf' states its unit, millimeter" in warning for warning in told.warnings)
    for robot in (metres, told):
        assert np.allclose(triangulation(robot.geometry.geometryObjects[0].geometry)[0].max(axis=0), (1.1, 0.2, 0.3))
