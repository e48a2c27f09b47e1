"""Recordings rendered from logs: the same as those that are written at once, of robots and scenes as they were then."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from rerun.chunk import RrdReader

from guidefield.engine import Engine
from guidefield.messages import requests
from guidefield.messages.requests import CertifyRequest, JointsGoal, PlanRequest, PlanStep, RobotFiles, UrdfFile
from guidefield.messages.scene import Box, PointCloud, Scene
from guidefield.messages.scene_changes import RequestScene, SceneDiff
from guidefield.recorder.stored import read_recording
from guidefield.rendering import Renderings, render_recording, whole_recording
from guidefield.run_log import LARGE_BYTES, MAGIC
from guidefield.stores.recordings import LOG, OBSTACLES, SCENE, KeptRecording, Recordings
from guidefield.stores.robots import RobotStore
from guidefield.stores.scenes import SceneStore
from tests.robots import box_arm

TIMES = {
    "/__properties": {"RecordingInfo:start_time"},
    "/__properties/plan": {"planning_seconds", "seconds"},
    "/documents/reply": {"message", "TextDocument:text"},
    "/documents/summary": {"TextDocument:text"},
    "/planner/log": {"TextLog:text"},
}
"""Columns that tell how long something took, by entity."""

ELBOW = JointsGoal({"elbow_joint": 1.2})
WALL = Scene("wall", obstacles=[Box(name="wall", size=(0.1, 2.0, 2.0), position=(1.2, 0.0, 0.5))])
LID = Scene("lid", obstacles=[Box(name="lid", size=(2.0, 2.0, 0.1), position=(0.0, 0.0, 0.7))])
CLOUD = PointCloud(name="cloud", points=[(1.5, 0.001 * k, 0.5) for k in range(2_000)], radius=0.01)
CUBE = Box(name="cube", size=(0.04, 0.04, 0.04), position=(0.0, 0.0, 0.05))

RUNS: dict[str, PlanRequest | CertifyRequest] = {
    "plan": PlanRequest("ur5", "table", ELBOW, guide_planes=[], sample_rate=50.0),
    "tree": PlanRequest("ur5", WALL, ELBOW, planner="tree"),
    "summary": PlanRequest("ur5", "table", ELBOW, guide_planes=[], recording="summary"),
    "steps": PlanRequest(
        "ur5",
        "table",
        attached_objects=[requests.AttachedObject(link="tool0", obstacle=CUBE)],
        steps=[PlanStep(ELBOW, pause=0.1), PlanStep(JointsGoal({"shoulder_pan_joint": 0.2}), detach="cube")],
    ),
    "failed step": PlanRequest(
        "ur5", LID, steps=[PlanStep(JointsGoal({"wrist_3_joint": 0.2})), PlanStep(ELBOW)], allowed_planning_time=5.0
    ),
    "cloud": PlanRequest("ur5", Scene("cloud", obstacles=[CLOUD, *WALL.obstacles]), ELBOW, guide_planes=[]),
    "certify": CertifyRequest("ur5", "table", path=[[0.0, -1.57, 0.0, 0.0, 0.0, 0.0], [0.5, -1.2, 0.3, 0.0, 0.0, 0.0]]),
}


@pytest.fixture
def recordings(tmp_path: Path) -> Recordings:
    return Recordings(tmp_path / "recordings")


@pytest.fixture
def engine(tmp_path: Path, recordings: Recordings) -> Engine:
    """An engine that keeps logs, robots and scenes."""
    scenes, robots = SceneStore(tmp_path / "scenes"), RobotStore(tmp_path / "robots")
    return Engine("cell", recordings=recordings, scenes=scenes, robots=robots)


def columns(file: Path) -> dict[str, list[tuple[Any, ...]]]:
    """Everything in a recording by entity, but for times and the numbers of rows."""
    found = dict[str, list[tuple[Any, ...]]]()
    for chunk in RrdReader(file).stream().to_chunks():
        batch, path = chunk.to_record_batch(), chunk.entity_path
        left_out = TIMES.get(path, set()) | {name for name in batch.schema.names if "RowId" in name}
        for name in batch.schema.names:
            if name not in left_out:
                data = tuple(None if one is None else one.to_pybytes() for one in batch.column(name).buffers())
                found.setdefault(path, []).append((name, batch.num_rows, data))
    return {path: sorted(rows, key=repr) for path, rows in found.items()}


@pytest.mark.parametrize("kind", RUNS)
def test_a_rendered_recording_is_the_one_that_is_written_at_once(kind: str, tmp_path: Path) -> None:
    engine, request = Engine(), msgspec.structs.replace(RUNS[kind], run_id="r1")
    at_once = engine.answer(request, record_to=tmp_path / "at_once.rrd")
    logged = engine.answer(request, record_to=tmp_path / "logged.rrd", deferred=True)
    assert {file.suffix for file in tmp_path.glob("logged.*")} - set(OBSTACLES) == {".log"}
    assert (at_once.recording, logged.recording) == (str(tmp_path / "at_once.rrd"), str(tmp_path / "logged.rrd"))
    Renderings().render(Recordings(tmp_path), "logged", whole=True)
    assert [file.name for file in tmp_path.glob("logged.*")] == ["logged.rrd"]
    expected, found = columns(tmp_path / "at_once.rrd"), columns(tmp_path / "logged.rrd")
    assert found.keys() == expected.keys()
    assert {path for path in expected if found[path] != expected[path]} == set()
    read = read_recording(tmp_path / "logged.rrd")
    assert read.request == request
    assert read.reply == msgspec.structs.replace(logged, warnings=read.reply.warnings)


def test_a_large_scene_is_kept_once_and_as_it_was_then(engine: Engine, recordings: Recordings, tmp_path: Path) -> None:
    boxes = [Box(name=f"b{k}", size=(0.01,) * 3, position=(2.0, 0.05 * k, 0.1)) for k in range(300)]
    many = Scene("many", obstacles=[*boxes, CLOUD])
    engine.answer(requests.StoreScene("many", many))
    assert min(len(msgspec.msgpack.encode(one)) for one in (boxes, CLOUD)) > LARGE_BYTES
    changed = RequestScene(name="many", base="many", remove=["b0"])
    asked = {"named": "many", "again": "many", "whole": many, "changed": changed}
    for run_id, scene in asked.items():
        engine.answer(PlanRequest("ur5", scene, ELBOW, guide_planes=[], run_id=run_id))
    assert all(recordings.file(run_id, LOG).stat().st_size < 100_000 for run_id in asked)
    assert recordings.file("whole", SCENE).samefile(recordings.file("named", SCENE))
    assert not recordings.file("changed", SCENE).samefile(recordings.file("named", SCENE))
    assert recordings.file("changed", OBSTACLES[0]).samefile(recordings.file("named", OBSTACLES[0]))
    assert len(list(recordings.shared_folder.iterdir())) == 3
    engine.answer(requests.ChangeScene("many", SceneDiff(remove=[f"b{k}" for k in range(1, 300)])))
    engine.answer(requests.DeleteScene("many"))
    for run_id, scene in asked.items():
        (tmp_path / f"{run_id}.rrd").write_bytes(render_recording(recordings, run_id))
        assert read_recording(tmp_path / f"{run_id}.rrd").request.scene == scene
        (centres,) = _values(tmp_path / f"{run_id}.rrd", "/obstacles/boxes", "Boxes3D:half_sizes")
        assert len(centres) == (299 if run_id == "changed" else 300)
    recordings.sweep()
    assert not recordings.shared_folder.exists()


def _values(file: Path, entity: str, column: str) -> list[Any]:
    (chunk,) = [one for one in RrdReader(file).stream().to_chunks() if one.entity_path == entity]
    return list(chunk.to_record_batch().column(column).to_pylist())


def test_a_stored_robot_is_the_one_that_was_planned_for(engine: Engine, recordings: Recordings, tmp_path: Path) -> None:
    def store(length: int) -> None:
        engine.answer(requests.StoreRobot("mine", RobotFiles(urdf=box_arm("y", length).text)))

    store(3)
    rows = {f"joint{k}": 0.4 for k in range(1)}
    plan = PlanRequest("mine", WALL, JointsGoal(rows), guide_planes=[], run_id="first")
    joint = engine.answer(requests.ReadRobot("mine")).joints[0].name
    plan = msgspec.structs.replace(plan, goal=JointsGoal({joint: 0.4}))
    first = engine.answer(plan)
    at_once = engine.answer(plan, record_to=tmp_path / "at_once.rrd")
    assert first.status == at_once.status
    store(2)  # another robot of that name
    engine.answer(msgspec.structs.replace(plan, run_id="second"))
    engine.answer(requests.DeleteRobot("mine"))
    for run_id in ("first", "second"):
        (tmp_path / f"{run_id}.rrd").write_bytes(render_recording(recordings, run_id))
    expected, found, other = (columns(tmp_path / f"{name}.rrd") for name in ("at_once", "first", "second"))
    differs = {path for path in expected if found[path] != expected[path]}
    assert differs <= {"/documents/reply", "/documents/request", "/__properties/plan"}, "as its key is told in it"
    assert other["/robot/model/frames"] != found["/robot/model/frames"]


def test_files_of_a_robot_that_have_changed_since_are_told(tmp_path: Path) -> None:
    urdf, engine = tmp_path / "arm.urdf", Engine()
    urdf.write_text(box_arm("y", 3).text)
    reference = UrdfFile(str(urdf))
    joint = engine.answer(requests.ReadRobot(reference)).joints[0].name
    plan = PlanRequest(reference, WALL, JointsGoal({joint: 0.4}), guide_planes=[])
    for name in ("same", "changed"):
        engine.answer(plan, record_to=tmp_path / f"{name}.rrd", deferred=True)
    recordings = Recordings(tmp_path)
    Renderings().render(recordings, "same", whole=True)
    urdf.write_text(box_arm("y", 2).text)
    Renderings().render(recordings, "changed", whole=True)
    assert recordings.describe("same").kind == "rendered"
    assert (tmp_path / "changed.lost").read_text() == "the files of its robot have changed since"
    assert recordings.list_owed() == []


@pytest.mark.parametrize(
    ("harm", "why"),
    [
        (lambda data: b"", "its log is damaged, or was written by another version of guidefield"),
        (lambda data: data.replace(MAGIC, b"guidefield run log 9\n"), "was written by another version of guidefield"),
        (lambda data: data[:-40], "its log is damaged: "),
        (lambda data: MAGIC + msgspec.msgpack.encode({"run_id": 5}), "its log is damaged: "),
    ],
)
def test_a_log_that_nothing_can_be_rendered_from_is_lost(harm, why, engine, recordings):
    engine.answer(PlanRequest("ur5", "table", ELBOW, guide_planes=[], run_id="r1"))
    log = recordings.file("r1", LOG)
    log.write_bytes(harm(log.read_bytes()))
    Renderings().render(recordings, "r1")
    assert recordings.describe("r1").kind == "lost"
    assert why in (recordings.folder / "r1.lost").read_text()


def test_a_disk_that_refuses_leaves_the_log_and_whoever_asks_gets_the_recording(
    engine: Engine, recordings: Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine.answer(PlanRequest("ur5", "table", ELBOW, guide_planes=[], run_id="r1"))
    before = recordings.describe("r1")
    write = Path.replace

    def refuse(self: Path, target: Path) -> Path:
        if Path(target) == recordings.path("r1"):
            raise OSError(28, "No space left on device")
        return write(self, target)

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(OSError, match="No space left"):
        Renderings().render(recordings, "r1")
    assert recordings.describe("r1") == before
    (tmp_path / "r1.rrd").write_bytes(render_recording(recordings, "r1"))
    assert read_recording(tmp_path / "r1.rrd").reply.run_id == "r1"
    monkeypatch.undo()
    Renderings().render(recordings, "r1")
    assert recordings.describe("r1").kind == "rendered"
    assert whole_recording(recordings, "r1")


def test_a_log_whose_recording_is_there_is_settled_and_one_that_is_gone_is_none(recordings: Recordings) -> None:
    recordings.store_log("r1", b"killed between the recording and the end of its log", ())
    recordings.path("r1").write_bytes(b"whole")
    Renderings().render(recordings, "r1")
    Renderings().render(recordings, "deleted")
    assert recordings.describe("r1") == KeptRecording("rendered", 5)
    assert np.all([file.name == "r1.rrd" for file in recordings.folder.iterdir()])
