"""Paths of a stream: what they keep from what rests, clouds among it, and when they are taken over."""

import coal
import msgspec
import numpy as np
import pinocchio as pin
import pytest

from guidefield.errors import RequestTooLarge
from guidefield.kernels.collide.layout import KEPT, ROUNDED_BOX
from guidefield.kernels.collide.parts import BALL_ROW, LEFT, LINK, RIGHT
from guidefield.messages.scene import HalfSpace, PointCloud, Scene, Sphere
from guidefield.messages.streams import Observation, Piece, StreamObstacle, StreamOpen, StreamUpdate
from guidefield.messages.values import JointsGoal, Placement
from guidefield.robot.model.joints import LocalPoint
from guidefield.scene.scene import build
from guidefield.stream.dodging import TimedPath
from guidefield.stream.obstacles import DriftingObstacles
from guidefield.stream.path_planner import NOTHING, AtRecordedTimes, TakeOver, WhenReady
from guidefield.stream.settings import STREAM, ClearanceRule
from guidefield.stream.shapes import shape_of
from guidefield.stream.stream import CertifiedStream
from tests.robots import robot

LARGER = 0.05  # links are told to be larger than they are by so much at most [m]

UP = {"shoulder_lift_joint": -1.5, "elbow_joint": 0.5}


def top(stream: CertifiedStream, z: LocalPoint) -> float:
    """How high a robot is with some coordinates (nv,), by Pinocchio and Coal [m]."""
    geometry = stream.group.geometry
    placed, data = geometry.createData(), stream.group.model.createData()
    pin.updateGeometryPlacements(stream.group.model, data, geometry, placed, stream.group.expand_from_local(z))
    ceiling = coal.Halfspace(np.array([0.0, 0.0, -1.0]), -10.0)
    gaps = [
        coal.distance(
            shape.geometry, coal.Transform3s(here.rotation, here.translation), ceiling, coal.Transform3s(),
            coal.DistanceRequest(), coal.DistanceResult(),
        )
        for shape, here in zip(geometry.geometryObjects, placed.oMg, strict=True)
    ]  # fmt: skip
    return 10.0 - min(gaps)


def test_a_path_begins_where_the_robot_is_closer_than_paths_keep() -> None:
    with CertifiedStream(StreamOpen("ur5", "empty", start=UP), robot("ur5"), build(Scene("empty"))) as stream:
        height = top(stream, stream.executing.ends)
    for gap, kept in ((0.003, 0.5), (0.0015, 0.25), (0.0004, 0.0), (0.01, 1.0)):
        ceiling = HalfSpace(name="ceiling", normal=(0.0, 0.0, -1.0), offset=-(height + gap))
        scene = build(Scene("room", obstacles=[ceiling]))
        with CertifiedStream(
            StreamOpen("ur5", "room", start=UP, tracking_tolerance=0.0), robot("ur5"), scene
        ) as stream:
            paths, z0 = stream._paths, stream.executing.ends
            z1 = z0.copy()
            z1[1] -= 1.0
            assert paths.find_free(np.array([z0, z1])).tolist() == [kept == 1.0, True]
            assert paths.choose_clearance(STREAM.resting, [z0, z1]) == kept * STREAM.resting
            path = paths.find_path(NOTHING, ClearanceRule(0.1, 0.0), z0, z1, 0)
        assert np.array_equal(path[[0, -1]], [z0, z1])


def ball(
    where: tuple[float, float, float], drift: tuple[float, float, float], radius: float = 0.1
) -> DriftingObstacles:
    """One that drifts, and may be as fast as that."""
    row = np.zeros((1, 16))
    row[0, [0, 5, 10]], row[0, [3, 7, 11]], row[0, 15] = 1.0, where, radius
    return DriftingObstacles(row, np.array([drift]), np.array([np.linalg.norm(drift)]), np.zeros(1))


