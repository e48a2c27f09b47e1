"""Prepare a robot and a scene for their first plan: each part is stored, and the next request continues from it.

Also crop a scene to the robot's reach. A part that is missing here is made later, within the plan's own time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from itertools import chain
from typing import TypeVar

from guidefield.collision.clearance import find_closed_bodies
from guidefield.collision.lanes.lanes import prepare_robot
from guidefield.collision.lanes.scene_tables import lane_scene, prepare_scene
from guidefield.collision.obstacle_boxes import obstacle_boxes
from guidefield.collision.part_tables import robot_parts
from guidefield.collision.preparation import Announce, is_prepared, prepare
from guidefield.collision.robot_ball import reach_ball
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.memo import MemoSet
from guidefield.messages.requests import GuidePlaneGoal, PlanRequest
from guidefield.parallel import run_parallel
from guidefield.planner.task.problem import Conditions, Problem
from guidefield.prove.tables import prepare_obstacles
from guidefield.robot.model.model import RobotModel
from guidefield.scene.content import are_many
from guidefield.scene.crop import crop, has_large, has_many
from guidefield.scene.distance_tables import distance_tables
from guidefield.scene.scene import Scene, unplaced

Asked = TypeVar("Asked", bound=Conditions)

# triangles and points, of resting meshes and clouds too; where any obstacle moves, a scene of fewer is laid out at a
# time within some milliseconds
MANY_HELD = 10_000


def prepare_plan(
    robot: RobotModel | None, scene: Scene, deadline: Deadline, told: Announce = lambda _: None, *, field: bool = False
) -> None:
    """Prepare a robot and a scene for a plan.

    Raises DeadlineExpired if the deadline passed before all is prepared.
    """
    if robot is not None and not is_prepared(robot):
        deadline.check("the meshes of the robot")
        prepare(robot, deadline, told)
    if scene not in _prepared and unplaced(scene):
        for some in _scenes_asked(scene):
            deadline.check(f"the obstacles of scene {scene.name}")
            _prepare_obstacles(some, deadline, told)
    _prepared.add(scene)
    if field:
        prepare_field(scene, deadline)


def prepare_problem(request: PlanRequest, problem: Problem, told: Announce) -> None:
    """Prepare the scene of a problem, and its robot if a plan certainly connects.

    Raises DeadlineExpired if the deadline passed before all is prepared.
    """
    if problem.scene.moves and not connects(request):
        return
    robot = problem.group.robot if connects(request) else None
    field = bool(problem.guide_planes) or request.guide_planes == "auto"
    prepare_plan(robot, problem.scene, problem.deadline, told, field=field)
    if robot is not None:
        prepare_links(problem.world, problem.deadline)


def crop_to_reach(problem: Asked, deadline: Deadline, *, limited: bool = True) -> Asked:
    """Crop the scene of a problem to the obstacles in its robot's reach: distances from the nearest ones are the same.

    Raises DeadlineExpired if time was up before.
    """
    scene, world = problem.scene, problem.world
    reach = reach_ball(problem.group, limited) if has_many(scene) or has_large(scene) else None
    if reach is None:
        return problem
    named = scene.names.intersection(chain.from_iterable(problem.allowed_collisions))
    cropped, chosen = crop(scene, reach, named, deadline)
    if cropped is scene:
        return problem
    pairs = world.pairs if chosen is None else world.pairs.among(chosen)
    return dataclasses.replace(problem, scene=cropped, world=World(problem.group, cropped, pairs, world.held_contacts))


def connects(request: PlanRequest) -> bool:
    """Return whether a plan certainly needs a connection by lanes."""
    return not isinstance(request.goal, GuidePlaneGoal)


def _scenes_asked(scene: Scene) -> Iterator[Scene]:
    yield scene
    if scene.moves and are_many([scene.message.obstacles[k] for k in scene.others], MANY_HELD):
        yield scene.resting
        for time in (0.0, scene.end):
            yield scene.at(time)


def _prepare_obstacles(scene: Scene, deadline: Deadline, told: Announce) -> None:
    if scene.convex:
        prepare_scene(scene, deadline, told)
        return
    run_parallel(lambda: distance_tables(scene), lambda: prepare_scene(scene, deadline, told))
    for lay_out in (lane_scene, prepare_obstacles, obstacle_boxes):
        deadline.check(f"the surfaces of scene {scene.name}")
        lay_out(scene)


def prepare_links(world: World, deadline: Deadline) -> None:
    """Make the tables of a robot's links, unless they are there.

    Raises DeadlineExpired if the deadline passed before.
    """
    robot = world.group.robot
    if is_laid_out(robot):
        return
    deadline.check(f"the links of {robot.name} were laid out")
    prepare_robot(world)
    find_closed_bodies(world.group)
    robot_parts(world.group)
    _laid_out.add(robot)


def is_laid_out(robot: RobotModel) -> bool:
    """Return whether the tables of a robot's links were made in this process."""
    return robot in _laid_out


def prepare_field(scene: Scene, deadline: Deadline) -> None:
    """Make the field of a scene, unless it is there; raises DeadlineExpired if the deadline passed before."""
    if "tables" not in vars(scene):
        deadline.check(f"the field of scene {scene.name}")
        _ = scene.tables


_prepared = MemoSet()
"""Scenes that `prepare_plan` has prepared in this process."""
_laid_out = MemoSet()
"""Robots whose links have their tables."""
