"""Answer kinematics requests, but for Jacobians and dynamics: frames, inverse kinematics, clearances, and the field.

A new kind of request is a line in `_ANSWERS`, and messages in messages/kinematics.py; order of rows and columns of
replies is the wire.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar, cast

import msgspec
import numpy as np

from guidefield.collision.clearance import ClearanceAt, blocking_pairs, clearance_gradient
from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.errors import InvalidConfiguration, at_path
from guidefield.geometry.surfaces import se3
from guidefield.handlers.attached import holding
from guidefield.handlers.configurations import (
    batches,
    configurations_from,
    frame_ids,
    model_configurations,
    pack_numbers,
    require_time,
    whole_group,
)
from guidefield.handlers.dynamics import dynamics, jacobian
from guidefield.kernels.field.field import exact, field_at_points
from guidefield.kernels.kinematics.forward_kinematics import FrameTable, place_frames
from guidefield.memo import memoized
from guidefield.memory import pause_collector
from guidefield.messages import requests, scene as scene_messages
from guidefield.messages.kinematics import PackedClearance
from guidefield.messages.replies import (
    ClearanceReply,
    ForwardKinematicsReply,
    InverseKinematicsReply,
    LinkWrench,
    PointPotentialReply,
    RobotPotentialReply,
)
from guidefield.messages.values import Placement, QuaternionXYZW, Reply, Vector3
from guidefield.potential import RobotField
from guidefield.prove.closest import ClosestPairs
from guidefield.read_only import read_only
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.inverse_kinematics import PoseTarget, solve
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import CLAMP_TOLERANCE, configuration_from_wire, configuration_to_wire
from guidefield.robot.model.joints import ModelConfiguration, RobotConfiguration, RobotConfigurations
from guidefield.robot.model.model import RobotModel
from guidefield.scene import scene as scenes
from guidefield.scene.scene import Scene

FRAMES_PER_CHECK = 1024
"""Configurations between two checks of the deadline: about a millisecond. For more, a reply pauses the collector."""
POINTS_PER_CHECK = 4096
"""Points at which the field is computed between two checks of the deadline.

