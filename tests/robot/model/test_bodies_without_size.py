"""Links of points, lines and faces: judged as what they are, within a micrometre."""

import math
from pathlib import Path

import numpy as np
import pytest

import guidefield
from guidefield.errors import RobotInvalid
from guidefield.messages.requests import UrdfFile, UrdfText
from guidefield.robot.catalog import Catalog
from guidefield.robot.urdf.elements import THICKNESS
from tests.robot.mesh_files import written
from tests.robot.mesh_files.written import part

URDF = """<robot name="z" version="1.1"><link name="w"/><link name="b"><collision>
<origin xyz="0.5 0 0"/><geometry>{shape}</geometry></collision></link>
<joint name="j" type="revolute"><parent link="w"/><child link="b"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""

BODIES = {
    '<box size="0 0 0"/>': (0.0, 0.0, 0.0),
    '<box size="1e-150 0.3 1e-150"/>': (0.0, 0.15, 0.0),
    '<box size="0.3 0 0.2"/>': (0.15, 0.0, 0.1),
    '<sphere radius="0.0"/>': (0.0, 0.0, 0.0),
    '<cylinder radius="0" length="0.4"/>': (0.0, 0.0, 0.2),
    '<cylinder radius="0.1" length="0"/>': (0.1, 0.1, 0.0),
    '<cylinder radius="0" length="0"/>': (0.0, 0.0, 0.0),
    '<capsule radius="0" length="0.4"/>': (0.0, 0.0, 0.2),
    '<capsule radius="0.05" length="0"/>': (0.05, 0.05, 0.05),
    '<mesh filename="m.obj" scale="0 1 1"/>': (0.0, 0.1, 0.15),
    '<mesh filename="m.obj" scale="0 0 1"/>': (0.0, 0.0, 0.15),
    '<mesh filename="m.obj" scale="0 0 0"/>': (0.0, 0.0, 0.0),
}
"""Half extents along the axes, by shape."""


def asked(folder: Path, shape: str, at: tuple[float, float, float], **more: object) -> dict:
    (folder / "m.obj").write_bytes(written.obj_materials([part((-0.05, -0.1, -0.15), (0.1, 0.2, 0.3))]))
    (folder / "z.urdf").write_text(URDF.format(shape=shape))
    ball = {"type": "sphere", "name": "ball", "radius": 0.05, "position": at}
    return {
        "robot": {"type": "urdf_file", "path": str(folder / "z.urdf")},
        "scene": {"name": "s", "obstacles": [ball]},
        "recording": "off",
        **more,
    }


@pytest.mark.parametrize(("shape", "half"), BODIES.items())
def test_distances_are_those_of_what_is_written(shape: str, half: tuple[float, float, float], tmp_path: Path) -> None:
    for axis, reach in enumerate(half):
        at = np.array([0.5, 0.0, 0.0]) + np.eye(3)[axis] * (reach + 0.15)
        request = asked(tmp_path, shape, tuple(at.tolist()), type="clearance", configurations=[{"j": 0.0}])
        del request["recording"]
        reply = guidefield.answer(request)
        assert reply.minimum == [pytest.approx(0.1, abs=3e-6)]
        assert any("judged as" in warning for warning in reply.warnings)


@pytest.mark.parametrize("shape", BODIES)
def test_motions_by_and_into_a_ball_are_told_apart(shape: str, tmp_path: Path) -> None:
    way = {"type": "certify", "path": [[-1.0], [1.0]], "position_names": ["j"]}
    hit = guidefield.answer(asked(tmp_path, shape, (0.5, 0.0, 0.0), **way))
    assert not hit.certificate.collision_free
    assert hit.clearance.minimum <= 0.0
    goal = {"type": "joints", "positions": {"j": 1.0}}
    planned = guidefield.answer(asked(tmp_path, shape, (0.5, 0.0, 0.4), start={"j": -1.0}, goal=goal, guide_planes=[]))
    assert planned.status.name == "SUCCESS"
    assert planned.certificate.collision_free


def test_a_warning_names_line_and_link_and_a_negative_size_is_an_error() -> None:
    robot = Catalog().load(UrdfText(URDF.format(shape='<cylinder radius="0" length="0.4"/>')))
    (told,) = [warning for warning in robot.warnings if "judged as" in warning]
    assert told.startswith("line 2: link 'b': <cylinder> has the 'radius' of '0'; what is zero is judged as 0.002 mm")
    assert math.isclose(robot.geometry.geometryObjects[0].geometry.radius, 0.5 * THICKNESS)
    for shape in ('<sphere radius="-1"/>', '<box size="0 -0.1 0"/>', '<cylinder radius="0" length="-1"/>'):
        with pytest.raises(RobotInvalid, match="must be positive"):
            Catalog().load(UrdfText(URDF.format(shape=shape)))


def test_a_mesh_whose_triangles_are_one_line_is_a_thin_box_along_it(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 0.1 0.2 0.2\nv 0.2 0.4 0.4\nf 1 2 3\n")
    (tmp_path / "z.urdf").write_text(URDF.format(shape='<mesh filename="m.obj"/>'))
    shape = Catalog().load(UrdfFile(str(tmp_path / "z.urdf"))).geometry.geometryObjects[0]
    assert np.allclose(np.sort(2.0 * shape.geometry.halfSide), [THICKNESS, THICKNESS, 0.6 + THICKNESS], atol=1e-9)
    ends = [shape.placement.act(side * np.array(shape.geometry.halfSide)) for side in (-1.0, 1.0)]
    assert np.allclose(sorted(map(tuple, ends)), [(0.5, 0, 0), (0.7, 0.4, 0.4)], atol=1e-5)
