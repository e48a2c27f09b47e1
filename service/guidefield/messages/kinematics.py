"""Requests about configurations, poses and points, one or a batch of them in one request, each with its reply.

A new kind stands here, request and reply, in the unions and in `_REPLIES`, and is answered by a function in `_ANSWERS`
of handlers/kinematics.py. Replies are in the order of the request; numbers come as lists, many also packed.

Names, order, defaults and meanings of fields are the wire and the Python API: a new one comes last. Docstrings of
messages, and `DEFAULT_TIME`, are in the schemas, that also in docs/wire.md, once by hand: then `tools/wire_page`.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from guidefield.messages.conditions import (
    MOST_POINTS,
    MOST_POSES,
    MOST_STARTS,
    AllowedCollisions,
    AttachedObjects,
    ConfigurationBatch,
    JointRates,
    PackedNumbers,
    Payload,
    RobotReference,
    SceneReference,
    TargetPose,
    require_finite_batch,
    require_finite_points,
    require_rates,
    settle_scene,
)
from guidefield.messages.plan_reply import Rows
from guidefield.messages.values import (
    AllowedTime,
    Message,
    Name,
    Placement,
    Positions,
    Reply,
    RunId,
    Vector3,
    require_finite,
    require_finite_configurations,
)

DEFAULT_TIME = 60.0
"""Default of the allowed time of a request [s]."""


class ForwardKinematics(Message, tag_field="type", tag="forward_kinematics"):
    """Placements of frames at configurations.

    Attributes:
        robot: The robot.
        frames: Their names.
        configurations: Joints left out are at the robot's rest configuration.
        robot_placement: Of the robot's root in the world.
        packed: Whether the reply packs its numbers.
        request_id: A name by which it can be cancelled; null: none.
        allowed_time: From the request's arrival, queue and loading included [s].
    """

    robot: RobotReference
    frames: Annotated[list[Name], msgspec.Meta(min_length=1, max_length=1_000)]
    configurations: ConfigurationBatch
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()
    packed: bool = False
    request_id: RunId | None = None
    allowed_time: AllowedTime = DEFAULT_TIME

    def __post_init__(self) -> None:
        require_finite_batch("configurations", self.configurations)


class ForwardKinematicsReply(Reply):
    """Placements of frames in the world.

    Attributes:
        placements: By configuration, then by frame; empty if the request has `packed`.
        packed: The same as positions [m] and unit quaternions (x, y, z, w), shape (configurations, frames, 7).
        warnings: Harmless peculiarities of the robot or the scene.
    """

    placements: list[list[Placement]]
    packed: PackedNumbers | None = None
    warnings: list[str] = []
    schema: int = 1


class InverseKinematics(Message, tag_field="type", tag="inverse_kinematics"):
    """Distinct configurations that bring the tip to each pose.

    Attributes:
        robot: The robot.
        poses: The poses.
        robot_placement: Of the robot's root in the world.
        tip: Name of the frame that reaches the poses; null: the robot's own.
        group: Joints that may move, as in `PlanRequest`.
        scene: The obstacles.
        collision_free: Whether solutions must be free of collision.
        attached_objects: Objects held by links; with `collision_free` they must touch nothing either.
        allowed_collisions: Pairs of links and obstacles that may touch.
        start_configurations: Starts of the search, before random ones; joints outside the group are as in the first.
        solutions: The number of solutions to search for at each pose.
        seed: Of the random starts.
        request_id: A name by which it can be cancelled; null: none.
        allowed_time: From the request's arrival, queue and loading included [s].
    """

    robot: RobotReference
    poses: Annotated[list[TargetPose], msgspec.Meta(max_length=MOST_POSES)]
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()
    tip: Name | None = None
    group: str | list[Name] | None = None
    scene: SceneReference | None = None
    collision_free: bool = False
    attached_objects: AttachedObjects = []
    allowed_collisions: AllowedCollisions = []
    start_configurations: Annotated[list[Positions], msgspec.Meta(max_length=MOST_STARTS)] = []
    solutions: Annotated[int, msgspec.Meta(ge=1, le=1_000)] = 8
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**53)] = 0
    request_id: RunId | None = None
    allowed_time: AllowedTime = DEFAULT_TIME

    def __post_init__(self) -> None:
        settle_scene(self)
        require_finite_configurations("start_configurations", self.start_configurations)


class InverseKinematicsReply(Reply):
    """Distinct solutions of each pose.

    Attributes:
        configurations: By pose.
        reasons: By pose, the reason for fewer solutions than requested; else empty.
        warnings: Harmless peculiarities of the robot or the scene.
    """

    configurations: list[list[Positions]]
    reasons: list[str]
    warnings: list[str] = []
    schema: int = 1


class Clearance(Message, tag_field="type", tag="clearance"):
    """Distance of the robot's moving links to the obstacles, and to themselves, at configurations.

    Attributes:
        robot: The robot.
        scene: The obstacles.
        configurations: Joints left out are at the robot's rest configuration.
        robot_placement: Of the robot's root in the world.
        attached_objects: Objects held by links; they are measured as links.
        allowed_collisions: Pairs of links and obstacles that may touch, and aren't measured.
        contacts: Whether the reply lists the pairs in contact.
        verdict: Whether the reply has only `free`, in a fraction of the time; its other lists are empty.
        gradients: Whether the reply has the gradients of both distances by the joints.
        packed: Whether the reply packs its numbers.
        request_id: A name by which it can be cancelled; null: none.
        allowed_time: From the request's arrival, queue and loading included [s].
    """

    robot: RobotReference
    scene: SceneReference
    configurations: ConfigurationBatch
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()
    attached_objects: AttachedObjects = []
    allowed_collisions: AllowedCollisions = []
    contacts: bool = False
    verdict: bool = False
    gradients: bool = False
    packed: bool = False
    request_id: RunId | None = None
    allowed_time: AllowedTime = DEFAULT_TIME

    def __post_init__(self) -> None:
        settle_scene(self)
        require_finite_batch("configurations", self.configurations)
        if self.verdict and (self.contacts or self.gradients):
            raise ValueError(
                "`verdict` asks whether configurations are free alone: leave out `contacts` and `gradients`"
            )


class PackedClearance(Reply):
    """The lists of a clearance reply, packed as `PackedNumbers`; NaN instead of null.

    Attributes:
        minimum, self_minimum: Shape (n,) [m].
        witness_points: Shape (n, 2, 3) [m, world].
        pairs: Every closest link and obstacle, once.
        pair: Index into `pairs` by configuration, shape (n,); -1 for none.
        gradient, self_gradient: Shape (n, columns of `velocity_names`); null unless requested.
    """

    minimum: PackedNumbers
    self_minimum: PackedNumbers
    witness_points: PackedNumbers
    pairs: list[list[str]]
    pair: PackedNumbers
    gradient: PackedNumbers | None = None
    self_gradient: PackedNumbers | None = None


class ClearanceReply(Reply):
    """Clearance, by configuration: signed where both shapes are convex, else 0 in contact; null without such a pair.

    Attributes:
        minimum: Smallest distance of moving links to obstacles [m].
        pair: The closest link and obstacle.
        witness_points: Their closest points [m, world].
        self_minimum: Smallest distance of the robot to itself [m].
        contacts: Pairs that touch, or of which one is wholly inside the other; null unless requested.
        free: Whether nothing touches and nothing is wholly inside something else; null unless requested by `verdict`.
        gradient: Derivatives of `minimum` in the columns of `velocity_names` [m per rad or m]; null unless
            requested, and at configurations without such a pair, or whose pair touches so that none is defined.
        self_gradient: The same of `self_minimum`.
        velocity_names: Columns of the gradients, in the tangent space.
        packed: The packed lists, instead of those above.
        warnings: Harmless peculiarities of the robot or the scene.
    """

    minimum: list[float | None]
    pair: list[list[str] | None]
    witness_points: list[list[Vector3] | None]
    self_minimum: list[float | None]
    contacts: list[list[list[str]]] | None = None
    free: list[bool] | None = None
    gradient: list[list[float] | None] | None = None
    self_gradient: list[list[float] | None] | None = None
    velocity_names: list[str] | None = None
    packed: PackedClearance | None = None
    warnings: list[str] = []
    schema: int = 1


class Potential(Message, tag_field="type", tag="potential"):
    """The field of a scene at points (a unit point charge each), or on a robot at configurations.

    Attributes:
        scene: The charged obstacles.
        points: The points [m, world].
        robot: The robot, if no points are given.
        robot_placement: Of its root in the world.
        configurations: Joints left out are at the robot's rest configuration.
        request_id: A name by which it can be cancelled; null: none.
        allowed_time: From the request's arrival, queue and loading included [s].
    """

    scene: SceneReference
    schema: Literal[1] = 1
    points: Annotated[list[Vector3], msgspec.Meta(max_length=MOST_POINTS)] | None = None
    robot: RobotReference | None = None
    robot_placement: Placement = Placement()
    configurations: ConfigurationBatch | None = None
    request_id: RunId | None = None
    allowed_time: AllowedTime = DEFAULT_TIME

    def __post_init__(self) -> None:
        settle_scene(self)
        by_points = self.points is not None
        by_robot = self.robot is not None and self.configurations is not None
        if by_points == by_robot or (self.robot is None) != (self.configurations is None):
            raise ValueError("give either `points`, or `robot` with `configurations`")
        require_finite_points("points", self.points or ())
        require_finite_batch("configurations", self.configurations or [])


class PointPotentialReply(Reply):
    """The field on a unit charge, by point.

    Attributes:
        potential: [1/m].
        gradient: [1/m^2], in the world.
        winding: Winding number of the solids around the point: 0 outside.
        warnings: Harmless peculiarities of the robot or the scene.
    """

    potential: list[float]
    gradient: list[Vector3]
    winding: list[float]
    warnings: list[str] = []
    schema: int = 1


class LinkWrench(Reply):
    """The wrench of the field on one link, by configuration, in the world's axes.

    Attributes:
        force: [1].
        torque: About the origin of the joint that moves the link [m].
    """

    force: list[Vector3]
    torque: list[Vector3]


class RobotPotentialReply(Reply):
    """The field on a robot, by configuration.

    Attributes:
        potential: U [m].
        generalized_force: -dU/dv, in the columns of `velocity_names`.
        velocity_names: Names of the columns, in the tangent space.
        links: By name.
        warnings: Harmless peculiarities of the robot or the scene.
    """

    potential: list[float]
    generalized_force: Rows
    velocity_names: list[str]
    links: dict[str, LinkWrench]
    warnings: list[str] = []
    schema: int = 1


ReferenceFrame = Literal["local", "world", "local_world_aligned"]
"""Frame in which twists are expressed, by Pinocchio's names: in the frame's own axes at its origin, in the world's
axes at the world's origin, or in the world's axes at the frame's origin."""


