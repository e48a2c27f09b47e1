"""The same problems said otherwise: larger, smaller, as meshes, far away, turned, in another order, with other words.

Usage: tools/bench otherwise <folder> [--robots panda,fetch] [--count N] [--repeats N] [--only ROW ...]

The folder is described in problems.py. Each of N public problems of a robot is answered as it is, and as each row says
it; answers are compared one by one. *certified* counts those that succeed, as it is and otherwise; *as found* those
whose optimised motion was not certified. Durations and times are ratios: the geometric mean, and in brackets the
largest; times are the processor's, the best of some repetitions, of robots and scenes that were seen before. Clearance
is the mean of the smallest distance over the size, as a share of the same as it is; in brackets of its inner part. Rows
that make a robot anew cover its links first; dense meshes take minutes, and are made where they are named.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin
from lxml import etree

from benchmarks.one.dense import write_dense_copy
from benchmarks.whole import public_requests
from doubting.sized import scale_lengths
from guidefield import Box, Cylinder, JointsGoal, Mesh, PlanReply, PlanRequest, Scene, Sphere, UrdfFile, answer
from guidefield.geometry import surfaces
from guidefield.messages.values import Placement

Change = Callable[[PlanRequest], PlanRequest]

SIZES = (0.01, 0.02, 0.1, 0.2, 0.35, 0.5, 3.0, 5.0, 10.0, 30.0, 100.0)
FAR = {"1 km": (1e3, 0.0, 0.0), "100 km": (6e4, 8e4, 0.0), "4,000 km": (5e5, 4e6, 0.0)}
"""Distances from the origin [m]; the last is that of coordinates of a map (UTM)."""

ON_DEMAND = ("dense",)
"""Rows that are made only where they are named."""


@dataclass(frozen=True)
class Said:
    """One answer: status, time [s], duration [s], smallest distances over the size; whether it is as it was found."""

    status: str
    seconds: float
    duration: float = math.nan
    clearance: float = math.nan
    inner: float = math.nan
    as_found: bool = False


def run(arguments: list[str]) -> None:
    """Print a table for each robot."""
    parser = argparse.ArgumentParser(prog="tools/bench otherwise", description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="the folder that `guidefield docs benchmarks` describes")
    parser.add_argument("--robots", default="panda,fetch", help="which, between commas")
    parser.add_argument("--count", type=int, default=14, help="how many problems of each, evenly chosen")
    parser.add_argument("--repeats", type=int, default=3, help="how often each is answered; the best counts")
    parser.add_argument("--only", nargs="*", default=[], help="the rows, or the first words of their names")
    asked = parser.parse_args(arguments)
    for robot in asked.robots.split(","):
        every = public_requests(asked.folder, robot, 1)[0]
        chosen = [every[i * len(every) // asked.count] for i in range(asked.count)]
        requests = [msgspec.structs.replace(request, run_id=None) for request in chosen]
        print(f"\n{robot}, {len(requests)} problems\n{'':>16} certified  as found  duration     time         clearance")
        with tempfile.TemporaryDirectory(prefix="guidefield-bench-") as scratch:
            changes = rows(requests[0], Path(scratch))
            as_it_is = None
            for name, (change, size) in changes.items():
                wanted = (
                    name not in ON_DEMAND
                    if not asked.only
                    else any(f"{name} ".startswith(f"{one} ") for one in asked.only)
                )
                if wanted or as_it_is is None:
                    try:
                        said = [_answered(change(request), size, asked.repeats) for request in requests]
                    except Exception as error:
                        print(f"{name:>16} {type(error).__name__}: {error}", flush=True)
                        continue
                    as_it_is = as_it_is or said
                    print(f"{name:>16} {_compared(as_it_is, said)}", flush=True)


def rows(request: PlanRequest, folder: Path) -> dict[str, tuple[Change, float]]:
    """How each row changes a request about the robot of one, and how large everything is then."""
    robot = request.robot
    assert isinstance(robot, UrdfFile), "public problems are of robots in files"
    changed: dict[str, tuple[Change, float]] = {"as it is": (lambda one: one, 1.0)}
    for size in SIZES:
        changed[f"{size:g} times"] = (lambda one, size=size: scaled(one, size, folder), size)
    same: dict[str, Change] = {
        "boxes as meshes": _of_obstacles(lambda each: [as_mesh(one) for one in each]),
        "one mesh": _of_obstacles(_in_one_mesh),
        "dense": lambda one: msgspec.structs.replace(one, robot=_dense(robot, folder)),
        **{f"{name} away": (lambda one, by=by: moved(one, by)) for name, by in FAR.items()},
        "moved": lambda one: moved(one, (3.0, -2.0, 1.0)),
        "turned": lambda one: moved(one, (0.0, 0.0, 0.0), turn=2.0),
        "reordered": _of_obstacles(lambda each: each[::-1]),
        "doubled": _of_obstacles(lambda each: [*each, *(msgspec.structs.replace(o, name=f"{o.name} 2") for o in each)]),
        "halved": _of_obstacles(lambda each: [half for one in each for half in _halves(one)]),
        "backwards": _backwards,
        "flipped axes": lambda one: flipped(one, folder),
        "shifted zeros": lambda one: shifted(one, folder),
        "links in between": lambda one: msgspec.structs.replace(
            one, robot=_written(robot, folder, "between", _put_links_between)
        ),
    }
    return changed | {name: (change, 1.0) for name, change in same.items()}


def scaled(request: PlanRequest, size: float, folder: Path) -> PlanRequest:
    """The request with everything as many times as large: robot, obstacles, ways of sliding joints."""
    robot, scene, goal = request.robot, request.scene, request.goal
    assert isinstance(robot, UrdfFile)
    assert isinstance(scene, Scene)
    assert isinstance(goal, JointsGoal)
    slides = {joint.get("name") for joint in _read(robot).iterfind("joint") if joint.get("type") == "prismatic"}

    def values(given: dict[str, Any]) -> dict[str, Any]:
        return {name: value * (size if name in slides else 1.0) for name, value in given.items()}

    return msgspec.structs.replace(
        request,
        robot=_written(robot, folder, f"{size:g}", lambda root: scale_lengths(root, size)),
        scene=msgspec.structs.replace(scene, obstacles=[_scaled(one, size) for one in scene.obstacles]),
        start=values(request.start),
        goal=JointsGoal(values(goal.positions)),
    )


def _scaled(one: Any, size: float) -> Any:
    """An obstacle, so many times as large."""
    lengths = {name: value for name in ("radius", "length") if (value := getattr(one, name, None)) is not None}
    changes: dict[str, Any] = {name: value * size for name, value in lengths.items()}
    if isinstance(one, Box):
        changes["size"] = tuple(side * size for side in one.size)
    return msgspec.structs.replace(one, position=tuple(value * size for value in one.position), **changes)


def moved(request: PlanRequest, by: Sequence[float], turn: float = 0.0) -> PlanRequest:
    """The request about a robot and a scene that both stand elsewhere, turned about z first [m, rad]."""
    scene = request.scene
    assert isinstance(scene, Scene)
    placement = np.array([[math.cos(turn), -math.sin(turn), 0.0], [math.sin(turn), math.cos(turn), 0.0], [0, 0, 1]])
    half = (0.0, 0.0, math.sin(0.5 * turn), math.cos(0.5 * turn))

    def placed(one: Any) -> Any:
        position = tuple((placement @ np.array(one.position) + np.array(by)).tolist())
        if isinstance(one, Sphere):
            return msgspec.structs.replace(one, position=position)
        return msgspec.structs.replace(one, position=position, quaternion_xyzw=_product(half, one.quaternion_xyzw))

    obstacles = [placed(one) for one in scene.obstacles]
    standing = Placement(position=tuple(by), quaternion_xyzw=half)
    scene = msgspec.structs.replace(scene, obstacles=obstacles)
    return msgspec.structs.replace(request, scene=scene, robot_placement=standing)


def _product(p: Sequence[float], q: Sequence[float]) -> tuple[float, ...]:
    """The product of two quaternions (x, y, z, w)."""
    v, w = np.cross(p[:3], q[:3]) + p[3] * np.array(q[:3]) + q[3] * np.array(p[:3]), p[3] * q[3] - np.dot(p[:3], q[:3])
    return (*v.tolist(), float(w))


def as_mesh(one: Any) -> Any:
    """A box as a mesh of 12 triangles; anything else as it is."""
    if not isinstance(one, Box):
        return one
    surface = surfaces.box(one.size)
    placed = {"position": one.position, "quaternion_xyzw": one.quaternion_xyzw}
    return Mesh(name=one.name, vertices=surface.vertices.tolist(), triangles=surface.triangles.tolist(), **placed)


def _in_one_mesh(obstacles: Sequence[Any]) -> list[Any]:
    """All boxes as one mesh in the world, and what else there is."""
    boxes = [one for one in obstacles if isinstance(one, Box)]
    vertices: list[list[float]] = []
    triangles: list[list[int]] = []
    for one in boxes:
        surface = surfaces.box(one.size)
        triangles += (surface.triangles + len(vertices)).tolist()
        x, y, z, w = one.quaternion_xyzw
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        vertices += (surface.vertices @ turn.T + np.array(one.position)).tolist()
    rest = [one for one in obstacles if not isinstance(one, Box)]
    return [Mesh(name="boxes", vertices=vertices, triangles=triangles), *rest] if boxes else rest


def _halves(one: Any) -> list[Any]:
    """Two halves of a box or cylinder across its z axis."""
    if isinstance(one, Sphere):
        return [one]
    x, y, z, w = one.quaternion_xyzw
    along = np.array([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)])
    height = one.length if isinstance(one, Cylinder) else one.size[2]
    halves = []
    for side, name in ((0.25, "top"), (-0.25, "bottom")):
        position = tuple((np.array(one.position) + side * height * along).tolist())
        lengths = (
            {"length": 0.5 * height} if isinstance(one, Cylinder) else {"size": (*one.size[:2], 0.5 * one.size[2])}
        )
        halves.append(msgspec.structs.replace(one, name=f"{one.name} {name}", position=position, **lengths))
    return halves


def _of_obstacles(change: Callable[[list[Any]], list[Any]]) -> Change:
    """Change the obstacles of a request's scene alone."""

    def changed(request: PlanRequest) -> PlanRequest:
        scene = request.scene
        assert isinstance(scene, Scene)
        return msgspec.structs.replace(
            request, scene=msgspec.structs.replace(scene, obstacles=change(list(scene.obstacles)))
        )

    return changed


