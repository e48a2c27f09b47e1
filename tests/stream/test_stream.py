"""A stream in one process: it reaches goals, gives way, keeps what it promises, and says why where it has no piece."""

import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import coal
import msgspec
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

import guidefield
from guidefield.errors import (
    GuidefieldError,
    InvalidConfiguration,
    InvalidGoal,
    MalformedRequest,
    UnknownFrame,
    UnknownObject,
)
from guidefield.messages.conditions import CartesianLimit
from guidefield.messages.scene import Box, Scene, Sphere
from guidefield.messages.streams import Observation, Piece, StreamObstacle, StreamOpen, StreamState, StreamUpdate
from guidefield.messages.values import JointSetGoal, JointsGoal, Placement
from guidefield.robot.model.joints import LocalPoint
from guidefield.scene.scene import build
from guidefield.stream.stream import CertifiedStream
from tests.robots import robot

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
from streaming.movers import Mover, hunting
from streaming.simulation import Faults, simulate
from streaming.units import unit

EMPTY = build(Scene("empty"))
GOAL = JointsGoal({"shoulder_pan_joint": 1.0, "elbow_joint": 1.0})
START = {"shoulder_lift_joint": -1.5, "elbow_joint": 0.5}
FAR = Placement((3.0, 0.0, 0.5))


def ball(name: str = "ball", speed: float = 0.3) -> StreamObstacle:
    return StreamObstacle(Sphere(name=name, radius=0.1), speed)


def opened(*obstacles: StreamObstacle, **fields: Any) -> CertifiedStream:
    request = StreamOpen(**{"robot": "ur5", "scene": "empty", "goal": GOAL, "start": START, **fields})
    return CertifiedStream(msgspec.structs.replace(request, obstacles=list(obstacles)), robot("ur5"), EMPTY)


def told(stream: CertifiedStream, cycles: int, *seen: Observation, first: int = 0) -> list[Piece | StreamState]:
    answers = []
    for k in range(first, first + cycles):
        observed = [msgspec.structs.replace(one, time=0.02 * k) for one in seen]
        answers.append(stream.update(StreamUpdate(0.02 * k, observed)))
    return answers


def test_the_goal_is_reached_and_every_piece_follows_the_one_before() -> None:
    with opened(ball()) as stream:
        answers = told(stream, 200, Observation("ball", 0.0, FAR))
    pieces = [one for one in answers if isinstance(one, Piece)]
    for before, piece in pairwise(pieces):
        assert piece.follows == before.number
        assert before.begins < piece.begins <= before.brakes
        assert np.allclose(piece.trajectory.velocities[-1], 0.0, atol=1e-9)
    last = pieces[-1]
    assert last.reaches_goal
    reached = dict(zip(last.position_names, last.trajectory.positions[-1], strict=True))
    for joint, value in GOAL.positions.items():
        assert reached[joint] == pytest.approx(value, abs=1e-5)
    assert [one.reason for one in answers if isinstance(one, StreamState)][-1] == "at_goal"


def fastest(stream: CertifiedStream, piece: Piece, frame: str) -> float:
    """The largest speed of a frame along a piece and its braking, by dense differences of its places [m/s]."""
    sent, model = piece.trajectory, stream.group.model
    begins, q, v, a = (np.array(rows) for rows in (sent.times, sent.positions, sent.velocities, sent.accelerations))
    data, index, places, times = model.createData(), model.getFrameId(frame), [], []
    for k, span in enumerate(np.diff(begins)):
        for t in np.linspace(0.0, span, 8, endpoint=False):
            z = q[k] + t * (v[k] + t * (a[k] / 2.0 + t * (a[k + 1] - a[k]) / (6.0 * span)))
            pin.framesForwardKinematics(model, data, stream.group.expand_from_local(z))
            places.append(data.oMf[index].translation.copy())
            times.append(begins[k] + t)
    apart = np.diff(times) > 1e-5  # nearer ones are but rounding
    return float((np.linalg.norm(np.diff(places, axis=0), axis=1)[apart] / np.diff(times)[apart]).max(initial=0.0))


