"""Recordings in the viewer's own words: of plans, of sequences and of searches."""

import itertools
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pinocchio as pin
import pytest
import rerun as rr

from guidefield.engine import Engine
from guidefield.messages import replies
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import PlanRequest
from guidefield.planner.task.trace import GROWTH_STEPS, LoggedTrees, Step
from guidefield.recorder import recorder
from guidefield.recorder.documents import unpack
from guidefield.recorder.motion import SHOWN_STEP
from tests.examples import example
from tests.recorder.runs import PLACEMENT, MadeUp, Recording, grown_trees, made_up

SINGLE = 1e-6  # recordings keep lengths and quaternions in single precision: what rounding may cost near 1 m


@pytest.fixture(autouse=True, scope="module")
def _strict() -> Iterator[None]:
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def run() -> MadeUp:
    return made_up("panda")


@pytest.fixture(scope="module")
def file(run: MadeUp, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("runs") / "run.rrd"
    run.record(path)
    return path


@pytest.fixture(scope="module")
def recording(file: Path) -> Recording:
    return Recording(file)


def record(run: MadeUp, file: Path, **changes) -> Recording:
    """The recording of a run whose reply is another."""
    replace(run, reply=msgspec.structs.replace(run.reply, **changes), profile=None).record(file)
    return Recording(file)


def verify(path: Path) -> None:
    command = [str(Path(sys.executable).with_name("rerun")), "rrd", "verify", str(path)]
    verdict = subprocess.run(command, capture_output=True, text=True, check=False)
    assert verdict.returncode == 0, verdict.stderr


def test_is_one_whole_file_with_its_own_layout(file, recording):
    verify(file)
    recordings, layouts = recording.stores()
    assert [store.recording_id for store in recordings] == ["run-1"]
    assert [store.application_id for store in layouts] == [recordings[0].application_id]
    assert list(file.parent.iterdir()) == [file]


def test_holds_what_a_reader_looks_for(recording):
    plots = ("clearance", "potential", "position", "velocity", "acceleration", "use/velocity", "use/acceleration")
    expected = {
        *("/ghosts", "/guide_planes", "/robot/visual/panda_link3_0", "/robot/collision/panda_link3_0", "/robot/tip"),
        *(f"/field/{name}" for name in ("charges/panda_joint3", "forces", "picture", "slice")),
        *(f"/obstacles/{name}" for name in ("boxes", "balls", "cylinders", "walls")),
        *(f"/path/{name}" for name in ("tip", "planned", "closest_pair")),
        *(f"/planner/{name}" for name in ("log", "tip", "connect/tree", "relaxed", "potential")),
        *(f"/plots/{name}" for name in plots),
        *(f"/documents/{name}" for name in ("summary", "request", "reply")),
    }
    assert expected <= recording.entities


@pytest.mark.parametrize("name", ["panda", "chain_moving_3x260_r20"])
def test_moves_every_link_as_pinocchio_does(name, tmp_path):
    run = made_up(name)
    run.record(tmp_path / "run.rrd")
    recording, robot = Recording(tmp_path / "run.rrd"), run.group.robot
    frames = Frames(recording, "path_time")
    links = frames.links()
    assert len(links) >= len(run.group.joints)
    assert np.allclose(frames.times, run.profile.times, atol=1e-9)
    for row in (0, 7, len(frames.times) - 1):
        # The whole robot's own kinematics, which neither the group nor the recorder had a hand in.
        q = robot.rest.copy()
        for joint in run.group.joints:
            whole = robot.joint(joint.name)
            q[whole.idx_q : whole.idx_q + whole.nq] = run.profile.configurations[
                row, joint.idx_q : joint.idx_q + joint.nq
            ]
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, q)
        for link in links:
            expected = PLACEMENT * data.oMf[robot.frame_id(link)]
            shown = frames.placement(link, row)
            assert np.allclose(shown, expected.homogeneous, atol=SINGLE), (link, row)


class Frames:
    """The robot's frames over a timeline, as a viewer understands them."""

    def __init__(self, recording: Recording, timeline: str) -> None:
        names = ("child_frame", "parent_frame", "translation", "quaternion")
        rows = [recording.values("/robot/model/frames", f"Transform3D:{name}", timeline) for name in names]
        at = recording.times("/robot/model/frames", timeline)
        self.times = np.unique(at)
        self._row = np.searchsorted(self.times, at)
        self._told = [tuple(value for (value,) in row) for row in zip(*rows, strict=True)]

    def links(self) -> list[str]:
        """Those that have a frame."""
        return [child.removeprefix("link ") for child in {told[0] for told in self._told} if child.startswith("link ")]

    def placement(self, link: str, row: int) -> np.ndarray:
        """The homogeneous matrix of a link in the world at the time of that number: what was told last holds."""
        whole, frame = np.eye(4), f"link {link}"
        while frame != "tf#/":
            last = max(k for k, told in enumerate(self._told) if told[0] == frame and self._row[k] <= row)
            _, frame, translation, (x, y, z, w) = self._told[last]
            whole = matrix(pin.Quaternion(w, x, y, z).matrix(), translation) @ whole
        return whole


