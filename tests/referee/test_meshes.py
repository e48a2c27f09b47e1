"""The referee's own shapes: mesh files, bodies within shapes, and tables that hold all that is declared."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import nnls

from guidefield import case_file
from guidefield.collision.bodies import bodies
from guidefield.collision.obstacle_boxes import obstacle_boxes
from guidefield.collision.world import World
from guidefield.messages.requests import UrdfFile
from guidefield.prove import proof
from guidefield.referee.case import Answer
from guidefield.referee.judge import judge
from guidefield.referee.loading import UnusableFile, case_of
from guidefield.referee.proof import Declared, Shapes, _by_planes, radius_about, standing_out
from guidefield.referee.shapes import UnreadableMesh, hull, read_mesh_file
from guidefield.robot.catalog import Catalog
from guidefield.robot.group.reduced_model import select
from guidefield.robot.mesh_files.reading import FileMesh, read_mesh
from guidefield.robot.model import collision_shapes
from guidefield.scene.cloud import Cloud
from guidefield.scene.scene import build
from guidefield.stores import scenes
from tests.collision.scenery import box, world_of
from tests.referee.cases import straight
from tests.robot.mesh_files import written
from tests.robot.mesh_files.written import WRITERS, part
from tests.robot.model.test_collision_shapes import TWO, urdf_of
from tests.robots import group, robot

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


WHOLE = np.array([[-1, -1]]), np.array([[-1, 0]])  # children and shapes of a single node


def declared_points(points: np.ndarray) -> Declared:
    z = np.array([0.0, 0.0, 1.0])
    return Declared(points, np.arange(len(points))[:, None], 0.0, 0.0, z, np.zeros(4))


def hulls(*some: np.ndarray) -> Shapes:
    count = len(some)
    begins = np.cumsum([0, *map(len, some)])
    return Shapes(begins, np.zeros(count), np.zeros(count), np.zeros((count, 3)), np.concatenate(some))


@settings(max_examples=18)
@given(st.integers(0, 10**6))
def test_points_stand_out_of_a_hull_by_no_more_than_is_said(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(int(rng.integers(4, 60)), 3)) * [0.2, 0.1, rng.choice([0.1, 0.01])]
    weights = rng.dirichlet(np.full(len(corners), 0.2), 200)
    inside = weights @ corners
    assert standing_out(declared_points(inside), hulls(corners), *WHOLE) <= 1e-7
    moved = inside + rng.normal(size=inside.shape) * 1e-7
    said = standing_out(declared_points(moved), hulls(corners), *WHOLE)
    convex, here = hull(corners), coal.Transform3s.Identity()
    for point in moved[:40]:
        at = coal.Transform3s(np.eye(3), point)
        found = coal.distance(coal.Sphere(0.0), at, convex, here, coal.DistanceRequest(), coal.DistanceResult())
        assert found <= said + 1e-6


def test_a_corner_that_is_missing_is_found() -> None:
    corners = np.indices((2, 2, 2)).reshape(3, 8).T * 0.1
    assert standing_out(declared_points(corners), hulls(corners), *WHOLE) == 0.0
    assert standing_out(declared_points(corners), hulls(corners[:-1]), *WHOLE) == np.inf


def test_each_triangle_has_to_be_in_one_part_and_in_all_about_it() -> None:
    corners = np.indices((2, 2, 2)).reshape(3, 8).T * 0.1
    items = np.array([[0, 1, 2], [5, 6, 7]])
    body = Declared(corners, items, 0.0, 0.0, np.array([0.0, 0.0, 1.0]), np.zeros(4))
    children, of_node = np.array([[1, 2], [-1, -1], [-1, -1]]), np.array([[-1, 0], [-1, 1], [-1, 2]])
    first, second = corners[items[0]], corners[items[1]]
    assert standing_out(body, hulls(corners, first, second), children, of_node) == 0.0
    assert standing_out(body, hulls(corners, first, first), children, of_node) == np.inf
    assert standing_out(body, hulls(first, first, second), children, of_node) == np.inf


@pytest.mark.parametrize("less", [0.0, 1e-7])
def test_a_cylinder_is_in_one_that_is_as_large(less: float) -> None:
    z = np.array([0.0, 0.0, 1.0])
    ends = np.array([[0.0, 0.0, -0.2], [0.0, 0.0, 0.2]])
    body = Declared(ends, np.arange(2)[None], 0.0, 0.1, z, np.zeros(4))
    shapes = Shapes(np.array([0, 2]), np.zeros(1), np.array([0.1 - less]), z[None], ends)
    assert standing_out(body, shapes, *WHOLE) == pytest.approx(less, abs=1e-15)
    assert radius_about(body, np.zeros(3)) == pytest.approx(np.hypot(0.1, 0.2))


@pytest.mark.parametrize("thin", [1.0, 1e-2, 1e-4, 1e-12, 0.0])
def test_points_are_no_farther_from_a_flat_hull_than_is_said(thin: float) -> None:
    """A point that is a micrometre out of a hull, however flat, is said to be little farther."""
    rng = np.random.default_rng(7)
    corners = rng.normal(size=(60, 3)) * (1.0, 1.0, thin) @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    shares = rng.dirichlet(np.full(4, 0.3), 200)
    inside = np.einsum("nk,nkc->nc", shares, corners[rng.integers(60, size=(200, 4))])
    points = inside + 1e-6 * rng.normal(size=inside.shape)
    told = _by_planes(points, corners)
    near = [
        nnls(np.vstack([1e3 * (corners - one).T, np.ones(60)]), np.array([0.0, 0.0, 0.0, 1.0]))[0] for one in points
    ]
    apart = [np.linalg.norm(corners.T @ (x / x.sum()) - one) for x, one in zip(near, points, strict=True)]
    assert (told >= np.array(apart) - 1e-9).all()
    assert told.max() < 2e-5


def test_what_is_beside_or_above_a_flat_hull_is_not_in_it() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    within, on_edge = np.array([[0.02, 0.02, 0.0]]), np.array([[0.05, 0.05, 0.0]])
    for points in (within, on_edge):
        assert standing_out(declared_points(points), hulls(corners), *WHOLE) <= 1e-12
        for off in ([0.0, 0.0, 1e-3], [0.06, 0.06, 0.0]):
            assert standing_out(declared_points(points + off), hulls(corners), *WHOLE) == np.inf
    line = corners[:2].repeat(2, axis=0)
    assert standing_out(declared_points(within), hulls(line), *WHOLE) == np.inf


TOOLS = Path(__file__).resolve().parents[2] / "tools"


@pytest.fixture(autouse=True)
def tools(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(TOOLS))


@pytest.mark.parametrize(("name", "scene"), [("panda", "bookshelf")])
def test_every_node_holds_what_is_below_it(name: str, scene: str) -> None:
    from doubting.tables import SINGLE, check_tables

    world = World.build(group(name), build(scenes.read_packaged(scene)))
    out = check_tables(world)
    assert {one.name for one in world.scene.obstacles} < set(out)
    assert max(out.values()) < SINGLE


@pytest.mark.parametrize(("share", "far"), [(0.5, np.inf), (1.0 - 1e-4, 2e-4)])
def test_spheres_that_are_too_small_are_seen(share: float, far: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a sphere loses triangles of its link; one that is little smaller is told with by how much."""
    from doubting.tables import SINGLE, check_tables

    right = proof._Nodes.shape

    def smaller(nodes: proof._Nodes, node: int, part: int) -> proof._Shape:
        shape = right(nodes, node, part)
        return shape._replace(ball=share * shape.ball) if part < 0 else shape

    monkeypatch.setattr(proof._Nodes, "shape", smaller)
    worst = max(check_tables(World.build(group("panda"), build(scenes.read_packaged("table")))).values())
    assert SINGLE < worst <= far