@settings(max_examples=3)
@given(st.floats(0.15, 0.8), st.floats(-1.5, 1.5), st.floats(-0.5, 1.5), st.floats(0.2, 0.6))
def test_pieces_and_their_stops_keep_speeds_in_space(speed: float, pan: float, elbow: float, y: float) -> None:
    """By dense differences, past a ball that drifts along."""
    goal = JointsGoal({"shoulder_pan_joint": pan, "elbow_joint": elbow})
    limits = [CartesianLimit(speed, frame="tool0"), CartesianLimit(0.5 * speed, link="forearm_link")]
    with opened(ball(speed=0.1), goal=goal, cartesian_limits=limits) as stream:
        answers = told(stream, 60, Observation("ball", 0.0, Placement((0.7, y, 0.4))))
        pieces = [one for one in answers if isinstance(one, Piece)]
        assert pieces
        tool, forearm = (max(fastest(stream, one, name) for one in pieces[::4]) for name in ("tool0", "forearm_link"))
    assert tool <= speed * (1.0 + 1e-6)
    assert forearm <= 0.5 * speed * (1.0 + 1e-6)


def test_a_goal_is_reached_at_a_limit_of_speed_in_space() -> None:
    arrivals = []
    for limits in ([], [CartesianLimit(0.25, frame="tool0")]):
        with opened(cartesian_limits=limits) as stream:
            pieces = [one for one in told(stream, 130) if isinstance(one, Piece)]
            assert pieces[-1].reaches_goal
            arrivals.append(pieces[-1].stops)
            speeds = [fastest(stream, one, "tool0") for one in pieces[10:-10:5]]
    assert 0.2 < max(speeds) <= 0.25
    assert arrivals[0] < 1.0 < arrivals[1] < 2.5


@pytest.mark.parametrize(
    ("limit", "error", "words"),
    [
        (CartesianLimit(0.2, frame="nose"), UnknownFrame, "no frame 'nose'"),
        (CartesianLimit(0.2, link="nose"), UnknownFrame, "no link 'nose'"),
        (CartesianLimit(0.2, frame="tool0", acceleration=1.0), MalformedRequest, "limits of acceleration in space"),
    ],
)
def test_limits_in_space_that_are_not_served_are_refused_by_name(limit, error, words) -> None:
    with pytest.raises(error, match=words):
        opened(cartesian_limits=[limit])


def test_the_same_updates_get_the_same_bits() -> None:
    rows = []
    for _ in range(2):
        with opened(ball(), seed=3) as stream:
            rows.append(msgspec.json.encode(told(stream, 25, Observation("ball", 0.0, Placement((0.5, 0.3, 0.5))))))
    assert rows[0] == rows[1]


def hunters(count: int) -> list[Mover]:
    rng = np.random.default_rng(4)
    movers = []
    for k in range(count):
        direction = rng.normal(size=3)
        where = np.array([0.0, 0.0, 0.5]) + 0.9 * direction / np.linalg.norm(direction)
        message = Box(name=f"box{k}", size=(0.1, 0.1, 0.1))
        movers.append(Mover(message, 0.6, where, np.zeros(3), steer=hunting))
    return movers


def test_what_hunts_touches_only_a_robot_that_stands() -> None:
    for seed, faults in enumerate((Faults(), Faults(lost=0.3, dropped=0.2, delayed=0.03, clock=0.004))):
        movers = hunters(3)
        obstacles = [StreamObstacle(one.message, one.largest) for one in movers]
        with opened(*obstacles, clock_error=0.004) as stream:
            outcome = simulate(
                stream, movers, [], 1.2, np.random.default_rng(seed), faults, charged=False, to_the_end=True
            )
        assert not outcome.at_speed
        assert outcome.pieces > 5
        assert outcome.excess.max() <= 1e-7


