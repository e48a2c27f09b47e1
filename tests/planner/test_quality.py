"""What a reply says of distances along a motion: exact between samples, and honest where there was no time."""

import inspect
import time

import numpy as np
import pytest

from guidefield.collision.clearance import clearance_at
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.handlers.plan import answer_plan
from guidefield.memo import MISSING
from guidefield.messages import codec, scene as messages
from guidefield.messages.requests import UrdfText
from guidefield.messages.values import Placement
from guidefield.planner import quality
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.quality import (
    END_LENGTH,
    FEW_SAMPLES,
    measure_clearance,
    measure_clearance_profile,
    measure_figures,
)
from guidefield.potential import RobotField
from guidefield.prove.search import TOLERANCE
from guidefield.robot.group.kinematics import Kinematics
from guidefield.scene.scene import build
from guidefield.stores import scenes
from tests.planner.problems import problem, scene_of
from tests.robots import group, grouped, load, rest, robot

APART = 2e-3  # how far a carriage passes by a thin post [m]


def carriage(length: float) -> UrdfText:
    """A box that slides along x, and one that slides along y on it."""
    box = '<collision><geometry><box size="0.02 0.1 0.1"/></geometry></collision>'
    limits = f'<limit lower="-1" upper="{length + 1}" effort="1" velocity="1"/>'
    return UrdfText(
        text=f'<robot name="carriage"><link name="rail"/><link name="car">{box}</link>'
        '<joint name="along" type="prismatic"><parent link="rail"/><child link="car"/><axis xyz="1 0 0"/>'
        f"{limits}</joint></robot>"
    )


def post(x: float) -> messages.Cylinder:
    """A post of 1 mm radius whose surface is 2 mm beside the path of the carriage."""
    return messages.Cylinder(name="post", radius=1e-3, length=1.0, position=(x, 0.05 + APART + 1e-3, 0.0))


def run(length: float) -> Trajectory:
    points = np.array([[0.0], [length]])
    return Trajectory(np.array([0.0, length]), points, np.zeros_like(points))


@pytest.mark.parametrize("length", [0.6, 10.0, 100.0])
@pytest.mark.parametrize("share", [0.31, 0.4975, 0.777])
def test_a_thin_post_is_passed_at_its_distance_however_long_the_path_is(length: float, share: float) -> None:
    made = problem(grouped(carriage(length)), scene_of(post(share * length)), q_start=np.zeros(1))
    measured = measure_clearance(run(length), made)
    assert measured.obstacle.exact
    assert APART - 1e-6 <= measured.obstacle.distance <= APART + TOLERANCE
    assert measured.obstacle.pair == ("car", "post")
    there = run(length).evaluate(np.array([measured.obstacle.time]))[0][0, 0]
    assert abs(there - share * length) <= 0.01 + 2e-3
    if length > 1.0:
        assert measured.inner == measured.obstacle


def test_a_reply_says_how_close_a_thin_post_was_passed() -> None:
    message = codec.decode_request(
        {
            "robot": {"type": "urdf", "text": carriage(10.0).text},
            "scene": "empty",
            "start": {"along": 0.0},
            "goal": {"type": "joints", "positions": {"along": 10.0}},
            "guide_planes": [],
            "allowed_planning_time": 60.0,
        }
    )
    told = []

    class Recording:
        def observe(self, event) -> None:
            pass

        def finish(self, reply, motion) -> None:
            told.append(motion.profile())

    scene = scene_of(post(4.321))
    reply = answer_plan(
        message, load(carriage(10.0)), scene, run_id="run", received=time.monotonic(), record=lambda *_: Recording()
    )
    assert reply.status.name == "SUCCESS"
    assert APART - 1e-6 <= reply.clearance.minimum <= APART + TOLERANCE
    assert APART - 1e-6 <= reply.clearance.inner <= APART + TOLERANCE
    assert reply.clearance.pair == ["car", "post"]
    assert reply.clearance.ends > 4.0
    assert reply.clearance.mean > 1.0
    (profile,) = told
    smallest = int(np.argmin(profile.obstacle_distance))
    assert profile.obstacle_distance[smallest] == pytest.approx(reply.clearance.minimum, abs=1e-5)
    assert profile.times[smallest] == pytest.approx(reply.clearance.time, abs=0.02)
    assert reply.clearance.time in profile.times
    between = np.linalg.norm(profile.witness[smallest, 0] - profile.witness[smallest, 1])
    assert between == pytest.approx(reply.clearance.minimum, abs=1e-6)


