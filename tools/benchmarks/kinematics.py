"""Batches of kinematics beside Pinocchio's own loops in Python, over the same robot, pairs and configurations.

Usage: tools/bench kinematics [ROBOT] [SCENE] [CONFIGURATIONS]

Columns are CPU time of one thread for each configuration [us], the best of three, and the ratio to Pinocchio's loop:
`forwardKinematics` with `updateFramePlacement` and `SE3ToXYZQUAT`, and `computeDistances` over all pairs.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin

import guidefield
from guidefield.collision.world import World
from guidefield.handlers.configurations import configurations_from, whole_group
from guidefield.messages.kinematics_requests import ConfigurationTable
from guidefield.messages.values import Placement
from guidefield.robot.catalog.catalog import Catalog
from guidefield.scene import library, scene as scenes

MOST_MEASURED = 300
"""Configurations at which Pinocchio's loop over all pairs is measured: of meshes it takes milliseconds each."""


def run(arguments: Sequence[str]) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="tools/bench kinematics", description=__doc__.partition("\n")[0])
    parser.add_argument("robot", nargs="?", default="panda")
    parser.add_argument("scene", nargs="?", default="bookshelf")
    parser.add_argument("count", nargs="?", type=int, default=2000, metavar="configurations")
    asked = parser.parse_args(arguments)
    name, scene, count = asked.robot, asked.scene, asked.count
    robot = Catalog().load(name)
    joints = [joint for joint in robot.joints if joint.mimic is None and joint.limits is not None]
    names = [joint.name for joint in joints]
    bounds = np.array([joint.limits for joint in joints])
    rows = np.random.default_rng(0).uniform(*bounds.T, (count, len(joints)))
    packed = {"names": names, "float64": rows.astype("<f8").tobytes()}
    listed = [dict(zip(names, row, strict=True)) for row in rows.tolist()]
    qs = configurations_from(robot, ConfigurationTable(names, rows=rows.tolist()))
    frames = {"type": "forward_kinematics", "robot": name, "frames": [robot.tip]}
    near = {"type": "clearance", "robot": name, "scene": scene}
    poses = guidefield.answer({**frames, "configurations": listed}).placements
    world = World.build(whole_group(robot, Placement()), scenes.build(library.read(scene)))
    free = [pose for (pose,), is_free in zip(poses, _free(near, packed), strict=True) if is_free]
    reach = {
        "type": "inverse_kinematics",
        "robot": name,
        "scene": scene,
        "collision_free": True,
        "solutions": 1,
        "poses": [msgspec.to_builtins(pose) for pose in free[:500]],
    }
    text = msgspec.json.encode({**frames, "configurations": listed})
    placing = _best(lambda: _place_each(robot, qs)) / len(qs)
    measured = qs[:MOST_MEASURED]
    measuring = _best(lambda: _distances(world, measured)) / len(measured)

    def answer(label: str, asked: Any, of: float, number: int = len(qs)) -> None:
        seconds = _best(lambda: msgspec.json.encode(guidefield.answer(asked))) / number
        print(f"{label:44s} {1e6 * seconds:10.2f}  {seconds / of:8.3f}")

    print(f"{name}, {scene}, {len(world.pairs)} pairs, {count} configurations; Pinocchio's loops: frames")
    print(f"{1e6 * placing:.2f} us, distances {1e6 * measuring:.2f} us a configuration\n")
    answer("forward kinematics, packed", {**frames, "configurations": packed, "packed": True}, placing)
    answer("forward kinematics, JSON in and out", text, placing)
    answer("clearance, packed", {**near, "configurations": packed, "packed": True}, measuring)
    answer("clearance, lists", {**near, "configurations": listed}, measuring)
    answer(
        "clearance with gradients, packed",
        {**near, "configurations": packed, "packed": True, "gradients": True},
        measuring,
    )
    answer("verdict", {**near, "configurations": packed, "verdict": True}, measuring)
    answer("collision-free inverse kinematics, a pose", reach, measuring, len(reach["poses"]))


def _free(near: dict[str, Any], packed: dict[str, Any]) -> list[bool]:
    found: list[bool] = guidefield.answer({**near, "configurations": packed, "verdict": True}).free
    return found


def _best(work: Callable[[], object]) -> float:
    times = []
    for _ in range(3):
        began = time.process_time()
        work()
        times.append(time.process_time() - began)
    return min(times)


def _place_each(robot: Any, qs: np.ndarray) -> list[np.ndarray]:
    model, data, frame = robot.model, robot.model.createData(), robot.frame_id(robot.tip)
    found = []
    for q in qs:
        pin.forwardKinematics(model, data, q)
        found.append(pin.SE3ToXYZQUAT(pin.updateFramePlacement(model, data, frame)))
    return found


def _distances(world: World, qs: np.ndarray) -> None:
    """Pinocchio's loop over all pairs of a world."""
    geometry = pin.GeometryModel(world.group.geometry)
    geometry.removeAllCollisionPairs()
    for index, obstacle in enumerate(world.scene.obstacles):
        geometry.addGeometryObject(pin.GeometryObject(f"obstacle {index}", 0, 0, obstacle.placement, obstacle.shape))
    for pair in range(len(world.pairs)):
        geometry.addCollisionPair(pin.CollisionPair(*world.pairs.of(pair)))
    data, geometry_data = world.model.createData(), geometry.createData()
    for q in qs:
        pin.computeDistances(world.model, data, geometry, geometry_data, q)
