"""One robot, loaded twice and planned for once: from its rest configuration to a random free one among random boxes."""

from __future__ import annotations

import re
import resource
import time
from collections import Counter
from typing import Any

import coal
import msgspec
import numpy as np
import pinocchio as pin

from guidefield.collision.world import World
from guidefield.engine import Engine
from guidefield.errors import GuidefieldError, RobotInvalid
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import JointsGoal, PlanRequest
from guidefield.messages.scene import Box, Scene
from guidefield.robot.catalog import Catalog
from guidefield.robot.configuration import configuration_from_wire, configuration_to_wire
from guidefield.robot.group import PlanningGroup
from guidefield.robot.model import RobotModel
from guidefield.robot.selection import select
from guidefield.scene.scene import build

BOXES = 8
BOX_SIZE = (0.1, 0.35)
"""Edges of the boxes, as shares of the robot's reach."""
GAP = 0.02
"""How far from the robot boxes stay at start and goal, as a share of its reach."""
TRIES = 2000
DENSE = 400.0
"""Samples of the motion that are looked at again [1/s]."""
SEED = 20260


def measured(name: str, planning: float, memory: float) -> dict[str, Any]:
    """The line of one robot.

    Args:
        name: Of the catalog.
        planning: Allowed planning time [s].
        memory: Most memory of this process [GB].
    """
    resource.setrlimit(resource.RLIMIT_DATA, (int(memory * 1e9), int(memory * 1e9)))
    line: dict[str, Any] = {"name": name, "message": ""}
    try:
        for which in ("cold", "cached"):
            began = time.process_time()
            robot = Catalog().load(name)
            line[which] = time.process_time() - began
    except RobotInvalid as error:
        return {**line, "status": error.code.name, "message": error.message}
    line.update(described(robot))
    group = select(robot, None, None, robot.rest, pin.SE3.Identity())
    line["planned"] = group.nv
    goal = free_goal(group)
    if goal is None:
        return {**line, "status": "NO FREE GOAL", "message": f"{TRIES} random configurations all touch"}
    scene = among(group, goal)
    request = PlanRequest(
        robot=name,
        scene=scene,
        goal=JointsGoal(positions=configuration_to_wire(group.joints, goal)),
        guide_planes=[],
        allowed_planning_time=planning,
        sample_rate=DENSE,
        recording="off",
    )
    engine = Engine()
    engine.warm_up()
    try:
        reply = engine.answer(request)
    except GuidefieldError as error:
        return {**line, "status": error.code.name, "message": error.message}
    assert isinstance(reply, PlanReply)
    return {**line, **outcome(reply, robot, scene)}


def described(robot: RobotModel) -> dict[str, Any]:
    """What a robot is."""
    own = [joint for joint in robot.joints if joint.mimic is None]
    reasons = Counter(re.sub(r"\d+ % of ", "", pair.reason) for pair in robot.pairs_left_out)
    links = robot.link_of_geometry
    tested = {frozenset((links(pair.first), links(pair.second))) for pair in robot.geometry.collisionPairs}
    return {
        "dof": sum(joint.nv for joint in own),
        "kinds": dict(Counter(joint.kind.value for joint in own)),
        "shapes": dict(Counter(choice.judged_as for choice in robot.geometry_choices)),
        "pairs": len(tested),
        "left_out": dict(reasons),
        "warnings": list(robot.warnings),
        "tip": robot.tip,
    }


def free_goal(group: PlanningGroup) -> np.ndarray | None:
    """A random configuration in which the robot doesn't touch itself; None if there is none among many."""
    rng = np.random.default_rng(SEED)
    world = World.build(group, build(Scene(name="empty")))
    for _ in range(TRIES):
        q = group.random(rng)
        if not world.in_collision(q) and world.enclosed(q) is None:
            return q
    return None


