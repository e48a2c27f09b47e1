"""The referee reads mesh files by itself: a part that the planner's reader loses is seen."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from guidefield import case_file
from guidefield.collision.world import World
from guidefield.messages.requests import UrdfFile
from guidefield.referee.case import Answer
from guidefield.referee.judge import judge
from guidefield.referee.loading import UnusableFile, case_of
from guidefield.referee.shapes import UnreadableMesh, read_mesh_file
from guidefield.robot.catalog import Catalog
from guidefield.robot.group.reduced_model import select
from guidefield.robot.mesh_files.reading import FileMesh, read_mesh
from guidefield.robot.model import collision_shapes
from tests.collision.scenery import box, world_of
from tests.referee.cases import straight
from tests.robot.mesh_files import written
from tests.robot.mesh_files.written import WRITERS, part
from tests.robot.model.test_collision_shapes import TWO, urdf_of

CRATE = box("crate", (0.05, 0.05, 0.05), (1.05, 0.1, 1.15))
WAY = [[-0.5], [0.5]]


def world_at(path: Path) -> World:
    robot = Catalog().load(UrdfFile(str(path)))
    return world_of(select(robot, None, "b", robot.rest, pin.SE3.Identity()), [CRATE])


def told_of(world: World) -> dict[str, Any]:
    (told,) = case_file.make_cases(straight(world, WAY))
    return json.loads(json.dumps(told))


@pytest.mark.parametrize(
    "kind", ["obj materials", "dae primitives", "dae nodes", "dae library", "gltf primitives", "3mf"]
)
def test_a_part_that_the_planner_loses_is_contact(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    suffix, writer = WRITERS[kind]
    path = urdf_of(tmp_path, f"mesh{suffix}", writer(TWO))
    assert judge(case_of(told_of(world_at(path)))).answer is Answer.CONTACT

    def first_part(path: Path, scale: np.ndarray | None = None) -> FileMesh:
        whole = read_mesh(path, scale)
        kept = whole.triangles[(whole.vertices[whole.triangles][..., 0] < 0.5).all(axis=1)]
        return FileMesh(whole.vertices[np.unique(kept)], np.unique(kept, return_inverse=True)[1].reshape(-1, 3))

    monkeypatch.setattr(collision_shapes, "read_mesh", first_part)
    world = world_at(path)
    assert world.group.geometry.geometryObjects[0].geometry.aabb_local.max_[0] < 0.5
    told = told_of(world)
    assert judge(case_of(told)).answer is Answer.FALSE_PART
    told["parts"]["links"] = {}
    assert judge(case_of(told)).answer is Answer.CONTACT


def test_a_buffer_beside_a_file_is_in_the_case(tmp_path: Path) -> None:
    (tmp_path / "parts.bin").write_bytes(written.buffer_of(TWO))
    told = told_of(world_at(urdf_of(tmp_path, "m.gltf", written.gltf(TWO, buffer="parts.bin"))))
    assert sorted(told["robot"]["mesh_files"]) == ["0/m.gltf", "0/parts.bin"]
    assert judge(case_of(told)).answer is Answer.CONTACT


def test_a_file_outside_its_folder_is_refused(tmp_path: Path) -> None:
    told = told_of(world_at(urdf_of(tmp_path, "m.stl", written.stl(TWO))))
    files = told["robot"]["mesh_files"]
    files["0/../../escaped.stl"] = files["0/m.stl"]
    with pytest.raises(UnusableFile, match="outside its folder"):
        case_of(told)


def test_a_file_without_triangles_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.obj"
    path.write_bytes(b"v 0 0 0\nv 1 0 0\nl 1 2\n")
    with pytest.raises(UnreadableMesh):
        read_mesh_file(path)


def test_a_shell_in_double_precision_is_that_of_a_mesh_in_single(tmp_path: Path) -> None:
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(1.0), -np.sin(1.0)], [np.sin(1.0), np.cos(1.0)]]
    parts = [part((0.1, 0.2, 0.3), (0.1, 0.2, 0.3), turn), part((1, 0, 0), (0.1, 0.2, 0.3), turn)]
    told = told_of(world_at(urdf_of(tmp_path, "m.dae", written.dae(parts))))
    ours = read_mesh(tmp_path / "m.dae")
    assert (ours.vertices[ours.triangles] != read_mesh_file(tmp_path / "m.dae")).any()
    shell = {"vertices": ours.vertices.tolist(), "triangles": ours.triangles.tolist()}
    told["parts"]["links"]["b_0"]["shell"] = shell
    assert judge(case_of(told)).answer is Answer.FREE
    shell["vertices"][0][0] += 1e-4
    assert judge(case_of(told)).answer is Answer.FALSE_PART


@pytest.mark.parametrize("kind", ["stl", "stl text", "obj materials", "ply text", "dae nodes", "gltf nodes", "3mf"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_a_mesh_of_another_ending_or_with_a_byte_order_mark_is_read(kind: str, mark: bytes, tmp_path: Path) -> None:
    suffix, writer = WRITERS[kind]
    content, wrong = writer(TWO), ".obj" if suffix.lower() == ".stl" else ".stl"
    is_text = content[:256].isascii() and b"\0" not in content[:256]
    path = urdf_of(tmp_path, f"mesh{wrong}", (mark if is_text else b"") + content)
    assert judge(case_of(told_of(world_at(path)))).answer is Answer.CONTACT
