"""A robot's first use: found in pieces before a request's time begins, kept on disk, told while it is found."""

import json
import time
from pathlib import Path

import numpy as np
import pytest

from guidefield.collision import part_tables
from guidefield.deadline import Deadline, DeadlineExpired
from guidefield.engine import Engine
from guidefield.errors import UnknownObject
from guidefield.handlers.attached import holding
from guidefield.handlers.certify import lay_out_ahead
from guidefield.handlers.plan import prepare_ahead
from guidefield.handlers.preparation import prepare
from guidefield.kernels.jit.cache import cache_folder
from guidefield.memory import MESH_TREES, BoundedMap
from guidefield.messages.conditions import AttachedObject
from guidefield.messages.requests import Attach, CertifyRequest, JointsGoal, PlanRequest, PlanStep, UrdfFile, UrdfText
from guidefield.messages.scene import Box, Mesh, Scene
from guidefield.messages.values import Placement
from guidefield.robot import link_bounds as parts_room
from guidefield.robot.catalog import Catalog
from guidefield.robot.link_bounds import COVERS, DELTA, MOST_PARTS, PARTS
from guidefield.scene.scene import build
from tests.geometry import solids
from tests.robot.odd_meshes import stl
from tests.robots import box_arm
from tests.scene.solids import l_prism, mesh_message


class Heard:
    """Who waits for a run, and hears what it tells."""

    def __init__(self) -> None:
        self.told: list[dict[str, object]] = []

    def be_prepared(self) -> None:
        """Nothing hangs on it."""

    def is_listened_to(self) -> bool:
        return True

    def is_cancelled(self) -> bool:
        return False

    def tell(self, what: bytes) -> None:
        self.told.append(json.loads(what))


