"""What is judged of mesh files is all that is in them: a slice of `tools/meshes`, and the robots of `tools/doubt`."""

from pathlib import Path

import numpy as np
import pytest

from guidefield.robot.catalog import Catalog
from guidefield.robot.model.collision_shapes import triangulation
from guidefield.robot.urdf.meshes import catalog_share

TOOLS = Path(__file__).resolve().parent.parent / "tools"
SLICE = (
    "alexander_description/meshes/LeftThigh.obj",
    "anymal_c_simple_description/meshes/wide_angle_camera.dae",
    "baxter_description/meshes/electric_gripper/fingers/extended_wide.DAE",
    "panda_description/meshes/collision/link5.stl",
    "panda_description/meshes/visual/link4.dae",
    "ur_description/meshes/ur3/visual/shoulder.dae",
    "ur_description/meshes/ur5/collision/wrist1.stl",
)


@pytest.fixture(autouse=True)
def tools(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(TOOLS))


@pytest.mark.parametrize("name", SLICE)
def test_a_file_of_the_catalog_is_read_as_assimp_reads_it(name: str) -> None:
    from doubting.mesh_files import compare

    assert compare(catalog_share() / "example-robot-data" / "robots" / name) is None


def test_a_part_that_is_lost_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from doubting import mesh_files
    from tests.robot.mesh_files.written import obj_materials, part

    path = tmp_path / "m.obj"
    path.write_bytes(obj_materials([part((0, 0, 0), (1, 1, 1)), part((2, 0, 0), (1, 1, 1))]))
    assert mesh_files.compare(path) is None
    whole = mesh_files.read_mesh(path)
    monkeypatch.setattr(mesh_files, "read_mesh", lambda _: whole._replace(triangles=whole.triangles[:12]))
    assert mesh_files.compare(path) == "12 triangles are judged, Assimp reads 24"
    moved = whole._replace(vertices=whole.vertices * (1.0, 1.0, 1.1))
    monkeypatch.setattr(mesh_files, "read_mesh", lambda _: moved)
    assert "differs: box by 0.1" in str(mesh_files.compare(path))


@pytest.mark.parametrize("seed", range(12))
def test_links_that_are_doubted_are_judged_whole(seed: int, tmp_path: Path) -> None:
    """Each box of a drawn file is in what is judged: its corners are vertices, or within the hull."""
    from doubting import mesh_files
    from doubting.formula import Formula
    from doubting.robots import FOLDER, Robot

    suffix, content, scale = mesh_files.draw_mesh_file(np.random.default_rng(seed))
    link = f'<collision><geometry><mesh filename="{FOLDER}m{suffix}" scale="{scale}"/></geometry></collision>'
    joint = '<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint>'
    text = f'<robot name="r"><link name="a"/><link name="b">{link}</link>{joint}</robot>'
    reference = Robot(text=text, meshes={f"m{suffix}": content}).reference(tmp_path)
    robot = Catalog().load(reference)
    ours, _ = triangulation(robot.geometry.geometryObjects[0].geometry)
    judged = Formula.of(Path(reference.path).read_text(), "fixed").geometry.geometryObjects[0].geometry
    theirs = np.array(judged.vertices())
    assert np.allclose([ours.min(axis=0), ours.max(axis=0)], [theirs.min(axis=0), theirs.max(axis=0)], atol=1e-6)
    assert 0.02 < np.ptp(ours, axis=0).max() < 1.0