class Jacobian(Message, tag_field="type", tag="jacobian"):
    """Jacobians of frames at configurations: their twists by the velocities of the joints.

    Attributes:
        robot: The robot.
        frames: Their names.
        configurations: Joints left out are at the robot's rest configuration.
        robot_placement: Of the robot's root in the world.
        reference_frame: The frame in which twists are expressed.
        velocities: Velocities of the joints, one for each configuration in the reply's columns [rad/s or m/s]: the
            reply has the frames' twists, too. A joint left out stands still.
        packed: Whether the reply packs its numbers.
        request_id: A name by which it can be cancelled; null: none.
        allowed_time: From the request's arrival, queue and loading included [s].
    """

    robot: RobotReference
    frames: Annotated[list[Name], msgspec.Meta(min_length=1, max_length=1_000)]
    configurations: ConfigurationBatch
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()
    reference_frame: ReferenceFrame = "local_world_aligned"
    velocities: JointRates | None = None
    packed: bool = False
    request_id: RunId | None = None
    allowed_time: AllowedTime = DEFAULT_TIME

    def __post_init__(self) -> None:
        require_finite_batch("configurations", self.configurations)
        require_rates("velocities", self.velocities, self.configurations)


class JacobianReply(Reply):
    """Jacobians of frames; rows are those of a twist: linear velocity first, then angular, as Pinocchio has them.

    Attributes:
        jacobian: By configuration, then by frame; six rows in the columns of `velocity_names`. Empty if the request
            has `packed`.
        velocity_names: Names of the columns, in the tangent space.
        twist: By configuration, then by frame [m/s, rad/s]; null unless velocities were given.
        packed: The Jacobians, shape (configurations, frames, 6, columns).
        packed_twist: The twists, shape (configurations, frames, 6).
        warnings: Harmless peculiarities of the robot or the scene.
    """

    jacobian: list[list[Rows]]
    velocity_names: list[str]
    twist: list[Rows] | None = None
    packed: PackedNumbers | None = None
    packed_twist: PackedNumbers | None = None
    warnings: list[str] = []
    schema: int = 1


