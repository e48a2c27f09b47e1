"""The judge of streams: what it proves holds at dense samples of Pinocchio and Coal; other motions are refused."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

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
            q = self.group.expand_from_chart(commit.state(time)[:, 0])
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
        pin.framesForwardKinematics(judged.group.model, data, judged.group.expand_from_chart(judged.opened.start))
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


def test_ways_are_bounded_by_what_is_travelled() -> None:
    judged = Judged("panda", [])
    rng = np.random.default_rng(8)
    for _ in range(5):
        commit = judged.random_commit(rng)
        geometry, data = judged.group.geometry, judged.group.model.createData()
        placed, before, ways = geometry.createData(), None, np.zeros(geometry.ngeoms)
        for time in np.linspace(0.0, commit.stops, 40):
            q = judged.group.expand_from_chart(commit.state(time)[:, 0])
            pin.updateGeometryPlacements(judged.group.model, data, geometry, placed, q)
            now = np.array([pose.translation for pose in placed.oMg])
            ways += 0.0 if before is None else np.linalg.norm(now - before, axis=1)
            before = now
        bound = judged.judge.bound_travel(commit, judged.obstacles.see(0.0), 0.0, commit.stops)
        assert ways.max() <= bound <= 6.0 * ways.max() + 0.05
