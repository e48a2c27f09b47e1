"""Pieces and braking within limits, and a stop in the end; what the judge proves holds at dense samples."""

from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.geometry.surfaces import se3
from guidefield.messages.scene import Box, Capsule, Cylinder, HalfSpace, Mesh, Obstacle, PointCloud, Scene, Sphere
from guidefield.messages.streams import Deviation, Observation, StreamObstacle, StreamOpen
from guidefield.messages.values import Placement
from guidefield.scene.obstacle import build as built
from guidefield.scene.scene import build
from guidefield.stream.commit import Commit, CommitReason, JointBounds, Judge, plan_commit
from guidefield.stream.obstacles import Obstacles
from guidefield.stream.opening import StreamSetup, read_opening
from tests.robots import robot

VELOCITY, ACCELERATION, JERK = 2.0, 10.0, 400.0
BOUNDS = JointBounds(np.array([-3.0]), np.array([3.0]), np.array([[VELOCITY, ACCELERATION, JERK]]))
ROUNDING = 1e-9
share = st.floats(-1.0, 1.0)


def state(q: float, v: float, a: float) -> np.ndarray:
    """A state whose acceleration can be ended within the velocity's limit, shape (1, 3); shares of the limits."""
    acceleration = 0.999 * a * ACCELERATION
    paths = VELOCITY * 0.999 - acceleration**2 / (2.0 * JERK)
    return np.array([[q, v * paths, acceleration]])


def piece(start: np.ndarray, velocity: float, goal: float = np.inf, within: float = 0.0) -> Commit:
    return plan_commit(start, np.array([velocity]), np.array([goal]), BOUNDS, 0.0, 0.03, within)


@settings(max_examples=18)
@given(share, share, share)
def test_a_piece_and_its_braking_keep_every_limit_and_end_in_a_stop(v: float, a: float, u: float) -> None:
    start = state(0.0, v, a)
    commit = piece(start, u * VELOCITY)
    times = np.unique(np.r_[np.linspace(0.0, commit.stops, 400), commit.phases[0, : commit.counts[0], 0]])
    states = np.array([commit.state(time)[0] for time in times])
    np.testing.assert_allclose(states[0, :3], start[0], atol=ROUNDING)
    for column, limit in ((1, VELOCITY), (2, ACCELERATION), (3, JERK)):
        assert np.abs(states[:, column]).max() <= limit * (1.0 + ROUNDING)
    assert not commit.state(commit.stops + 1e-6)[0, 1:].any()
    # no jump: each derivative is what the one below it changes by (second way: trapezoids between all knots)
    steps = np.diff(times)
    np.testing.assert_allclose(np.diff(states[:, 2]), steps * states[:-1, 3], atol=1e-7)
    middles = 0.5 * (states[1:, 2] + states[:-1, 2])
    np.testing.assert_allclose(np.diff(states[:, 1]), steps * middles, atol=1e-7)


@settings(max_examples=12)
@given(share, share, st.floats(-0.4, 0.4))
def test_no_goal_is_passed_that_need_not_be(v: float, u: float, away: float) -> None:
    start = state(0.0, v, 0.0)
    still = float(piece(start, 0.0).ends[0])
    goal = still + away
    velocity = np.copysign(abs(u) * VELOCITY, away)
    ends = float(piece(start, velocity, goal).ends[0])
    assert (ends - goal) * np.sign(away) <= 1e-8
    if (float(piece(start, velocity).ends[0]) - goal) * np.sign(away) > 0.0:
        assert abs(ends - goal) <= 1e-8


@settings(max_examples=12)
@given(share)
def test_braking_lasts_as_long_as_it_has_to(v: float) -> None:
    start = state(0.0, v, 0.0)
    commit = plan_commit(start, np.zeros(1), np.array([np.inf]), BOUNDS, 0.0, 1e-9, 0.0)
    speed = abs(start[0, 1])
    # a triangle of acceleration, or a trapezoid where its limit is reached
    quickest = speed / ACCELERATION + ACCELERATION / JERK
    if speed < ACCELERATION**2 / JERK:
        quickest = 2.0 * np.sqrt(speed / JERK)
    assert abs(commit.stops - quickest) <= 1e-7
    assert abs(commit.ends[0] - 0.5 * start[0, 1] * quickest) <= 1e-7  # it is symmetric in time


