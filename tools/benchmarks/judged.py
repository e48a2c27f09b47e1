"""Other planners' paths, judged by `certify`, HPP and dense samples on the exact meshes: where they differ, and why.

Usage: tools/bench judged <folder> [--robots panda,ur5,fetch,baxter] [--every N] [--seconds S] [--hpp]

The folder is described in problems.py; the planners are those of peers.py that are installed. Samples are
`JUDGED_STEP` apart, on the meshes as they are in their files, through Pinocchio and Coal alone. The certificate judges
hulls that stand off from their meshes: a path that it alone refuses is told with the distance of the exact meshes where
it was refused, and with how far the hulls of the two bodies stand off together. Times are CPU times of one thread. With
--hpp the continuous validation of HPP judges them too, on the exact meshes, and is installed for it in `.venv-hpp`.
Straight ways from start to goal are judged beside the planners'.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks import peers
from benchmarks.connect_peers import print_times
from benchmarks.problems import ROBOTS, Problems, scene_message
from doubting import hpp
from guidefield.collision.world import World
from guidefield.engine import Engine
from guidefield.messages.replies import CertifyReply
from guidefield.messages.requests import CertifyRequest, UrdfFile
from guidefield.scene.scene import build

JUDGED_STEP = 0.01
"""Joint distance between two configurations that are judged [rad or m]."""


class ExactMeshes:
    """A robot's meshes as they are in their files, among obstacles, through Pinocchio and Coal alone.

    Args:
        given: The robot.
        world: Whose pairs count.
    """

    def __init__(self, given: Problems, world: World) -> None:
        group = world.group
        urdf = given.folder / "robots" / given.robot / f"{given.robot}.urdf"
        model = pin.buildModelFromUrdf(str(urdf))
        folders = [str(given.folder / "robots")]
        geometry = pin.buildGeomFromUrdf(model, str(urdf), pin.GeometryType.COLLISION, package_dirs=folders)
        self._bodies = [shape.name for shape in geometry.geometryObjects]
        ours = [shape.name for shape in group.geometry.geometryObjects]
        for obstacle in world.scene.obstacles:
            geometry.addGeometryObject(
                pin.GeometryObject(f"obstacle/{obstacle.name}", 0, obstacle.placement, obstacle.shape)
            )
        geometry.removeAllCollisionPairs()
        first = len(ours)
        self.names: list[tuple[str, str]] = []
        for pair, (a, b) in enumerate(world.pairs.bodies(np.arange(len(world.pairs))).tolist()):
            at = [self._bodies.index(ours[k]) if k < first else len(self._bodies) + k - first for k in (a, b)]
            geometry.addCollisionPair(pin.CollisionPair(*at))
            self.names.append(world.pair_names(pair))
        self._model, self._data = model, model.createData()
        self._geometry, self._scratch = geometry, geometry.createData()
        self._columns = [model.joints[model.getJointId(joint.name)] for joint in group.joints]
        self._world = world

    def _configuration(self, z: np.ndarray) -> np.ndarray:
        q = pin.neutral(self._model)
        for joint, value in zip(self._columns, z.tolist(), strict=True):
            q[joint.idx_q : joint.idx_q + joint.nq] = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
        return q

    def touched(self, path: np.ndarray) -> tuple[str, str] | None:
        """The pair that touches first at samples of a path (n, nv), if any does."""
        for a, b in itertools.pairwise(path):
            count = max(1, int(np.ceil(np.linalg.norm(b - a) / JUDGED_STEP)))
            for share in np.linspace(0.0, 1.0, count + 1):
                q = self._configuration(a + share * (b - a))
                if pin.computeCollisions(self._model, self._data, self._geometry, self._scratch, q, True):
                    hit = next(k for k, one in enumerate(self._scratch.collisionResults) if one.isCollision())
                    return self.names[hit]
        return None

    def distance(self, z: np.ndarray, pair: tuple[str, str]) -> float:
        """Distance of the bodies of a pair at a chart point (nv,) [m]."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._scratch, self._configuration(z))
        mine = [k for k, names in enumerate(self.names) if set(names) == set(pair)]
        return min(pin.computeDistance(self._geometry, self._scratch, k).min_distance for k in mine)


@dataclass(frozen=True)
class Row:
    """One path: whether the certificate and samples find it free, its CPU time [ms], and how a difference is told.

    `case` is the path as the referee's file has it.
    """

    certified: bool
    sampled: bool
    milliseconds: float
    case: dict[str, Any]
    difference: str = ""
    known: bool = False


def run(arguments: list[str]) -> None:
    """Print, for each robot and planner, how the two judges agree, and every difference."""
    parser = argparse.ArgumentParser(prog="tools/bench judged", description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="the folder that `guidefield docs benchmarks` describes")
    parser.add_argument("--robots", default=",".join(ROBOTS), help="which, between commas")
    parser.add_argument("--every", type=int, default=1, help="take every n-th problem only")
    parser.add_argument("--seconds", type=float, default=5.0, help="what planning may take")
    parser.add_argument("--hpp", action="store_true", help="install HPP, and ask it too")
    options = parser.parse_args(arguments)
    if options.hpp and (why := hpp.install()):
        print(f"HPP isn't asked: {why}")
    planners = {"straight": _straight, **peers.installed()}
    for robot in options.robots.split(","):
        given, engine = Problems.load(options.folder, robot, options.every), Engine()
        for name, solve in planners.items():
            rows = [_row(given, engine, problem, solve, options.seconds) for problem in given.problems]
            paths = [row for row in rows if row is not None]
            _print(robot, name, paths, len(rows))
            if options.hpp and hpp.installed():
                _print_hpp(paths)


