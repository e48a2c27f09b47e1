"""Ways of a stream: what they keep from what rests, and a way out of where that is not kept."""

from __future__ import annotations

from itertools import pairwise, product
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.kernels.collide.layout import DRIFTING_BOX, KEPT, ROUNDED_BOX
from guidefield.kernels.stream.dodge import FADING, KeptClearances, Tube, find_schedule
from guidefield.messages.goals import JointsGoal
from guidefield.messages.scene import Box, HalfSpace, Scene
from guidefield.messages.streams import Observation, Piece, StreamObstacle, StreamOpen, StreamState
from guidefield.messages.values import Placement
from guidefield.robot.model.spaces import ChartPoint, ChartPoints
from guidefield.scene.scene import build
from guidefield.stream.dodging import TimedPath, _along, build_tube
from guidefield.stream.obstacles import DriftingObstacles
from guidefield.stream.path_planner import NOTHING
from guidefield.stream.settings import STREAM, ClearanceRule
from guidefield.stream.shapes import read_only_views
from guidefield.stream.stream import CertifiedStream
from tests.robots import robot

LARGER = 0.05
"""Links are told to be larger than they are by so much at most [m]."""

UP = {"shoulder_lift_joint": -1.5, "elbow_joint": 0.5}


def top(stream: CertifiedStream, z: ChartPoint) -> float:
    """How high a robot is with some coordinates (nv,), by Pinocchio and Coal [m]."""
    geometry = stream.group.geometry
    placed, data = geometry.createData(), stream.group.model.createData()
    pin.updateGeometryPlacements(stream.group.model, data, geometry, placed, stream.group.expand_from_chart(z))
    ceiling = coal.Halfspace(np.array([0.0, 0.0, -1.0]), -10.0)
    gaps = [
        coal.distance(
            shape.geometry, coal.Transform3s(here.rotation, here.translation), ceiling, coal.Transform3s(),
            coal.DistanceRequest(), coal.DistanceResult(),
        )
        for shape, here in zip(geometry.geometryObjects, placed.oMg, strict=True)
    ]  # fmt: skip
    return 10.0 - min(gaps)


def test_a_way_begins_where_the_robot_is_closer_than_ways_keep() -> None:
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
            way = paths.find_path(NOTHING, ClearanceRule(0.1, 0.0), z0, z1, 0)
        assert way is not None
        assert np.array_equal(way[[0, -1]], [z0, z1])


def test_ways_keep_what_the_robot_may_be_off_by_and_what_the_judge_wants_of_each_obstacle() -> None:
    tolerance, scene = 0.01, build(Scene("empty"))
    crate = StreamObstacle(Box(name="crate", size=(0.1, 0.1, 0.1)), largest_speed=0.4, uncertainty=0.01)
    asked = StreamOpen(
        "ur5", "empty", start=UP, obstacles=[crate], tracking_tolerance=tolerance, clock_error=0.005, min_clearance=0.02
    )
    with CertifiedStream(asked, robot("ur5"), scene) as stream:
        stream.update(time=0.0, obstacles=[Observation("crate", 0.0, Placement((0.3, 0.3, 1.5)))])
        paths, z = stream._paths, stream.executing.ends
        drifting = stream._obstacles.drifting(0.0)
        swept, largest = paths.bound_error([z]), most_moved(stream, z, tolerance)
        ends = [z, z + 0.5]
        assert largest <= swept <= 1.5 * largest
        assert paths.bound_error(ends) == max(swept, paths.bound_error(ends[1:])) > swept
        kept = 0.02 + paths.bound_error(ends) + STREAM.resting
        assert paths.choose_clearance(STREAM.resting, ends) == pytest.approx(kept, rel=1e-15)
        assert drifting.margins == pytest.approx([0.01 + 0.02 + 0.4 * 0.005])
        kept_from_each = paths._among(drifting, ClearanceRule(0.05, 0.1), *ends).drifting.boxes.reshape(
            -1, DRIFTING_BOX
        )[:, KEPT]
        assert kept_from_each == pytest.approx(0.05 + 0.1 * 0.4 + drifting.margins + paths.bound_error(ends))


def most_moved(stream: CertifiedStream, z: ChartPoint, tolerance: float) -> float:
    """How far a vertex of a link goes at most where each joint is off by a tolerance, by Pinocchio, joint by joint."""
    group = stream.group
    data, placed = group.model.createData(), group.geometry.createData()
    pin.computeJointJacobians(group.model, data, group.expand_from_chart(z))
    pin.updateGeometryPlacements(group.model, data, group.geometry, placed)
    most = 0.0
    for shape, here in zip(group.geometry.geometryObjects, placed.oMg, strict=True):
        if not isinstance(shape.geometry, coal.BVHModelBase | coal.ConvexBase):
            continue
        for vertex in shape.geometry.vertices()[::50]:
            arm = here.act(vertex) - data.oMi[shape.parentJoint].translation
            frame = pin.SE3(np.eye(3), data.oMi[shape.parentJoint].translation)
            jacobian = frame.toActionMatrixInverse() @ pin.getJointJacobian(
                group.model, data, shape.parentJoint, pin.ReferenceFrame.WORLD
            )
            rates = jacobian[:3] + np.cross(jacobian[3:].T, arm).T
            most = max(most, tolerance * float(np.linalg.norm(rates, axis=0).sum()))
    return most


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
        pin.updateGeometryPlacements(group.model, data, group.geometry, placed, group.expand_from_chart(z))
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
        gaps = paths.lanes.gaps(rows, z[None], most)[0]
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


