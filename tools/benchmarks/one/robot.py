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

from guidefield.collision.enclosure import enclosed
from guidefield.collision.preparation import prepare
from guidefield.collision.world import World
from guidefield.engine import Engine
from guidefield.errors import GuidefieldError, InvalidGroup, RobotInvalid
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import JointsGoal, PlanRequest
from guidefield.messages.scene import Box, Scene
from guidefield.prove.certificate import motion_free
from guidefield.robot.bodies.sphere_cover import coverage
from guidefield.robot.catalog.catalog import Catalog
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import configuration_from_wire, configuration_to_wire
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.self_contacts import scratch_space
from guidefield.scene.scene import build

BOXES = 8
BOX_SIZE = (0.1, 0.35)
"""Edges of the boxes, as shares of the robot's reach."""
GAP = 0.02
"""How far from the robot boxes stay at start and goal, as a share of its reach."""
LEGS, TRIES = 3, 60
"""Straight legs of the walk to the goal, and how many are tried for each, ever shorter."""
APART = 0.03
"""How far apart the configurations are that are looked at on a leg [rad or m]."""
CANDIDATES = 400
"""Boxes that are tried."""
DENSE = 400.0
"""Samples of the motion that are looked at again [1/s]."""
SEED = 20260


def measured(name: str, planning: float | None, memory: float) -> dict[str, Any]:
    """The line of one robot.

    Args:
        name: Of the catalog.
        planning: Allowed planning time [s]; None: it is only loaded and prepared.
        memory: Most memory of this process [GB].
    """
    resource.setrlimit(resource.RLIMIT_DATA, (int(memory * 1e9), int(memory * 1e9)))
    line: dict[str, Any] = {"name": name, "status": "LOADED", "message": ""}
    began = time.process_time()
    try:
        robot = Catalog().load(name)
    except RobotInvalid as error:
        return {**line, "status": error.code.name, "message": error.message}
    line["load"] = time.process_time() - began
    line.update(described(robot))
    began = time.process_time()
    covered = coverage(robot)
    line.update(spheres=covered.spheres, overhang=1000.0 * covered.overhang)
    line["covering"] = time.process_time() - began
    try:
        group = select(robot, None, None, robot.rest, pin.SE3.Identity())
    except InvalidGroup as error:
        return {**line, "status": error.code.name, "message": error.message}
    line["planned"] = group.nv
    began = time.process_time()
    prepare(robot)
    line["preparing"] = time.process_time() - began
    if planning is None:
        return line
    walk = free_walk(group)
    fixed = bool(np.all(group.lower == group.upper))
    if fixed or len(walk) == 1:
        why = "its joints' lower and upper limits are the same" if fixed else "near rest no motion is free of itself"
        return {**line, "status": "CANNOT MOVE", "message": "; ".join([why, *robot.warnings[-2:]])}
    scene = among(group, walk)
    request = PlanRequest(
        robot=name,
        scene=scene,
        goal=JointsGoal(positions=configuration_to_wire(group.joints, walk[-1])),
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


def free_walk(group: PlanningGroup) -> list[np.ndarray]:
    """A random walk from the rest configuration without touching itself: what it leads to can be reached."""
    rng, world = np.random.default_rng(SEED), World.build(group, build(Scene(name="empty")))
    walk = [group.part_of(group.robot.rest)]
    for _ in range(LEGS):
        for share in np.linspace(1.0, 0.05, TRIES):
            leg = between(group, walk[-1], group.interpolate(walk[-1], group.random(rng), share))
            if (
                any(map(world.in_collision, map(group.expand, leg)))
                or enclosed(world, group.expand(leg[-1])) is not None
            ):
                continue
            if motion_free(world, *group.chart_path([walk[-1], leg[-1]])).free:
                walk += leg
                break
    return walk


def between(group: PlanningGroup, q0: np.ndarray, q1: np.ndarray) -> list[np.ndarray]:
    """Configurations on the straight way from one to another, `APART` at most; the last included, the first not."""
    count = 1 + int(np.abs(group.difference(q0, q1)).max() / APART)
    return [group.interpolate(q0, q1, t) for t in np.linspace(0.0, 1.0, count + 1)[1:]]


def among(group: PlanningGroup, walk: list[np.ndarray]) -> Scene:
    """Random boxes where the robot moves that keep away from it on all of a walk: its end stays within reach."""
    rng = np.random.default_rng(SEED)
    looked = [walk[index] for index in np.unique(np.linspace(0, len(walk) - 1, 40).astype(int))]
    bodies = [body for q in looked for body in placed(group, q)]
    centres = np.array([p.translation for _ in range(50) for _, p in placed(group, group.random(rng))])
    low, high = centres.min(axis=0), centres.max(axis=0)
    reach = max(float(np.linalg.norm(high - low)) / 2.0, 0.05)
    boxes: list[Box] = []
    for _ in range(CANDIDATES):
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
    touching = touching_at_samples(reply, robot, scene)
    line["dense"] = not touching and reply.certificate.collision_free
    line["touching"] = touching
    return line


def touching_at_samples(reply: PlanReply, robot: RobotModel, scene: Scene) -> list[str]:
    """Names of a pair that Coal finds in contact at a sample of a motion: of the robot with itself or with a box.

    Nothing of the planner takes part but the robot's model, its shapes and pairs; empty if there is none.
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
    data = robot.model.createData()
    pairs = [pin.CollisionPair(pair.first, pair.second) for pair in geometry.collisionPairs]
    geometry.removeAllCollisionPairs()
    for pair in pairs:
        if not _rigid(robot, geometry, pair, reply.position_names):
            geometry.addCollisionPair(pair)
    geometry_data = scratch_space(geometry)
    resting = configuration_to_wire(robot.joints, robot.rest)
    for row in reply.trajectory.positions:
        q = configuration_from_wire(robot, {**resting, **_positions(reply.position_names, row)})
        if pin.computeCollisions(robot.model, data, geometry, geometry_data, q, True):
            hits = zip(geometry.collisionPairs, geometry_data.collisionResults, strict=True)
            first = next(pair for pair, result in hits if result.isCollision())
            return [geometry.geometryObjects[index].name for index in (first.first, first.second)]
    return []


def _rigid(robot: RobotModel, geometry: Any, pair: Any, columns: list[str]) -> bool:
    """Whether two bodies can't move relative to each other: the same planned joints move both."""
    planned = {joint.name for joint in robot.joints if any(c.partition(".")[0] == joint.name for c in columns)}
    planned |= {joint.name for joint in robot.joints if joint.mimic is not None and joint.mimic.driver in planned}
    moved = []
    for index in (pair.first, pair.second):
        supports = robot.model.supports[geometry.geometryObjects[index].parentJoint]
        moved.append({robot.model.names[joint] for joint in supports} & planned)
    return moved[0] == moved[1]


def _positions(names: list[str], row: list[float]) -> dict[str, Any]:
    """Columns of a reply as a configuration of the wire."""
    gathered: dict[str, list[float]] = {}
    for name, value in zip(names, row, strict=True):
        joint, _, part = name.rpartition(".")
        gathered.setdefault(joint if part in ("x", "y", "z", "theta", "qx", "qy", "qz", "qw") else name, []).append(
            value
        )
    return {name: values[0] if len(values) == 1 else values for name, values in gathered.items()}
