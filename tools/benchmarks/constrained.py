"""Plans within random path constraints: how many are found, how long that takes, and how long the motions are.

Usage: tools/bench constrained [--robots panda,ur5,kinova,FILE.urdf] [--problems N] [--seconds S]

Each problem has two random configurations that keep a cone, a plane, a line, or a cone and a plane, among random boxes.
Both ends are brought onto the constraint here, by Newton's method on Pinocchio's Jacobians, so that the problems are
the same whoever plans. *connect* is the time of the stage, *whole* that of the plan [ms]; *way* the length of the path
of the joints [rad or m], over the plans that were found. All times, and the time that a plan may take, are CPU times:
other work on the machine changes nothing. A robot's packages are looked for in the folder above that of its file.
"""

from __future__ import annotations

import argparse
import itertools
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

import guidefield
from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.collision.world import World
from guidefield.geometry.surfaces import se3
from guidefield.messages import codec, scene as messages
from guidefield.messages.conditions import RobotReference
from guidefield.robot.catalog import Catalog
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.group.path_constraints import Cone, ConstrainedFrames, PathConstraint, line, plane
from guidefield.robot.group.reduced_model import select
from guidefield.scene.scene import build

KINDS = ("cone", "plane", "line", "both")
BOXES = 5


def run(arguments: list[str]) -> None:
    """Plan for every robot and kind, and print a row for each."""
    parser = argparse.ArgumentParser(prog="tools/bench constrained")
    parser.add_argument("--robots", default="panda,ur5,kinova")
    parser.add_argument("--problems", type=int, default=15, help="of each kind, for each robot")
    parser.add_argument("--seconds", type=float, default=5.0, help="that a plan may take")
    asked = parser.parse_args(arguments)
    time.monotonic = time.perf_counter = time.process_time
    print(f"{'':22s}{'found':>10s}{'connect':>10s}{'95 %':>8s}{'whole':>8s}{'way':>8s}")
    for robot, kind in itertools.product(asked.robots.split(","), KINDS):
        asked_for = problems(robot, kind, asked.problems, asked.seconds)
        replies = [guidefield.answer(codec.decode_request(one)) for one in asked_for]
        found = [reply for reply in replies if reply.status.name == "SUCCESS"]
        connect = 1e3 * np.array([reply.timing.connect for reply in replies])
        whole = 1e3 * np.median([reply.timing.total for reply in replies])
        ways = [reply.metrics.joint_path_length for reply in found]
        print(
            f"{Path(robot).stem:12s}{kind:10s}{len(found):4d} of {len(replies):2d}{np.median(connect):10.1f}"
            f"{np.percentile(connect, 95):8.0f}{whole:8.0f}{np.mean(ways) if ways else np.nan:8.2f}",
            flush=True,
        )


def problems(name: str, kind: str, count: int, seconds: float) -> list[dict[str, Any]]:
    """Requests about one robot and kind of constraint."""
    sent_robot = name if Path(name).suffix == "" else _file(Path(name))
    robot = Catalog().load(msgspec.convert(sent_robot, RobotReference))
    group = select(robot, None, None, robot.rest, se3((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
    rng = np.random.default_rng([KINDS.index(kind), 7])
    made: list[dict[str, Any]] = []
    while len(made) < count:
        boxes = [_box(rng, number) for number in range(BOXES)]
        scene = messages.Scene(name="boxes", obstacles=list(boxes))
        lanes = BatchCollision.build(World.build(group, build(scene)))
        first = group.chart(group.random(rng))
        values, sent = _constraints(rng, kind, group, first)
        frames = ConstrainedFrames(group, values)
        ends = [_brought(frames, z) for z in (first, *(group.chart(group.random(rng)) for _ in range(20)))]
        free = [z for z in ends if z is not None and not lanes.touching(z[None], 0.005)[0]]
        if len(free) < 2:
            continue
        start, goal = (dict(zip(group.position_names, group.wire_positions(z), strict=True)) for z in free[:2])
        made.append(
            {
                "robot": sent_robot,
                "scene": msgspec.to_builtins(scene),
                "start": start,
                "goal": {"type": "joints", "positions": goal},
                "guide_planes": [],
                "path_constraints": sent,
                "allowed_planning_time": seconds,
                "recording": "off",
            }
        )
    return made


def _file(path: Path) -> dict[str, Any]:
    srdf = path.with_suffix(".srdf")
    return {
        "type": "urdf_file",
        "path": str(path),
        "srdf_path": str(srdf) if srdf.exists() else None,
        "package_dirs": [str(path.parent.parent)],
    }


def _box(rng: np.random.Generator, number: int) -> messages.Box:
    angle, away, height = rng.uniform(-np.pi, np.pi), rng.uniform(0.45, 0.9), rng.uniform(0.0, 1.2)
    position = tuple(np.array([away * np.cos(angle), away * np.sin(angle), height]).tolist())
    return messages.Box(name=f"box {number}", size=tuple(rng.uniform(0.05, 0.25, 3).tolist()), position=position)


def _constraints(
    rng: np.random.Generator, kind: str, group: PlanningGroup, z: np.ndarray
) -> tuple[tuple[PathConstraint, ...], list[dict[str, Any]]]:
    """Constraints that a configuration keeps, as values and as they are sent."""
    placed = Kinematics(group).frame_placement(group.expand_from_chart(z), group.tip_id)
    point = placed.translation.tolist()
    values: list[PathConstraint] = []
    sent: list[dict[str, Any]] = []
    if kind in ("cone", "both"):
        axis = np.eye(3)[rng.integers(3)]
        target, limit = placed.rotation @ axis, rng.uniform(0.15, 0.5)
        values.append(Cone(group.tip, axis, target, limit))
        sent.append(
            {"type": "orientation_cone", "axis": axis.tolist(), "target_axis": target.tolist(), "half_angle": limit}
        )
    if kind in ("plane", "both"):
        normal, tolerance = _unit(rng), rng.uniform(0.01, 0.05)
        values.append(plane(group.tip, placed.translation, normal, tolerance))
        sent.append({"type": "plane", "normal": normal.tolist(), "point": point, "tolerance": tolerance})
    if kind == "line":
        direction, tolerance = _unit(rng), rng.uniform(0.02, 0.06)
        values.append(line(group.tip, placed.translation, direction, tolerance))
        sent.append({"type": "line", "direction": direction.tolist(), "point": point, "tolerance": tolerance})
    for one in sent:
        one["frame"] = group.tip
    return tuple(values), sent


def _unit(rng: np.random.Generator) -> np.ndarray:
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def _brought(frames: ConstrainedFrames, z: np.ndarray) -> np.ndarray | None:
    """The configuration near another one that keeps constraints with half of their room."""
    group, aim = frames.group, 0.5 * frames.limits
    for _ in range(30):
        values, rows = frames.values_and_rows(z)
        excess = values - aim
        if (excess <= 1e-9).all():
            return z
        much = excess > 0.0
        z = np.clip(z - np.linalg.lstsq(rows[much], excess[much], rcond=None)[0], group.lower, group.upper)
    return None