def matrix(rotation: np.ndarray, translation: list[float]) -> np.ndarray:
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = rotation, translation
    return whole


def test_shows_the_planners_steps(run, recording):
    steps = [event for event in run.events if isinstance(event, Step)]
    assert recording.times("/planner/tip", "step").tolist() == list(range(len(steps)))
    positions = recording.values("/plots/position", "Scalars:scalars", "step")
    assert np.allclose(positions, [step.q for step in steps])
    frames = Frames(recording, "step")
    assert frames.times.tolist() == list(range(len(steps)))
    data = run.group.model.createData()
    for row, step in enumerate(steps):
        pin.framesForwardKinematics(run.group.model, data, run.group.expand(step.q))
        expected = data.oMf[run.group.model.getFrameId("panda_link5")].homogeneous
        assert np.allclose(frames.placement("panda_link5", row), expected, atol=SINGLE)
    evaluated = [index for index, step in enumerate(steps) if step.potential is not None]
    assert recording.times("/planner/potential", "step").tolist() == evaluated
    potentials = recording.values("/planner/potential", "Scalars:scalars", "step")
    assert np.ravel(potentials).tolist() == [steps[index].potential for index in evaluated]


def test_plots_the_trajectory_and_its_limits(run, recording):
    times = recording.times("/plots/velocity", "path_time")
    velocities = np.array(recording.values("/plots/velocity", "Scalars:scalars", "path_time"))
    for knot, velocity in zip(run.reply.trajectory.times, run.reply.trajectory.velocities, strict=True):
        row = np.argmin(np.abs(times - knot))
        assert abs(times[row] - knot) < 1e-8
        assert np.allclose(velocities[row], velocity, atol=1e-9)
    shares = np.array(recording.values("/plots/use/velocity", "Scalars:scalars", "path_time"))
    assert np.allclose(shares[:, :-2], velocities / run.group.velocity_limits)
    assert (shares[:, -2:] == [-1.0, 1.0]).all()
    assert recording.one("/plots/use/velocity", "SeriesLines:names") == [
        *run.group.velocity_names,
        "lower limit",
        "upper limit",
    ]
    accelerations = np.array(recording.values("/plots/acceleration", "Scalars:scalars", "path_time"))
    shares = np.array(recording.values("/plots/use/acceleration", "Scalars:scalars", "path_time"))
    assert np.allclose(shares[:, :-2], accelerations / run.group.acceleration_limits)
    positions = np.array(recording.values("/plots/position", "Scalars:scalars", "path_time"))
    shares = np.array(recording.values("/plots/use/position", "Scalars:scalars", "path_time"))[:, :-2]
    group = run.group
    assert np.allclose(group.lower + (shares + 1.0) / 2.0 * (group.upper - group.lower), positions)
    inside = (times[:-1] + times[1:]) / 2  # acceleration is the slope of velocity, straight between knots
    slopes = np.diff(velocities, axis=0) / np.diff(times)[:, None]
    knots = np.array(run.reply.trajectory.times)
    alone = [not ((knots > low) & (knots < high)).any() for low, high in itertools.pairwise(times)]
    _, _, expected = run.trajectory.evaluate(inside[alone])
    assert np.allclose(slopes[alone], expected, atol=1e-5)
    assert recording.one("/plots/velocity", "SeriesLines:names") == run.group.velocity_names
    # velocity is the slope of position, so what it sums up to is the way between the ends
    way = np.trapezoid(velocities, times, axis=0)
    expected = np.subtract(run.reply.trajectory.positions[-1], run.reply.trajectory.positions[0])
    assert np.allclose(way, expected, atol=5e-3)