@settings(max_examples=18)
@given(st.lists(share, min_size=3, max_size=3), st.lists(st.floats(0.2, 1.0), min_size=3, max_size=3))
def test_from_rest_all_coordinates_go_straight_on_together(shares: list[float], hardness: list[float]) -> None:
    """Else a robot near the floor would begin with a motion of its own; every limit is kept all the same."""
    rates = np.outer(hardness, [VELOCITY, ACCELERATION, JERK])
    bounds = JointBounds(np.full(3, -3.0), np.full(3, 3.0), rates)
    velocities = np.array(shares) * rates[:, 0]
    state, goals = np.zeros((3, 3)), np.full(3, np.inf)
    for begins in (0.0, 0.02, 0.04):  # each follows the one before
        commit = plan_commit(state, velocities, goals, bounds, begins, 0.03, 0.0)
        states = np.array([commit.state(time) for time in np.linspace(begins, commit.stops, 50)])
        assert (np.abs(states[:, :, 1:]) <= rates * (1.0 + ROUNDING)).all()
        states = np.array([commit.state(time) for time in np.linspace(begins, commit.brakes, 30)])
        along = states[:, :, 0] @ velocities / max(velocities @ velocities, 1e-12)
        np.testing.assert_allclose(
            states[:, :, 0], np.outer(along, velocities), atol=1e-3 * max(1e-6, np.abs(commit.ends).max())
        )
        state = commit.state(begins + 0.02)[:, :3]


@settings(max_examples=12)
@given(share, st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4), st.sampled_from([0.0, 5.0, 9e8]))
def test_what_is_told_keeps_the_jerk_however_late_the_next_piece_is(v: float, later: list[float], clock: float) -> None:
    """Also from the last moments of a braking, where a square root loses half its digits, and by a clock long on."""
    commit = plan_commit(state(0.0, v, 0.0), np.zeros(1), np.array([np.inf]), BOUNDS, clock, 0.03, 1e-7)
    for share_of in later:
        told = commit.trajectory()
        spans, accelerations = np.diff(told.times), np.array(told.accelerations)[:, 0]
        assert (spans > 0.0).all()
        assert abs(told.times[-1] - commit.stops) <= np.spacing(commit.stops)
        assert told.velocities[-1] == [0.0]
        assert told.accelerations[-1] == [0.0]
        rounded = 4.0 * np.spacing(told.times[1:]) + 1e-13 / JERK
        assert (np.abs(np.diff(accelerations)) <= JERK * (spans + rounded)).all()
        since = (1.0 - 1e-6 * share_of**4) * (commit.stops - commit.begins)
        now = commit.state(commit.begins + since)[:, :3]
        commit = plan_commit(now, np.zeros(1), np.array([np.inf]), BOUNDS, commit.begins + since, 0.03, 1e-7)


EMPTY = build(Scene("empty"))
SHAPES: list[Obstacle] = [
    Box(name="box", size=(0.2, 0.1, 0.3)),
    Sphere(name="ball", radius=0.12),
    Capsule(name="capsule", radius=0.05, length=0.3),
    Cylinder(name="cylinder", radius=0.1, length=0.25),
]
ORIGIN = np.zeros(3)


def moved(q: np.ndarray, p: np.ndarray) -> Any:
    return pin.SE3(pin.Quaternion(q / np.linalg.norm(q)).toRotationMatrix(), p)


