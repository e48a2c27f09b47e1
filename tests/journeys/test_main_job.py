"""The main job over a real session: a Panda reaches between two boards of a bookshelf, and an independent judge agrees.

The client knows only the wire: Zenoh, JSON, and the request's fields. The judge knows only the URDF, the scene file and
the reply: Pinocchio and Coal on the URDF's own meshes, nothing of guidefield.
"""

import itertools
import json
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

from tests.journeys.service import PlainClient
from tests.recorder.runs import Recording

STEP = 2e-3  # between two configurations that are judged, no joint moves further [rad]

SHARE = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share")))
PANDA = SHARE / "example-robot-data" / "robots" / "panda_description"
SHELF = Path(__file__).resolve().parents[2] / "scenes" / "bookshelf.json"

REQUEST: dict[str, Any] = {
    "robot": "panda",
    "scene": "bookshelf",
    "start": {
        "panda_joint1": 0.0,
        "panda_joint2": -0.785398,
        "panda_joint3": 0.0,
        "panda_joint4": -2.356194,
        "panda_joint5": 0.0,
        "panda_joint6": 1.570796,
        "panda_joint7": 0.785398,
    },
    "allowed_planning_time": 60.0,
}
TARGET = {"position": [0.58, 0.0, 0.48], "quaternion_xyzw": [0.0, 0.7071067811865476, 0.0, 0.7071067811865476]}
JOBS = {
    "planes": {**REQUEST, "run_id": "planes", "goal": {"type": "guide_plane"}},
    "pose": {**REQUEST, "run_id": "pose", "goal": {"type": "pose", **TARGET}, "guide_planes": []},
}


@pytest.fixture(scope="module")
def replies(wire: PlainClient) -> dict[str, dict[str, Any]]:
    return {name: wire.ask("guidefield/local/plan", request) for name, request in JOBS.items()}


class Judge:
    """The Panda among the shelf's obstacles, from the files alone."""

    def __init__(self) -> None:
        urdf, srdf = str(PANDA / "urdf" / "panda.urdf"), str(PANDA / "srdf" / "panda.srdf")
        self.model = pin.buildModelFromUrdf(urdf)
        self.data = self.model.createData()
        self.geometry = pin.buildGeomFromUrdf(self.model, urdf, pin.GeometryType.COLLISION, None, [str(SHARE)])
        moving = [i for i, shape in enumerate(self.geometry.geometryObjects) if shape.parentJoint > 0]
        self.geometry.addAllCollisionPairs()
        pin.removeCollisionPairs(self.model, self.geometry, srdf)
        for name, shape, placement in _shapes(json.loads(SHELF.read_text())):
            added = self.geometry.addGeometryObject(pin.GeometryObject(name, 0, 0, placement, shape))
            for index in moving:
                self.geometry.addCollisionPair(pin.CollisionPair(index, added))
        self.geometry_data = self.geometry.createData()
        self.q = pin.neutral(self.model)

    def place(self, names: list[str], positions: np.ndarray) -> np.ndarray:
        q = self.q.copy()
        for name, value in zip(names, positions, strict=True):
            q[self.model.joints[self.model.getJointId(name)].idx_q] = value
        return q

    def collides(self, q: np.ndarray) -> bool:
        return bool(pin.computeCollisions(self.model, self.data, self.geometry, self.geometry_data, q, True))

    def tip(self, q: np.ndarray) -> Any:
        pin.framesForwardKinematics(self.model, self.data, q)
        return self.data.oMf[self.model.getFrameId("panda_hand_tcp")]


def _shapes(scene: dict[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    for obstacle in scene["obstacles"]:
        x, y, z, w = obstacle["quaternion_xyzw"]
        placement = pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), np.array(obstacle["position"], float))
        if obstacle["type"] == "box":
            yield obstacle["name"], coal.Box(*obstacle["size"]), placement
        else:
            assert obstacle["type"] == "cylinder"
            yield obstacle["name"], coal.Cylinder(obstacle["radius"], obstacle["length"]), placement