def test_draws_obstacles_where_they_are(run, recording):
    named = {obstacle.name: obstacle for obstacle in run.scene.obstacles}
    colors = []
    for name in ("pill", "wedge", "floor"):
        drawn = np.array(recording.one(f"/obstacles/single/{name}", "Mesh3D:vertex_positions"))
        distances = np.linalg.norm(drawn[:, None] - named[name].vertices[None], axis=2)
        assert distances.min(axis=1).max() < SINGLE
        assert distances.min(axis=0).max() < SINGLE
        colors += recording.one(f"/obstacles/single/{name}", "Mesh3D:albedo_factor")
    for entity, kind, name, sizes in (
        ("/obstacles/boxes", "Boxes3D", "box / lid", [[0.15, 0.1, 0.05]]),
        ("/obstacles/balls", "Ellipsoids3D", "ball", [[0.05] * 3]),
        ("/obstacles/cylinders", "Cylinders3D", "can", None),
    ):
        assert recording.one(entity, f"{kind}:labels") == [name]
        assert np.allclose(recording.one(entity, f"{kind}:centers"), [named[name].message.position], atol=SINGLE)
        if sizes is not None:
            assert np.allclose(recording.one(entity, f"{kind}:half_sizes"), sizes, atol=SINGLE)
        colors += recording.one(entity, f"{kind}:colors")
    assert np.allclose(recording.one("/obstacles/cylinders", "Cylinders3D:lengths"), [0.14], atol=SINGLE)
    assert np.allclose(recording.one("/obstacles/cylinders", "Cylinders3D:radii"), [0.03], atol=SINGLE)
    wall = np.array(recording.one("/obstacles/walls", "Mesh3D:vertex_positions"))
    assert {tuple(corner) for corner in wall.tolist()} == {(1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (1.0, 1.0, 1.0)}
    assert recording.one("/obstacles/walls", "names") == ["wall"]
    colors += list(set(recording.one("/obstacles/walls", "Mesh3D:vertex_colors")))
    assert len(set(colors)) == len(run.scene.obstacles)


def test_keeps_request_and_reply_to_the_last_digit(run, recording):
    assert unpack(bytes(recording.one("/documents/request", "message")), PlanRequest) == run.request
    assert unpack(bytes(recording.one("/documents/reply", "message")), replies.PlanReply) == run.reply
    (summary,) = recording.one("/documents/summary", "TextDocument:text")
    assert run.reply.status.message in summary
    assert "31.0 mm" in summary
    assert "the start was clamped" in summary


def test_records_a_failure_with_its_partial_motion(run, tmp_path):
    details = {"pair": ["panda_hand", "can"], "depth": 0.01}
    status = replies.Outcome(code=-101, name="STUCK_IN_MINIMUM", message="12 mm in front of GP 2", details=details)
    changes = {"path": run.reply.path[:3], "trajectory": None, "metrics": None, "clearance": None}
    recording = record(run, tmp_path / "run.rrd", status=status, **changes)
    verify(tmp_path / "run.rrd")
    positions = np.array(recording.values("/plots/position", "Scalars:scalars", "path_time"))
    assert np.allclose(positions[0], run.reply.path[0])
    assert np.allclose(positions[-1], run.reply.path[2])
    assert np.abs(np.diff(positions, axis=0)).max() < 1.001 * SHOWN_STEP
    (red,) = recording.one("/obstacles/single/can", "Mesh3D:albedo_factor")
    assert (red >> 24, (red >> 16) & 255) == (230, 57)
    assert "/robot/at_fault/panda_hand_0" in recording.entities
    assert "12 mm in front of GP 2" in recording.one("/documents/summary", "TextDocument:text")[0]


def test_a_goal_that_is_refused_is_shown(run, tmp_path):
    details = {"stage": "goal", "pair": ["panda_hand", "can"], "depth": 0.01}
    status = replies.Outcome(code=-12, name="GOAL_IN_COLLISION", message="the goal is in collision", details=details)
    changes = {"path": run.reply.path[:1], "trajectory": None, "metrics": None, "clearance": None}
    outcome = "the goal is in collision: panda_hand and can, 10.0 mm deep, and what else is said about it at length"
    figures = replies.CertificateFigures(collision_free=True, method="Coal", covers="path", evaluations=0)
    changes |= {"stages": [replies.Stage("ends", outcome, 0.1)], "certificate": figures}
    recording = record(run, tmp_path / "run.rrd", status=status, **changes)
    (summary,) = recording.one("/documents/summary", "TextDocument:text")
    rows = [line for line in summary.splitlines() if line.startswith("|")]
    assert max(map(len, rows)) < 110
    assert outcome in " ".join(" ".join(line.strip("| ") for line in rows).split()).replace("ends | 100.0 ms | ", "")
    assert "free: the start alone" in summary
    (position,) = recording.values("/plots/position", "Scalars:scalars", "path_time")
    q = run.group.q_origin.copy()
    q[0] = run.request.goal.positions["panda_joint1"]
    assert np.allclose(position, q)
    assert recording.one("/path/failure", "Points3D:labels") == ["goal in collision: panda_hand - can"]
    data = run.group.model.createData()
    pin.framesForwardKinematics(run.group.model, data, run.group.expand(q))
    tip = data.oMf[run.group.model.getFrameId(run.group.tip)].translation
    assert np.allclose(recording.one("/path/failure", "Points3D:positions"), [tip], atol=SINGLE)


def test_a_folder_that_is_not_there_is_an_os_error(run, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"run\.rrd"):
        run.record(tmp_path / "missing" / "run.rrd")
    assert list(tmp_path.iterdir()) == []


FULL_DISK = """
import resource, signal, sys
from pathlib import Path
from tests.recorder.runs import made_up
run, path = made_up("panda"), Path(sys.argv[1])
run.record(path)
before = path.read_bytes()
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
for size in (200_000, len(before) - 4_000):  # two recordings differ by some bytes: their blueprints have random names
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    try:
        run.record(path)
    except OSError as error:
        print(type(error).__name__)
    assert path.read_bytes() == before and list(path.parent.iterdir()) == [path]
"""


def test_a_full_disk_leaves_the_earlier_recording_alone(tmp_path):
    """Full in the middle, and full within the file's last part, its table of contents."""
    command = [sys.executable, "-c", FULL_DISK, str(tmp_path / "run.rrd")]
    root = Path(__file__).parents[2]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=root)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["OSError", "OSError"]


