"""Prepare a robot and a scene for their first plan: each part is stored, and the next request continues from it.

Of a robot: bounding spheres, convex parts, trees of meshes, points on links. That takes about a second for an arm whose
links are meshes, some seconds for a humanoid. Results are kept on disk (`geometry/cache.py`), so that a preparation
that was stopped goes on where it was, in whatever process. What a stopped preparation lacks is made within the
plan's own time; until then robots' replies lack spheres and parts, recordings spheres. `keep` must follow all tasks of
its search: shapes without a result then count as having none. Also crop a scene to the robot's reach.
"""

from __future__ import annotations

import dataclasses
import functools
import logging
import time
from collections.abc import Callable, Iterator
from itertools import chain
from typing import TypeVar

import coal

from guidefield.collision.batch.batch_collision import prepare_robot
from guidefield.collision.batch.scene_tables import batch_scene, prepare_scene
from guidefield.collision.bodies import reach_ball
from guidefield.collision.clearance import find_closed_bodies
from guidefield.collision.obstacle_boxes import obstacle_boxes
from guidefield.collision.part_tables import recall_mesh_tree, robot_parts
from guidefield.collision.solids import hulls_of
from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.geometry.solid import clear_solids
from guidefield.memo import MemoSet
from guidefield.messages.requests import GuidePlaneGoal, PlanRequest
from guidefield.parallel import run_parallel
from guidefield.planner.task.problem import Conditions, Problem
from guidefield.prove.tables import prepare_obstacles
from guidefield.robot.link_bounds import COVERS, DELTA, MOST_PARTS, PARTS, ShapeTask, find_in_parallel
from guidefield.robot.link_charges import link_bodies, surface_samples
from guidefield.robot.model.model import RobotModel
from guidefield.scene.crop import crop, has_large, has_many
from guidefield.scene.distance_tables import distance_tables
from guidefield.scene.obstacle_message import are_many
from guidefield.scene.scene import Scene, unplaced

_log = logging.getLogger(__name__)

Announce = Callable[[str], None]  # receives before each task what is prepared: ``covering link2, shape 3 of 8``

LONG = 1.0  # a preparation of a robot that takes longer is worth a line in the log [s]
# triangles and points, of resting meshes and clouds too; where any obstacle moves, a scene of fewer is laid out at a
# time within some milliseconds
MANY_HELD = 10_000

AnyConditions = TypeVar("AnyConditions", bound=Conditions)


def is_prepared(robot: RobotModel) -> bool:
    """Return whether `prepare` came to its end for a robot in this process."""
    return robot in _prepared_robots


def prepare(robot: RobotModel, deadline: Deadline = UNLIMITED, announce: Announce = lambda _: None) -> None:
    """Compute all that is missing; `announce` is called before each task, by one thread at a time.

    Raises DeadlineExpired if time was up; what is found by then is kept.
    """
    if is_prepared(robot):
        return
    began = time.monotonic()

    def progress(task: ShapeTask) -> None:
        deadline.check(task.description)
        announce(task.description)

    covers, parts = COVERS.search(robot, DELTA), PARTS.search(robot, MOST_PARTS)
    # the cover and the parts of a mesh one after the other, from the same solid
    unfound = sorted([*covers.tasks, *parts.tasks], key=lambda task: -task.extent)
    find_in_parallel(unfound, progress)
    clear_solids()
    covers.keep()
    parts.keep()
    whole = {"laying out the surfaces of": link_bodies, "spreading points on": surface_samples}
    on_links = [
        ShapeTask(f"{doing} {robot.name}", 0.0, functools.partial(find, robot)) for doing, find in whole.items()
    ]
    # if no cover or part was missing, these are probably on disk, and one thread reads them sooner than kernels load
    find_in_parallel([*_surfaces(robot), *on_links], progress, None if unfound else 1)
    hulls_of(robot)
    _prepared_robots.add(robot)
    if time.monotonic() - began > LONG:
        _log.info("prepared robot %s in %.1f s", robot.name, time.monotonic() - began)


def _surfaces(robot: RobotModel) -> list[ShapeTask]:
    return [
        ShapeTask.of("laying out", robot, index, 0.0, functools.partial(recall_mesh_tree, shape.geometry))
        for index, shape in enumerate(robot.geometry.geometryObjects)
        if isinstance(shape.geometry, coal.BVHModelBase)
    ]


def prepare_plan(
    robot: RobotModel | None,
    scene: Scene,
    deadline: Deadline,
    announce: Announce = lambda _: None,
    *,
    field: bool = False,
) -> None:
    """Prepare a robot and a scene for a plan.

    Raises DeadlineExpired if the deadline passed before all is prepared.
    """
    if robot is not None and not is_prepared(robot):
        deadline.check("the meshes of the robot")
        prepare(robot, deadline, announce)
    if scene not in _prepared and unplaced(scene):
        for some in _find_scenes(scene):
            deadline.check(f"the obstacles of scene {scene.name}")
            _prepare_obstacles(some, deadline, announce)
    _prepared.add(scene)
    if field:
        prepare_field(scene, deadline)


def prepare_problem(request: PlanRequest, problem: Problem, announce: Announce) -> None:
    """Prepare the scene of a problem, and its robot if a plan certainly connects.

    Raises DeadlineExpired if the deadline passed before all is prepared.
    """
    if problem.scene.moves and not connects(request):
        return
    robot = problem.group.robot if connects(request) else None
    field = bool(problem.guide_planes) or request.guide_planes == "auto"
    prepare_plan(robot, problem.scene, problem.deadline, announce, field=field)
    if robot is not None:
        prepare_links(problem.world, problem.deadline)


def crop_to_reach(problem: AnyConditions, deadline: Deadline, *, limited: bool = True) -> AnyConditions:
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
    """Return whether a plan certainly needs a search in SIMD batches."""
    return not isinstance(request.goal, GuidePlaneGoal)


def _find_scenes(scene: Scene) -> Iterator[Scene]:
    yield scene
    if scene.moves and are_many([scene.message.obstacles[k] for k in scene.others], MANY_HELD):
        yield scene.resting
        for time in (0.0, scene.end):
            yield scene.at(time)


def _prepare_obstacles(scene: Scene, deadline: Deadline, announce: Announce) -> None:
    if scene.convex:
        prepare_scene(scene, deadline, announce)
        return
    run_parallel(lambda: distance_tables(scene), lambda: prepare_scene(scene, deadline, announce))
    for lay_out in (batch_scene, prepare_obstacles, obstacle_boxes):
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
_prepared_robots = MemoSet()
"""Robots that `prepare` has prepared in this process."""
_laid_out = MemoSet()
"""Robots whose links have their tables."""