DynamicsQuantity = Literal["inverse_dynamics", "gravity", "mass_matrix", "centre_of_mass"]


class Dynamics(Message, tag_field="type", tag="dynamics"):
    """Rigid-body dynamics at configurations, without friction and the inertia of rotors.

    Attributes:
        robot: The robot; it needs `<inertial>` elements.
        configurations: Joints left out are at the robot's rest configuration.
        quantities: The results: "inverse_dynamics", the torques or forces that drive the joints with the given
            velocities and accelerations; "gravity", those that hold the robot still; "mass_matrix";
            "centre_of_mass", of the whole robot and its payload, in the world.
        robot_placement: Of the robot's root in the world.
        velocities: Of the joints, one for each configuration [rad/s or m/s]; null: they are zero.
        accelerations: The same [rad/s^2 or m/s^2].
        gravity: Acceleration of free fall [m/s^2, world].
        payload: Loads on links.
        packed: Whether the reply packs its numbers.
        request_id: A name by which it can be cancelled; null: none.
        allowed_time: From the request's arrival, queue and loading included [s].
    """

    robot: RobotReference
    configurations: ConfigurationBatch
    quantities: Annotated[list[DynamicsQuantity], msgspec.Meta(min_length=1, max_length=4)]
    schema: Literal[1] = 1
    robot_placement: Placement = Placement()
    velocities: JointRates | None = None
    accelerations: JointRates | None = None
    gravity: Vector3 = (0.0, 0.0, -9.81)
    payload: Annotated[list[Payload], msgspec.Meta(max_length=1_000)] = []
    packed: bool = False
    request_id: RunId | None = None
    allowed_time: AllowedTime = DEFAULT_TIME

    def __post_init__(self) -> None:
        require_finite_batch("configurations", self.configurations)
        require_rates("velocities", self.velocities, self.configurations)
        require_rates("accelerations", self.accelerations, self.configurations)
        require_finite("gravity", self.gravity)
        if self.accelerations is not None and "inverse_dynamics" not in self.quantities:
            raise ValueError("`accelerations` are for `inverse_dynamics`, which `quantities` doesn't have")