class Judged:
    """A robot and its judge among obstacles that are observed."""

    def __init__(self, name: str, obstacles: list[StreamObstacle], scene: Scene | None = None, **fields: Any) -> None:
        model = robot(name)
        self.scene = EMPTY if scene is None else build(scene)
        self.opened: StreamSetup = read_opening(StreamOpen(name, "empty", **fields), model, self.scene)
        self.group = self.opened.group
        request = self.opened.request
        tolerances = np.full(self.group.nv, request.tracking_tolerance)
        self.judge = Judge(self.opened.world, self.opened.bounds, request.min_clearance, tolerances)
        self.obstacles = Obstacles(self.scene, self.opened.assumption, self.opened.bodies_met)
        for one in obstacles:
            self.obstacles.take(self.obstacles.prepare(one, "$.obstacles[0]", ()))

    def random_commit(self, rng: np.random.Generator, begins: float = 0.0) -> Commit:
        """A commit at speed."""
        rates = self.opened.bounds.rates
        z = self.opened.start + rng.uniform(-0.5, 0.5, self.group.nv)
        z = np.clip(z, self.group.lower + 0.3, self.group.upper - 0.3)
        start = np.column_stack([z, rng.uniform(-0.7, 0.7, self.group.nv) * rates[:, 0], np.zeros(self.group.nv)])
        wanted = rng.uniform(-1.0, 1.0, self.group.nv) * rates[:, 0]
        bounds = JointBounds(np.full(self.group.nv, -np.inf), np.full(self.group.nv, np.inf), rates)
        return plan_commit(start, wanted, np.full(self.group.nv, np.inf), bounds, begins, 0.03, 1e-7)

    def told(self, commit: Commit, most: int = 5000) -> CommitReason:
        return self.judge.judge(commit, self.obstacles.see(0.0), most).reason

    def least_room(self, commit: Commit, seen: Observation, shape: Any, rate: float, samples: int = 60) -> float:
        """By how much the distance exceeds what is promised, where least: dense samples, Pinocchio and Coal."""
        geometry, data = self.group.geometry, self.group.model.createData()
        placed, least = geometry.createData(), np.inf
        for time in np.linspace(commit.begins, commit.stops, samples):
            q = self.group.expand_from_local(commit.state(time)[:, 0])
            pin.updateGeometryPlacements(self.group.model, data, geometry, placed, q)
            at = np.array(seen.placement.position) + (time - seen.time) * np.array(seen.velocity)
            pose = se3(tuple(at), seen.placement.quaternion_xyzw)
            there = coal.Transform3s(pose.rotation, pose.translation)
            for body in np.unique(self.opened.world.pairs.moving).tolist():
                here = placed.oMg[body]
                result = coal.DistanceResult()
                coal.distance(
                    geometry.geometryObjects[body].geometry,
                    coal.Transform3s(here.rotation, here.translation),
                    shape,
                    there,
                    coal.DistanceRequest(),
                    result,
                )
                least = min(least, result.min_distance - rate * (time - seen.time))
        return float(least)


@pytest.mark.parametrize("assume", ["largest_speed", Deviation(0.2)], ids=["speed", "deviation"])
@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_what_is_proven_holds_densely_and_what_is_not_close_to_failing_is_proven(name: str, assume: Any) -> None:
    rng = np.random.default_rng(11)
    speed = 0.5
    verdicts = []
    for message in SHAPES:
        judged = Judged(
            name, [StreamObstacle(message, speed)], assume=assume, tracking_tolerance=0.0,
            allowed_collisions=[(a, b) for a in robot(name).links for b in robot(name).links if a < b],
        )  # fmt: skip
        shape = built(message, 0).shape
        for _ in range(6):
            turned = moved(rng.normal(size=4), ORIGIN)
            where = rng.uniform([-0.7, -0.7, 0.1], [0.7, 0.7, 0.9])
            velocity = (0.0, 0.0, 0.0) if assume == "largest_speed" else tuple(rng.uniform(-0.3, 0.3, 3).tolist())
            quaternion = tuple(pin.Quaternion(turned.rotation).coeffs().tolist())
            if isinstance(message, Sphere):
                quaternion = (0.0, 0.0, 0.0, 1.0)
            seen = Observation(message.name, -0.02, Placement(tuple(where.tolist()), quaternion), velocity)
            judged.obstacles.observe(seen)
            commit = judged.random_commit(rng)
            verdict = judged.told(commit)
            room = judged.least_room(commit, seen, shape, speed if assume == "largest_speed" else 0.2, 24)
            verdicts.append(verdict is CommitReason.FREE)
            if verdict is CommitReason.FREE:
                assert room > -1e-6
            elif verdict is CommitReason.OBSTACLE:
                assert room <= 0.006  # hulls and convex parts stand off the meshes by some millimetres
            if room > 0.006:
                assert verdict is CommitReason.FREE
    assert 0 < sum(verdicts) < len(verdicts)