def test_gaps_are_no_larger_than_distances_and_motions_keep_from_what_drifts() -> None:
    """Against Coal's distances; links are told to be larger than they are."""
    rng, told, most = np.random.default_rng(0), [], 0.4
    with CertifiedStream(StreamOpen("ur5", "empty", start=UP), robot("ur5"), build(Scene("empty"))) as stream:
        group, paths = stream.group, stream._paths
    placed, data = group.geometry.createData(), group.model.createData()
    for _ in range(60):
        z, sides, rows = group.random(rng), rng.uniform(0.05, 0.2, (3, 3)), np.zeros((3, ROUNDED_BOX))
        turns = [pin.exp3(turn) for turn in rng.normal(size=(3, 3))]
        rows[:, :12].reshape(3, 3, 4)[:, :, :3], rows[:, 12:15] = turns, 0.5 * sides
        rows[:, [3, 7, 11]] = rng.uniform([-0.8, -0.8, 0.0], [0.8, 0.8, 1.0], (3, 3))
        pin.updateGeometryPlacements(group.model, data, group.geometry, placed, group.expand_from_local(z))
        distances = np.array([
            min(
                coal.distance(
                    shape.geometry, coal.Transform3s(here.rotation, here.translation), coal.Box(*side),
                    coal.Transform3s(turn, row[[3, 7, 11]]), coal.DistanceRequest(), coal.DistanceResult(),
                )
                for shape, here in zip(group.geometry.geometryObjects, placed.oMg, strict=True)
                if shape.parentJoint
            )
            for side, turn, row in zip(sides, turns, rows, strict=True)
        ])  # fmt: skip
        gaps = paths.batch.gaps(rows, z[None], most)[0]
        assert (gaps <= np.minimum(np.maximum(distances, -np.inf), most) + 1e-5).all()
        apart = distances > 0.0
        assert (gaps[apart] >= np.minimum(distances, most)[apart] - LARGER).all()
        kept = rng.uniform(0.0, most, 3)
        told.append(bool((gaps < kept).any()))
        resting = DriftingObstacles(rows, np.zeros((3, 3)), np.zeros(3), kept - paths.bound_error([z, z]))
        assert paths._among(resting, ClearanceRule(0.0, 0.0), z, z).drifting.boxes.reshape(3, -1)[
            :, KEPT
        ] == pytest.approx(kept)
    assert 10 < sum(told) < 50


@pytest.mark.parametrize("margin", [0.0, 0.1, 0.5, 2.0])
def test_a_goal_is_free_where_all_stays_farther_than_is_kept(margin: float) -> None:
    """Also where more is kept than distances are measured up to elsewhere."""
    with CertifiedStream(StreamOpen("ur5", "empty", start=UP), robot("ur5"), build(Scene("empty"))) as stream:
        paths, z = stream._paths, stream.executing.ends
    ceiling = np.zeros((1, 16))
    ceiling[0, [0, 5, 10]], ceiling[0, 12:15] = 1.0, (5.0, 5.0, 0.1)
    for beyond, free in ((-0.01, False), (LARGER + 0.01, True)):
        ceiling[0, 11] = top(stream, z) + margin + beyond + 0.1
        drifting = DriftingObstacles(ceiling.copy(), np.zeros((1, 3)), np.zeros(1), np.array([margin]))
        assert paths.is_goal_free(drifting, z) == free


STRETCHED = {"shoulder_lift_joint": -0.6, "elbow_joint": 0.6}


def test_paths_are_planned_to_where_obstacles_will_be() -> None:
    """The straight path is free of a ball that has left it by then, and not of one that comes."""
    with CertifiedStream(StreamOpen("ur5", "empty", start=STRETCHED), robot("ur5"), build(Scene("empty"))) as stream:
        paths, z0, speeds = stream._paths, stream.executing.ends, stream._opened.bounds.rates[:, 0]
    z1, model, kept = z0.copy(), stream.group.model, ClearanceRule(0.02, 0.0)
    z1[0] += 1.5
    data = model.createData()
    pin.framesForwardKinematics(model, data, stream.group.expand_from_local(0.5 * (z0 + z1)))
    tip, rise = data.oMf[stream.group.tip_id].translation, 2.0
    drop = rise * 0.75 / speeds[0]
    free = {
        name: paths.is_free(ball((tip[0], tip[1], height), (0.0, 0.0, drift)), kept, 0.0, np.array([z0, z1]))
        for name, height, drift in (
            ("rests there", tip[2], 0.0),
            ("leaves", tip[2], rise),
            ("comes", tip[2] - drop, rise),
            ("rests below", tip[2] - drop, 0.0),
        )
    }
    assert free == {"rests there": False, "leaves": True, "comes": False, "rests below": True}


def test_a_path_may_end_whole_turns_from_its_goal_where_a_joint_turns_without_end() -> None:
    """The first joint of the robot does, the second one doesn't; the path that ends there is followed to its end."""
    goal = JointsGoal({"j2s6s200_joint_1": 0.5})
    with CertifiedStream(StreamOpen("kinova", "empty", goal=goal), robot("kinova"), build(Scene("empty"))) as stream:
        pursuit = stream._state.pursuit
        end, slower = pursuit.goals[0] + 2.0 * np.pi * np.eye(6)[0], pursuit.goals[0] + 2.0 * np.pi * np.eye(6)[1]
        assert stream._finder.is_same(end, pursuit.goals[0])
        assert not stream._finder.is_same(slower, pursuit.goals[0])
        pursuit.follow(TimedPath(np.array([stream.executing.ends, end]), stream._finder._speeds))
        time, answer = 0.0, stream.update(time=0.0)
        while isinstance(answer, Piece) and time < 20.0:
            time += 0.02
            answer = stream.update(time=time)
        assert answer.reason == "at_goal"
        assert stream.executing.ends == pytest.approx(end)


EMPTY = build(Scene("empty"))
BALL = StreamObstacle(Sphere(name="ball", radius=0.12), 0.3)
ASKED = StreamOpen(
    "ur5",
    "empty",
    JointsGoal({"shoulder_pan_joint": 1.6, "elbow_joint": 1.0}),
    start={"shoulder_lift_joint": -1.0, "elbow_joint": 1.0},
    obstacles=[BALL],
)
IN_THE_WAY = Placement((0.45, 0.45, 0.35))