A multiple of `LANES` of `kernels/field/field.py`, which evaluates as many together: else bits of replies change.
"""

_Item = TypeVar("_Item")


def answer_kinematics(
    request: requests.KinematicsRequest,
    robot: RobotModel | None,
    scene: Scene | None,
    deadline: Deadline = UNLIMITED,
) -> Reply:
    """The reply to a request of any kind, with the warnings of robot and scene before its own.

    Raises DeadlineExpired if the deadline passed before all is answered; its details say how many are; GuidefieldError
    as the function of its kind in `_ANSWERS`.
    """
    reply = _ANSWERS[type(request)](request, robot, scene, deadline)
    warnings = [warning for one in (robot, scene) if one is not None for warning in one.warnings]
    answered: Reply = msgspec.structs.replace(reply, warnings=warnings + reply.warnings)
    return answered


def _warn_beyond_limits(robot: RobotModel, configurations: RobotConfigurations, field: str) -> list[str]:
    """Warn about each joint that a configuration of (n, nq) has beyond its limits: it is answered anyway."""
    warnings = []
    for joint in robot.joints if len(configurations) else ():
        if joint.limits is None:
            continue
        lower, upper = joint.limits
        values = configurations[:, joint.idx_q]
        excess = np.maximum(lower - values, values - upper)
        worst = int(np.argmax(excess))
        if excess[worst] > CLAMP_TOLERANCE:
            warnings.append(
                f"`{field}[{worst}]` has joint {joint.name} at {values[worst]:.6g}, {excess[worst]:.3g} beyond its"
                f" limits [{lower:.6g}, {upper:.6g}]; limits don't count here"
            )
    return warnings


def forward_kinematics(
    request: requests.ForwardKinematics,
    robot: RobotModel,
    _scene: Scene | None = None,
    deadline: Deadline = UNLIMITED,
) -> ForwardKinematicsReply:
    """Placements of frames in the world.

    Raises UnknownFrame if the robot lacks a frame; InvalidConfiguration if a configuration doesn't fit the robot.
    """
    frames = _frame_table(robot, tuple(request.frames))
    root = _rows_of(request.robot_placement.position, request.robot_placement.quaternion_xyzw)
    configurations, joints = configurations_from(robot, request.configurations), robot.joint_table
    placements = np.empty((len(configurations), len(request.frames), 7))
    for some in batches(deadline, len(configurations), FRAMES_PER_CHECK):
        place_frames(joints, frames, root, configurations[some], placements[some])
    if request.packed:
        return ForwardKinematicsReply(placements=[], packed=pack_numbers(placements))
    with (
        pause_collector() if len(placements) > FRAMES_PER_CHECK else contextlib.nullcontext()
    ):  # all that is made stays
        listed = [
            [Placement((x, y, z), (a, b, c, d)) for x, y, z, a, b, c, d in of_frames]
            for of_frames in placements.tolist()
        ]
    return ForwardKinematicsReply(placements=listed)


def inverse_kinematics(
    request: requests.InverseKinematics,
    robot: RobotModel,
    scene: Scene | None = None,
    deadline: Deadline = UNLIMITED,
) -> InverseKinematicsReply:
    """Distinct configurations of the planned joints that bring the tip to each pose.

    Joints outside the group have the values of the first start configuration, else those of the rest configuration.

    Raises InvalidGroup if the group cannot be planned for; UnknownFrame if the robot lacks the tip, or a link that
    holds something; UnknownObject if a pair that may touch is of nothing there, or what is held has a name that is
    taken; InvalidConfiguration if a start configuration doesn't fit the robot, or differs from the first in a joint
    outside the group.
    """
    obstacles = scene or scenes.build(scene_messages.Scene(name="empty"))
    robot = holding(robot, request.attached_objects, obstacles, deadline)
    starts = []
    for index, positions in enumerate(request.start_configurations):
        with at_path(f"$.start_configurations[{index}]"):
            starts.append(configuration_from_wire(robot, positions))
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
    accept = None
    if world is not None:  # what is closer than `prove.closest.NEARLY`, 10 um, counts as contact without Coal
        closest = ClosestPairs(world)
        accept = lambda zs: closest.free(group.expand_each(zs), confirmed=False)  # noqa: E731
    configurations, reasons = [], []
    for index, pose in enumerate(_within(deadline, request.poses)):
        result = solve(
            group,
            PoseTarget.from_wire(pose),
            [group.to_local(group.part_of(start)) for start in starts],
            request.solutions,
            rng=np.random.default_rng([request.seed, index]),
            accept=accept,
            deadline=deadline,
        )
        require_time(deadline, index, len(request.poses))
        configurations.append([configuration_to_wire(group.joints, group.from_local(z)) for z in result.solutions])
        reasons.append(result.reason)
        if world is not None and not result.solutions:
            met = blocking_pairs(world, [group.expand_from_local(z) for z in result.rejected])
            reasons[-1] += f": {met.describe()}" if met.counts else ""
    given = cast(RobotConfigurations, np.array(starts).reshape(-1, robot.model.nq))
    warnings = _warn_beyond_limits(robot, given, "start_configurations")
    return InverseKinematicsReply(configurations=configurations, reasons=reasons, warnings=warnings)


def clearance(
    request: requests.Clearance, robot: RobotModel, scene: Scene, deadline: Deadline = UNLIMITED
) -> ClearanceReply:
    """Exact distances of the moving links to the obstacles, and of the robot to itself.

    Raises InvalidConfiguration if a configuration doesn't fit the robot; UnknownFrame or UnknownObject as
    `inverse_kinematics`.
    """
    robot = holding(robot, request.attached_objects, scene, deadline)
    group = whole_group(robot, request.robot_placement)
    world = World.build(group, scene, request.allowed_collisions)
    closest, configurations = ClosestPairs(world), configurations_from(robot, request.configurations)
    found = _Clearances(world, request.gradients, request.contacts)
    free: list[bool] = []
    for some in batches(deadline, len(configurations)):
        batch = model_configurations(group, configurations[some])
        if request.verdict:
            free += closest.free(batch).tolist()
            continue
        for q, one in zip(batch, closest.clearances(batch), strict=True):
            found.add(q, one)
    warnings = _warn_beyond_limits(robot, configurations, "configurations")
    if request.verdict:
        return ClearanceReply(minimum=[], pair=[], witness_points=[], self_minimum=[], free=free, warnings=warnings)
    reply = found.as_packed() if request.packed else found.as_lists()
    return msgspec.structs.replace(reply, warnings=warnings)


def potential(
    request: requests.Potential, robot: RobotModel | None, scene: Scene, deadline: Deadline = UNLIMITED
) -> PointPotentialReply | RobotPotentialReply:
    """The scene's field on unit charges at points, or on the robot at configurations.

    Raises InvalidConfiguration if a configuration doesn't fit the robot.
    """
    if robot is None:
        return _at_points(request.points or [], scene, deadline)
    group = whole_group(robot, request.robot_placement)
    robot_field = RobotField(group, scene)
    energies: list[float] = []
    forces: list[list[float]] = []
    links: dict[str, LinkWrench] = {}
    for q in _within(deadline, [*map(group.part_of, configurations_from(robot, request.configurations or []))]):
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


class _Clearances:
    def __init__(self, world: World, gradients: bool, contacts: bool) -> None:
        self._world = world
        self._found: list[ClearanceAt] = []
        self._gradients: list[tuple[np.ndarray | None, np.ndarray | None]] | None = [] if gradients else None
        self._contacts: list[list[list[str]]] | None = [] if contacts else None

    def add(self, q: ModelConfiguration, one: ClearanceAt) -> None:
        self._found.append(one)
        if self._gradients is not None:
            own, obstacle = (clearance_gradient(self._world, q, one, own=own) for own in (True, False))
            self._gradients.append((obstacle, own))
        if self._contacts is not None:
            self._contacts.append([list(pair) for pair in blocking_pairs(self._world, [q]).counts])

    def as_lists(self) -> ClearanceReply:
        found = self._found
        gradient = own = None
        if self._gradients is not None:
            gradient, own = (
                [None if row is None else row.tolist() for row in (both[k] for both in self._gradients)] for k in (0, 1)
            )
        return ClearanceReply(
            minimum=[_finite(one.obstacle_distance) for one in found],
            pair=[None if one.obstacle_pair is None else list(one.obstacle_pair) for one in found],
            witness_points=[None if one.witness is None else [*map(_vector, one.witness)] for one in found],
            self_minimum=[_finite(one.self_distance) for one in found],
            contacts=self._contacts,
            gradient=gradient,
            self_gradient=own,
            velocity_names=None if gradient is None else self._world.group.velocity_names,
        )

    def as_packed(self) -> ClearanceReply:
        found, numbers = self._found, dict[tuple[str, str], int]()
        pair = [-1 if (p := one.obstacle_pair) is None else numbers.setdefault(p, len(numbers)) for one in found]
        nowhere, no_slope = np.full((2, 3), np.nan), np.full(self._world.group.nv, np.nan)
        numbers_packed = PackedClearance(
            minimum=pack_numbers(_or_nan([one.obstacle_distance for one in found])),
            self_minimum=pack_numbers(_or_nan([one.self_distance for one in found])),
            witness_points=pack_numbers(
                _rows([nowhere if one.witness is None else one.witness for one in found], (2, 3))
            ),
            pairs=[list(names) for names in numbers],
            pair=pack_numbers(np.array(pair, float)),
        )
        if self._gradients is not None:
            slopes = [
                _rows([no_slope if g[k] is None else g[k] for g in self._gradients], no_slope.shape) for k in (0, 1)
            ]
            numbers_packed = msgspec.structs.replace(
                numbers_packed, gradient=pack_numbers(slopes[0]), self_gradient=pack_numbers(slopes[1])
            )
        names = None if self._gradients is None else self._world.group.velocity_names
        return ClearanceReply(
            minimum=[], pair=[], witness_points=[], self_minimum=[], contacts=self._contacts, velocity_names=names,
            packed=numbers_packed,
        )  # fmt: skip


_ANSWERS: dict[type, Callable[[Any, Any, Any, Deadline], Any]] = {
    requests.ForwardKinematics: forward_kinematics,
    requests.InverseKinematics: inverse_kinematics,
    requests.Clearance: clearance,
    requests.Potential: potential,
    requests.Jacobian: jacobian,
    requests.Dynamics: dynamics,
}


def _at_points(points: Sequence[Vector3], scene: Scene, deadline: Deadline) -> PointPotentialReply:
    tables = exact(scene.tables)
    potentials: list[float] = []
    gradients: list[Vector3] = []
    windings: list[float] = []
    for begin in range(0, len(points), POINTS_PER_CHECK):
        require_time(deadline, begin, len(points))
        some = np.array(points[begin : begin + POINTS_PER_CHECK], float)
        field = field_at_points(tables, some)
        potentials += field.potential.tolist()
        gradients += [_vector(gradient) for gradient in field.gradient]
        windings += field.winding.tolist()
    return PointPotentialReply(potential=potentials, gradient=gradients, winding=windings)


def _within(deadline: Deadline, items: Sequence[_Item]) -> Iterator[_Item]:
    for done, one in enumerate(items):
        require_time(deadline, done, len(items))
        yield one


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
                path=f"$.{field}.{joint.name}",
            )


@functools.lru_cache(16)
def _rows_of(position: Vector3, quaternion_xyzw: QuaternionXYZW) -> np.ndarray:
    return np.ascontiguousarray(se3(position, quaternion_xyzw).homogeneous[:3])


@memoized
def _frame_table(robot: RobotModel, names: tuple[str, ...]) -> FrameTable:
    frames = [robot.model.frames[index] for index in frame_ids(robot, names)]
    table = FrameTable(
        np.array([frame.parentJoint for frame in frames], np.int64),
        np.array([frame.placement.homogeneous[:3] for frame in frames]).reshape(-1, 3, 4),
    )
    read_only(*table)
    return table


def _or_nan(distances: Sequence[float]) -> np.ndarray:
    found = np.array(distances, float)
    found[np.isinf(found)] = np.nan
    return found


def _rows(rows: Sequence[np.ndarray | None], shape: tuple[int, ...]) -> np.ndarray:
    return np.array(rows, float).reshape(len(rows), *shape)


def _vector(values: np.ndarray) -> Vector3:
    x, y, z = values.tolist()
    return x, y, z


def _finite(distance: float) -> float | None:
    return float(distance) if np.isfinite(distance) else None