def _straight(task: peers.Task) -> peers.Answer:
    """The straight way from start to goal."""
    return peers.Answer(np.array([task.start, task.goal]), 0.0, 0.0, 0.0)


def _row(given: Problems, engine: Engine, problem: dict[str, Any], solve: Any, seconds: float) -> Row | None:
    """One problem's path, judged twice; None where the planner found none."""
    message = scene_message(problem)
    world = World.build(given.group, build(message))
    robot = given.folder / "robots" / given.robot / given.robot
    packages = given.folder / "robots"
    answer = solve(peers.Task(robot, packages, world, problem["obstacles"], *given.ends(problem), seconds, 0))
    if answer.path is None:
        return None
    names = [joint.name for joint in given.group.joints]
    standing = {name: value for name, value in _standing(given).items() if name not in names}
    request = CertifyRequest(
        UrdfFile(path=f"{robot}.urdf", srdf_path=f"{robot}.srdf", package_dirs=[str(packages)]),
        message,
        path=answer.path.tolist(),
        start=standing,
        position_names=names,
        allowed_time=60.0,
        recording="off",
    )
    begin = time.thread_time()
    reply = engine.answer(request)
    milliseconds = 1e3 * (time.thread_time() - begin)
    assert isinstance(reply, CertifyReply), "a judgement was asked for"
    exact = ExactMeshes(given, world)
    touched = exact.touched(answer.path)
    certified = reply.certificate.collision_free
    difference, known = _difference(given, reply, exact, touched, names)
    where = f"{problem['set']} {problem['index']}: {difference}" if difference else ""
    return Row(certified, touched is None, milliseconds, hpp.case(given.group.robot, request), where, known)


def _standing(given: Problems) -> dict[str, float]:
    """Values of joints that no problem moves."""
    robot = given.group.robot
    return {joint.name: float(robot.rest[joint.idx_q]) for joint in robot.joints if joint.nq == 1 and not joint.mimic}


def _difference(
    given: Problems, reply: CertifyReply, exact: ExactMeshes, touched: tuple[str, str] | None, names: list[str]
) -> tuple[str, bool]:
    """Where the two judges differ, in words, and whether a reason is known; nothing where they agree."""
    certificate = reply.certificate
    if certificate.collision_free == (touched is None):
        return "", False
    if certificate.collision_free:
        return f"certified, and {touched} touch at a sample", False
    if certificate.pair is None or certificate.place is None:
        return f"refused: {certificate.reason}; free at samples", False
    place = np.array([certificate.place.configuration[name] for name in names])
    first, second = certificate.pair
    distance, stand_off = exact.distance(place, (first, second)), _stand_off(given, (first, second))
    told = f"{certificate.reason} of {first} and {second}"
    if distance <= 0.0:
        return f"{told}; the meshes touch there, between samples", True
    told += f"; the meshes keep {1e3 * distance:.3f} mm there, their hulls stand off by {1e3 * stand_off:.3f} mm"
    return told, distance <= stand_off + 1e-5


def _stand_off(given: Problems, pair: tuple[str, str]) -> float:
    """How far what is judged of two bodies stands off from their meshes together, at most [m]."""
    of = Counter[str]()
    for choice in given.group.robot.geometry_choices:
        of[choice.link] = max(of[choice.link], choice.stand_off)
    return float(sum(of[name] for name in pair))


def _print(robot: str, planner: str, rows: list[Row], asked: int) -> None:
    print(f"\n{robot}, {planner}: {len(rows)} paths for {asked} problems")
    if not rows:
        return
    for certified, sampled, words in (
        (True, True, "free for both"),
        (False, False, "refused by both"),
        (False, True, "refused by the certificate alone"),
        (True, False, "refused by samples alone"),
    ):
        print(f"  {words}: {sum((row.certified, row.sampled) == (certified, sampled) for row in rows)}")
    alone = [row for row in rows if row.difference]
    print(f"  differences whose reason is known: {sum(row.known for row in alone)} of {len(alone)}")
    print_times("  certify, ms", np.array([row.milliseconds for row in rows]))
    for row in alone:
        print(f"   {'known' if row.known else 'UNKNOWN'} {row.difference}")


def _print_hpp(rows: list[Row]) -> None:
    """What HPP says of the same paths; that it finds no contact between two moving links is no proof in 9.0.2."""
    heard = hpp.heard([row.case for row in rows], 60.0 + 10.0 * len(rows))
    for answer, certified in itertools.product(sorted({one.answer for one in heard}), (True, False)):
        count = sum((one.answer, row.certified) == (answer, certified) for one, row in zip(heard, rows, strict=True))
        print(f"  HPP: {answer}, {'free' if certified else 'refused'} for the certificate: {count}")
    print_times("  HPP, ms", np.array([1e3 * one.seconds for one in heard if one.answer != "not judged"]))
    for one, row in zip(heard, rows, strict=True):
        if one.reason or (one.answer == "contact" and row.certified):
            print(f"   {'ALARM' if row.certified and not one.reason else 'not judged'} {one}")