def opened(taking: TakeOver | None = None, asked: StreamOpen = ASKED) -> CertifiedStream:
    return CertifiedStream(asked, robot("ur5"), EMPTY, taking)


def seen(now: float, placement: Placement = IN_THE_WAY) -> Observation:
    return Observation("ball", now, placement)


def test_what_was_taken_over_when_it_was_found_is_repeated_to_the_bit() -> None:
    taking, at, answers = WhenReady(), [], []
    with opened(taking) as stream:
        for cycle in range(120):
            now = 0.02 * cycle
            answers.append(stream.update(StreamUpdate(now, [seen(now)])))
            if taking.last == now:
                at.append(now)
            if cycle % 7 == 0 and stream._state.ordered is not None:  # some are found in time, some are not
                stream._state.ordered.found.result()
    assert at, "a way was planned and taken over"
    with opened(AtRecordedTimes(at)) as again:
        assert [again.update(StreamUpdate(0.02 * k, [seen(0.02 * k)])) for k in range(120)] == answers
    assert any(isinstance(one, Piece) for one in answers)


def test_what_is_noted_counts_like_what_is_answered() -> None:
    """Where obstacles are is known all the same; who comes for the first time is told of with the next answer."""
    with opened() as noted, opened() as answered:
        for stream in (noted, answered):
            stream.update(StreamUpdate(0.0))
        assert noted.note(StreamUpdate(0.02, [seen(0.02)])) is None
        answered.update(StreamUpdate(0.02, [seen(0.02)]))
        assert noted._obstacles.oldest == answered._obstacles.oldest == 0.02
        assert np.array_equal(noted._obstacles.boxes([0.1]), answered._obstacles.boxes([0.1]))
        late = noted.note(StreamUpdate(0.01))
        assert late.reason == "late"
        assert noted._state.fresh
        noted.update(StreamUpdate(0.04))
        assert not noted._state.fresh


def test_a_stream_knows_so_many_obstacles_and_forgets_those_that_are_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("guidefield.stream.obstacles.MOST_STREAM_OBSTACLES", 3)

    def ball(name: str) -> StreamObstacle:
        return StreamObstacle(msgspec.structs.replace(BALL.obstacle, name=name), 0.3)

    with opened() as stream:
        far = Placement((3.0, 0.0, 0.0))
        stream.update(StreamUpdate(0.0, [seen(0.0, far)], declare=[ball("b"), ball("c")]))
        with pytest.raises(RequestTooLarge, match=r"declare\[0\]`: a stream knows 3 obstacles at most"):
            stream.update(StreamUpdate(0.02, declare=[ball("d")]))
        stream.update(StreamUpdate(0.04, [seen(0.04, far)], gone=["b"]))
        stream.update(StreamUpdate(0.06, [seen(0.06, far)], declare=[ball("d")]))
        assert stream._obstacles.names == ["ball", "c", "d"]
        stream.update(StreamUpdate(0.08, [seen(0.08, far)], gone=["c"]))
        with pytest.raises(RequestTooLarge, match=r"declare\[1\]`"):  # who is declared again makes no room
            stream.update(StreamUpdate(0.1, declare=[ball("c"), ball("e")]))
        assert stream._obstacles.known["c"].gone
        assert stream._obstacles.names == ["ball", "c", "d"]


@pytest.mark.parametrize("stray", [0.0, 1e4])
def test_of_a_cloud_neighbours_stand_together_however_it_is_given(stray: float) -> None:
    """Whoever gave points in any order had each leaf of the judge's tree and each box for paths about all."""
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (4000, 3))
    points[7] += stray  # cameras see such
    message = PointCloud(name="cloud", points=points.tolist(), radius=0.01)
    shape = shape_of(build(Scene("room", obstacles=[message])).obstacles[0])
    balls, links = shape.parts.balls.reshape(-1, BALL_ROW), shape.parts.links.reshape(-1, LINK)
    leaves = links[:, LEFT] < 0
    assert np.array_equal(np.unique(balls[leaves, :3], axis=0), np.unique(points, axis=0))
    above, pending = np.full((len(balls), 4), np.nan), [0]
    for node in pending:  # which grows
        if not leaves[node]:
            above[links[node, [LEFT, RIGHT]]] = balls[node]
            pending += links[node, [LEFT, RIGHT]].tolist()
            below = balls[links[node, [LEFT, RIGHT]]]
            assert (np.linalg.norm(below[:, :3] - balls[node, :3], axis=1) <= balls[node, 3] - 0.01 + 1e-9).all()
    assert sorted(pending) == list(range(len(balls))), "each node is below one other"
    assert np.median(above[leaves, 3]) < 0.2
    assert np.median(shape.boxes[:, 12:15].max(axis=1)) < 0.5
