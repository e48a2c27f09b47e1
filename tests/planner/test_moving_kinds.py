"""Random requests among moving obstacles of every kind: answered, and what is certified is free at dense times.

The oracle places robot and obstacles by Pinocchio alone, and makes Coal's shapes of the messages itself.
"""

import time
from itertools import pairwise
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.errors import Status
from guidefield.geometry.surfaces import se3
from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.planner.guide.guide import ATTEMPTS
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.plan import Plan, Planner, plan
from guidefield.planner.task.problem import Problem
from guidefield.prove.certificate import certify
from guidefield.prove.verdict import Reason
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.guide_plane import build
from tests.planner.guide.test_guide import plane_at
from tests.planner.problems import closed_shell, problem, scene_of
from tests.robots import box_arm, group, grouped, rest

SECONDS = 3.0  # budget of one request: a motion that only got part of the way is judged as well

KINDS = (
    "box", "sphere", "capsule", "cylinder", "convex mesh", "dented mesh", "triangle", "corner", "half space", "cloud",
)  # fmt: skip

L_SHAPE = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
L_TRIANGLES = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]


def turned(rng: np.random.Generator) -> tuple[float, ...]:
    q = rng.normal(size=4)
    return tuple((q / np.linalg.norm(q)).tolist())


def moving(kind: str, name: str, rng: np.random.Generator, since: float = 0.0, until: float = 3.0) -> Any:
    """An obstacle of a kind that flies past, or into, an arm at the origin."""
    times = np.sort(rng.uniform(since, until, rng.integers(2, 5)))
    times += 0.05 * np.arange(len(times))
    flight = messages.ObstacleTrajectory(
        times=times.tolist(),
        placements=[
            Placement(position=tuple(rng.uniform([0.3, -0.8, 0.1], [1.0, 0.8, 1.0]).tolist()), quaternion_xyzw=q)
            for q in (turned(rng) for _ in times)
        ],
    )
    size, at = rng.uniform(0.04, 0.2, 3), {"name": name, "trajectory": flight}
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size / 2
    cube = closed_shell(1.0)
    sides = cube.triangles[:10]
    sheet = [(0.0, 0.0, 0.0), (2 * size[0], 0.0, 0.0), (0.0, 2 * size[1], 0.0)]
    makers = {
        "box": lambda: messages.Box(size=tuple(size.tolist()), **at),
        "sphere": lambda: messages.Sphere(radius=size[0], **at),
        "capsule": lambda: messages.Capsule(radius=size[0], length=size[1], **at),
        "cylinder": lambda: messages.Cylinder(radius=size[0], length=size[1], **at),
        "convex mesh": lambda: messages.Mesh(vertices=corners.tolist(), triangles=[*sides, (1, 5, 7), (1, 7, 3)], **at),
        "dented mesh": lambda: messages.Mesh(
            vertices=(0.5 * size * np.array(cube.vertices)).tolist(), triangles=cube.triangles, **at
        ),
        "triangle": lambda: messages.Polygon(vertices=sheet, **at),
        "corner": lambda: messages.Polygon(vertices=[(x * size[0], y * size[1], 0.0) for x, y in L_SHAPE], **at),
        "half space": lambda: messages.HalfSpace(normal=tuple(size.tolist()), offset=-float(size @ size), **at),
        "cloud": lambda: messages.PointCloud(points=corners.tolist(), radius=0.2 * size[0], **at),
    }
    return makers[kind]()


def bare_shapes(message: Any) -> list[Any]:
    """Coal's shapes of a message, in the frame that its trajectory moves, and where they are in it."""
    match message:
        case messages.Box():
            shape = coal.Box(*message.size)
        case messages.Sphere():
            shape = coal.Sphere(message.radius)
        case messages.Capsule():
            shape = coal.Capsule(message.radius, message.length)
        case messages.Cylinder():
            shape = coal.Cylinder(message.radius, message.length)
        case messages.Mesh():
            shape = surface(np.array(message.vertices, float), message.triangles)
        case messages.HalfSpace():
            length = np.linalg.norm(message.normal)
            shape = coal.Halfspace(np.array(message.normal) / length, message.offset / length)
        case messages.PointCloud():
            ball = coal.Capsule(message.radius, 0.0)  # Coal finds balls in contact with triangles without area
            return [(ball, pin.SE3(np.eye(3), np.array(point))) for point in message.points]
        case _:
            triangles = [(0, 1, 2)] if len(message.vertices) == 3 else L_TRIANGLES
            shape = surface(np.array(message.vertices, float), triangles)
    return [(shape, pin.SE3.Identity())]


def surface(vertices: np.ndarray, triangles: Any) -> Any:
    made = coal.BVHModelOBBRSS()
    made.beginModel(len(triangles), len(vertices))
    made.addVertices(vertices)
    made.addTriangles(np.array(triangles))
    made.endModel()
    return made


def placed(trajectory: messages.ObstacleTrajectory, time: float) -> Any:
    """Where an obstacle's frame is, on a screw from each placement to the next."""
    frames = [se3(p.position, p.quaternion_xyzw) for p in trajectory.placements]
    for (t0, t1), (a, b) in zip(pairwise(trajectory.times), pairwise(frames), strict=True):
        if t0 <= time <= t1:
            return pin.SE3.Interpolate(a, b, (time - t0) / (t1 - t0))
    return frames[0] if time < trajectory.times[0] else frames[-1]