def test_the_judge_from_outside_sees_a_robot_that_keeps_on() -> None:
    """The same without what is observed: the obstacle is declared to stand, and hunts."""
    movers = hunters(3)
    obstacles = [StreamObstacle(one.message, 0.0) for one in movers]
    for one in movers:
        one.largest = 2.0
    with opened(*obstacles) as stream:
        outcome = simulate(
            stream, movers, [], 1.6, np.random.default_rng(0), Faults(lost=0.95), charged=False, to_the_end=True
        )
    assert outcome.at_speed or outcome.at_rest


def test_a_robot_that_stands_gives_way_to_what_drifts_into_it() -> None:
    outcomes = []
    for taking in (True, False):
        with opened(ball(speed=0.15), goal=None) as stream:
            data = stream.group.model.createData()
            pin.framesForwardKinematics(stream.group.model, data, stream.group.expand_from_local(stream.executing.ends))
            tip = np.array(data.oMf[stream.group.tip_id].translation)
            away = np.array([1.0, 0.0, 0.3])
            drift = -0.12 * away / np.linalg.norm(away)
            mover = Mover(ball().obstacle, 0.15, tip - 3.0 * drift, drift)
            lost = Faults(dropped=0.0 if taking else 1.0)
            rng = np.random.default_rng(0)
            outcomes.append(
                simulate(stream, [mover], [], 4.0, rng, lost, charged=False, deviating=True, to_the_end=True)
            )
    gave_way, stayed = outcomes
    assert stayed.at_rest
    assert not gave_way.at_speed
    assert not gave_way.at_rest
    assert gave_way.pieces > 0


def test_reasons_why_there_is_no_piece() -> None:
    with opened(ball()) as stream:
        seen = Observation("ball", 0.0, FAR)
        told(stream, 3, seen)
        late = stream.update(time=0.01)
        stale = stream.update(time=1.0)
        elsewhere = stream.update(time=1.02, obstacles=[at(seen, 1.02)], joints=_zeros(stream))
        stream.stop()
        stopped = stream.update(time=1.04, obstacles=[at(seen, 1.04)])
        number = stream.aim_for({"type": "joints", "positions": {"elbow_joint": 0.9}})
        after = stream.update(time=1.06, obstacles=[at(seen, 1.06)])
    states = [one for one in (late, stale, stopped) if isinstance(one, StreamState)]
    assert [one.reason for one in states] == ["late", "stale", "stopped"]
    # a robot that stands elsewhere goes on from there
    assert elsewhere.trajectory.positions[0] == pytest.approx([0.1] * 6, abs=1e-9)
    assert after.goal == number == 2


def at(seen: Observation, time: float) -> Observation:
    """The same observation at another time [s]."""
    return msgspec.structs.replace(seen, time=time)


def _zeros(stream: CertifiedStream) -> dict[str, float]:
    return dict.fromkeys(stream.group.position_names, 0.1)


def test_a_robot_at_rest_that_nothing_can_be_proven_for_says_what_is_too_close() -> None:
    where, speed = np.array([0.5, 0.4, 0.5]), 5.0
    with opened(ball(speed=speed)) as stream:
        states = told(stream, 3, Observation("ball", 0.0, Placement((0.5, 0.4, 0.5))))
        gaps = gaps_at(stream, stream.executing.ends, coal.Sphere(0.1), where)
    for cycle, state in enumerate(states):
        assert (state.reason, state.executing) == ("too_close", 0)
        assert state.stops <= state.update == 0.02 * cycle, "it stands"
        assert state.pair is not None
        link, other = state.pair
        assert other == "ball"
        # by then the ball can have come so far; a robot that begins to move goes no 2 cm within a latency and a piece
        assert 0.0 < gaps[link] < speed * (state.time - state.update) + 0.02


