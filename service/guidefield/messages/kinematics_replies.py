"""The answers to kinematics requests, in the order asked."""

from __future__ import annotations

from guidefield.messages.goals import Positions
from guidefield.messages.plan_reply import Rows
from guidefield.messages.values import Placement, Reply, Vector3


class ForwardKinematicsReply(Reply):
    """Placements of frames in the world.

    Attributes:
        placements: By configuration, then by frame.
        warnings: What was odd about the robot or the scene but harmless.
        schema: Version of this message.
    """

    placements: list[list[Placement]]
    warnings: list[str] = []
    schema: int = 1


class InverseKinematicsReply(Reply):
    """Distinct solutions of each pose.

    Attributes:
        configurations: By pose.
        reasons: By pose, why there are none or not more; else empty.
        warnings: What was odd about the robot or the scene but harmless.
        schema: Version of this message.
    """

    configurations: list[list[Positions]]
    reasons: list[str]
    warnings: list[str] = []
    schema: int = 1


class ClearanceReply(Reply):
    """Clearance, by configuration: signed where both shapes are convex, else 0 in contact; null without such a pair.

    Attributes:
        minimum: Smallest distance of moving links to obstacles [m].
        pair: The closest link and obstacle.
        witness_points: Their closest points [m, world].
        self_minimum: Smallest distance of the robot to itself [m].
        contacts: Pairs that touch, or of which one is wholly inside the other; null unless they were asked for.
        warnings: What was odd about the robot or the scene but harmless.
        schema: Version of this message.
    """

    minimum: list[float | None]
    pair: list[list[str] | None]
    witness_points: list[list[Vector3] | None]
    self_minimum: list[float | None]
    contacts: list[list[list[str]]] | None = None
    warnings: list[str] = []
    schema: int = 1


class PointPotentialReply(Reply):
    """The field on a unit charge, by point.

    Attributes:
        potential: [1/m].
        gradient: [1/m^2], in the world.
        winding: How often solids wind around the point: 0 outside.
        warnings: What was odd about the robot or the scene but harmless.
        schema: Version of this message.
    """

    potential: list[float]
    gradient: list[Vector3]
    winding: list[float]
    warnings: list[str] = []
    schema: int = 1


class LinkWrench(Reply):
    """What the field does to one link, by configuration, in the world's axes.

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
        warnings: What was odd about the robot or the scene but harmless.
        schema: Version of this message.
    """

    potential: list[float]
    generalized_force: Rows
    velocity_names: list[str]
    links: dict[str, LinkWrench]
    warnings: list[str] = []
    schema: int = 1
