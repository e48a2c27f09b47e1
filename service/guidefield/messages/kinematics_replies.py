"""Replies to kinematics requests, in the order of the request; numbers as lists, many also packed.

Names, meanings and defaults of fields are the wire. Docstrings of messages are in docs/wire.md and the schemas: after a
change, `tools/wire_page`.
"""

from __future__ import annotations

from guidefield.messages.plan_reply import Rows
from guidefield.messages.values import Placement, Positions, Reply, Vector3


class PackedNumbers(Reply):
    """Numbers packed row by row.

    Attributes:
        shape: The size along each axis.
        float64: Little-endian float64: bytes in MessagePack and in Python, base64 text in JSON.

    Examples:
        >>> import numpy as np
        >>> from guidefield.messages.kinematics_replies import PackedNumbers
        >>> packed = PackedNumbers(shape=[2, 1], float64=np.array([[0.5], [1.5]]).tobytes())
        >>> np.frombuffer(packed.float64, "<f8").reshape(packed.shape).tolist()
        [[0.5], [1.5]]
    """

    shape: list[int]
    float64: bytes


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