def gaps_at(stream: CertifiedStream, z: LocalPoint, shape: Any, where: np.ndarray) -> dict[str, float]:
    """How far each link is from a shape, with coordinates (nv,) of the robot, by Pinocchio and Coal [m]."""
    geometry, model = stream.group.geometry, stream.group.model
    placed, data = geometry.createData(), model.createData()
    pin.updateGeometryPlacements(model, data, geometry, placed, stream.group.expand_from_local(z))
    gaps: dict[str, float] = {}
    for one, here in zip(geometry.geometryObjects, placed.oMg, strict=True):
        gap = coal.distance(
            one.geometry, coal.Transform3s(here.rotation, here.translation), shape, coal.Transform3s(np.eye(3), where),
            coal.DistanceRequest(), coal.DistanceResult(),
        )  # fmt: skip
        link = model.frames[one.parentFrame].name
        gaps[link] = min(gap, gaps.get(link, np.inf))
    return gaps


def test_what_appears_in_the_way_of_what_is_executed_is_told() -> None:
    with opened(ball(speed=5.0)) as stream:
        told(stream, 15)
        data = stream.executing.state(0.3)
        assert np.abs(data[:, 1]).max() > 0.1
        answer = stream.update(time=0.3, obstacles=[Observation("ball", 0.3, Placement((0.0, 0.0, 0.5)))])
    assert answer.reason == "appeared"
    assert answer.pair[1] == "ball"


def on_the_way(stream: CertifiedStream, time: float) -> Observation:
    """A ball where the last frame is at a time, by the pieces that were sent, each of which is taken."""
    commits = [one for one in stream._state.commits.values() if one.begins <= time]
    z = max(commits, key=lambda one: one.begins).state(time)[:, 0]
    data = stream.group.model.createData()
    pin.framesForwardKinematics(stream.group.model, data, stream.group.expand_from_local(z))
    return Observation("ball", time, Placement(tuple(data.oMf[stream.group.tip_id].translation.tolist())))


@pytest.mark.parametrize("latency", [0.02, 0.1])
def test_what_appears_before_the_last_piece_begins_is_told(latency: float) -> None:
    """Nothing that is executed is left out where pieces are on their way."""
    with opened(ball(speed=0.0), goal=JointsGoal({"shoulder_pan_joint": 3.0}), latency=latency) as stream:
        told(stream, 40)
        now = 0.8
        assert stream.judged(now).free
        seen = at(on_the_way(stream, now + 0.25 * latency), now)
        answer = stream.update(time=now, obstacles=[seen])
        assert (answer.reason, (answer.pair or ("", ""))[1]) == ("appeared", "ball")
        assert not stream.judged(now).free


@pytest.mark.parametrize("how", ["stopped", "tracking"])
def test_what_appears_is_told_before_why_there_is_no_piece(how: str) -> None:
    with opened(ball(speed=0.0), goal=JointsGoal({"shoulder_pan_joint": 3.0})) as stream:
        told(stream, 30)
        joints = None
        if how == "stopped":
            stream.stop()
        else:
            z = stream.executing.state(0.6)[:, 0] + 0.05
            joints = dict(zip(stream.group.position_names, z.tolist(), strict=True))
        quiet = stream.update(time=0.6, joints=joints)
        assert quiet.reason == how
        joints = None if joints is None else {name: value + 0.05 for name, value in joints.items()}
        answer = stream.update(time=0.61, joints=joints, obstacles=[at(on_the_way(stream, 0.65), 0.61)])
    assert (answer.reason, (answer.pair or ("", ""))[1]) == ("appeared", "ball")


@pytest.mark.parametrize("wrong", ["ghost", "gone", "declare", "executing", "future"])
def test_of_an_update_that_is_refused_nothing_is_taken(wrong: str) -> None:
    with opened(ball(speed=0.0), goal=JointsGoal({"shoulder_pan_joint": 3.0})) as stream:
        told(stream, 40)
        seen = at(on_the_way(stream, 0.84), 0.8)
        fields: dict[str, Any] = {
            "ghost": {"obstacles": [seen, Observation("ghost", 0.8)]},
            "gone": {"obstacles": [seen], "gone": ["ball", "ghost"]},
            "declare": {"obstacles": [seen], "declare": [ball(speed=0.9), ball("forearm_link")]},
            "executing": {"obstacles": [seen], "executing": 999},
            "future": {"obstacles": [seen, at(seen, 0.9)]},
        }[wrong]
        with pytest.raises(GuidefieldError):
            stream.update(time=0.8, **fields)
        known = stream._obstacles.known["ball"]
        assert (known.seen, known.gone, known.declared.largest_speed) == (None, False, 0.0)
        answer = stream.update(time=0.8, obstacles=[seen])
    assert answer.reason == "appeared"