def _backwards(request: PlanRequest) -> PlanRequest:
    """From the goal to the start."""
    goal = request.goal
    assert isinstance(goal, JointsGoal)
    start = {name: request.start[name] for name in goal.positions}
    return msgspec.structs.replace(request, start={**request.start, **goal.positions}, goal=JointsGoal(start))


def flipped(request: PlanRequest, folder: Path) -> PlanRequest:
    """The request about a robot whose joints all count the other way round."""
    robot, goal = request.robot, request.goal
    assert isinstance(robot, UrdfFile)
    assert isinstance(goal, JointsGoal)
    return msgspec.structs.replace(
        request,
        robot=_written(robot, folder, "flipped", _flip),
        start={name: -float(value) for name, value in request.start.items()},
        goal=JointsGoal({name: -float(value) for name, value in goal.positions.items()}),
    )


def _flip(root: Any) -> None:
    """Turn the axes of all joints of a URDF round in place, and their limits with them."""
    for joint in root.iterfind("joint"):
        if joint.get("type") in ("revolute", "continuous", "prismatic"):
            axis, limit = joint.find("axis"), joint.find("limit")
            given = [float(one) for one in axis.get("xyz").split()]
            axis.set("xyz", " ".join(repr(-one) for one in given))
            if limit is not None and limit.get("lower"):
                lower, upper = float(limit.get("lower")), float(limit.get("upper"))
                limit.set("lower", repr(-upper))
                limit.set("upper", repr(-lower))
        if (mimic := joint.find("mimic")) is not None:
            mimic.set("offset", repr(-float(mimic.get("offset", 0.0))))