class DynamicsReply(Reply):
    """Dynamics, by configuration; quantities that the request doesn't name are null.

    Attributes:
        velocity_names: Names of the columns, in the tangent space.
        mass: Of the whole robot and its payload [kg].
        inverse_dynamics: Torques or forces in the columns of `velocity_names` [N m or N].
        gravity: The same that hold the robot still.
        mass_matrix: Symmetric, in these columns.
        centre_of_mass: Of the robot and its payload [m, world].
        packed: The packed fields by name; the fields above are null then.
        warnings: Harmless peculiarities of the robot or the scene.
    """

    velocity_names: list[str]
    mass: float
    inverse_dynamics: Rows | None = None
    gravity: Rows | None = None
    mass_matrix: list[Rows] | None = None
    centre_of_mass: list[Vector3] | None = None
    packed: dict[str, PackedNumbers] | None = None
    warnings: list[str] = []
    schema: int = 1


KinematicsRequest = ForwardKinematics | InverseKinematics | Clearance | Potential | Jacobian | Dynamics

KinematicsReply = (
    ForwardKinematicsReply
    | InverseKinematicsReply
    | ClearanceReply
    | PointPotentialReply
    | JacobianReply
    | DynamicsReply
    | RobotPotentialReply
)

_REPLIES: dict[type, type[KinematicsReply]] = {
    ForwardKinematics: ForwardKinematicsReply,
    InverseKinematics: InverseKinematicsReply,
    Clearance: ClearanceReply,
    Jacobian: JacobianReply,
    Dynamics: DynamicsReply,
}


def kinematics_reply_kind(request: KinematicsRequest) -> type[KinematicsReply]:
    """Return the type of the reply to a request."""
    if isinstance(request, Potential):
        return RobotPotentialReply if request.points is None else PointPotentialReply
    return _REPLIES[type(request)]