def test_spheres_and_boxes_hold_what_they_are_about() -> None:
    from doubting.tables import SINGLE, check_bounds, random_scene, robot_alone

    alone = check_bounds(robot_alone(robot("panda")))
    assert {f"panda_link{k}" for k in range(1, 8)} < set(alone)
    among = check_bounds(World.build(group("panda"), random_scene(np.random.default_rng(4), rounds=2)))
    assert {"many points", "the tree of obstacles", "the tree of distances"} < set(among)
    assert max(*alone.values(), *among.values()) < SINGLE


FAULTS = {
    "a sphere": lambda made: made | {"radii": 0.99 * made["radii"]},
    "smaller spheres": lambda made: made | {"part_radii": 0.9 * made["part_radii"]},
    "a box": lambda made: made | {"halves": made["halves"] - 1e-5},
    "a leaf": lambda made: made | {"nodes": np.where(made["nodes"] > 0.1, made["nodes"] - 1e-5, made["nodes"])},
    "the order": lambda made: made | {"order": np.roll(made["order"], 1)},
}
"""What spoils tables, a named tuple's or a dataclass' fields, so that they don't hold what they are about."""


@pytest.mark.parametrize("fault", FAULTS)
def test_bounds_that_are_too_small_are_seen(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from doubting import tables
    from doubting.tables import SINGLE

    def spoilt(made: Any) -> Any:
        fields = made._asdict() if hasattr(made, "_asdict") else {name: getattr(made, name) for name in vars(made)}
        return SimpleNamespace(**FAULTS[fault](fields))

    world = World.build(group("panda"), build(scenes.read_packaged("bookshelf")))
    if "sphere" in fault:
        monkeypatch.setattr(tables, "bodies", lambda of: spoilt(bodies(of)))
    else:
        monkeypatch.setattr(
            tables, "obstacle_boxes", lambda of: SimpleNamespace(tables=spoilt(obstacle_boxes(of).tables))
        )
    assert max(tables.check_bounds(world).values()) > SINGLE


@pytest.mark.parametrize("level", [0, 1, 2])
def test_points_and_boxes_of_a_cloud_that_are_moved_are_seen(level: int) -> None:
    from doubting.tables import SINGLE, _in_cloud

    points = np.random.default_rng(6).normal(size=(5000, 3))
    cloud = Cloud(points, 0.02).tables.tables
    assert max(far for _, far in _in_cloud("cloud", cloud, points)) < SINGLE
    begin, name = (0, "points") if level == 0 else (96 * int(cloud.firsts[level]), "boxes")
    moved = getattr(cloud, name).copy()
    moved[begin : begin + 16] += 1e-3  # the first x of some points, or the lower ends of boxes
    assert max(far for _, far in _in_cloud("cloud", cloud._replace(**{name: moved}), points)) > SINGLE
