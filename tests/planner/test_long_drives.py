"""Plans round a cloud of points and through many rooms; each makes a part of a table at most once."""

from collections import Counter
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

import guidefield
from guidefield import Box, JointsGoal, PlanRequest, Scene, UrdfText, answer, memo
from guidefield.engine import Engine
from guidefield.errors import Status
from guidefield.geometry import surfaces
from guidefield.robot.group.group import Alike
from guidefield.robot.link_charges import surface_points
from guidefield.robot.model.model import RobotModel
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene as BuiltScene
from tests.handlers.motions import Bare, distance

CART = """<robot name="cart"><link name="base"><collision><origin xyz="0 0 0.2"/><geometry>
<cylinder radius="0.28" length="0.36"/></geometry></collision></link></robot>"""

ROOM, DOOR, WIDTH = 6.0, 1.0, 6.0  # length of a room along the path, width of a door, and of a room across it [m]


def rooms(count: int) -> Scene:
    """Rooms in a row along x, with doors to either side in turn."""
    end = ROOM * count
    walls = {"left": (end, 0.1, end / 2, WIDTH / 2), "right": (end, 0.1, end / 2, -WIDTH / 2)}
    walls |= {f"end {x:.0f}": (0.1, WIDTH, x, 0.0) for x in (0.0, end)}
    for k in range(1, count):
        door = 1.8 if k % 2 else -1.8
        for name, low, high in (("right", -WIDTH / 2, door - DOOR / 2), ("left", door + DOOR / 2, WIDTH / 2)):
            walls[f"{name} of {k}"] = (0.1, high - low, ROOM * k, (low + high) / 2)
    return Scene(
        "rooms", obstacles=[Box(name=n, size=(a, b, 1.0), position=(x, y, 0.5)) for n, (a, b, x, y) in walls.items()]
    )


@pytest.mark.parametrize("seed", [0, 1])
def test_a_drive_of_48_metres_is_certified_as_it_was_optimised(seed: int) -> None:
    start, goal = ([x, 0.0, 0.0] for x in (ROOM / 2, ROOM * 7.5))
    reply = answer(
        PlanRequest(
            UrdfText(CART, root_joint="planar"),
            rooms(8),
            JointsGoal({"root_joint": goal}),
            start={"root_joint": start},
            guide_planes=[],
            allowed_planning_time=20.0,
            seed=seed,
        )
    )
    assert reply.status.name == "SUCCESS"
    assert reply.certificate.collision_free
    assert not [warning for warning in reply.warnings if "as it was found" in warning]


RADIUS = 0.02
SOLID = surfaces.box((0.3, 0.4, 0.5))
SCAN = surface_points(SOLID.vertices, SOLID.triangles, 0.06).points + np.array([0.5, 0.0, 0.25])


def test_a_robot_goes_around_a_cloud() -> None:
    cloud = {"type": "point_cloud", "name": "scan", "points": SCAN.tolist(), "radius": RADIUS}
    reply = guidefield.answer(
        {
            "robot": "panda",
            "scene": {"name": "scanned", "obstacles": [cloud]},
            "start": {"panda_joint1": 1.2},
            "goal": {"type": "joints", "positions": {"panda_joint1": -1.2}},
            "guide_planes": [],
            "allowed_planning_time": 60.0,
            "recording": "off",
        }
    )
    assert reply.status.name == "SUCCESS", reply.status
    bare, ball, nearest = Bare(reply.position_names), coal.Sphere(RADIUS), np.inf
    places = [pin.SE3(np.eye(3), point) for point in SCAN[::3]]
    for row in reply.trajectory.positions[::4]:
        bare.stand(np.array(row))
        for _, shape, here in bare.bodies():
            nearest = min(nearest, *(distance(shape, here, ball, there) for there in places))
    assert nearest > 0.0
    assert nearest > reply.clearance.minimum - 1e-3


SCENE = Scene("two boxes", obstacles=[
    Box(name="left", size=(0.1, 0.1, 0.4), position=(0.5, 0.4, 0.3)),
    Box(name="right", size=(0.1, 0.1, 0.4), position=(0.5, -0.4, 0.3)),
])  # fmt: skip
REQUEST = PlanRequest(robot="panda", scene=SCENE, goal=JointsGoal({"panda_joint1": 0.6}), allowed_planning_time=60.0)

Made = Counter[tuple[object, ...]]


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Made:
    """How often each part was made, by its function, its owner and what else was asked; the owners live on."""
    counts, keep, owners = Made(), memo.Answers.keep, list[object]()

    def counted(self: Any, owner: object, asked: object, answer: Any) -> Any:
        if answer is not True and isinstance(owner, Alike | RobotModel | Obstacle | BuiltScene):  # True marks work done
            counts[self._number, type(owner).__name__, id(owner), asked] += 1
            owners.append(owner)
        return keep(self, owner, asked, answer)

    monkeypatch.setattr(memo.Answers, "keep", counted)
    return counts


def _status(engine: Engine) -> int:
    reply = engine.answer(REQUEST)
    return reply.status.code


def test_a_plan_makes_each_part_once_and_the_next_one_none(made: Made) -> None:
    engine = Engine()
    assert _status(engine) == Status.SUCCESS
    assert made, "the first plan makes parts"
    assert {part: count for part, count in made.items() if count > 1} == {}
    made.clear()
    assert _status(engine) == Status.SUCCESS
    assert dict(made) == {}