def among(group: PlanningGroup, goal: np.ndarray) -> Scene:
    """Random boxes where the robot moves that touch it neither at rest nor at the goal."""
    rng = np.random.default_rng(SEED)
    bodies = [*placed(group, group.part_of(group.robot.rest)), *placed(group, goal)]
    moved = [[p.translation for _, p in placed(group, group.random(rng))] for _ in range(50)]
    centres = np.concatenate([np.array(points).reshape(-1, 3) for points in moved])
    low, high = centres.min(axis=0), centres.max(axis=0)
    reach = max(float(np.linalg.norm(high - low)) / 2.0, 0.05)
    boxes: list[Box] = []
    for _ in range(TRIES):
        if len(boxes) == BOXES:
            break
        size, centre = reach * rng.uniform(*BOX_SIZE, 3), rng.uniform(low - 0.2 * reach, high + 0.2 * reach)
        shape, at = coal.Box(*size), coal.Transform3s(np.eye(3), centre)
        if all(_distance(shape, at, body, placement) > GAP * reach for body, placement in bodies):
            boxes.append(Box(name=f"box{len(boxes)}", size=tuple(size.tolist()), position=tuple(centre.tolist())))
    return Scene(name="boxes", obstacles=list(boxes))


def placed(group: PlanningGroup, q: np.ndarray) -> list[tuple[Any, Any]]:
    """Collision shapes of a group's robot, and where they are."""
    data, geometry_data = group.model.createData(), group.geometry.createData()
    pin.updateGeometryPlacements(group.model, data, group.geometry, geometry_data, group.expand(q))
    shapes = (body.geometry for body in group.geometry.geometryObjects)
    return [(shape, p.copy()) for shape, p in zip(shapes, geometry_data.oMg, strict=True)]


def _distance(shape: Any, at: Any, body: Any, placement: Any) -> float:
    there = coal.Transform3s(placement.rotation, placement.translation)
    return float(coal.distance(shape, at, body, there, coal.DistanceRequest(), coal.DistanceResult()))


def outcome(reply: PlanReply, robot: RobotModel, scene: Scene) -> dict[str, Any]:
    """What became of a plan."""
    line: dict[str, Any] = {
        "status": reply.status.name,
        "message": reply.status.message,
        "details": reply.status.details,
        "boxes": len(scene.obstacles),
        "planning": reply.timing.total - reply.timing.load,
        "stages": {stage.name: f"{stage.outcome}, {stage.seconds:.3g} s" for stage in reply.stages},
        "timing": {name: round(seconds, 4) for name, seconds in msgspec.to_builtins(reply.timing).items()},
    }
    if reply.trajectory is None or reply.clearance is None:
        return line
    if reply.clearance.minimum is not None:
        line["clearance"] = 1000.0 * reply.clearance.minimum
    line["duration"] = reply.trajectory.times[-1]
    line["dense"] = free_at_samples(reply, robot, scene) and reply.certificate.collision_free
    return line


def free_at_samples(reply: PlanReply, robot: RobotModel, scene: Scene) -> bool:
    """Whether Coal finds no contact at any sample of a motion: of the robot with itself, of moving links with boxes.

    Nothing of the planner takes part but the robot's model, its shapes and pairs.
    """
    assert reply.trajectory is not None
    geometry = robot.geometry.copy()
    own = geometry.ngeoms
    for box in scene.obstacles:
        assert isinstance(box, Box)
        placement = pin.SE3(np.eye(3), np.array(box.position))
        added = geometry.addGeometryObject(pin.GeometryObject(box.name, 0, placement, coal.Box(*box.size)))
        for index in range(own):
            if geometry.geometryObjects[index].parentJoint:
                geometry.addCollisionPair(pin.CollisionPair(index, added))
    data, geometry_data = robot.model.createData(), geometry.createData()
    resting = configuration_to_wire(robot.joints, robot.rest)
    for row in reply.trajectory.positions:
        q = configuration_from_wire(robot, {**resting, **_positions(reply.position_names, row)})
        if pin.computeCollisions(robot.model, data, geometry, geometry_data, q, True):
            return False
    return True


def _positions(names: list[str], row: list[float]) -> dict[str, Any]:
    """Columns of a reply as a configuration of the wire."""
    gathered: dict[str, list[float]] = {}
    for name, value in zip(names, row, strict=True):
        joint, _, part = name.rpartition(".")
        gathered.setdefault(joint if part in ("x", "y", "z", "theta", "qx", "qy", "qz", "qw") else name, []).append(
            value
        )
    return {name: values[0] if len(values) == 1 else values for name, values in gathered.items()}
