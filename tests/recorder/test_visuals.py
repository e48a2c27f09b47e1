"""What is drawn of robots, and smoothed surfaces."""

import dataclasses
import io
import os
import re
from pathlib import Path

import coal
import networkx
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from hypothesis import given, settings, strategies as st
from PIL import EpsImagePlugin

from guidefield.recorder import bodies, surface
from guidefield.recorder.bodies import cover_spheres, visual_bodies
from guidefield.recorder.surface import Surface
from guidefield.robot.link_bounds import coverage
from guidefield.robot.urdf.meshes import catalog_share
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


SHAPES = {
    "box": (coal.Box(0.2, 0.3, 0.4), 0.2 * 0.3 * 0.4, 24),
    "sphere": (coal.Sphere(0.1), 4.0 / 3.0 * np.pi * 0.1**3, None),
    "cylinder": (coal.Cylinder(0.1, 0.5), np.pi * 0.1**2 * 0.5, None),
    "capsule": (coal.Capsule(0.1, 0.5), np.pi * 0.1**2 * 0.5 + 4.0 / 3.0 * np.pi * 0.1**3, None),
    "ellipsoid": (coal.Ellipsoid(0.1, 0.2, 0.3), 4.0 / 3.0 * np.pi * 0.1 * 0.2 * 0.3, None),
}


def closed(drawn: Surface) -> trimesh.Trimesh:
    return trimesh.Trimesh(drawn.vertices, drawn.triangles, merge_norm=True, merge_tex=True)


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_is_drawn_with_its_volume_and_its_bounds(name):
    shape, volume, vertices = SHAPES[name]
    drawn = surface.of_shape(shape)
    mesh = closed(drawn)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(volume, rel=0.02)
    shape.computeLocalAABB()
    assert np.allclose(mesh.bounds, [shape.aabb_local.min_, shape.aabb_local.max_], atol=1e-3)
    assert vertices is None or len(drawn.vertices) == vertices


@pytest.mark.parametrize("name", SHAPES)
def test_normals_are_unit_and_point_outwards(name):
    drawn = surface.of_shape(SHAPES[name][0])
    assert np.allclose(np.linalg.norm(drawn.normals, axis=1), 1.0, atol=1e-5)
    facing = np.einsum("tik,tk->ti", drawn.normals[drawn.triangles], closed_face_normals(drawn))
    assert facing.min() > np.cos(surface.CREASE)


def closed_face_normals(drawn: Surface) -> np.ndarray:
    a, b, c = (drawn.vertices[drawn.triangles[:, i]].astype(float) for i in range(3))
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


@settings(max_examples=12)
@given(seed=st.integers(0, 2**32 - 1), crease=st.floats(0.1, 1.5))
def test_creases_part_the_corners_at_a_vertex(seed, crease):
    """Two triangles share a corner's normal exactly if smooth edges lead from one to the other around it."""
    rng = np.random.default_rng(seed)
    mesh = trimesh.Trimesh(np.round(rng.normal(size=(30, 3)), 4)).convex_hull
    around = [networkx.Graph() for _ in mesh.vertices]
    for number, face in enumerate(mesh.faces):
        for vertex in face:
            around[vertex].add_node(number)
    for faces, edge, angle in zip(
        mesh.face_adjacency, mesh.face_adjacency_edges, mesh.face_adjacency_angles, strict=True
    ):
        for vertex in edge:
            if angle < crease:
                around[vertex].add_edge(*faces)
    drawn = surface.shade(mesh.vertices, mesh.faces, crease)
    assert len(drawn.vertices) == sum(networkx.number_connected_components(graph) for graph in around)
    assert len(drawn.triangles) == len(mesh.faces)
    assert trimesh.Trimesh(drawn.vertices, drawn.triangles).area == pytest.approx(mesh.area, rel=1e-4)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".glb", ".dae", ".ply"])
def test_reads_every_kind_of_mesh_file_at_its_scale(suffix, tmp_path):
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    path = tmp_path / f"box{suffix}"
    box.export(path)
    drawn = surface.read_mesh(path, np.array([0.001, 0.001, 0.002]), (10, 20, 30, 255))
    assert np.allclose(np.ptp(drawn.vertices, axis=0), [0.001, 0.002, 0.006])
    assert (drawn.colors == (10, 20, 30, 255)).all()


def test_keeps_the_colours_of_the_file(tmp_path):
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=[200, 100, 50, 255])
    box = trimesh.creation.box()
    box.visual = trimesh.visual.TextureVisuals(material=material)
    box.export(tmp_path / "box.glb")
    drawn = surface.read_mesh(tmp_path / "box.glb", np.ones(3), None)
    assert np.abs(drawn.colors.astype(int) - (200, 100, 50, 255)).max() <= 1


def test_a_file_with_nothing_to_draw_is_refused(tmp_path):
    path = Path(tmp_path / "points.obj")
    path.write_text("v 0 0 0\nv 1 0 0\n")
    with pytest.raises(ValueError, match=r"points\.obj"):
        surface.read_mesh(path, np.ones(3), None)


def test_a_file_that_trimesh_finds_empty_is_read_as_it_is_for_collisions():
    """A real one: its triangles hang on a node that trimesh doesn't reach."""
    robots = catalog_share() / "example-robot-data" / "robots"
    path = robots / "anymal_b_simple_description" / "meshes" / "foot" / "anymal_foot.dae"
    drawn = surface.read_mesh(path, np.full(3, 2.0), None)
    expected = coal.MeshLoader().load(str(path), np.full(3, 2.0))
    expected.computeLocalAABB()
    box = expected.aabb_local
    assert np.allclose([drawn.vertices.min(axis=0), drawn.vertices.max(axis=0)], [box.min_, box.max_], atol=1e-6)


def test_a_texture_that_is_postscript_is_not_run(tmp_path, monkeypatch):
    """Pillow goes by content, and hands PostScript to Ghostscript, whatever a client called the file."""
    monkeypatch.setattr(EpsImagePlugin, "gs_binary", None)
    program, ran = tmp_path / "gs", tmp_path / "ran"
    program.write_text(f"#!/bin/sh\ntouch {ran}\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    (tmp_path / "a.mtl").write_text("newmtl a\nmap_Kd a.png\n")
    header = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n"
    (tmp_path / "a.png").write_bytes(header + b"showpage\n%%EOF\n")
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 0 1\n"
    faces = "f 1/1 3/2 2/3\nf 1/1 2/2 4/3\nf 2/1 3/2 4/3\nf 1/1 4/2 3/3\n"
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\nusemtl a\n{corners}{faces}")
    with pytest.raises(OSError, match="Ghostscript"):
        surface.read_mesh(tmp_path / "a.obj", np.ones(3), None)
    assert not ran.exists()
    assert EpsImagePlugin.gs_binary is None  # as before: others in this process may read such files