@pytest.mark.parametrize("latency", [0.05, 0.2])
def test_pieces_that_are_on_their_way_are_followed(latency: float) -> None:
    """A client that says what it executes, while several pieces haven't begun, isn't held up."""
    with opened(goal=GOAL, latency=latency) as stream:
        taken, executed, now = [], 0, 0.0
        while now < 4.0 and not (taken and taken[-1].reaches_goal):
            begun = [one for one in taken if one.begins <= now]
            executed = begun[-1].number if begun else 0
            answer = stream.update(time=now, executing=executed)
            if isinstance(answer, Piece):
                assert answer.follows == (taken[-1].number if taken else 0)
                taken.append(answer)
            now += 0.02
    assert taken[-1].reaches_goal
    assert taken[-1].stops < 2.0 + 2.0 * latency


def test_what_is_on_its_way_is_never_forgotten() -> None:
    """Updates that come too fast for that are refused: else nobody would look at what is executed meanwhile."""
    refused = 0
    with opened(goal=JointsGoal({"shoulder_pan_joint": 3.0}), latency=0.5, period=0.005) as stream:
        for cycle in range(160):
            now = 0.005 * cycle
            begun = [one for one in stream._state.commits.values() if one.begins <= now]
            try:
                stream.update(time=now, executing=max(one.number for one in begun) if begun else 0)
            except MalformedRequest as error:
                refused += "63 pieces haven't begun yet" in error.message
            assert stream._state.find_executed(now)[0].begins <= max(now, 0.0)
    assert refused > 10


def test_what_the_robot_may_be_off_by_counts_before_what_appears() -> None:
    lasting = []
    for tolerance in (0.0, 0.05):
        fields = {"appear_distance": 0.08, "appear_speed": 0.0, "tracking_tolerance": tolerance}
        goal = JointsGoal({"shoulder_pan_joint": 1.5})
        with opened(goal=goal, start={"shoulder_lift_joint": -0.3, "elbow_joint": 0.2}, **fields) as stream:
            group, model, longest = stream.group, stream.group.model, 0.0
            data, off = model.createData(), np.eye(group.nv)[0] * tolerance
            for cycle in range(60):
                answer = stream.update(time=0.02 * cycle)
                if not isinstance(answer, Piece):
                    continue
                base, places = stream._state.commits[answer.follows], []
                for z in (base.state(0.02 * cycle)[:, 0] - off, stream.executing.ends + off):
                    pin.framesForwardKinematics(model, data, group.expand_from_local(z))
                    places.append(np.array(data.oMf[group.tip_id].translation))
                longest = max(longest, float(np.linalg.norm(places[1] - places[0])))
            assert longest < 0.08
            lasting.append(longest)
    assert lasting[0] > 0.0


@pytest.mark.parametrize("clock", [0.0, 9e8])
def test_the_cubic_that_is_told_keeps_the_jerk_by_any_clock(clock: float) -> None:
    with opened(goal=GOAL) as stream:
        rates = stream._opened.bounds.rates
        for cycle in range(60):
            answer = stream.update(time=clock + 0.02 * cycle)
            if not isinstance(answer, Piece):
                continue
            times, q, v = (
                np.array(rows)
                for rows in (answer.trajectory.times, answer.trajectory.positions, answer.trajectory.velocities)
            )
            spans = np.diff(times)[:, None]
            assert (spans > 0.0).all()
            jerks = 6.0 * ((v[1:] + v[:-1]) - 2.0 * np.diff(q, axis=0) / spans) / spans**2
            rounded = 24.0 * np.spacing(np.abs(q).max()) / spans**3
            assert (np.abs(jerks) <= rates[:, 2] * (1.0 + 1e-5) + rounded).all()


