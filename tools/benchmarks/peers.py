"""Other planners on the same problems, in the same run: OMPL and roboplan (`pip install -e .[bench]`).

OMPL has no robot: its checker is our exact world, through Pinocchio and Coal. roboplan reads the URDF itself. Each
plans with its RRT-Connect, checks motions every `STEP`, and shortens what it found with its own simplifier.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.problems import Problems, scene_of
from guidefield.collision.world import World

STEP = 0.05
"""Longest step between two checks of a motion [rad or m]."""

RANGE = 1.0
"""Longest extension of a tree [rad or m]."""

SEED = 0


@dataclass(frozen=True, eq=False)
class Task:
    """One problem.

    Attributes:
        robot: `<robot>.urdf` and `<robot>.srdf` without their suffix.
        packages: Where `package://` leads.
        world: The robot among the obstacles; each joint has one value.
        obstacles: The same obstacles as the problems' file has them.
        start, goal: Values of the group's joints, in its order.
        seconds: What planning may take.
    """

    robot: Path
    packages: Path
    world: World
    obstacles: Sequence[dict[str, Any]]
    start: np.ndarray
    goal: np.ndarray
    seconds: float


@dataclass(frozen=True, eq=False)
class Answer:
    """A planner's result.

    Attributes:
        path: Values of the group's joints (n, nv), simplified; None if it found none.
        scene, plan, simplify: CPU time of each step [us].
        fault: Why it could not even begin; empty where it did.
    """

    path: np.ndarray | None
    scene: float
    plan: float
    simplify: float
    fault: str = ""


def task_of(given: Problems, declared: dict[str, Any], seconds: float) -> Task:
    """A public problem as a task for planners."""
    world = World.build(given.group, scene_of(declared))
    return Task(
        given.description, given.folder / "robots", world, declared["obstacles"], *given.ends(declared), seconds
    )


class _Clock:
    """CPU time of this thread since it was last asked [us]."""

    def __init__(self) -> None:
        self._last = time.thread_time()

    def __call__(self) -> float:
        before, self._last = self._last, time.thread_time()
        return 1e6 * (self._last - before)


def list_installed() -> dict[str, Callable[[Task], Answer]]:
    """The planners that are installed, by name."""
    return {name: solve for name, solve in SOLVERS.items() if importlib.util.find_spec(name) is not None}


def ompl(task: Task) -> Answer:
    """RRT-Connect and `PathSimplifier.simplifyMax`, the validity of states through our exact world."""
    from ompl import base, geometric, util

    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(SEED + 1)
    group, clock = task.world.group, _Clock()
    space = base.RealVectorStateSpace(group.nv)
    bounds = base.RealVectorBounds(group.nv)
    for j in range(group.nv):
        bounds.setLow(j, float(group.lower[j]))
        bounds.setHigh(j, float(group.upper[j]))
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)

    def free(state: Any) -> bool:
        return not task.world.in_collision(group.expand_from_local(np.array([state[j] for j in range(group.nv)])))

    def state(values: np.ndarray) -> Any:
        made = space.allocState()
        for j, value in enumerate(values):
            made[j] = float(value)
        return made

    information = setup.getSpaceInformation()
    setup.setStateValidityChecker(free)
    information.setStateValidityCheckingResolution(STEP / space.getMaximumExtent())
    planner = geometric.RRTConnect(information)
    planner.setRange(RANGE)
    setup.setPlanner(planner)
    setup.setStartAndGoalStates(state(task.start), state(task.goal))
    setup.setup()
    scene = clock()
    setup.solve(task.seconds)
    plan = clock()
    if not setup.haveExactSolutionPath():
        return Answer(None, scene, plan, 0.0)
    path = setup.getSolutionPath()
    geometric.PathSimplifier(information).simplifyMax(path)
    simplify = clock()
    return Answer(np.array([[s[j] for j in range(group.nv)] for s in path.getStates()]), scene, plan, simplify)


def roboplan(task: Task) -> Answer:
    """RRT-Connect and `PathShortcutter`, in C++ on a scene of its own."""
    from roboplan import core, rrt

    group, clock = task.world.group, _Clock()
    names = [joint.name for joint in group.joints]
    description = core.loadUrdfSceneDescription(f"{task.robot}.urdf", [str(task.packages)])
    try:
        scene = core.Scene("problem", description)
    except RuntimeError as error:  # it refuses some models: Baxter's, for frames of one name
        return Answer(None, clock(), 0.0, 0.0, str(error))
    scene.importSrdf(Path(f"{task.robot}.srdf").read_text())
    scene.addGroup("planned", names)
    _add_obstacles(scene, task)
    scene.setRngSeed(SEED)
    options = rrt.RRTOptions(
        group_name="planned",
        max_nodes=1_000_000,
        max_connection_distance=RANGE,
        collision_check_step_size=STEP,
        max_planning_time=task.seconds,
        rrt_connect=True,
    )
    planner = rrt.RRT(scene, options)
    planner.setRngSeed(SEED)
    built = clock()
    try:
        path = planner.plan(core.JointConfiguration(names, task.start), core.JointConfiguration(names, task.goal))
    except RuntimeError:  # how it says that it found none
        return Answer(None, built, clock(), 0.0)
    plan = clock()
    shortcutting = core.PathShortcuttingOptions(group_name="planned", max_step_size=STEP, seed=SEED)
    short = core.PathShortcutter(scene, shortcutting).shortcut(path)
    simplify = clock()
    columns = [list(short.joint_names).index(name) for name in names]
    return Answer(np.array(short.positions)[:, columns], built, plan, simplify)


def _add_obstacles(scene: Any, task: Task) -> None:
    """Add the obstacles; they are not judged against one another nor, as in our world, against links that stand."""
    from roboplan import core

    robot = task.world.group
    colour = np.array([0.5, 0.5, 0.5, 1.0])
    makers = {
        "box": lambda one: (scene.addBoxGeometry, core.Box(*one["size"])),
        "cylinder": lambda one: (scene.addCylinderGeometry, core.Cylinder(one["radius"], one["height"])),
        "sphere": lambda one: (scene.addSphereGeometry, core.Sphere(one["radius"])),
    }
    placed: list[str] = []
    for index, one in enumerate(task.obstacles):
        name = f"obstacle {index}"
        x, y, z, w = one["quaternion_xyzw"]
        placement = pin.SE3(pin.Quaternion(w, x, y, z).normalized(), np.array(one["position"]))
        add, shape = makers[one["type"]](one)
        add(name, "universe", shape, np.asfortranarray(placement.homogeneous), colour)
        placed.append(name)
    standing = {
        robot.robot.link_of_geometry(index)
        for index, shape in enumerate(robot.geometry.geometryObjects)
        if shape.parentJoint == 0
    }
    apart = [(a, b) for i, a in enumerate(placed) for b in [*placed[:i], *sorted(standing)]]
    if apart:
        scene.setCollisions(apart, False)


SOLVERS: dict[str, Callable[[Task], Answer]] = {"ompl": ompl, "roboplan": roboplan}
"""By the name of their package."""
