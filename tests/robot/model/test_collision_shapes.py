"""Collision shapes: all parts of mesh files are judged, in metres, as hulls where these stand off little."""

from pathlib import Path

import coal
import numpy as np
import pytest
import trimesh

import guidefield
from guidefield.errors import RobotInvalid
from guidefield.messages.requests import UrdfFile
from guidefield.robot.catalog import Catalog
from guidefield.robot.model.collision_shapes import HULL_STAND_OFF, triangulation
from guidefield.robot.model.model import USUAL_REACH, RobotModel
from tests.geometry import solids
from tests.robot.mesh_files import written
from tests.robot.mesh_files.written import WRITERS, part
from tests.robots import ARMS, load, robot

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
    for one in (metres, told):
        assert np.allclose(triangulation(one.geometry.geometryObjects[0].geometry)[0].max(axis=0), (1.1, 0.2, 0.3))


@pytest.mark.parametrize("name", ARMS)
def test_choices_follow_the_stand_off(name: str) -> None:
    model = robot(name)
    for choice, one in zip(model.geometry_choices, model.geometry.geometryObjects, strict=True):
        if choice.judged_as == "convex hull":
            assert isinstance(one.geometry, coal.Convex)
            assert 0.0 <= choice.stand_off <= HULL_STAND_OFF
        elif choice.judged_as == "triangle mesh":
            assert isinstance(one.geometry, coal.BVHModelBase)
            assert choice.stand_off == 0.0
            assert _farthest_probe(one.geometry) > HULL_STAND_OFF


def _points(vertices: np.ndarray) -> coal.StdVec_Vec3s:
    points = coal.StdVec_Vec3s()
    for vertex in vertices:
        points.append(vertex)
    return points


def _farthest_probe(body: object) -> float:
    """Largest of Coal's distances of points on a mesh's hull from the mesh [m]."""
    hull = triangulation(coal.Convex.convexHull(_points(triangulation(body)[0]), True, "Qt"))
    corners = hull[0][hull[1]]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    widest = corners[np.argsort(-areas)[:60]].mean(axis=1)
    probe, there, request, result = (
        coal.Sphere(1e-9),
        coal.Transform3s.Identity(),
        coal.DistanceRequest(),
        coal.DistanceResult(),
    )
    farthest = 0.0
    for point in np.vstack([widest, solids.on_surface(hull, 400, np.random.default_rng(0))]):
        result.clear()
        here = coal.Transform3s(np.eye(3), point)
        farthest = max(farthest, coal.distance(probe, here, body, there, request, result))
    return farthest


def _arm_of(mesh: solids.Mesh, folder: Path, reach: float = 1.0) -> RobotModel:
    """One link of a mesh that turns on a small base, with a frame as far away as it reaches [m]."""
    trimesh.Trimesh(*mesh, process=False).export(folder / "shell.stl")
    box = '<collision><geometry><box size="0.02 0.02 0.02"/></geometry></collision>'
    shell = '<collision><geometry><mesh filename="shell.stl"/></geometry></collision>'
    joint = (
        '<joint name="j1" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="1 0 0"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
    )
    end = f'<joint name="end" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0 0 {reach!r}"/></joint>'
    links = f'<link name="base">{box}</link><link name="arm">{shell}</link><link name="tip"/>'
    (folder / "r.urdf").write_text(f'<robot name="r">{links}{joint}{end}</robot>')
    return load(UrdfFile(path=str(folder / "r.urdf")))


@pytest.mark.parametrize("size", [0.0625, 32.0])
def test_a_mesh_of_a_robot_of_another_size_is_judged_as_at_home(tmp_path: Path, size: float) -> None:
    for corner in (0.002, 0.02):  # a hull stands off by less than 5 mm, and by more
        outline = np.array([(0, 0), (0.3, 0), (0.15, corner), (0, 0.3)])
        bent = trimesh.creation.extrude_triangulation(outline, np.array([(0, 1, 2), (0, 2, 3)]), 0.1)
        home = _arm_of((np.array(bent.vertices), np.array(bent.faces)), tmp_path).geometry_choices[1]
        vertices = size * np.array(bent.vertices, np.float32)
        away = _arm_of((vertices, np.array(bent.faces)), tmp_path, size * USUAL_REACH)
        assert away.size == pytest.approx(size)
        assert away.geometry_choices[1].judged_as == home.judged_as
        assert away.geometry_choices[1].stand_off == pytest.approx(size * home.stand_off)


