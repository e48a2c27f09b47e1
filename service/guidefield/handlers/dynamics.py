"""Jacobians and rigid-body dynamics at configurations, by Pinocchio.

Order of twists (linear part first) and names of reference frames are Pinocchio's, and the wire's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.errors import RobotInvalid, UnknownFrame
from guidefield.geometry.surfaces import se3
from guidefield.handlers.attached import payload_inertia
from guidefield.handlers.configurations import (
    batches,
    configurations_from,
    frame_ids,
    pack_numbers,
    rates_from,
    whole_group,
)
from guidefield.messages import requests
from guidefield.messages.replies import DynamicsReply, JacobianReply
from guidefield.messages.values import Placement
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import Scene

_FRAMES = {"local": pin.LOCAL, "world": pin.WORLD, "local_world_aligned": pin.LOCAL_WORLD_ALIGNED}


def jacobian(
    request: requests.Jacobian, robot: RobotModel, _scene: Scene | None = None, deadline: Deadline = UNLIMITED
) -> JacobianReply:
    """Jacobians of frames by the velocities of the joints, and the frames' twists where velocities are given.

    Columns are the joints that are no mimic joints; what these add is in the column of their source joint.

    Raises UnknownFrame if the robot lacks a frame; InvalidConfiguration if a configuration or velocity doesn't fit the
    robot.
    """
    frames = frame_ids(robot, request.frames)
    group, root = whole_group(robot, request.robot_placement), se3_of(request.robot_placement)
    configurations = configurations_from(robot, request.configurations)
    rates = None if request.velocities is None else rates_from(group, request.velocities, "velocities")
    model, data, reference = robot.model, robot.model.createData(), _FRAMES[request.reference_frame]
    to_world = _to_world(request.reference_frame, root)
    found = np.empty((len(configurations), len(frames), 6, group.nv))
    for some in batches(deadline, len(configurations)):
        for row, q in zip(found[some], configurations[some], strict=True):
            pin.computeJointJacobians(model, data, q)
            pin.updateFramePlacements(model, data)
            for out, frame in zip(row, frames, strict=True):
                out[:] = to_world @ pin.getFrameJacobian(model, data, frame, reference) @ group.expand_velocity
    twists = None if rates is None else np.einsum("nkij,nj->nki", found, rates)
    if request.packed:
        return JacobianReply(
            jacobian=[],
            velocity_names=group.velocity_names,
            packed=pack_numbers(found),
            packed_twist=None if twists is None else pack_numbers(twists),
        )
    return JacobianReply(
        jacobian=found.tolist(),
        velocity_names=group.velocity_names,
        twist=None if twists is None else twists.tolist(),
    )


def dynamics(
    request: requests.Dynamics, robot: RobotModel, _scene: Scene | None = None, deadline: Deadline = UNLIMITED
) -> DynamicsReply:
    """Torques, mass matrix and centre of mass of the links that joints move, with a payload.

    Raises RobotInvalid if no link that moves has a mass; UnknownFrame if the robot lacks a link that carries a payload;
    MalformedRequest if the inertia of a payload can't be that of a body; InvalidConfiguration if a configuration,
    velocity or acceleration doesn't fit the robot.
    """
    group, root = whole_group(robot, request.robot_placement), se3_of(request.robot_placement)
    model = _with_payload(robot, request.payload)
    _require_mass(robot, model)
    model.gravity.linear = root.rotation.T @ np.array(request.gravity)
    configurations = configurations_from(robot, request.configurations)
    still = np.zeros((len(configurations), group.nv))
    velocities, accelerations = (
        still if given is None else rates_from(group, given, field)
        for field, given in (("velocities", request.velocities), ("accelerations", request.accelerations))
    )
    expand, data, count = group.expand_velocity, model.createData(), len(configurations)
    answer: dict[str, Callable[[Any, Any, Any], Any]] = {
        "inverse_dynamics": lambda q, v, a: expand.T @ pin.rnea(model, data, q, expand @ v, expand @ a),
        "gravity": lambda q, _v, _a: expand.T @ pin.computeGeneralizedGravity(model, data, q),
        "mass_matrix": lambda q, _v, _a: expand.T @ _symmetric(pin.crba(model, data, q)) @ expand,
        "centre_of_mass": lambda q, _v, _a: root.act(pin.centerOfMass(model, data, q)),
    }
    shapes = {"mass_matrix": (group.nv, group.nv), "centre_of_mass": (3,)}
    found = {name: np.empty((count, *shapes.get(name, (group.nv,)))) for name in request.quantities}
    for some in batches(deadline, count):
        given = zip(configurations[some], velocities[some], accelerations[some], strict=True)
        for index, (q, v, a) in enumerate(given, some.start):
            for name, rows in found.items():
                rows[index] = answer[name](q, v, a)
    mass, warnings = float(pin.computeTotalMass(model)), _mass_warnings(robot, model)
    if request.packed:
        numbers = {str(name): pack_numbers(rows) for name, rows in found.items()}
        return DynamicsReply(velocity_names=group.velocity_names, mass=mass, packed=numbers, warnings=warnings)
    return DynamicsReply(
        velocity_names=group.velocity_names,
        mass=mass,
        warnings=warnings,
        **{name: rows.tolist() for name, rows in found.items()},
    )


def se3_of(placement: Placement) -> Any:
    """The pinocchio.SE3 of a message's placement."""
    return se3(placement.position, placement.quaternion_xyzw)


def _to_world(reference: requests.ReferenceFrame, root: Any) -> np.ndarray:
    """Matrix (6, 6) from twists as Pinocchio has them for a root at the origin to those for a root placed elsewhere."""
    if reference == "local":
        return np.eye(6)
    turn = pin.SE3(root.rotation, np.zeros(3)) if reference == "local_world_aligned" else root
    action: np.ndarray = turn.action
    return action


def _with_payload(robot: RobotModel, payload: Sequence[requests.Payload]) -> Any:
    model = robot.model.copy()
    for index, one in enumerate(payload):
        if one.link not in robot.links:
            available = list(robot.links)
            raise UnknownFrame(
                f"`payload[{index}]`: the robot has no link {one.link!r}; it has {', '.join(available)}",
                link=one.link,
                available=available,
            )
        frame = model.frames[robot.frame_id(one.link)]
        inertia = payload_inertia(one.mass, one.centre_of_mass, one.inertia, f"payload[{index}]")
        model.appendBodyToJoint(frame.parentJoint, inertia, frame.placement)
    return model


def _require_mass(robot: RobotModel, model: Any) -> None:
    if not any(inertia.mass > 0.0 for inertia in list(model.inertias)[1:]):
        raise RobotInvalid(
            f"robot {robot.name!r} has no inertia: none of its moving links has an <inertial> with a <mass>, so there "
            "is no dynamics; add these to the URDF, or a `payload` to the request",
            robot=robot.name,
        )


def _symmetric(upper: np.ndarray) -> np.ndarray:
    whole: np.ndarray = np.triu(upper) + np.triu(upper, 1).T
    return whole


def _mass_warnings(robot: RobotModel, model: Any) -> list[str]:
    masses = np.array([inertia.mass for inertia in model.inertias])
    without = [
        joint.name
        for joint in robot.joints
        if masses[list(model.subtrees[joint.index])].sum() == 0.0 and joint.mimic is None
    ]
    if not without:
        return []
    return [f"no link that {', '.join(without)} move has a mass: their rows of the dynamics are 0"]