def passing_by(gap: float, at: float) -> messages.Sphere:
    """A ball that flies past a carriage at rest at x = 0, closest at a time [s]."""
    y = 0.05 + 0.02 + gap
    flight = messages.ObstacleTrajectory(
        times=[at - 0.4, at + 0.4], placements=[Placement(position=(-4.0, y, 0.0)), Placement(position=(4.0, y, 0.0))]
    )
    return messages.Sphere(name="ball", radius=0.02, trajectory=flight)


def waiting() -> Trajectory:
    """It waits for three seconds, then leaves."""
    points = np.array([[0.0], [0.0], [2.0]])
    return Trajectory(np.array([0.0, 3.0, 9.0]), points, np.zeros_like(points))


@pytest.mark.parametrize("at", [0.4, 1.2345, 2.3])
def test_what_comes_close_while_the_robot_waits_is_seen(at: float) -> None:
    made = problem(grouped(carriage(10.0)), scene_of(passing_by(0.003, at)), q_start=np.zeros(1))
    measured = measure_clearance(waiting(), made)
    assert 0.003 - 1e-6 <= measured.obstacle.distance <= 0.003 + TOLERANCE
    assert measured.obstacle.time == pytest.approx(at, abs=0.05 / 10.0)
    profile = measure_clearance_profile((measured, made, made.scene))
    assert profile.obstacle_distance.min() == pytest.approx(measured.obstacle.distance, abs=1e-5)
    assert (np.diff(profile.times) < 0.11).all()
    np.testing.assert_allclose(profile.lengths[profile.times <= 3.0], 0.0, atol=1e-3)
    assert profile.lengths[-1] == pytest.approx(2.0)


def test_the_inner_path_leaves_out_the_ends() -> None:
    made = problem(grouped(carriage(10.0)), scene_of(post(0.1)), q_start=np.zeros(1))
    measured = measure_clearance(run(10.0), made)
    assert measured.obstacle.distance == pytest.approx(APART, abs=TOLERANCE)
    beside = np.hypot(END_LENGTH - 0.1 - 0.01, APART + 1e-3) - 1e-3
    assert measured.inner.distance == pytest.approx(beside, abs=2 * TOLERANCE)
    short = measure_clearance(run(0.5), made)
    assert short.inner is None


def test_where_time_is_up_what_is_kept_at_least_is_told_with_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is told as the smallest that may not be; the certificate's clearance is what is certain."""
    monkeypatch.setattr(quality, "LAST_SEARCH_S", 0.0)
    ready = {f"panda_joint{i}": v for i, v in enumerate((0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785), 1)}
    message = codec.decode_request(
        {
            "robot": "panda",
            "scene": "table",
            "start": ready,
            "goal": {"type": "joints", "positions": {"panda_joint1": 0.6, "panda_joint4": -2.0}},
            "min_clearance": 0.01,
            "allowed_planning_time": 60.0,
        }
    )

    def asked():
        return answer_plan(
            message, robot("panda"), build(scenes.read_packaged("table")), run_id="r", received=time.monotonic()
        )

    exact = asked()
    assert not any("clearance" in warning for warning in exact.warnings)
    monkeypatch.setattr(Deadline, "expired", lambda _: measuring())
    monkeypatch.setattr(quality._SEARCHED, "of", lambda *_: MISSING)  # as if the certificate had been alone
    hurried = asked()
    assert hurried.status.name == "SUCCESS"
    told = [warning for warning in hurried.warnings if warning not in exact.warnings]
    assert [w.partition(" is not")[0].rpartition("`")[0].rpartition("`")[2] for w in told] == [
        "clearance.minimum",
        "clearance.inner",
        "self_clearance.minimum",
    ]
    assert 0.01 <= hurried.clearance.minimum <= exact.clearance.minimum + TOLERANCE
    assert 0.01 <= hurried.clearance.inner <= exact.clearance.inner + TOLERANCE
    assert 0.0 <= hurried.self_clearance.minimum <= exact.self_clearance.minimum + TOLERANCE
    assert codec.encode(hurried)


def measuring() -> bool:
    """Whether the distances are being measured, by who asks."""
    return any(frame.function == "measure_clearance" and "quality" in frame.filename for frame in inspect.stack())


