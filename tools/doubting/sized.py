"""The same larger or smaller, and the same with meshes in place of primitives."""

from __future__ import annotations

import dataclasses
from typing import Any

import msgspec
import numpy as np
from lxml import etree

from doubting.loaded import Loaded, Wire
from doubting.robots import Robot
from guidefield.geometry import surfaces
from guidefield.messages import requests, scene as messages
from guidefield.messages.values import Placement
from guidefield.robot.model.joints import JointKind
from guidefield.robot.model.loading import DEFAULT_TRANSLATION_SPEED

USUAL = 0.6
"""Of so many robots the size is their own."""
SIZES = (0.02, 30.0)
"""The smallest and the largest that others become."""
MESHED = 0.15
"""Of so many plans the boxes, cylinders and capsules are meshes."""
SLIDING = {JointKind.PRISMATIC: 1, JointKind.PLANAR: 2, JointKind.FLOATING: 3}
"""Number of values of a joint that are lengths."""
LENGTHS = ("xyz", "size", "radius", "length")
"""Attributes of a URDF that are lengths."""


def drawn_size(rng: np.random.Generator, robot: Robot) -> float:
    """Draw the factor by which a robot grows; those of the catalog stay."""
    if robot.catalog is not None or rng.random() < USUAL:
        return 1.0
    return float(np.exp(rng.uniform(*np.log(SIZES))))


def sized_robot(robot: Robot, size: float) -> Robot:
    """A robot, so many times as large."""
    root = etree.fromstring(robot.text.encode())
    scale_lengths(root, size)
    return dataclasses.replace(robot, text=etree.tostring(root, encoding="unicode"))


def scale_lengths(root: Any, size: float) -> None:
    """Scale all lengths of a URDF in place."""
    for element in root.iter():
        for name in LENGTHS:
            if element.tag != "axis" and element.get(name):
                element.set(name, " ".join(repr(float(one) * size) for one in element.get(name).split()))
    for mesh in root.iter("mesh"):
        scale = [float(one) * size for one in mesh.get("scale", "1 1 1").split()]
        mesh.set("scale", " ".join(map(repr, scale)))
    for joint in root.iterfind("joint[@type='prismatic']"):
        limit = joint.find("limit")
        limit.set("velocity", limit.get("velocity", str(DEFAULT_TRANSLATION_SPEED)))
        for name in ("lower", "upper", "velocity"):
            limit.set(name, repr(float(limit.get(name, 0.0)) * size))


def sized_request(request: requests.PlanRequest, size: float, loaded: Loaded) -> requests.PlanRequest:
    """A plan for the robot that became so many times as large, with all else so much larger, too."""
    goal: Any = request.goal
    if isinstance(goal, requests.PoseGoal):
        goal = _larger(goal, size, "position")
    elif isinstance(goal, requests.JointsGoal):
        goal = requests.JointsGoal(_wire(goal.positions, size, loaded))
    elif isinstance(goal, requests.JointSetGoal):
        goal = requests.JointSetGoal([_wire(one, size, loaded) for one in goal.positions])
    planes: Any = request.guide_planes or []
    return msgspec.structs.replace(
        request,
        robot=loaded.reference,
        scene=messages.Scene(name="doubted", obstacles=[_obstacle(one, size) for one in request.scene.obstacles]),
        start=_wire(request.start, size, loaded),
        goal=goal,
        robot_placement=_larger(request.robot_placement, size, "position"),
        min_clearance=size * request.min_clearance,
        attached_objects=[
            msgspec.structs.replace(
                one, obstacle=_obstacle(one.obstacle, size), placement=_larger(one.placement, size, "position")
            )
            for one in request.attached_objects
        ],
        path_constraints=[_larger(one, size, "point", "tolerance") for one in request.path_constraints],
        guide_planes=[_larger(one, size, "vertices") for one in planes],
    )


def in_meshes(request: requests.PlanRequest) -> requests.PlanRequest:
    """A plan among meshes in place of boxes, cylinders and capsules that rest."""
    obstacles = [_meshed(one) for one in request.scene.obstacles]
    return msgspec.structs.replace(request, scene=messages.Scene(name="doubted", obstacles=obstacles))


def _meshed(one: Any) -> Any:
    makers = {
        messages.Box: lambda: surfaces.box(one.size),
        messages.Cylinder: lambda: surfaces.cylinder(one.radius, one.length),
        messages.Capsule: lambda: surfaces.capsule(one.radius, one.length),
    }
    if type(one) not in makers or one.trajectory is not None:
        return one
    made = makers[type(one)]()
    return messages.Mesh(
        name=one.name,
        vertices=[tuple(v) for v in np.asarray(made.vertices).tolist()],
        triangles=[tuple(t) for t in np.asarray(made.triangles).tolist()],
        position=one.position,
        quaternion_xyzw=one.quaternion_xyzw,
    )


def _larger(message: Any, size: float, *fields: str) -> Any:
    """A message with some fields, numbers or lists of any depth, times a size."""
    found = {field: _times(getattr(message, field), size) for field in fields if hasattr(message, field)}
    return msgspec.structs.replace(message, **found)


def _times(value: Any, size: float) -> Any:
    return type(value)(_times(one, size) for one in value) if isinstance(value, list | tuple) else size * value


def _obstacle(one: Any, size: float) -> Any:
    larger = _larger(one, size, "position", "size", "radius", "length", "vertices", "points", "offset")
    if one.trajectory is None:
        return larger
    placements: list[Placement] = [_larger(each, size, "position") for each in one.trajectory.placements]
    return msgspec.structs.replace(larger, trajectory=messages.ObstacleTrajectory(one.trajectory.times, placements))


def _wire(positions: Wire, size: float, loaded: Loaded) -> Wire:
    """Values of joints with lengths times a size."""
    lengths = {joint.name: SLIDING.get(joint.kind, 0) for joint in loaded.model.joints}
    found = {}
    for name, value in positions.items():
        values = np.atleast_1d(np.array(value, float))
        values[: lengths[name]] *= size
        found[name] = values.tolist() if isinstance(value, list) else float(values[0])
    return found