def test_a_cloud_a_mesh_and_a_half_space_are_judged_as_what_they_are() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.1, 0.1, (300, 3))
    corners = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])
    triangles = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    triangles += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    vertices = [*map(tuple, corners.tolist()), *map(tuple, (0.4 * corners).tolist())]
    hollow = [*triangles, *((a + 8, c + 8, b + 8) for a, b, c in triangles)]
    others: list[Obstacle] = [
        PointCloud(name="scan", points=list(map(tuple, points.tolist())), radius=0.02),
        Mesh(name="hollow", vertices=vertices, triangles=hollow),
        HalfSpace(name="wall", normal=(-1.0, 0.0, 0.0), offset=0.0),
    ]
    for message in others:
        judged = Judged("ur5", [StreamObstacle(message, 0.1)])
        commit = Commit.standing(judged.opened.start, 0.0)
        data = judged.group.model.createData()
        pin.framesForwardKinematics(judged.group.model, data, judged.group.expand_from_local(judged.opened.start))
        tip = np.array(data.oMf[judged.group.tip_id].translation)
        far = tip + np.array([1.0, 0.0, 0.0])
        for where, free in ((tip, False), (far, True)):
            seen = Observation(message.name, 0.0, Placement(tuple(where.tolist())))
            judged.obstacles.observe(seen)
            assert (judged.told(commit) is CommitReason.FREE) == free, message.name


def test_a_robot_wholly_inside_a_closed_mesh_is_not_free() -> None:
    corners = 2.0 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    sides = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    sides += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    # a cube with a small dent is solid and not convex
    vertices = [*map(tuple, corners.tolist()), (1.0, 0.0, 0.0)]
    dented = [one for one in sides if one not in ((4, 6, 7), (4, 7, 5))]
    dented += [(4, 6, 8), (6, 7, 8), (7, 5, 8), (5, 4, 8)]
    judged = Judged("ur5", [StreamObstacle(Mesh(name="room", vertices=vertices, triangles=dented), 0.0)])
    judged.obstacles.observe(Observation("room", 0.0, Placement((-0.5, 0.0, 0.0))))
    assert judged.told(Commit.standing(judged.opened.start, 0.0)) is CommitReason.OBSTACLE


@pytest.mark.parametrize("column", [0, 1, 2, 3, 4])
def test_a_motion_that_breaks_a_limit_or_jumps_is_refused(column: int) -> None:
    judged = Judged("ur5", [])
    commit = judged.random_commit(np.random.default_rng(2))
    assert judged.told(commit) is not CommitReason.LIMITS
    phases = commit.phases.copy()
    phases[2, 1, column] += 1e-5 if column else 1e-4
    broken = Commit(1, 0.0, 0.03, commit.stops, commit.start, phases, commit.counts, commit.ends)
    assert judged.told(broken) is CommitReason.LIMITS


def test_the_robot_meets_itself() -> None:
    judged = Judged("ur5", [], start={"elbow_joint": 3.0})
    assert judged.told(Commit.standing(judged.opened.start, 0.0)) is CommitReason.OWN


def test_bounds_of_travel_contain_what_is_travelled() -> None:
    judged = Judged("panda", [])
    rng = np.random.default_rng(8)
    for _ in range(5):
        commit = judged.random_commit(rng)
        geometry, data = judged.group.geometry, judged.group.model.createData()
        placed, before, travels = geometry.createData(), None, np.zeros(geometry.ngeoms)
        for time in np.linspace(0.0, commit.stops, 40):
            q = judged.group.expand_from_local(commit.state(time)[:, 0])
            pin.updateGeometryPlacements(judged.group.model, data, geometry, placed, q)
            now = np.array([pose.translation for pose in placed.oMg])
            travels += 0.0 if before is None else np.linalg.norm(now - before, axis=1)
            before = now
        bound = judged.judge.bound_travel(commit, judged.obstacles.see(0.0), 0.0, commit.stops)
        assert travels.max() <= bound <= 6.0 * travels.max() + 0.05
