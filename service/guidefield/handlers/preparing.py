"""What the first use of a robot or scene needs is found before anything is asked of it, while there is time.

It is some long calls into libraries: they are made aside, so that the answer comes in time whatever they take.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator

from guidefield.aside import Spent, StoppedError, done_aside, together, wait_for_others
from guidefield.collision.enclosure import closed_bodies
from guidefield.collision.lanes.lanes import prepare_robot
from guidefield.collision.lanes.scene_tables import lane_scene, prepare_scene
from guidefield.collision.minimum.tables import prepare_obstacles, robot_parts
from guidefield.collision.obstacle_boxes import obstacle_boxes
from guidefield.collision.preparation import Told, is_prepared, prepare
from guidefield.collision.world import World
from guidefield.robot.model.model import RobotModel
from guidefield.scene.distance_tables import distance_tables
from guidefield.scene.placed import unplaced
from guidefield.scene.points import are_many
from guidefield.scene.scene import Scene

MANY_HELD = 10_000
"""Obstacles that move, of fewer triangles and points, are held somewhere within some milliseconds."""


def prepare_in_time(
    robot: RobotModel | None, scene: Scene, spent: Spent, told: Told = lambda _: None, *, field: bool = False
) -> None:
    """Prepare a robot and a scene for a plan.

    Args:
        robot: The robot; None where it needn't connect anything.
        scene: The scene.
        spent: Whether time is up.
        told: Told what is prepared.
        field: Whether the scene's field is needed too.

    Raises:
        StoppedError: if time was up; its text says before what.
    """
    known = (scene in _prepared or not unplaced(scene)) and (not field or "tables" in vars(scene))
    if known and (robot is None or is_prepared(robot)):
        wait_for_others(spent)
        return
    at = [f"the obstacles of scene {scene.name}" if robot is None or is_prepared(robot) else "the meshes of the robot"]

    def doing(what: str) -> None:
        at[0] = what
        told(what)

    def work() -> None:
        if robot is not None:
            prepare(robot, spent, doing)
        for some in _as_asked(scene):
            at[0] = f"the obstacles of scene {scene.name}"
            _prepare_obstacles(some, spent, doing, at)
        if field:
            at[0] = f"the field of scene {scene.name}"
            _ = scene.tables

    done_aside(work, spent, lambda: at[0])
    _prepared.add(scene)


def _as_asked(scene: Scene) -> Iterator[Scene]:
    """A scene as a plan asks about it: among obstacles of many triangles or points that move, with these held too."""
    yield scene
    if scene.moves and are_many([scene.message.obstacles[k] for k in scene.others], MANY_HELD):
        yield scene.resting
        for time in (0.0, scene.end):
            yield scene.at(time)


def _prepare_obstacles(scene: Scene, spent: Spent, told: Told, at: list[str]) -> None:
    if scene.convex:
        prepare_scene(scene, spent, told)
        return
    together(lambda: distance_tables(scene), lambda: prepare_scene(scene, spent, told))
    if spent():
        raise StoppedError(at[0])
    at[0] = f"the surfaces of scene {scene.name}"
    lane_scene(scene)
    prepare_obstacles(scene)
    obstacle_boxes(scene)


def lay_out_in_time(world: World, spent: Spent) -> None:
    """Make what the first plan of a robot needs beside what prepares it: tables of its links.

    Raises:
        StoppedError: if time was up before.
    """
    robot = world.group.robot
    if not is_laid_out(robot):
        done_aside(lambda: lay_out(world), spent, lambda: f"the links of {robot.name} were laid out")


def lay_out(world: World) -> None:
    """Make the tables of a robot's links; see `lay_out_in_time`."""
    prepare_robot(world)
    closed_bodies(world.group)
    robot_parts(world.group)
    _laid_out.add(world.group.robot)


def is_laid_out(robot: RobotModel) -> bool:
    """Whether the tables of a robot's links were made in this process."""
    return robot in _laid_out


def field_in_time(scene: Scene, spent: Spent) -> None:
    """Make the field of a scene.

    Raises:
        StoppedError: if time was up before.
    """
    if "tables" not in vars(scene):
        done_aside(lambda: scene.tables, spent, lambda: f"the field of scene {scene.name}")


_prepared: weakref.WeakSet[Scene] = weakref.WeakSet()

_laid_out: weakref.WeakSet[RobotModel] = weakref.WeakSet()
