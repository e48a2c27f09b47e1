from __future__ import annotations

import dataclasses
import io
import re

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from guidefield.messages.requests import UrdfFile
from guidefield.recorder import bodies, surface
from guidefield.recorder.bodies import cover_spheres, visual_bodies
from guidefield.recorder.surface import GREY, Surface
from guidefield.robot.bodies.sphere_cover import coverage
from guidefield.robot.catalog.catalog import Catalog
from guidefield.robot.model.model import RobotSource
from tests.robots import robot

MOST_DRAWN = 6
"""Number of looks of a robot that are compared."""


def without(text: str, parts: list[str]) -> str:
    for part in parts:
        text = text.replace(part, "")
    return text


@pytest.mark.parametrize("name", ["panda", "xarm7", "anymal_c_simple"])
def test_bodies_are_where_pinocchio_has_them(name):
    """Pinocchio reads the same elements with its own parser and its own mesh reader."""
    model = robot(name)
    left_out = re.findall("<visual>.*?</visual>", model.source.urdf_text, re.DOTALL)[MOST_DRAWN:]
    source = dataclasses.replace(model.source, urdf_text=without(model.source.urdf_text, left_out))
    read = pin.GeometryModel()
    pin.buildGeomFromUrdfString(model.model, source.urdf_text, pin.GeometryType.VISUAL, read, [])
    expected = {shape.name: shape for shape in read.geometryObjects}
    drawn, faults = visual_bodies(source)
    assert faults == ()
    assert {body.name for body in drawn} == set(expected)
    for body in drawn:
        shape = expected[body.name]
        shape.geometry.computeLocalAABB()
        box = shape.geometry.aabb_local
        in_link = model.model.frames[model.frame_id(body.link)].placement.inverse() * shape.placement
        if shape.meshPath in ("BOX", "CYLINDER", "SPHERE"):
            continue  # its box isn't that of a turned primitive's corners
        own = in_shape_frame(body, in_link)
        assert np.allclose([own.min(axis=0), own.max(axis=0)], [box.min_, box.max_], atol=2e-4), body.name


def in_shape_frame(body: bodies.Body, in_link: pin.SE3) -> np.ndarray:
    """A body's vertices in the frame of Pinocchio's shape, whose vertices are scaled but not placed."""
    if isinstance(body.surface, Surface):
        points, placement = body.surface.vertices.astype(float), pin.SE3.Identity()
    else:
        scene = trimesh.load_scene(io.BytesIO(body.surface), file_type="glb")
        points, placement = scene.to_geometry().vertices, body.placement
    there = in_link.inverse() * placement
    return points @ there.rotation.T + there.translation


def test_a_material_of_the_urdf_colours_a_mesh_over():
    drawn, _ = visual_bodies(robot("xarm7").source)
    by_name = {body.name: body for body in drawn}
    assert (by_name["link1_0"].surface.colors == (255, 255, 255, 255)).all()
    assert (by_name["link7_0"].surface.colors[:, :3] < 255).all()


URDF = """<robot name="r">
  <material name="blue"><color rgba="0 0 1 1"/></material>
  <link name="base">
    <visual><origin xyz="0 0 1" rpy="0 0 1.5707963"/><geometry><box size="0.2 0.4 0.6"/></geometry>
      <material name="blue"/></visual>
    <visual><geometry><capsule radius="0.1" length="0.3"/></geometry></visual>
    <visual><geometry><mesh filename="/nowhere/at_all.stl"/></geometry></visual>
    <visual><geometry><torus radius="1"/></geometry></visual>
  </link></robot>"""


def test_primitives_have_their_placement_and_their_material():
    drawn, faults = visual_bodies(RobotSource(URDF, None))
    box, capsule = drawn
    assert np.allclose(box.surface.vertices.min(axis=0), [-0.2, -0.1, 0.7], atol=1e-6)
    assert box.color == (0, 0, 255, 255)
    assert np.allclose(np.ptp(capsule.surface.vertices, axis=0), [0.2, 0.2, 0.5], atol=1e-3)
    assert capsule.color == GREY
    assert [fault.split(":")[0] for fault in faults] == ["visual base_2 is not drawn", "visual base_3 is not drawn"]


def test_a_robot_without_looks_is_drawn_as_it_is_judged(tmp_path):
    path = tmp_path / "arm.urdf"
    link = '<link name="{}"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>'
    joint = (
        '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )
    path.write_text(f'<robot name="arm">{link.format("a")}{link.format("b")}{joint}</robot>')
    _, chunks = bodies.prepare(Catalog().load(UrdfFile(path=str(path))), tmp_path / "arm.rrd")
    paths = {chunk.entity_path for chunk in chunks}
    assert paths - {"/robot/spheres/a", "/robot/spheres/b"} == {
        f"/robot/{tree}/{link}_0" for tree in ("visual", "collision") for link in "ab"
    }


def test_balls_that_are_drawn_contain_each_link():
    """Pinocchio's own hulls of the shapes: every vertex is in a ball of its link."""
    model = robot("panda")
    coverage(model)
    drawn = {chunk.entity_path: chunk.to_record_batch() for chunk in cover_spheres(model)}
    for index, shape in enumerate(model.geometry.geometryObjects):
        link = model.link_of_geometry(index)
        batch = drawn[f"/robot/spheres/{link}"]
        assert batch.column("CoordinateFrame:frame").to_pylist() == [[f"link {link}"]]
        centers, radii = (np.array(batch.column(f"Points3D:{name}").to_pylist()[0]) for name in ("positions", "radii"))
        in_link = model.model.frames[model.frame_id(link)].placement.inverse() * shape.placement
        vertices = surface.of_shape(shape.geometry).move(in_link).vertices
        inside = np.linalg.norm(vertices[:, None] - centers[None], axis=2) <= radii + 1e-5
        assert inside.any(axis=1).all(), link