@pytest.fixture(scope="module")
def judge() -> Judge:
    return Judge()


def _executed(trajectory: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, positions and velocities of what a robot executes: cubic Hermite pieces, in steps of at most `STEP`."""
    times, positions, velocities = (np.array(trajectory[key]) for key in ("times", "positions", "velocities"))
    dense: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for (t0, t1), (p0, p1), (v0, v1) in zip(*map(itertools.pairwise, (times, positions, velocities)), strict=True):
        h = t1 - t0
        speed = max(np.abs(v0).max(), np.abs(v1).max(), 1.5 * np.abs(p1 - p0).max() / h) * 1.5
        s = np.linspace(0.0, 1.0, 2 + int(speed * h / STEP))[:, None]
        blends = (2 * s**3 - 3 * s**2 + 1) * p0 + (3 * s**2 - 2 * s**3) * p1
        tangents = (s**3 - 2 * s**2 + s) * h * v0 + (s**3 - s**2) * h * v1
        slopes = 6 * (s - s**2) * (p1 - p0) / h + (3 * s**2 - 4 * s + 1) * v0 + (3 * s**2 - 2 * s) * v1
        dense.append((t0 + s[:, 0] * h, blends + tangents, slopes))
    return tuple(np.concatenate(part) for part in zip(*dense, strict=True))


@pytest.mark.parametrize("job", JOBS)
def test_it_succeeds_and_says_how(job: str, replies: dict[str, dict[str, Any]]) -> None:
    reply = replies[job]
    assert reply["status"]["name"] == "SUCCESS", reply["status"]
    assert reply["certificate"]["collision_free"] is True
    assert reply["certificate"]["covers"] == "trajectory"
    assert reply["run_id"] == job
    assert reply["clearance"]["minimum"] > 0.0
    assert reply["timing"]["total"] > 0.0
    assert reply["counters"]["collision_checks"] > 0


@pytest.mark.parametrize("job", JOBS)
def test_an_independent_dense_check_finds_it_free(job: str, replies: dict[str, dict[str, Any]], judge: Judge) -> None:
    names = replies[job]["position_names"]
    _, motion, _ = _executed(replies[job]["trajectory"])
    assert len(motion) > 500
    assert np.abs(np.diff(motion, axis=0)).max() <= STEP
    assert not [row for row, positions in enumerate(motion) if judge.collides(judge.place(names, positions))]


def test_the_judge_would_see_a_collision(judge: Judge) -> None:
    """The straight path to the goal's side of the shelf leads through a board."""
    assert judge.collides(judge.place(["panda_joint2", "panda_joint4"], np.array([0.9, -1.0])))


@pytest.mark.parametrize("job", JOBS)
def test_the_motion_begins_at_its_start_and_keeps_the_limits_of_the_robot(job, replies, wire):
    reply = replies[job]
    limits = {joint["name"]: joint for joint in wire.ask("guidefield/local/robots/panda")["joints"]}
    times, positions, velocities = _executed(reply["trajectory"])
    at_knots = np.array(reply["trajectory"]["accelerations"])
    for column, name in enumerate(reply["position_names"]):
        assert positions[:, column].min() >= limits[name]["lower"][0] - 1e-9
        assert positions[:, column].max() <= limits[name]["upper"][0] + 1e-9
        assert np.abs(velocities[:, column]).max() <= limits[name]["velocity"][0] * (1 + 1e-6)
        assert np.abs(at_knots[:, column]).max() <= limits[name]["acceleration"][0] * (1 + 1e-6)
    assert np.allclose(velocities[[0, -1]], 0.0, atol=1e-9)
    start = [REQUEST["start"][name] for name in reply["position_names"]]
    assert np.allclose([positions[0], reply["path"][0]], start, atol=1e-9)
    assert (np.diff(times) >= 0.0).all()
    assert reply["metrics"]["duration"] == pytest.approx(times[-1])


def test_the_tip_crosses_the_planes_in_order_and_ends_on_the_last(replies, judge):
    reply = replies["planes"]
    planes = json.loads(SHELF.read_text())["guide_planes"]
    assert len(planes) >= 2
    assert [plane["name"] for plane in reply["guide_planes"]] == [plane["name"] for plane in planes]
    _, motion, _ = _executed(reply["trajectory"])
    tips = np.array([judge.tip(judge.place(reply["position_names"], row)).translation for row in motion])
    crossed = [int(np.argmax(tips[:, 0] >= plane["vertices"][0][0] - 1e-3)) for plane in planes]
    assert crossed == sorted(crossed)
    for row, plane in zip(crossed, planes, strict=True):
        corners = np.array(plane["vertices"])
        assert (tips[row, 1:] >= corners[:, 1:].min(axis=0) - 1e-3).all()
        assert (tips[row, 1:] <= corners[:, 1:].max(axis=0) + 1e-3).all()
    assert tips[-1, 0] == pytest.approx(planes[-1]["vertices"][0][0], abs=2e-3)


def test_the_tip_ends_at_the_pose(replies: dict[str, dict[str, Any]], judge: Judge) -> None:
    reply = replies["pose"]
    tip = judge.tip(judge.place(reply["position_names"], np.array(reply["trajectory"]["positions"][-1])))
    assert np.linalg.norm(tip.translation - TARGET["position"]) < 2e-4
    x, y, z, w = TARGET["quaternion_xyzw"]
    wanted = pin.Quaternion(w, x, y, z).matrix()
    assert np.linalg.norm(pin.log3(wanted.T @ tip.rotation)) < 2e-3


@pytest.mark.parametrize("job", JOBS)
def test_the_run_is_kept_with_a_recording_that_can_be_opened(job, replies, wire, tmp_path):
    assert replies[job]["recording"] == f"guidefield/local/runs/{job}/recording"
    kept = wire.ask(f"guidefield/local/runs/{job}")
    assert kept["reply"] == replies[job]
    assert kept["request"]["goal"]["type"] == JOBS[job]["goal"]["type"]
    assert job in {run["run_id"] for run in wire.ask("guidefield/local/runs?status=SUCCESS;robot=panda")["runs"]}
    answer = wire.answer(replies[job]["recording"])
    assert answer.is_reply
    assert answer.encoding == "application/octet-stream"
    recording = tmp_path / "run.rrd"
    recording.write_bytes(answer.payload)
    verified = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(recording)], check=False, capture_output=True, text=True
    )
    assert verified.returncode == 0, verified.stderr
    opened = Recording(recording)
    assert {"/robot/visual/panda_hand_0", "/robot/model/frames", "/documents/reply"} <= opened.entities
    assert len(opened.stores()[1]) == 1, "its layout is in it"


def test_the_same_request_gives_the_same_path(replies: dict[str, dict[str, Any]], wire: PlainClient) -> None:
    for name, request in JOBS.items():
        again = wire.ask("guidefield/local/plan", {**request, "run_id": f"{name}-again", "recording": "off"})
        assert again["path"] == replies[name]["path"]
        assert again["recording"] is None


def test_a_run_id_is_used_once(replies: dict[str, dict[str, Any]], wire: PlainClient) -> None:
    again = wire.ask("guidefield/local/plan", JOBS["planes"])  # whose answer got lost asks in the same words
    assert again == replies["planes"]
    error = wire.refusal("guidefield/local/plan", json.dumps({**JOBS["planes"], "seed": 1}).encode())
    assert error["name"] == "MALFORMED_REQUEST"
    assert error["details"]["run_id"] == "planes"


def test_a_run_is_deleted(replies: dict[str, dict[str, Any]], wire: PlainClient) -> None:
    wire.ask("guidefield/local/plan", {**JOBS["pose"], "run_id": "short-lived", "recording": "off"})
    wire.ask("guidefield/local/runs/short-lived?delete")
    assert wire.refusal("guidefield/local/runs/short-lived")["name"] == "INVALID_OBJECT_NAME"
