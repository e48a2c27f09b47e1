"""The kinematics requests: where frames are, what reaches a pose, how near obstacles are, and their field."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, TypeVar

import msgspec
import numpy as np
import pinocchio as pin

from guidefield.collision.blocking_pairs import blocking_pairs
from guidefield.collision.clearance import clearance_at
from guidefield.collision.enclosure import enclosed_each
from guidefield.collision.world import World
from guidefield.errors import InvalidConfiguration
from guidefield.geometry.placements import se3
from guidefield.handlers.allowance import UNLIMITED, Allowance
from guidefield.handlers.attached import holding
from guidefield.kernels.field.field import field_at_points
from guidefield.kernels.field.field_tables import exact
from guidefield.messages import requests, scene as scene_messages
from guidefield.messages.replies import (
    ClearanceReply,
    ForwardKinematicsReply,
    InverseKinematicsReply,
    LinkWrench,
    PointPotentialReply,
    RobotPotentialReply,
)
from guidefield.messages.values import Placement, Reply, Vector3
from guidefield.potential import RobotField
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.robot.ik.inverse_kinematics import solve
from guidefield.robot.ik.pose_target import PoseTarget
from guidefield.robot.model.configuration import configuration_from_wire, configuration_to_wire
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.spaces import ChartPoints, RobotConfiguration
from guidefield.scene import scene as scenes
from guidefield.scene.scene import Scene

POINTS_AT_ONCE = 4096
"""At so many points the field is found before it is asked whether to go on."""

_Asked = TypeVar("_Asked")


def answer_kinematics(
    request: requests.KinematicsRequest,
    robot: RobotModel | None,
    scene: Scene | None,
    allowance: Allowance = UNLIMITED,
) -> Reply:
    """The reply to a request of any kind, with what is odd about robot and scene.

    Raises:
        TimedOut, Preempted: if time is up, or somebody asked to stop, before all is answered.
        GuidefieldError: as its own function.
    """
    reply = _ANSWERS[type(request)](request, robot, scene, allowance)
    warnings = [warning for one in (robot, scene) if one is not None for warning in one.warnings]
    return msgspec.structs.replace(reply, warnings=warnings)


def forward_kinematics(
    request: requests.ForwardKinematics,
    robot: RobotModel,
    _scene: Scene | None = None,
    allowance: Allowance = UNLIMITED,
) -> ForwardKinematicsReply:
    """Placements of frames in the world.

    Raises:
        UnknownFrame: if the robot lacks a frame.
        InvalidConfiguration: if a configuration doesn't fit the robot.
    """
    frames = [robot.frame_id(name) for name in request.frames]
    T_world_root, data = (
        se3(request.robot_placement.position, request.robot_placement.quaternion_xyzw),
        robot.model.createData(),
    )
    placements = []
    for positions in _within(allowance, request.configurations):
        pin.forwardKinematics(robot.model, data, configuration_from_wire(robot, positions))
        local = [pin.updateFramePlacement(robot.model, data, frame) for frame in frames]
        placements.append([_placement(T_world_root * T_root_frame) for T_root_frame in local])
    return ForwardKinematicsReply(placements=placements)


def inverse_kinematics(
    request: requests.InverseKinematics,
    robot: RobotModel,
    scene: Scene | None = None,
    allowance: Allowance = UNLIMITED,
) -> InverseKinematicsReply:
    """Distinct configurations of the planned joints that bring the tip to each pose.

    Joints outside the group have the values of the first start configuration, else those of the rest configuration.

    Raises:
        InvalidGroup: if the group cannot be planned for.
        UnknownFrame: if the robot lacks the tip, or a link that holds something.
        UnknownObject: if a pair that may touch is of nothing there, or what is held has a name that is taken.
        InvalidConfiguration: if a start configuration doesn't fit the robot, or differs from the first in a joint
            outside the group.
    """
    obstacles = scene or _empty_scene()
    robot = holding(robot, request.attached_objects, obstacles)
    starts = [configuration_from_wire(robot, positions) for positions in request.start_configurations]
    reference = starts[0] if starts else robot.rest
    group = select(
        robot,
        request.group,
        request.tip,
        reference,
        se3(request.robot_placement.position, request.robot_placement.quaternion_xyzw),
    )
    for index, start in enumerate(starts):
        _require_same_outside(group, start, f"start_configurations[{index}]")
    world = World.build(group, obstacles, request.allowed_collisions) if request.collision_free else None
    configurations, reasons = [], []
    for index, pose in enumerate(_within(allowance, request.poses)):
        result = solve(
            group,
            PoseTarget.from_wire(pose),
            [group.chart(group.part_of(start)) for start in starts],
            request.solutions,
            rng=np.random.default_rng([request.seed, index]),
            accept=None if world is None else partial(_are_free, world),
            stopped=allowance.spent,
        )
        allowance.require_more(index, len(request.poses))
        configurations.append([configuration_to_wire(group.joints, group.from_chart(z)) for z in result.solutions])
        reasons.append(result.reason)
        if world is not None and not result.solutions:
            met = blocking_pairs(world, [group.expand_from_chart(z) for z in result.rejected])
            reasons[-1] += f": {met.told()}" if met.counts else ""
    return InverseKinematicsReply(configurations=configurations, reasons=reasons)


def clearance(
    request: requests.Clearance, robot: RobotModel, scene: Scene, allowance: Allowance = UNLIMITED
) -> ClearanceReply:
    """Exact distances of the moving links to the obstacles, and of the robot to itself.

    Raises:
        InvalidConfiguration: if a configuration doesn't fit the robot.
        UnknownFrame, UnknownObject: as `inverse_kinematics`.
    """
    robot = holding(robot, request.attached_objects, scene)
    group = _whole_group(robot, request.robot_placement)
    world = World.build(group, scene, request.allowed_collisions)
    found, contacts = [], []
    for positions in _within(allowance, request.configurations):
        q = group.expand(group.part_of(configuration_from_wire(robot, positions)))
        found.append(clearance_at(world, q))
        if request.contacts:
            contacts.append([list(pair) for pair in blocking_pairs(world, [q]).counts])
    return ClearanceReply(
        minimum=[_finite(one.obstacle_distance) for one in found],
        pair=[None if one.obstacle_pair is None else list(one.obstacle_pair) for one in found],
        witness_points=[None if one.witness is None else [_vector(point) for point in one.witness] for one in found],
        self_minimum=[_finite(one.self_distance) for one in found],
        contacts=contacts if request.contacts else None,
    )


def potential(
    request: requests.Potential, robot: RobotModel | None, scene: Scene, allowance: Allowance = UNLIMITED
) -> PointPotentialReply | RobotPotentialReply:
    """The scene's field on unit charges at points, or on the robot at configurations.

    Raises:
        InvalidConfiguration: if a configuration doesn't fit the robot.
    """
    if robot is None:
        return _at_points(request.points or [], scene, allowance)
    group = _whole_group(robot, request.robot_placement)
    robot_field = RobotField(group, scene)
    energies: list[float] = []
    forces: list[list[float]] = []
    links: dict[str, LinkWrench] = {}
    for positions in _within(allowance, request.configurations or []):
        q = group.part_of(configuration_from_wire(robot, positions))
        energy = robot_field.evaluate(q)
        energies.append(energy.potential)
        forces.append((-energy.gradient).tolist())
        for link, (force, torque) in robot_field.link_wrenches(q).items():
            wrench = links.setdefault(link, LinkWrench(force=[], torque=[]))
            wrench.force.append(_vector(force))
            wrench.torque.append(_vector(torque))
    return RobotPotentialReply(
        potential=energies, generalized_force=forces, velocity_names=group.velocity_names, links=links
    )


_ANSWERS: dict[type, Callable[[Any, Any, Any, Allowance], Reply]] = {
    requests.ForwardKinematics: forward_kinematics,
    requests.InverseKinematics: inverse_kinematics,
    requests.Clearance: clearance,
    requests.Potential: potential,
}


def _at_points(points: Sequence[Vector3], scene: Scene, allowance: Allowance) -> PointPotentialReply:
    """The field at points, some of them at a time."""
    tables = exact(scene.tables)
    potentials: list[float] = []
    gradients: list[Vector3] = []
    windings: list[float] = []
    for begin in range(0, len(points), POINTS_AT_ONCE):
        allowance.require_more(begin, len(points))
        some = np.array(points[begin : begin + POINTS_AT_ONCE], float)
        field = field_at_points(tables, some)
        potentials += field.potential.tolist()
        gradients += [_vector(gradient) for gradient in field.gradient]
        windings += field.winding.tolist()
    return PointPotentialReply(potential=potentials, gradient=gradients, winding=windings)


def _within(allowance: Allowance, asked: Sequence[_Asked]) -> Iterator[_Asked]:
    """What was asked, one after the other, as long as there is time."""
    for done, one in enumerate(asked):
        allowance.require_more(done, len(asked))
        yield one


def _whole_group(robot: RobotModel, placement: Placement) -> PlanningGroup:
    """All joints of a robot that don't follow another."""
    joints = [joint.name for joint in robot.joints if joint.mimic is None]
    return select(robot, joints, None, robot.rest, se3(placement.position, placement.quaternion_xyzw))