@pytest.mark.parametrize("inverted", [True, False])
def test_a_sealed_hollow_that_a_hull_fills_is_told(tmp_path: Path, inverted: bool) -> None:
    inner = solids.box((0.19, 0.19, 0.19))
    arm = _arm_of(solids.together(solids.box((0.2, 0.2, 0.2)), solids.turned(inner) if inverted else inner), tmp_path)
    assert arm.geometry_choices[1].judged_as == "convex hull"
    assert "link 'arm': mesh 'shell.stl' is judged by its hull, which fills 6.86 l of hollows" in arm.warnings


def test_a_hollow_behind_a_narrow_opening_that_a_hull_fills_is_told(tmp_path: Path) -> None:
    profile = [(0, 0), (0.1, 0), (0.1, 0.2), (0.003, 0.2), (0.003, 0.195), (0.095, 0.195), (0.095, 0.005), (0, 0.005)]
    bottle = trimesh.creation.revolve(np.array(profile), sections=48)
    arm = _arm_of((np.array(bottle.vertices), np.array(bottle.faces)), tmp_path)
    assert arm.geometry_choices[1].judged_as == "convex hull"
    told = next(warning for warning in arm.warnings if "fills" in warning)
    assert 4.0 < float(told.split("fills ")[1].split()[0]) < 1e3 * np.pi * 0.095**2 * 0.19


def test_a_mesh_in_millimetres_is_told(tmp_path: Path) -> None:
    told = "link 'arm': mesh 'shell.stl' is 200 m large: are its numbers millimetres?"
    assert any(told in warning for warning in _arm_of(solids.box((200.0, 20.0, 30.0)), tmp_path).warnings)
    assert not any("large" in warning for warning in _arm_of(solids.box((2.0, 0.2, 0.3)), tmp_path).warnings)


def test_a_link_of_an_open_mesh_is_told_to_be_a_thin_wall(tmp_path: Path) -> None:
    outline = np.array([(0, 0), (0.3, 0), (0.3, 0.1), (0.1, 0.1), (0.1, 0.3), (0, 0.3)])
    halves = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)])
    bent = trimesh.creation.extrude_triangulation(outline, halves, 0.1)
    whole = np.array(bent.vertices), np.array(bent.faces)
    topless = whole[0], whole[1][bent.face_normals[:, 2] < 0.9]
    open_at = "its surface is open (6 edges belong to one triangle): it is judged as a thin wall"
    told = f"link 'arm': mesh 'shell.stl': {open_at}"
    open_arm, closed_arm = _arm_of(topless, tmp_path), _arm_of(whole, tmp_path)
    assert [one.judged_as for one in (open_arm.geometry_choices[1], closed_arm.geometry_choices[1])] == 2 * [
        "triangle mesh"
    ]
    assert told in open_arm.warnings
    box = trimesh.creation.box((0.2, 0.2, 0.2))
    lidless = np.array(box.vertices), np.array(box.faces)[box.face_normals[:, 2] < 0.9]
    turned = whole[0], np.where(np.arange(len(whole[1]))[:, None] % 2, whole[1], whole[1][:, ::-1])
    for closed in (closed_arm, _arm_of(turned, tmp_path)):
        assert not any("thin wall" in warning for warning in closed.warnings)
    assert _arm_of(lidless, tmp_path).geometry_choices[1].judged_as == "triangle mesh"  # its lid is 10 cm off
    flat_box = trimesh.creation.box((0.2, 0.2, 0.004))
    shallow = np.array(flat_box.vertices), np.array(flat_box.faces)[flat_box.face_normals[:, 2] < 0.9]
    hulled = _arm_of(shallow, tmp_path)
    assert hulled.geometry_choices[1].judged_as == "convex hull"
    assert not any("thin wall" in warning for warning in hulled.warnings)
    state = {"robot": {"type": "urdf_file", "path": str(tmp_path / "r.urdf")}, "scene": {"name": "s", "obstacles": []}}
    trimesh.Trimesh(*topless, process=False).export(tmp_path / "shell.stl")
    plan = {**state, "goal": {"type": "joints", "positions": {"j1": 0.1}}, "guide_planes": [], "recording": "off"}
    assert told in guidefield.answer(plan).warnings
    assert told in guidefield.answer({**state, "type": "clearance", "configurations": [{}]}).warnings
