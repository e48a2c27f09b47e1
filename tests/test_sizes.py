"""A problem that is said otherwise has the same answer: at every size, far away, turned, in another order."""

import functools
from collections.abc import Sequence

import msgspec
import numpy as np
import pytest

from guidefield import (
    Box,
    Cylinder,
    InverseKinematics,
    JointsGoal,
    PlanReply,
    PlanRequest,
    PoseGoal,
    Scene,
    Sphere,
    UrdfText,
    answer,
)
from guidefield.messages.conditions import TargetPose
from guidefield.messages.requests import OrientationCone, PlanStep
from guidefield.messages.scene import GuidePlane, ObstacleTrajectory
from guidefield.messages.values import Placement
from tests.robots import robot

AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0")
LINK = 0.25  # of an arm that reaches 1.2 m at size 1 [m]


def arm(size: float) -> UrdfText:
    """An arm of box links on a slide, whose lengths are a size times as large."""
    links, joints = [], []
    for i in range(len(AXES) + 1):
        length, width = 0.9 * LINK * size, 0.05 * size
        links.append(
            f'<link name="l{i}"><collision><origin xyz="0 0 {0.5 * length!r}"/><geometry>'
            f'<box size="{width!r} {width!r} {length!r}"/></geometry></collision></link>'
        )
    joints.append(
        f'<joint name="slide" type="prismatic"><parent link="base"/><child link="l0"/><axis xyz="0 1 0"/>'
        f'<limit lower="{-0.5 * size!r}" upper="{0.5 * size!r}" velocity="{0.5 * size!r}" effort="1"/></joint>'
    )
    for i, axis in enumerate(AXES):
        joints.append(
            f'<joint name="j{i}" type="revolute"><origin xyz="0 0 {LINK * size if i else 0.3 * size!r}"/>'
            f'<parent link="l{i}"/><child link="l{i + 1}"/><axis xyz="{axis}"/>'
            '<limit lower="-2.5" upper="2.5" velocity="1.5" effort="1"/></joint>'
        )
    return UrdfText(text=f'<robot name="arm"><link name="base"/>{"".join(links + joints)}</robot>')


def problem(size: float = 1.0, by: Sequence[float] = (0.0, 0.0, 0.0), turn: float = 0.0, step: int = 1) -> PlanRequest:
    """Round a post and under a shelf, all of it so many times as large, moved [m] and turned about z [rad]."""
    c, s = np.cos(turn), np.sin(turn)
    half = (0.0, 0.0, float(np.sin(0.5 * turn)), float(np.cos(0.5 * turn)))

    def at(x: float, y: float, z: float) -> tuple[float, float, float]:
        return (size * (c * x - s * y) + by[0], size * (s * x + c * y) + by[1], size * z + by[2])

    obstacles = [
        Cylinder(name="post", radius=0.06 * size, length=1.2 * size, position=at(0.6, 0.0, 0.6)),
        Box(
            name="shelf",
            size=(0.5 * size, 0.7 * size, 0.04 * size),
            position=at(0.75, 0.35, 0.95),
            quaternion_xyzw=half,
        ),
        Box(name="wall", size=(0.04 * size, 1.6 * size, size), position=at(-0.5, 0.0, 0.5), quaternion_xyzw=half),
    ]
    start = {"slide": -0.2 * size, "j0": -0.9, "j1": 0.9, "j2": 0.4}
    goal = {"slide": 0.2 * size, "j0": 0.9, "j1": 0.9, "j2": 0.4, "j3": 0.0, "j4": 0.0}
    return PlanRequest(
        arm(size),
        Scene(name="cell", obstacles=obstacles[::step]),
        JointsGoal(goal),
        start=start,
        robot_placement=Placement(position=tuple(by), quaternion_xyzw=half),
        guide_planes=[],
        recording="off",
        allowed_planning_time=60.0,
    )


def ask(request: PlanRequest) -> PlanReply:
    """A certified plan, without warnings."""
    reply = answer(request)
    assert reply.status.name == "SUCCESS", reply.status.message
    assert not reply.warnings
    assert reply.metrics is not None
    assert reply.clearance is not None
    return reply


def plan(request: PlanRequest, size: float) -> tuple[float, float]:
    """Duration [s] and smallest distance over the size of a certified plan."""
    reply = ask(request)
    return reply.metrics.duration, reply.clearance.minimum / size


@pytest.mark.parametrize("name", ["panda", "ur5", "chain_fixed_6x320_r25", "chain_moving_3x260_r25"])
def test_robots_of_usual_reach_have_the_size_one(name: str) -> None:
    assert robot(name).size == 1.0


@functools.cache
def as_it_is() -> tuple[float, float]:
    return plan(problem(), 1.0)