SHIFT = 0.3
"""By how much zeros of turning joints are shifted [rad]."""


def shifted(request: PlanRequest, folder: Path) -> PlanRequest:
    """The request about a robot whose turning joints count from elsewhere."""
    robot, goal = request.robot, request.goal
    assert isinstance(robot, UrdfFile)
    assert isinstance(goal, JointsGoal)
    turning = {joint.get("name") for joint in _read(robot).iterfind("joint") if _turns(joint)}

    def values(given: dict[str, Any]) -> dict[str, Any]:
        return {name: value - SHIFT * (name in turning) for name, value in given.items()}

    changed = _written(robot, folder, "shifted", _shift)
    return msgspec.structs.replace(
        request, robot=changed, start=values(request.start), goal=JointsGoal(values(goal.positions))
    )


def _turns(joint: Any) -> bool:
    return joint.get("type") in ("revolute", "continuous") and joint.find("mimic") is None


def _shift(root: Any) -> None:
    """Turn the frames of turning joints of a URDF about their axes in place, and shift their limits."""
    for joint in filter(_turns, root.iterfind("joint")):
        origin, axis, limit = joint.find("origin"), joint.find("axis"), joint.find("limit")
        if origin is None:
            origin = etree.SubElement(joint, "origin")
        roll, pitch, yaw = (float(one) for one in origin.get("rpy", "0 0 0").split())
        given = np.array([float(one) for one in (axis.get("xyz") if axis is not None else "1 0 0").split()])
        turned = pin.rpy.rpyToMatrix(roll, pitch, yaw) @ pin.AngleAxis(SHIFT, given / np.linalg.norm(given)).matrix()
        origin.set("rpy", " ".join(map(repr, pin.rpy.matrixToRpy(turned).tolist())))
        for name in ("lower", "upper"):
            if joint.get("type") == "revolute" and limit is not None and limit.get(name):
                limit.set(name, repr(float(limit.get(name)) - SHIFT))