def test_a_pose_is_a_goal() -> None:
    goal = {"type": "pose", "position": [0.4, 0.3, 0.5], "quaternion_xyzw": [1.0, 0.0, 0.0, 0.0]}
    with guidefield.Stream(robot="ur5", scene="table", goal=goal, start=START) as stream:
        assert isinstance(stream.update(time=0.0), Piece)
        assert [piece.number for piece in stream] == [1]


SET = JointSetGoal([{"elbow_joint": 9.0}, {"shoulder_pan_joint": 1.0}, {"shoulder_pan_joint": -0.4}])
"""One that is out of limits, one further away, and the nearest."""


@pytest.mark.parametrize("taken", [False, True], ids=["free", "taken"])
def test_of_a_set_of_configurations_the_nearest_that_nothing_is_on_is_the_goal(taken: bool) -> None:
    with opened(ball(speed=0.0), goal=SET) as stream:
        place = tip_at(stream, -0.4) if taken else FAR
        answers = told(stream, 150, Observation("ball", 0.0, place))
        reached = stream.executing.ends[0]
    assert isinstance(answers[-1], StreamState)
    assert answers[-1].reason == "at_goal"
    assert reached == pytest.approx(1.0 if taken else -0.4, abs=1e-5)


def tip_at(stream: CertifiedStream, pan: float) -> Placement:
    """Where the tip is with the shoulder turned so far [rad], by Pinocchio."""
    z = stream.executing.ends.copy()
    z[0] = pan
    return tip_with(stream, z)


def tip_with(stream: CertifiedStream, z: LocalPoint) -> Placement:
    """Where the tip is with coordinates (nv,), by Pinocchio."""
    model = stream.group.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, stream.group.expand_from_local(z))
    x, y, height = data.oMf[stream.group.tip_id].translation.tolist()
    return Placement((x, y, height))


@pytest.mark.parametrize(
    ("fields", "error", "words"),
    [
        ({"obstacles": [{"name": "cat", "time": 0.0}]}, UnknownObject, r"\$\.obstacles\[0\]\.name"),
        ({"obstacles": [{"name": "ball", "time": 9.0}]}, MalformedRequest, r"\$\.obstacles\[0\]\.time"),
        ({"gone": ["cat"]}, UnknownObject, r"\$\.gone\[0\]"),
        ({"joints": {"elbow_joint": 0.0}}, InvalidConfiguration, r"\$\.joints"),
        ({"executing": 7}, MalformedRequest, "executing"),
        ({"speed": 1.0}, MalformedRequest, "speed"),
    ],
)
def test_an_update_that_is_ill_posed_names_its_field(fields, error, words):
    with opened(ball()) as stream, pytest.raises(error, match=words):
        stream.update(time=1.0, **fields)


def test_what_is_not_served_or_out_of_limits_is_refused_by_name() -> None:
    with pytest.raises(MalformedRequest, match="degrees of freedom"):
        guidefield.Stream(robot="quadrotor_base", scene="table")
    with pytest.raises(InvalidGoal, match="elbow_joint"):
        opened(goal=JointsGoal({"elbow_joint": 9.0}))
    with pytest.raises(ValueError, match="period"):
        StreamOpen("ur5", "table", period=0.05, piece=0.04)
    with pytest.raises(ValueError, match="trajectory"):
        guidefield.StreamObstacle(
            Box(name="b", size=(1.0, 1.0, 1.0), trajectory={"times": [0.0], "placements": [Placement()]}), 1.0
        )


@pytest.mark.parametrize("seed", [1, 7, 31], ids=["plain", "held_and_cloud", "mesh_and_drift"])
def test_a_unit_of_doubt_finds_nothing(seed: int) -> None:
    outcome = unit(seed, 0.8)
    assert not outcome.at_speed
    assert outcome.excess.max() <= 1e-7
    assert outcome.pieces > 0
    assert outcome.moved > 0.2