@pytest.mark.parametrize("size", [0.01, 0.1, 0.35, 3.0, 30.0])
def test_everything_so_many_times_as_large_has_the_same_answer(size: float) -> None:
    (duration, kept), (expected, distance) = plan(problem(size), size), as_it_is()
    assert duration == pytest.approx(expected, rel=0.03)
    assert kept >= 0.95 * distance


def test_twice_as_large_has_the_same_answer_to_the_last_digits() -> None:
    """Doubling rounds nothing: what differs was chosen by a length that isn't a share of the robot's size."""
    small, large = (ask(problem(size)) for size in (4.0, 8.0))
    assert small.trajectory.times == pytest.approx(large.trajectory.times, rel=1e-12)
    assert small.metrics.smoothness == pytest.approx(large.metrics.smoothness, rel=1e-9)
    assert 2.0 * small.clearance.mean == pytest.approx(large.clearance.mean, rel=1e-6)
    assert 2.0 * small.clearance.inner == pytest.approx(large.clearance.inner, rel=1e-4)


def otherwise_asked(size: float) -> dict[str, PlanRequest]:
    """The same problem with more that has lengths, all of them so many times as large."""
    asked, places = problem(size), ((0.7, -0.6, 0.9), (0.5, 0.6, 0.7))
    way = [Placement(position=(size * x, size * y, size * z)) for x, y, z in places]
    ball = Sphere(name="ball", radius=0.1 * size, trajectory=ObstacleTrajectory([0.0, 2.0], way))
    cell = msgspec.structs.replace(asked.scene, obstacles=[*asked.scene.obstacles, ball])
    steps = [PlanStep(JointsGoal({"j0": -0.3, "j1": 0.4})), PlanStep(asked.goal)]
    near = PoseGoal((0.5 * size, 0.45 * size, 0.6 * size), (0.0, 1.0, 0.0, 0.0), position_tolerance=(0.01 * size,) * 3)
    changes: dict[str, dict[str, object]] = {
        "away": {"objective": "clearance", "min_clearance": 0.01 * size},
        "among what moves": {"scene": cell},
        "upright": {"path_constraints": [OrientationCone("l5", (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), 2.2)]},
        "in steps": {"goal": None, "steps": steps},
        "to a pose": {"goal": near},
    }
    return {name: msgspec.structs.replace(asked, **change) for name, change in changes.items()}


@pytest.mark.parametrize("name", list(otherwise_asked(1.0)))
def test_twice_as_large_is_the_same_whatever_is_asked(name: str) -> None:
    small, large = (ask(otherwise_asked(size)[name]) for size in (4.0, 8.0))
    assert small.trajectory.times == pytest.approx(large.trajectory.times, rel=1e-9)


GATE = [(0.35, -0.5, 0.75), (0.35, -0.2, 0.75), (0.35, -0.2, 1.1), (0.35, -0.5, 1.1)]
"""Corners of a guide plane beside the post [m]."""


@pytest.mark.parametrize("derived", [False, True])
def test_guide_planes_of_an_arm_twice_as_large_are_crossed_in_the_same_way(derived: bool) -> None:
    replies = []
    for size in (4.0, 8.0):
        gate = GuidePlane("gate", [(x * size, y * size, z * size) for x, y, z in GATE])
        replies.append(ask(msgspec.structs.replace(problem(size), guide_planes="auto" if derived else [gate])))
    small, large = replies
    assert len(small.guide_planes) == len(large.guide_planes) >= 1
    assert small.trajectory.times == pytest.approx(large.trajectory.times, rel=1e-9)


@pytest.mark.parametrize("size", [0.02, 0.2, 8.0, 30.0])
def test_inverse_kinematics_are_the_same_at_every_size(size: float) -> None:
    def found(by: float) -> list[dict[str, float]]:
        poses = [TargetPose((by * x, by * 0.3, by * 0.7), (0.0, 1.0, 0.0, 0.0)) for x in (0.3, 0.5, 0.7)]
        return [one[0] for one in answer(InverseKinematics(arm(by), poses, start_configurations=[{}])).configurations]

    for one, other in zip(found(size), found(0.5 * size), strict=True):
        for name, value in one.items():
            assert value / (size if name == "slide" else 1.0) == pytest.approx(
                other[name] / (0.5 * size if name == "slide" else 1.0), abs=1e-3
            )


@pytest.mark.parametrize(
    "changes", [{"by": (600.0, 800.0, 0.0)}, {"turn": 2.0}, {"by": (3.0, -2.0, 1.0)}, {"step": -1}]
)
def test_a_change_that_changes_nothing_has_the_same_answer(changes: dict[str, object]) -> None:
    (duration, kept), (expected, distance) = plan(problem(**changes), 1.0), as_it_is()
    assert duration == pytest.approx(expected, rel=0.03)
    assert kept >= 0.95 * distance