def later(drifting: DriftingObstacles, time: float) -> np.ndarray:
    """Its boxes after a time [s], shape (k, 16)."""
    boxes = drifting.boxes.copy()
    boxes[:, [3, 7, 11]] += time * drifting.drifts
    return boxes


STRETCHED = {"shoulder_lift_joint": -0.6, "elbow_joint": 0.6}


WIDENING = 0.4
"""So much more is kept for each second from a close end [m/s]."""

ALL = 10.0
"""Where a way ends so much would have to be kept before less is enough there: never [m]."""


def searched(
    paths: Any, drifting: DriftingObstacles, kept: np.ndarray, tube: Tube, foreseen: int, dear: float, width: int
) -> tuple[float, np.ndarray]:
    """What the cheapest way in a tube costs, and where it is at each step."""
    timed, reached = np.empty((foreseen + 1, tube.places.shape[1])), np.empty(foreseen + 1, np.int64)
    tube = read_only_views(tube._replace(speeds=np.ascontiguousarray(tube.speeds)))
    wanted = read_only_views(KeptClearances(kept, WIDENING, dear))
    rows, cost = find_schedule(paths.lanes.words, drifting.boxes, drifting.drifts, wanted, tube, width, timed, reached)
    columns = reached[:rows] % tube.taken.shape[1]
    assert (timed[:rows][columns == 0] == tube.places[reached[:rows] // tube.taken.shape[1]][columns == 0]).all()
    return cost, timed[:rows]


@pytest.mark.parametrize("ending", [0.02, ALL])
def test_what_a_way_costs_is_the_least_of_all_ways_to_go_on_or_wait(ending: float) -> None:
    """Against all of them, one after the other."""
    with CertifiedStream(StreamOpen("ur5", "empty", start=STRETCHED), robot("ur5"), build(Scene("empty"))) as stream:
        paths, z0, speeds = stream._paths, stream.executing.ends, stream._opened.bounds.rates[:, 0]
    step, steps, dear, stays = 0.1, 8, 60.0, 1
    places = np.array([z0 + k * np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0]) for k in (0, 1, 2, 3, 3)])
    tube = Tube(places, np.empty((0, 6)), np.zeros((5, 1), np.int64), speeds, step, stays)
    kept = np.array([[0.25], [0.15], [ending]])
    costs = []
    for start in (0.2, 0.5, 0.8):
        drifting = ball((0.6, start, 0.5), (0.0, -0.5, 0.0))
        least = np.array([paths.lanes.gaps(later(drifting, step * i), places, 0.25)[:, 0] for i in range(steps + 1)])
        best = np.inf
        for moves in product((-1, 0, 1), repeat=steps):
            place, cost = 0, 0.0
            for i, on in enumerate(moves, start=1):
                if place == len(places) - 1:
                    break
                if not place + on >= 0:
                    cost = np.inf
                    break
                waits = on == 0 or min(place, place + on) >= len(places) - 1 - stays
                place += on
                left = max(0, len(places) - 1 - stays - place)
                there = least[min(steps, i + left), -1]
                enough = there + WIDENING * step * left if there >= ending else np.inf
                lack = max(0.0, min(kept[1 if waits else 0, 0], enough) - least[i, place])
                cost += step * (1.0 + dear * lack / (1.0 + step * i / FADING))
            best = min(best, cost + step * (len(places) - 1 - place))
        found, _ = searched(paths, drifting, kept, tube, steps, dear, 0)
        assert found == pytest.approx(best, rel=1e-12)
        costs.append(found)
    assert max(costs) > 0.5, "who is in the way costs something"
    assert len(set(costs)) == 3


def test_a_way_is_followed_no_earlier_than_it_says() -> None:
    speeds, ahead = np.array([1.0, 2.0]), 0.2
    points = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.0], [0.3, 0.0], [0.3, 0.4]])
    way = TimedPath(points, speeds, np.array([5.0, 5.1, 5.6, 5.8, 6.0]))
    assert [way.due(time) for time in (4.0, 5.0, 5.05, 5.3, 5.7, 5.9, 6.0)] == pytest.approx(
        [0.0, 0.0, 0.05, 0.1, 0.2, 0.4, np.inf]
    )
    assert TimedPath(points, speeds).due(-1e9) == np.inf
    stand = np.array([0.02, 0.0])
    waits = way.aim(stand, 0.0, ahead, way.due(5.3))
    assert waits.last == pytest.approx([0.1, 0.0])
    assert waits.direction == pytest.approx([0.08, 0.0])
    goes = way.aim(stand, 0.0, ahead, way.due(5.9))
    assert goes.last is None
    assert goes.direction == pytest.approx([0.2, 0.0])
    there = TimedPath(np.array([[0.0, 0.0], [0.3, 0.0], [0.0, 0.0]]), speeds, np.array([0.0, 0.3, 0.6]))
    assert there.aim(np.array([0.01, 0.0]), 0.0, ahead, there.due(0.1)).place == pytest.approx(0.01), (
        "not where it ends"
    )


