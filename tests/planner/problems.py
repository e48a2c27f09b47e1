"""Planning problems for the tests, and walls and posts that a path goes close by."""

import functools
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from guidefield.collision.clearance import clearance_at, contacts_at
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.messages import codec, scene as messages
from guidefield.planner.connect import connect
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
    """A goal by local coordinates."""
    return ConfigurationGoal((planned.from_local(np.array(z, float)),))


def densely_free(made_for: Problem, path: np.ndarray, step: float = 2e-3) -> bool:
    """Whether no sample of a polyline in local coordinates collides, by Pinocchio's own test of all pairs."""
    for a, b in pairwise(path):
        for t in np.linspace(0.0, 1.0, 1 + int(np.ceil(np.abs(b - a).max() / step))):
            if contacts_at(made_for.world, made_for.group.expand_from_local(a + t * (b - a))):
                return False
    return True


@functools.cache
def over_the_wall() -> tuple[Problem, np.ndarray]:
    """A Panda, a wall between start and goal, and a path over it that was found by the tree: it grazes the wall."""
    wall = messages.Box(name="wall", size=(0.5, 0.04, 0.7), position=(0.55, 0.0, 0.35))
    made = problem("panda", scene_of(wall), planes=())
    start, goal = made.group.to_local(rest(made.group)), made.group.to_local(rest(made.group))
    start[0], goal[0] = 0.9, -0.9
    start[1] = goal[1] = 0.3
    rng = np.random.default_rng(1)
    path = connect(made, start, goal[None], rng).path
    path.setflags(write=False)
    return made, path


def resampled(path: np.ndarray, step: float = 0.03) -> np.ndarray:
    """A path with a point every so much of its length."""
    lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]
    places = np.linspace(0.0, lengths[-1], int(np.ceil(lengths[-1] / step)) + 1)
    return np.column_stack([np.interp(places, lengths, column) for column in path.T])


def smallest_clearance(made: Problem, path: np.ndarray, ends: float = 0.0) -> float:
    """Exact smallest distance to obstacles along a polyline, some of it left out at both ends."""
    points = resampled(path)
    step = np.linalg.norm(points[1] - points[0])
    skip = int(np.ceil(ends / step))
    inner = points[skip : len(points) - skip]
    return min(clearance_at(made.world, made.group.expand_from_local(z)).obstacle_distance for z in inner)


def beside_the_path(planned: PlanningGroup, path: np.ndarray) -> Problem:
    """A post that the straight motion just misses, and that both ends are far from."""
    middle = problem(planned, scene_of(), planes=()).kinematics.tip_position(
        planned.expand_from_local(path.mean(axis=0))
    )
    rng = np.random.default_rng(0)
    for _ in range(1000):
        place = middle + 0.15 * rng.normal(size=3)
        post = messages.Sphere(name="post", radius=0.03, position=tuple(place.tolist()))
        made = problem(planned, scene_of(post), planes=())
        ends = [clearance_at(made.world, planned.expand_from_local(z)).obstacle_distance for z in path]
        if min(ends) > 0.06 and 0.003 < smallest_clearance(made, path) < 0.02:
            return made
    raise AssertionError("no place for a post")
