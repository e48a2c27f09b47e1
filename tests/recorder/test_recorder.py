from __future__ import annotations

import itertools
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

from guidefield.messages import replies
from guidefield.messages.requests import PlanRequest, PoseGoal
from guidefield.planner.task import trace
from guidefield.planner.task.trace import Step
from guidefield.recorder.documents import unpack
from guidefield.recorder.motion import SHOWN_STEP
from tests.journeys.service import await_that
from tests.recorder.runs import MIN_CLEARANCE, PLACEMENT, MadeUp, Recording, made_up

SINGLE = 1e-6
"""Recordings keep lengths and quaternions in single precision: what rounding may cost near 1 m."""


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
    expected = {
        "/robot/visual/panda_link3_0",
        "/robot/collision/panda_link3_0",
        "/robot/model/frames",
        "/robot/tip",
        "/field/charges/panda_joint3",
        "/field/forces",
        "/field/picture",
        "/field/slice",
        "/ghosts",
        "/obstacles/boxes",
        "/obstacles/balls",
        "/obstacles/cylinders",
        "/obstacles/walls",
        "/guide_planes",
        "/path/tip",
        "/path/planned",
        "/path/closest_pair",
        "/planner/log",
        "/planner/tip",
        "/planner/connect/tree",
        "/planner/relaxed",
        "/planner/potential",
        "/plots/clearance",
        "/plots/potential",
        "/plots/position",
        "/plots/velocity",
        "/plots/acceleration",
        "/plots/use/velocity",
        "/plots/use/acceleration",
        "/documents/summary",
        "/documents/request",
        "/documents/reply",
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


def test_bodies_hang_on_their_links(recording):
    for entity in recording.entities:
        for tree in ("visual", "collision"):
            if entity.startswith(f"/robot/{tree}/"):
                link = entity.removeprefix(f"/robot/{tree}/").rpartition("_")[0]
                assert recording.one(entity, "CoordinateFrame:frame") == [f"link {link}"]


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


def test_tells_every_event_and_the_end(run, recording):
    lines = [text for (text,) in recording.values("/planner/log", "TextLog:text", "step")]
    levels = [level for (level,) in recording.values("/planner/log", "TextLog:level", "step")]
    assert len(lines) == len(run.events) + 1
    assert "step 2" in lines[3]
    assert levels[-3] == "WARN"
    assert "something odd" in lines[-3]
    assert lines[-1] == f"SUCCESS: {run.reply.status.message}"


def test_plots_what_was_measured(run, recording):
    times = recording.times("/plots/clearance", "path_time")
    assert np.allclose(times, run.profile.times, atol=1e-9)
    assert recording.one("/plots/clearance", "SeriesLines:names") == ["to obstacles", "to itself", "asked for"]
    shown = np.array(recording.values("/plots/clearance", "Scalars:scalars", "path_time"))
    finite = np.isfinite(run.profile.obstacle_distance)
    assert np.array_equal(shown[finite, 0], run.profile.obstacle_distance[finite])
    assert np.isnan(shown[~finite, 0]).all()
    assert np.array_equal(shown[:, 1], run.profile.self_distance)
    assert (shown[:, 2] == MIN_CLEARANCE).all()
    potential = recording.values("/plots/potential", "Scalars:scalars", "path_time")
    assert np.array_equal(np.ravel(potential), run.profile.potential[1])


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


def test_shows_the_closest_pair_where_there_is_one(run, recording):
    strips = recording.values("/path/closest_pair", "LineStrips3D:strips", "path_time")
    for row, pair in enumerate(run.profile.obstacle_pair):
        if pair is None:
            assert strips[row] == []
        else:
            assert np.allclose(strips[row][0], run.profile.witness[row], atol=SINGLE)
    labels = recording.values("/path/closest_pair", "LineStrips3D:labels", "path_time")
    assert labels[0] == [f"{1e3 * run.profile.obstacle_distance[0]:.0f} mm  panda_hand - box / lid"]


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


def test_draws_guide_planes_with_their_names(run, recording):
    outlines = recording.one("/guide_planes", "LineStrips3D:strips")
    for plane, outline in zip(run.scene.guide_planes, outlines, strict=True):
        assert np.allclose(outline, [*plane.vertices, plane.vertices[0]], atol=SINGLE)
    assert recording.one("/guide_planes", "Points3D:labels") == [plane.name for plane in run.scene.guide_planes]
    corners = np.array(recording.one("/guide_planes", "Mesh3D:vertex_positions"))
    assert np.allclose(corners, np.concatenate([plane.vertices for plane in run.scene.guide_planes]), atol=SINGLE)
    triangles = np.array(recording.one("/guide_planes", "Mesh3D:triangle_indices"))
    area = np.linalg.norm(np.cross(*np.diff(corners[triangles], axis=1).transpose(1, 0, 2)), axis=1).sum() / 2
    assert area == pytest.approx(2 * 0.5 * 0.4 * 0.3, rel=1e-5)


def test_keeps_request_and_reply_to_the_last_digit(run, recording):
    assert unpack(bytes(recording.one("/documents/request", "message")), PlanRequest) == run.request
    assert unpack(bytes(recording.one("/documents/reply", "message")), replies.PlanReply) == run.reply
    (summary,) = recording.one("/documents/summary", "TextDocument:text")
    assert run.reply.status.message in summary
    assert "31.0 mm" in summary
    assert "the start was clamped" in summary


def test_can_be_asked_for_by_what_it_is_about(recording):
    assert recording.one("/__properties/plan", "status") == ["SUCCESS"]
    assert recording.one("/__properties/plan", "robot") == ["panda"]
    assert recording.one("/__properties/plan", "clearance") == [0.031]
    (made_with,) = recording.one("/__properties/plan", "made_with")
    assert "coal 3" in made_with


def test_ghosts_lie_along_the_way_in_grey(recording):
    colors = np.array(recording.one("/ghosts", "Mesh3D:vertex_colors"), np.uint32)
    red, green, blue = (colors >> 24) & 255, (colors >> 16) & 255, (colors >> 8) & 255
    assert (red == green).all()
    assert (green == blue).all()
    assert len(set(red.tolist())) >= 5


def test_a_summary_leaves_out_the_field_and_the_planners_life(run, recording, tmp_path):
    request = msgspec.structs.replace(run.request, recording="summary")
    summary = record(replace(run, request=request), tmp_path / "run.rrd")
    verify(tmp_path / "run.rrd")
    left_out = recording.entities - summary.entities
    assert {path.split("/")[1] for path in left_out} >= {"field", "planner"}
    assert not any(path.startswith(("/field", "/planner")) for path in summary.entities)
    assert {"/robot/model/frames", "/robot/visual/panda_hand_0", "/ghosts", "/obstacles/boxes"} <= summary.entities
    assert {"/path/tip", "/plots/position", "/plots/velocity", "/documents/summary"} <= summary.entities
    assert unpack(bytes(summary.one("/documents/request", "message")), PlanRequest) == request


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


def test_a_pose_to_reach_is_shown(run, tmp_path):
    goal = PoseGoal(position=(0.5, 0.1, 0.4), quaternion_xyzw=(0.0, 1.0, 0.0, 0.0))
    asked = replace(run, request=msgspec.structs.replace(run.request, goal=goal))
    recording = record(asked, tmp_path / "run.rrd")
    assert np.allclose(recording.one("/path/goal", "Transform3D:translation"), [goal.position], atol=SINGLE)
    assert np.allclose(recording.one("/path/goal", "Transform3D:quaternion"), [goal.quaternion_xyzw], atol=SINGLE)
    assert "/path/failure" not in recording.entities


def test_the_robot_is_there_at_each_step_of_a_plan_without_steps(run, tmp_path):
    events = tuple(event for event in run.events if not isinstance(event, Step))
    recording = record(replace(run, events=events), tmp_path / "run.rrd")
    frames = Frames(recording, "step")
    assert frames.times.tolist() == [0]
    assert np.allclose(frames.placement("panda_hand", 0), Frames(recording, "path_time").placement("panda_hand", 0))


def test_records_a_failure_without_any_motion(run, tmp_path):
    status = replies.Outcome(code=-10, name="START_STATE_IN_COLLISION", message="the hand is in the can")
    reply = msgspec.structs.replace(run.reply, status=status, path=[], trajectory=None)
    replace(run, events=(), reply=reply, profile=None).record(tmp_path / "run.rrd")
    verify(tmp_path / "run.rrd")
    recording = Recording(tmp_path / "run.rrd")
    (position,) = recording.values("/plots/position", "Scalars:scalars", "path_time")
    whole = [run.group.robot.joint(joint.name) for joint in run.group.joints]
    assert np.allclose(position, [run.group.q_reference[joint.idx_q] for joint in whole])


def test_a_motion_that_goes_nowhere_can_be_recorded(run, tmp_path):
    row = run.reply.path[0]
    still = replies.Trajectory(times=[0.0], positions=[row], velocities=[[0.0] * 7], accelerations=[[0.0] * 7])
    recording = record(run, tmp_path / "run.rrd", path=[row], trajectory=still)
    assert np.allclose(recording.values("/plots/position", "Scalars:scalars", "path_time"), [row])


def test_keeps_so_many_events_and_counts_the_others(run, tmp_path, monkeypatch):
    monkeypatch.setattr(trace, "MAX_EVENTS", 4)
    recording = record(run, tmp_path / "run.rrd")
    lines = [text for (text,) in recording.values("/planner/log", "TextLog:text", "step")]
    assert len(lines) == 6
    assert lines[4] == f"{len(run.events) - 4} more events were not kept"


def test_leaves_no_threads_behind(run, tmp_path):
    def threads() -> int:
        return len(list(Path("/proc/self/task").iterdir()))

    for number in range(2):  # the first ones start what is kept for good: an allocator's thread, a pool
        run.record(tmp_path / f"warm{number}.rrd")
    before = threads()
    for number in range(3):
        run.record(tmp_path / f"run{number}.rrd")
    await_that(lambda: threads() <= before)


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


def test_the_layout_comes_before_the_recording_for_the_web_viewer(file: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "rerun", "rrd", "print", str(file)]
    said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300).stdout
    assert 0 <= said.index("BlueprintActivationCommand") < said.index("        Recording,")