def least_apart(planned: PlanningGroup, obstacles: Any, trajectory: Trajectory, times: np.ndarray) -> float:
    """The smallest distance of a robot to what moves at some times."""
    data, scratch = planned.model.createData(), planned.geometry.createData()
    shapes = [(message, *one) for message in obstacles for one in bare_shapes(message)]
    bodies = [i for i, body in enumerate(planned.geometry.geometryObjects) if body.parentJoint]
    least = np.inf
    for instant in times:
        q = planned.from_local(trajectory.evaluate(np.array([instant]))[0][0])
        pin.updateGeometryPlacements(planned.model, data, planned.geometry, scratch, planned.expand(q))
        for message, shape, within in shapes:
            there = placed(message.trajectory, instant) * within
            for body in bodies:
                link, at = planned.geometry.geometryObjects[body].geometry, scratch.oMg[body]
                request, result = coal.DistanceRequest(), coal.DistanceResult()
                found = coal.distance(link, transform(at), shape, transform(there), request, result)
                least = min(least, found)
    return least


def transform(placement: Any) -> Any:
    return coal.Transform3s(placement.rotation, placement.translation)


def asked(seed: int) -> tuple[Problem, Plan]:
    """A random request among one to three moving obstacles, and its plan."""
    rng = np.random.default_rng(seed)
    chosen = [KINDS[(seed + i) % len(KINDS)] for i in range(rng.integers(1, 4))]
    obstacles = [moving(kind, f"{i} {kind}", rng) for i, kind in enumerate(chosen)]
    plane = plane_at(rng.uniform(0.5, 0.75), half=0.25, z=rng.uniform(0.4, 0.6))
    made = problem(
        "panda",
        scene_of(*obstacles, planes=[plane]),
        min_clearance=float(rng.choice([0.0, 0.02])),
        deadline=Deadline(time.monotonic() + SECONDS),
    )
    return made, plan(made, Planner.GUIDED, ATTEMPTS["projected"](made.group))


@pytest.mark.parametrize("seed", range(3))
def test_what_is_certified_among_moving_obstacles_of_any_kind_is_free_at_dense_times(seed: int) -> None:
    made, found = asked(seed)
    assert found.verdict.reason in set(Reason) - {Reason.BEYOND_LIMITS, Reason.PATH_CONSTRAINT}
    assert (found.trajectory is not None) == (found.status is Status.SUCCESS)
    if found.trajectory is not None:
        assert found.verdict.free
        times = np.linspace(0.0, found.trajectory.duration, 150)
        obstacles = made.scene.message.obstacles
        assert least_apart(made.group, obstacles, found.trajectory, times) >= made.min_clearance - 1e-5


def swing(seed: int) -> Trajectory:
    """A random motion of the arm from rest to rest within its limits, that waits in between."""
    rng, planned = np.random.default_rng(seed), group("panda")
    start = planned.to_local(rest(planned))
    offsets = rng.uniform(-0.5, 0.5, (2, len(start)))
    points = np.array([start, start + offsets[0], start + offsets[0], start + offsets.sum(axis=0)])
    points = np.clip(points, planned.lower, planned.upper)
    return Trajectory(np.array([0.0, 1.0, 1.6, 2.6]), points, np.zeros_like(points))


@pytest.mark.parametrize("clearance", [0.0, 0.02])
@pytest.mark.parametrize("kind", KINDS)
def test_the_timed_certificate_says_what_coal_says_of_every_kind(kind: str, clearance: float) -> None:
    planned, verdicts = group("panda"), []
    for seed in range(14):
        motion, rng = swing(seed), np.random.default_rng(100 + seed)
        scene = scene_of(moving(kind, kind, rng))
        worlds = World.build(planned, scene)
        verdict = certify(worlds, motion.bezier(), clearance, times=motion.piece_times())
        if verdict.pair is not None and kind not in verdict.pair:
            continue  # the arm meets itself
        times, obstacles = np.linspace(0.0, motion.duration, 40), scene.message.obstacles
        if verdict.free:
            assert least_apart(planned, obstacles, motion, times) >= clearance - 1e-5
        else:
            assert verdict.reason in (Reason.CONTACT, Reason.TOO_CLOSE)
            share = verdict.piece + verdict.parameter
            there = np.interp([share], range(4), motion.times)
            assert least_apart(planned, obstacles, motion, there) <= clearance + 1e-5
        verdicts.append(verdict.free)
    assert len(set(verdicts)) == 2, "some are free, some aren't"


def test_what_is_kept_is_asked_of_a_motion_that_only_got_part_of_the_way() -> None:
    """A motion that could not be finished has a certificate of the clearance that was asked for, or none."""
    arm, gap = grouped(box_arm("slide", 1)), 0.03
    post = messages.Box(name="post", size=(1.0, 0.1, 0.05), position=(0.0, 0.02 + gap + 0.05, 0.6))
    plane = plane_at(5.0, z=0.5)
    for kept, free in ((0.9 * gap, True), (1.5 * gap, False)):
        found = plan(
            problem(arm, scene_of(post), q_start=np.array([0.0]), planes=(build(plane, 0),), min_clearance=kept)
        )
        assert found.status is not Status.SUCCESS
        assert found.verdict.free is free
        assert found.verdict.reason is (Reason.FREE if free else Reason.TOO_CLOSE)