def _put_links_between(root: Any) -> None:
    """Put a link without shape, which doesn't move, before each joint of a URDF that does, in place."""
    for joint in [one for one in root.iterfind("joint") if one.get("type") != "fixed"]:
        name, parent, origin = f"{joint.get('name')}_between", joint.find("parent"), joint.find("origin")
        etree.SubElement(root, "link", name=name)
        fixed = etree.SubElement(root, "joint", name=f"{name}_joint", type="fixed")
        etree.SubElement(fixed, "parent", link=parent.get("link"))
        etree.SubElement(fixed, "child", link=name)
        if origin is not None:
            fixed.append(origin)  # which leaves the other joint without one
        parent.set("link", name)


def _read(robot: UrdfFile) -> Any:
    return etree.parse(robot.path).getroot()


def _written(robot: UrdfFile, folder: Path, name: str, change: Callable[[Any], None]) -> UrdfFile:
    """A changed copy of a robot, written once into a folder."""
    path = folder / f"{Path(robot.path).stem} {name}.urdf"
    if not path.exists():
        root = _read(robot)
        change(root)
        path.write_bytes(etree.tostring(root))
    return msgspec.structs.replace(robot, path=str(path))


def _dense(robot: UrdfFile, folder: Path) -> UrdfFile:
    """A copy whose meshes have 16 times as many triangles, written once into a folder."""
    into = folder / "dense"
    if not into.exists():
        write_dense_copy({"path": robot.path, "package_dirs": robot.package_dirs}, 16, into)
    return UrdfFile(path=str(into / "dense.urdf"), srdf_path=robot.srdf_path)


def _answered(request: PlanRequest, size: float, repeats: int) -> Said:
    """The answer to a request, after one that isn't counted."""
    seconds = math.inf
    for _ in range(repeats + 1):
        begin = time.process_time()
        reply = answer(request)
        spent, seconds = time.process_time() - begin, min(seconds, time.process_time() - begin)
        if spent > 20.0:
            break
    assert isinstance(reply, PlanReply), "a plan was asked for"
    if reply.status.name != "SUCCESS" or reply.metrics is None or reply.clearance is None:
        return Said(reply.status.name, seconds)
    kept = [math.nan if one is None else one / size for one in (reply.clearance.minimum, reply.clearance.inner)]
    as_found = any("as it was found" in warning for warning in reply.warnings)
    return Said(reply.status.name, seconds, reply.metrics.duration, *kept, as_found)


def _compared(before: Sequence[Said], after: Sequence[Said]) -> str:
    """The columns of a row."""
    pairs = [(one, other) for one, other in zip(before, after, strict=True) if one.status == other.status == "SUCCESS"]
    done = f"{sum(one.status == 'SUCCESS' for one in before)} {sum(one.status == 'SUCCESS' for one in after)}"
    if not pairs:
        return f"{done:>9}  {', '.join(sorted({one.status for one in after}))}"
    durations = np.array([other.duration / one.duration for one, other in pairs])
    times = np.array([other.seconds / one.seconds for one, other in pairs])
    kept = [
        np.nanmean([getattr(other, part) for _, other in pairs]) / np.nanmean([getattr(one, part) for one, _ in pairs])
        for part in ("clearance", "inner")
    ]
    return (
        f"{done:>9}  {sum(one.as_found for one in after):>8}"
        f"  {_mean(durations):.3f} ({durations.max():.2f})  {_mean(times):.2f} ({times.max():.1f})"
        f"   {kept[0]:.3f} ({kept[1]:.3f})"
    )


def _mean(values: np.ndarray) -> float:
    """The geometric mean."""
    return float(np.exp(np.log(values).mean()))