def _are_free(world: World, zs: ChartPoints) -> np.ndarray:
    """Which chart points (n, nv) touch nothing: (n,), bool."""
    qs = [world.group.expand_from_chart(z) for z in zs]
    free = ~np.array(world.in_collision_each(qs), bool)
    inside = enclosed_each(world, [q for q, one in zip(qs, free, strict=True) if one])
    free[free] = [one is None for one in inside]
    return free


def _require_same_outside(group: PlanningGroup, q_whole: RobotConfiguration, field: str) -> None:
    """Refuse a configuration that differs from the group's reference in a joint that stands still."""
    planned = {joint.name for joint in group.joints}
    for joint in group.robot.joints:
        at = slice(joint.idx_q, joint.idx_q + joint.nq)
        fixed = joint.name not in planned and joint.mimic is None
        if fixed and not np.allclose(q_whole[at], group.q_reference[at], rtol=0.0, atol=1e-9):
            raise InvalidConfiguration(
                f"`{field}.{joint.name}` is outside the group and must be as in the first start configuration",
                joint=joint.name,
                path=f"$.{field}",
            )


def _empty_scene() -> Scene:
    return scenes.build(scene_messages.Scene(name="empty"))


def _placement(placement: Any) -> Placement:
    values = pin.SE3ToXYZQUAT(placement).tolist()
    return Placement(position=tuple(values[:3]), quaternion_xyzw=tuple(values[3:]))


def _vector(values: np.ndarray) -> Vector3:
    x, y, z = values.tolist()
    return x, y, z


def _finite(distance: float) -> float | None:
    return float(distance) if np.isfinite(distance) else None