@pytest.fixture
def cold(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder for a cache that is empty on disk and in memory."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache_folder().parents[1]))  # the kernels' is full
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(part_tables, "_KNOWN", BoundedMap(MESH_TREES))
    return tmp_path


def bent(folder: Path) -> UrdfFile:
    """A robot whose two links are channels."""
    vertices, triangles = solids.channel()
    (folder / "channel.stl").write_bytes(stl(vertices[triangles]))
    link = '<link name="l{}"><collision><geometry><mesh filename="channel.stl"/></geometry></collision></link>'
    joint = (
        '<joint name="j" type="revolute"><origin xyz="0 0 0.3"/><parent link="l0"/><child link="l1"/>'
        '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>'
    )
    (folder / "bent.urdf").write_text(f'<robot name="bent">{link.format(0)}{link.format(1)}{joint}</robot>')
    return UrdfFile(path=str(folder / "bent.urdf"))


def request_for(robot: UrdfFile, allowed: float) -> PlanRequest:
    return PlanRequest(
        robot=robot,
        scene=Scene(name="empty"),
        goal=JointsGoal(positions={"j": 1.0}),
        guide_planes=[],
        allowed_planning_time=allowed,
        recording="off",
    )


def test_it_says_what_it_prepares_stops_between_two_pieces_and_goes_on_from_there(cold: Path) -> None:
    urdf = bent(cold)
    heard: list[str] = []
    with pytest.raises(DeadlineExpired, match="cutting l0, shape 1 of 2"):
        prepare(Catalog().load(urdf), Deadline(is_cancelled=lambda: len(heard) == 1), heard.append)
    assert heard == ["covering l0, shape 1 of 2"], "both links have the same mesh"
    prepare(Catalog().load(urdf), announce=heard.append)
    assert heard[1:3] == ["cutting l0, shape 1 of 2", "laying out l0, shape 1 of 2"]


def test_a_second_process_computes_nothing(cold: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    urdf = bent(cold)
    prepare(Catalog().load(urdf))
    kept = {path.name: path.stat().st_size for path in (cold / "cache").rglob("*-*")}
    assert {name.partition("-")[0] for name in kept} >= {"coverage", "parts"}
    monkeypatch.setattr(part_tables, "_KNOWN", BoundedMap(MESH_TREES))  # as another process has it
    monkeypatch.setattr(parts_room, "decompose", None)
    prepare(Catalog().load(urdf))
    assert {path.name for path in (cold / "cache").rglob("*-*")} == set(kept)


def test_over_the_wire_preparing_counts_and_is_told(cold: Path) -> None:
    urdf, engine, heard = bent(cold), Engine(), Heard()
    late = engine.answer(request_for(urdf, 1e-3), received=time.monotonic(), watcher=heard)
    assert late.status.name == "TIMED_OUT"
    pieces = ["covering l0, shape 1 of 2", "cutting l0, shape 1 of 2"]  # begun in this turn, perhaps both by then
    assert late.status.details["stage"] == "load"
    assert late.status.details["preparing"] in ["the meshes of the robot", *pieces]
    assert (late.certificate.collision_free, late.certificate.evaluations) == (False, 0)
    reply = engine.answer(request_for(urdf, 600.0), received=time.monotonic(), watcher=heard)
    assert reply.status.name == "SUCCESS"
    prepared = [told["preparing"] for told in heard.told if told["stage"] == "load" and told["preparing"]]
    assert [told for told in dict.fromkeys(prepared) if told in pieces] == pieces
    assert heard.told[-1]["preparing"] is None
    assert 0.0 < reply.timing.load <= reply.timing.total


def new_mesh(name: str) -> Mesh:
    """A mesh of a size that nobody has seen."""
    vertices, triangles = l_prism()
    return mesh_message(vertices * np.random.default_rng().uniform(0.01, 0.02), triangles, name)


@pytest.mark.parametrize("named", [True, False])
def test_a_judgements_tables_are_made_before_its_time_begins(named: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    engine, arm = Engine(), UrdfText(box_arm("y x slide", 3).text)
    request = CertifyRequest(
        robot=arm,
        scene=Scene(name="s", obstacles=[Box(name="box", size=(0.1, 0.1, 0.1), position=(3.0, 0.0, 0.0))]),
        path=[[0.0, 0.0, 0.0], [0.1, 0.1, 0.1]] if not named else [[0.0], [0.1]],
        position_names=["j2"] if named else None,
        attached_objects=[AttachedObject(new_mesh("held"), "l3", Placement(position=(0.0, 0.0, 0.5)), ["l2"])],
    )
    lay_out_ahead(request, engine._load_robot)

    def late(*_: object) -> None:
        raise AssertionError("it was to be made before")

    monkeypatch.setattr("guidefield.collision.part_tables.PartsTable.add_shape", late)
    monkeypatch.setattr("guidefield.collision.solids._of_links", late)
    reply = engine.answer(request, received=time.monotonic())
    assert reply.status.name == "SUCCESS"


def test_what_steps_pick_up_is_prepared_before_their_time_begins() -> None:
    engine, arm = Engine(), UrdfText(box_arm("y x slide", 3).text)
    scene = Scene(name="s", obstacles=[new_mesh("part"), new_mesh("other")])
    step = PlanStep(goal=JointsGoal({"j1": 0.1}), attach=Attach("part"))
    request = PlanRequest(robot=arm, scene=scene, steps=[step])
    assert not prepare_ahead(request, engine._load_robot, engine._find_scene_message)
    assert prepare_ahead(request, engine._load_robot, engine._find_scene_message)

    robot, nowhere = engine._load_robot(arm), build(Scene(name="nowhere"))
    for obstacle, known in ((scene.obstacles[0], True), (scene.obstacles[1], False)):
        there = AttachedObject(obstacle, "l2", Placement(position=(0.1, 0.2, 0.3)))
        held = holding(robot, [there], nowhere)
        assert (not COVERS.search(held, DELTA).tasks and not PARTS.search(held, MOST_PARTS).tasks) == known


def test_what_cannot_be_picked_up_is_refused_when_the_request_is_answered() -> None:
    engine, arm = Engine(), UrdfText(box_arm("y x slide", 3).text)
    step = PlanStep(goal=JointsGoal({"j1": 0.1}), attach=Attach("nothing"))
    request = PlanRequest(robot=arm, scene=Scene(name="s"), steps=[step])
    with pytest.raises(UnknownObject, match="nothing"):
        engine.answer(request)