def test_ways_are_planned_to_where_obstacles_will_be() -> None:
    """The straight way is free of a ball that has left it by then, and not of one that comes."""
    with CertifiedStream(StreamOpen("ur5", "empty", start=STRETCHED), robot("ur5"), build(Scene("empty"))) as stream:
        paths, z0, speeds = stream._paths, stream.executing.ends, stream._opened.bounds.rates[:, 0]
    z1, model, kept = z0.copy(), stream.group.model, ClearanceRule(0.02, 0.0)
    z1[0] += 1.5
    data = model.createData()
    pin.framesForwardKinematics(model, data, stream.group.expand_from_chart(0.5 * (z0 + z1)))
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


def test_a_way_with_times_keeps_its_corners() -> None:
    """Straight from one place of its tube to the next isn't free of what rests; turning back neither."""
    with CertifiedStream(StreamOpen("ur5", "empty", start=STRETCHED), robot("ur5"), build(Scene("empty"))) as stream:
        paths, z0, speeds = stream._paths, stream.executing.ends, stream._opened.bounds.rates[:, 0]
    rng, beside = np.random.default_rng(0), 0
    for k in range(30):
        corners = z0 + np.concatenate([np.zeros((1, 6)), rng.uniform(-0.4, 0.4, (6, 6))]).cumsum(axis=0)
        far = k == 0
        centre = np.full(3, 9.0) if far else rng.uniform((0.3, -0.8, 0.2), (0.9, 0.8, 0.8))
        timed = paths.schedule(ball(tuple(centre), tuple(rng.uniform(-0.8, 0.8, 3))), corners)
        assert np.array_equal(timed.points[[0, -1]], corners[[0, -1]])
        assert (np.diff(timed.times) >= 0.0).all()
        places = require_no_corner_passed(TimedPath(corners, speeds), timed.points)
        beside += None in places
        if far:
            assert timed.times == pytest.approx(places, abs=1e-9), "nothing is in the way"
    assert beside > 0
    way, step = TimedPath(corners, speeds), STREAM.step
    tube = build_tube(way, np.full((1, 6), 0.01), speeds, lambda zs: np.zeros(len(zs), bool), 10)
    reached = np.array([0, 1, 2, 3, 3, 2, 1, 2])
    points, times = _along(way, tube, tube.places[reached], reached * tube.taken.shape[1])
    assert way.length > 4.0 * step
    places = require_no_corner_passed(way, points)
    wanted = np.interp(times[times <= 7.0 * step], step * np.arange(8), step * reached)
    assert places[: len(wanted)] == pytest.approx(wanted), "there and back"
    assert np.array_equal(points[-1], corners[-1])


def require_no_corner_passed(way: TimedPath, points: ChartPoints) -> list[float | None]:
    """Where on a way each of some points (m, nv) is; None: beside it. No corner is between two that follow."""
    nearest_places = [way.nearest(point, 0.0, np.inf) for point in points]
    off = [float(np.abs(way.at(a) - point).max()) for a, point in zip(nearest_places, points, strict=True)]
    places = [a if one < 1e-9 else None for a, one in zip(nearest_places, off, strict=True)]
    for a, b in pairwise(places):
        if a is not None and b is not None:
            assert not ((way.begins > min(a, b) + 1e-9) & (way.begins < max(a, b) - 1e-9)).any()
    return places


def test_a_way_may_end_whole_turns_from_its_goal_where_a_joint_turns_without_end() -> None:
    """The first joint of the robot does, the second one doesn't; the way that ends there is followed to its end."""
    goal = JointsGoal({"j2s6s200_joint_1": 0.5})
    with CertifiedStream(StreamOpen("kinova", "empty", goal=goal), robot("kinova"), build(Scene("empty"))) as stream:
        pursuit = stream._state.pursuit
        assert pursuit is not None
        end, slower = pursuit.goals[0] + 2.0 * np.pi * np.eye(6)[0], pursuit.goals[0] + 2.0 * np.pi * np.eye(6)[1]
        assert stream._is_same(end, pursuit.goals[0])
        assert not stream._is_same(slower, pursuit.goals[0])
        pursuit.follow(TimedPath(np.array([stream.executing.ends, end]), stream._speeds))
        time, answer = 0.0, stream.update(time=0.0)
        while isinstance(answer, Piece) and time < 20.0:
            time += 0.02
            answer = stream.update(time=time)
        assert isinstance(answer, StreamState)
        assert answer.reason == "at_goal"
        assert stream.executing.ends == pytest.approx(end)
