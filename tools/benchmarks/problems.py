"""What the benchmarks share: the public problems, as planning groups, scenes and chart points.

A folder holds `problems/<robot>.json.gz`, `robots/<robot>/<robot>.urdf` and, if rows of other planners are wanted,
`peers.json.gz`; service/docs/benchmarks.md says how the first two are written.
"""

from __future__ import annotations

import gzip
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.collision.world import World
from guidefield.messages import scene as messages
from guidefield.messages.requests import UrdfFile
from guidefield.planner.task.problem import Goal, Problem
from guidefield.potential import Precision, RobotField
from guidefield.robot.catalog import Catalog
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.group.reduced_model import select
from guidefield.scene.scene import Scene, build

ROBOTS = ("panda", "ur5", "fetch", "baxter")


@dataclass(frozen=True, eq=False)
class Problems:
    """The valid problems of a robot.

    Attributes:
        folder: Where they come from.
        robot: Its name.
        group: The joints that are planned for.
        names: Their names in the order of the problems' values.
        problems: As they are declared.
    """

    folder: Path
    robot: str
    group: PlanningGroup
    names: list[str]
    problems: list[dict[str, Any]]

    @classmethod
    def load(cls, folder: Path, robot: str, every: int = 1) -> Problems:
        """Every n-th of a robot's problems."""
        with gzip.open(folder / "problems" / f"{robot}.json.gz") as file:
            declared = json.load(file)
        path = folder / "robots" / robot / robot
        model = Catalog().load(
            UrdfFile(path=f"{path}.urdf", srdf_path=f"{path}.srdf", package_dirs=[str(folder / "robots")])
        )
        rest = model.rest.copy()
        for name, value in declared["other_joints"].items():
            joint = model.joint(name)
            if joint is not None and joint.nq == 1:
                rest[joint.idx_q] = value
        group = select(model, declared["joint_names"], None, rest, pin.SE3.Identity())
        valid = [problem for problem in declared["problems"] if problem["valid"]]
        return cls(folder, robot, group, declared["joint_names"], valid[::every])

    def ends(self, problem: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
        """Chart points (nv,) of start and goal."""
        start, goal = (self._chart(values) for values in (problem["start"], problem["goals"][0]))
        return start, goal

    def _chart(self, values: list[float]) -> np.ndarray:
        by_name = dict(zip(self.names, values, strict=True))
        # a few values of the problems lie some micrometres or microradians beyond the limits
        ordered = [by_name[joint.name] for joint in self.group.joints]
        clipped: np.ndarray = np.clip(ordered, self.group.lower, self.group.upper)
        return clipped

    def peers_rows(self, planner: str = "vamp rrtc") -> dict[tuple[str, int], dict[str, Any]]:
        """A planner's rows in the folder by problem set and index; none without its file."""
        path = self.folder / "peers.json.gz"
        if not path.exists():
            return {}
        with gzip.open(path) as file:
            rows = json.load(file)["rows"]
        return {
            (row["set"], row["index"]): row for row in rows if row["planner"] == planner and row["robot"] == self.robot
        }


def scene_message(problem: dict[str, Any]) -> messages.Scene:
    """The obstacles of a problem in the wire's words."""
    obstacles: list[messages.Obstacle] = []
    for declared in problem["obstacles"]:
        name, position = declared["name"], tuple(declared["position"])
        turn = np.array(declared["quaternion_xyzw"])
        turn /= np.linalg.norm(turn)
        placement = {
            "name": name,
            "position": position,
            "quaternion_xyzw": tuple(turn.tolist()),
        }
        match declared["type"]:
            case "box":
                obstacles.append(messages.Box(size=tuple(declared["size"]), **placement))
            case "cylinder":
                obstacles.append(messages.Cylinder(radius=declared["radius"], length=declared["height"], **placement))
            case "sphere":
                obstacles.append(messages.Sphere(name=name, radius=declared["radius"], position=position))
    return messages.Scene(name="problem", obstacles=obstacles)


def scene_of(problem: dict[str, Any]) -> Scene:
    """The obstacles of a problem."""
    return build(scene_message(problem))


def posed(group: PlanningGroup, scene: Scene, q_start: np.ndarray, goal: Goal, **rest: Any) -> Problem:
    """A problem, the tables of its world made anew; `rest` is what else `Problem` takes."""
    return Problem(
        group=group,
        scene=scene,
        world=World.build(group, scene),
        robot_field=RobotField(group, scene, Precision.SINGLE),
        kinematics=Kinematics(group),
        q_start=q_start,
        goal=goal,
        **rest,
    )
