"""The public problems that benchmarks share, as planning groups, scenes, configurations and requests.

A folder holds `problems/<robot>.json.gz`, `robots/<robot>/<robot>.urdf` and, if rows of other planners are wanted,
`peers.json.gz`; service/docs/benchmarks.md says how the first two are written.
"""

from __future__ import annotations

import argparse
import gzip
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin

from guidefield.messages import scene as messages
from guidefield.messages.requests import PlanRequest, UrdfFile
from guidefield.messages.values import JointsGoal, PoseGoal
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
        model = Catalog().load(_reference(folder, robot))
        rest = model.rest.copy()
        for name, value in declared["other_joints"].items():
            joint = model.joint(name)
            if joint is not None and joint.nq == 1:
                rest[joint.idx_q] = value
        group = select(model, declared["joint_names"], None, rest, pin.SE3.Identity())
        valid = [problem for problem in declared["problems"] if problem["valid"]]
        return cls(folder, robot, group, declared["joint_names"], valid[::every])

    @property
    def description(self) -> Path:
        """The robot's URDF and SRDF without their suffix."""
        return self.folder / "robots" / self.robot / self.robot

    @property
    def reference(self) -> UrdfFile:
        """The robot as a request names it."""
        return _reference(self.folder, self.robot)

    @property
    def standing(self) -> dict[str, float]:
        """Values of all joints of one coordinate that follow none, where no problem moves them."""
        robot = self.group.robot
        return {one.name: float(robot.rest[one.idx_q]) for one in robot.joints if one.nq == 1 and one.mimic is None}

    def ends(self, problem: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
        """Local coordinates (nv,) of start and goal."""
        start, goal = (self._local(values) for values in (problem["start"], problem["goals"][0]))
        return start, goal

    def _local(self, values: list[float]) -> np.ndarray:
        by_name = dict(zip(self.names, values, strict=True))
        # a few values of the problems lie some micrometres or microradians beyond the limits
        ordered = [by_name[joint.name] for joint in self.group.joints]
        return np.clip(ordered, self.group.lower, self.group.upper)

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


def _reference(folder: Path, robot: str) -> UrdfFile:
    path = folder / "robots" / robot / robot
    return UrdfFile(path=f"{path}.urdf", srdf_path=f"{path}.srdf", package_dirs=[str(folder / "robots")])


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


def public_requests(given: Problems) -> tuple[list[PlanRequest], list[PlanRequest]]:
    """Requests for a robot's public problems, named by set and index: with joint goals, and with the tip's poses."""
    group = given.group
    joints, poses = [], []
    for problem in given.problems:
        start, goal = (dict(zip((j.name for j in group.joints), z.tolist(), strict=True)) for z in given.ends(problem))
        request = PlanRequest(
            given.reference,
            scene_message(problem),
            JointsGoal(goal),
            run_id=f"{problem['set']}_{problem['index']}",
            group=given.names,
            start=given.standing | start,
            guide_planes=[],
            recording="off",
        )
        joints.append(request)
        pose = Kinematics(group).frame_placement(group.expand_from_local(given.ends(problem)[1]), group.tip_id)
        turn = pin.Quaternion(pose.rotation).coeffs().tolist()
        goal_pose = PoseGoal(position=tuple(pose.translation.tolist()), quaternion_xyzw=tuple(turn))
        poses.append(msgspec.structs.replace(request, goal=goal_pose))
    return joints, poses


def problems_parser(
    name: str, doc: str, every: int = 1, robots: Sequence[str] = ROBOTS, nargs: str | None = None
) -> argparse.ArgumentParser:
    """The parser of a benchmark over the public problems, with what all of them take."""
    parser = argparse.ArgumentParser(prog=f"tools/bench {name}", description=doc.partition("\n")[0])
    parser.add_argument("folder", type=Path, nargs=nargs, help="the folder that `guidefield docs benchmarks` describes")
    parser.add_argument("--robots", default=",".join(robots), help="which, between commas")
    parser.add_argument("--every", type=int, default=every, help="take every n-th problem only")
    return parser


def print_times(title: str, times: Sequence[float]) -> None:
    """Print median, mean and 95th percentile of what is a number."""
    known = [value for value in times if np.isfinite(value)]
    if known:
        print(f"{title}: median {np.median(known):.4g}, mean {np.mean(known):.4g}, p95 {np.quantile(known, 0.95):.4g}")
