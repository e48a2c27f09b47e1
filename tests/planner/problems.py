"""Planning problems for the tests."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from guidefield.collision.clearance import contacts_at
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.messages import codec, scene as messages
from guidefield.planner.task.problem import ConfigurationGoal, Goal, LastPlaneGoal, Problem
from guidefield.planner.task.trace import Event
from guidefield.potential import Precision, RobotField
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.model.configuration import configuration_from_wire
from guidefield.scene.scene import Scene, build
from guidefield.stores import scenes
from tests.examples import example
from tests.robots import group, rest


class Listener:
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.events: list[Event] = []

    def observe(self, event: Event) -> None:
        self.events.append(event)


def closed_shell(half: float) -> messages.Mesh:
    """A cube with a dent in one face: closed and not convex."""
    corners = [(x, y, z) for x in (-half, half) for y in (-half, half) for z in (-half, half)]
    faces = [
        (0, 1, 3),
        (0, 3, 2),
        (4, 6, 7),
        (4, 7, 5),
        (0, 4, 5),
        (0, 5, 1),
        (2, 3, 7),
        (2, 7, 6),
        (0, 2, 6),
        (0, 6, 4),
    ]
    top = [(1, 5, 8), (5, 7, 8), (7, 3, 8), (3, 1, 8)]
    return messages.Mesh(name="shell", vertices=[*corners, (0.0, 0.0, 0.9 * half)], triangles=[*faces, *top])


def scene_of(*obstacles: messages.Obstacle, planes: Sequence[messages.GuidePlane] = ()) -> Scene:
    """A scene written in a test."""
    return build(messages.Scene(name="test", obstacles=list(obstacles), guide_planes=list(planes)))


def library_scene(name: str) -> Scene:
    """A packaged scene."""
    return build(scenes.read_packaged(name))


def problem(
    planned: PlanningGroup | str = "panda",
    scene: Scene | str = "bookshelf",
    goal: Goal | None = None,
    q_start: np.ndarray | None = None,
    planes: tuple | None = None,
    **options,
) -> Problem:
    """A problem with sensible parts for what isn't given."""
    planned = group(planned) if isinstance(planned, str) else planned
    scene = library_scene(scene) if isinstance(scene, str) else scene
    return Problem(
        group=planned,
        scene=scene,
        world=World.build(planned, scene),
        robot_field=RobotField(planned, scene, Precision.SINGLE),
        kinematics=Kinematics(planned),
        q_start=rest(planned) if q_start is None else q_start,
        goal=goal or LastPlaneGoal(),
        guide_planes=scene.guide_planes if planes is None else planes,
        **{"deadline": Deadline(), "observer": Listener(), **options},
    )


def seed_problem(title: str) -> Problem:
    """The problem of a request that ships as an example."""
    request = codec.decode_request(example(title))
    planned = group(request.robot)
    return problem(
        planned, request.scene, q_start=planned.part_of(configuration_from_wire(planned.robot, request.start))
    )


def to_configuration(z: Sequence[float], planned: PlanningGroup) -> ConfigurationGoal:
    """A goal by chart values."""
    return ConfigurationGoal((planned.from_chart(np.array(z, float)),))


def densely_free(made_for: Problem, path: np.ndarray, step: float = 2e-3) -> bool:
    """Whether no sample of a polyline in the chart collides, by Pinocchio's own test of all pairs."""
    for a, b in pairwise(path):
        for t in np.linspace(0.0, 1.0, 1 + int(np.ceil(np.abs(b - a).max() / step))):
            if contacts_at(made_for.world, made_for.group.expand_from_chart(a + t * (b - a))):
                return False
    return True
