import dataclasses
import io
import re

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from guidefield.recorder import bodies, surface
from guidefield.recorder.bodies import cover_spheres, visual_bodies
from guidefield.recorder.surface import Surface
from guidefield.robot.link_bounds import coverage
from tests.robots import robot

MOST_DRAWN = 6  # number of looks of a robot that are compared


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