@pytest.fixture(scope="module")
def carried(tmp_path_factory: pytest.TempPathFactory) -> tuple[PlanReply, Recording]:
    """The can is picked up, lifted, and put down in the air."""
    request = json.loads(example("kitchen"))
    request["steps"] = request["steps"][:4]
    request["steps"][3]["detach"] = "can"
    request |= {"allowed_planning_time": 120.0, "recording": "summary"}
    path = tmp_path_factory.mktemp("sequence") / "run.rrd"
    reply = Engine().answer(request, record_to=path)
    assert reply.status.name == "SUCCESS", reply.status.message
    assert reply.recording == str(path)
    return reply, Recording(path)


def test_the_object_rests_until_it_is_picked_up_and_is_carried_then(carried: tuple[PlanReply, Recording]) -> None:
    reply, recording = carried
    entity = "/obstacles/single/can"
    times = recording.times(entity, "path_time")
    moved = np.array(recording.values(entity, "Transform3D:translation", "path_time")).reshape(-1, 3)
    lifting = reply.steps[3]
    assert np.abs(moved[times <= lifting.begin]).max() < 1e-6
    np.testing.assert_allclose(moved[-1], (0.0, 0.0, 0.04), atol=1e-3)
    assert (np.diff(moved[times >= lifting.begin][:, 2]) > -1e-6).all()


@pytest.fixture(scope="module", params=["panda", "kinova"])
def searched(request: pytest.FixtureRequest) -> MadeUp:
    return made_up(request.param)


def _tip(searched: MadeUp, z: np.ndarray) -> np.ndarray:
    model = searched.group.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, searched.group.expand_from_local(z))
    return np.array(data.oMf[model.getFrameId(searched.group.tip)].translation)


def test_each_edge_of_a_tree_is_drawn_once_a_parent_before_its_children(searched: MadeUp) -> None:
    trees = grown_trees(searched.group)
    (chunk,) = recorder.trees(
        searched.group, [(5, LoggedTrees(tuple(len(points) for points, _ in trees), tuple(trees)))]
    )
    batch = chunk.to_record_batch()
    assert batch.column("step").to_pylist() == list(range(5, 5 + GROWTH_STEPS))
    rows = batch.column("LineStrips3D:strips").to_pylist()
    drawn = np.array([strip for row in rows for strip in row])
    expected = [
        [_tip(searched, points[parent]), _tip(searched, point)]
        for points, parents in trees
        for point, parent in zip(points, parents, strict=True)
        if parent >= 0
    ]
    assert drawn.shape == np.shape(expected)
    for edge in expected:
        assert np.isclose(drawn, edge, atol=1e-6).all(axis=(1, 2)).sum() == 1
    reached = [_tip(searched, points[0]) for points, _ in trees] + [_tip(searched, trees[1][0][1])]
    for start, end in drawn:
        assert min(np.linalg.norm(np.subtract(start, one)) for one in reached) < 1e-5
        reached.append(end)