def test_a_profile_has_the_distances_of_each_sample_among_what_rests_and_what_moves() -> None:
    """By Coal alone, in a world of its own for each sample."""
    planned = group("panda")
    flight = messages.ObstacleTrajectory(
        times=[0.0, 2.0], placements=[Placement(position=(0.45, -0.9, 0.6)), Placement(position=(0.45, 0.9, 0.6))]
    )
    scene = scene_of(
        messages.Box(name="crate", size=(0.1, 0.1, 0.3), position=(0.3, 0.6, 0.15)),
        messages.Sphere(name="ball", radius=0.05, trajectory=flight),
    )
    made = problem(planned, scene, q_start=rest(planned))
    begin = planned.to_local(rest(planned))
    points = np.array([begin, begin + 0.4])
    measured = measure_clearance(Trajectory(np.array([0.0, 2.0]), points, np.zeros_like(points)), made)
    profile = measure_clearance_profile((measured, made, scene))
    assert {pair[1] for pair in profile.obstacle_pair if pair} == {"crate", "ball"}
    for row in range(0, len(profile.times), 5):
        time_there, q = float(profile.times[row]), profile.configurations[row]
        there = clearance_at(World.build(planned, scene.at(time_there)), planned.expand(q))
        assert profile.obstacle_distance[row] == pytest.approx(there.obstacle_distance, abs=1e-6)
        assert profile.self_distance[row] == pytest.approx(there.self_distance, abs=1e-6)
        assert (profile.obstacle_pair[row], profile.self_pair[row]) == (there.obstacle_pair, there.self_pair)
        between = np.linalg.norm(profile.witness[row, 0] - profile.witness[row, 1])
        assert between == pytest.approx(abs(there.obstacle_distance), abs=1e-6)
    moments, values = profile.potential
    rows = np.searchsorted(profile.times, moments)
    assert (moments[0], moments[-1]) == (profile.times[0], profile.times[-1])
    assert np.diff(rows).max() == (2 if len(profile.times) > FEW_SAMPLES else 1)
    samples = zip(moments.tolist(), profile.configurations[rows], strict=True)
    energies = [RobotField(planned, scene.at(there)).potential(q) for there, q in samples]
    np.testing.assert_allclose(values, energies, rtol=1e-3)


@pytest.mark.parametrize("knots", [1, 2, 30, 300])
def test_lengths_are_those_of_many_chords(knots: int) -> None:
    planned, rng = group("panda"), np.random.default_rng(knots)
    times = np.cumsum(rng.uniform(0.005, 0.2, knots))
    times -= times[0]
    rates, phases = rng.uniform(1.0, 9.0, planned.nv), rng.uniform(0.0, 6.0, planned.nv)
    turns = times[:, None] * rates + phases
    motion = Trajectory(times, rest(planned) + 0.3 * np.sin(turns), 0.3 * rates * np.cos(turns))
    kinematics = Kinematics(planned)
    dense = motion.evaluate(np.unique(np.concatenate([np.linspace(0.0, motion.duration, 20_001), motion.times])))[0]
    tips = np.array([kinematics.tip_position(planned.expand_from_local(z)) for z in dense])
    told = measure_figures(motion, kinematics)
    for said, path in ((told.joint_path_length, dense), (told.tip_path_length, tips)):
        assert said == pytest.approx(np.linalg.norm(np.diff(path, axis=0), axis=1).sum(), rel=1e-4, abs=1e-12)


@pytest.mark.parametrize(("rates", "length"), [((-6.0, -6.0), None), ((3.0, -3.0), 1.5), ((1.0, 1.0), 1.0)])
def test_the_length_of_a_path_that_turns_back_is_all_that_was_gone(rates, length):
    arm = grouped(carriage(3.0))
    path = Trajectory(
        np.array([0.0, 1.0]),
        np.array([[0.0], [0.0 if rates[0] * rates[1] < 0 else 1.0]]),
        np.array([[r] for r in rates]),
    )
    samples = path.evaluate(np.linspace(0.0, 1.0, 2_000_001))[0][:, 0]
    gone = float(np.abs(np.diff(samples)).sum())
    assert length is None or gone == pytest.approx(length, rel=1e-9)
    told = measure_figures(path, Kinematics(arm))
    assert told.joint_path_length == pytest.approx(gone, rel=1e-4)
    assert told.tip_path_length == pytest.approx(gone, rel=1e-4)


def test_the_length_of_a_path_that_turns_back_in_each_of_many_pieces_is_all_that_was_gone() -> None:
    """Each piece alone misses little, all together a hundredth; found by tools/doubt."""
    arm, rng = grouped(carriage(3.0)), np.random.default_rng(5)
    positions = np.cumsum(rng.uniform(-0.004, 0.006, 400))
    rates = rng.uniform(-0.03, 0.03, 400)
    path = Trajectory(np.arange(400.0), positions[:, None], rates[:, None])
    samples = path.evaluate(np.linspace(0.0, 399.0, 2_000_001))[0][:, 0]
    gone = float(np.abs(np.diff(samples)).sum())
    told = measure_figures(path, Kinematics(arm))
    assert told.joint_path_length == pytest.approx(gone, rel=1e-4)
    assert told.tip_path_length == pytest.approx(gone, rel=1e-4)
