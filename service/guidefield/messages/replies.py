"""What the service answers: one Struct per request, and the error that stands in for it."""

from __future__ import annotations

from typing import Any

import msgspec

from guidefield.errors import GuidefieldError
from guidefield.messages.requests import PlanRequest, Positions
from guidefield.messages.robot_replies import (
    GeometryInfo as GeometryInfo,
    JointInfo as JointInfo,
    PairLeftOut as PairLeftOut,
    RobotReply as RobotReply,
    RobotsReply as RobotsReply,
    RobotSummary as RobotSummary,
)
from guidefield.messages.scene import GuidePlane, Scene
from guidefield.messages.service_replies import (
    Histogram as Histogram,
    InfoReply as InfoReply,
    Progress as Progress,
)
from guidefield.messages.values import Placement, Reply, Vector3

Rows = list[list[float]]


class Outcome(Reply):
    """How a plan ended: wire code, its name, one sentence to act on, and the values it speaks about."""

    code: int
    name: str
    message: str
    details: dict[str, Any] = {}


class ErrorReply(Reply):
    """What travels as ``reply_err``."""

    code: int
    name: str
    message: str
    details: dict[str, Any] = {}


class Trajectory(Reply):
    """A motion in time: knots of the certified curve, or samples of it at `sample_rate` [s, rad or m]."""

    times: list[float]
    positions: Rows
    velocities: Rows
    accelerations: Rows


class Stage(Reply):
    """One stage of a plan: what it was, how it ended, how long it took [s]."""

    name: str
    outcome: str
    seconds: float
    plane: int | None = None


class ClearanceFigures(Reply):
    """Distance between moving links and obstacles along the trajectory [m, s]; `pair` is the closest."""

    minimum: float | None
    mean: float | None
    inner: float | None
    ends: float | None
    pair: list[str] | None
    time: float | None


class SelfClearance(Reply):
    """Smallest distance of the robot to itself along the trajectory [m]."""

    minimum: float | None
    pair: list[str] | None


class CertificateFigures(Reply):
    """What was judged, how, and with how many evaluations."""

    collision_free: bool
    method: str
    covers: str
    evaluations: int


class Metrics(Reply):
    """Length, duration and smoothness of a motion [rad, m, s, rad/s^3]."""

    joint_path_length: float
    tip_path_length: float
    duration: float
    peak_jerk: float
    smoothness: float


class Timing(Reply):
    """Seconds by stage; `ends` judges start and goal, `measure` takes the reply's figures."""

    queue: float = 0.0
    load: float = 0.0
    ends: float = 0.0
    connect: float = 0.0
    guide: float = 0.0
    relax: float = 0.0
    parameterize: float = 0.0
    certify: float = 0.0
    measure: float = 0.0
    total: float = 0.0


class Counters(Reply):
    """How often the expensive things were done."""

    iterations: int = 0
    potential_evaluations: int = 0
    collision_checks: int = 0


class PlanReply(Reply):
    """The answer to a plan request, an honest "no" included."""

    run_id: str
    status: Outcome
    position_names: list[str]
    velocity_names: list[str]
    path: Rows
    trajectory: Trajectory | None
    guide_planes: list[GuidePlane]
    stages: list[Stage]
    clearance: ClearanceFigures | None
    self_clearance: SelfClearance | None
    certificate: CertificateFigures
    metrics: Metrics | None
    timing: Timing
    counters: Counters
    seed: int
    planner: str
    recording: str | None
    schema: int = 1
    warnings: list[str] = []


class ForwardKinematicsReply(Reply):
    """Placements, per configuration and frame, in the order asked."""

    placements: list[list[Placement]]
    schema: int = 1


class InverseKinematicsReply(Reply):
    """Distinct solutions per pose; `reasons` says, per pose, why there are none or not more."""

    configurations: list[list[Positions]]
    reasons: list[str]
    schema: int = 1


class ClearanceReply(Reply):
    """Clearance per configuration [m]: signed where both shapes are convex, else 0 in contact."""

    minimum: list[float | None]
    pair: list[list[str] | None]
    witness_points: list[list[Vector3] | None]
    self_minimum: list[float | None]
    schema: int = 1


class PointPotentialReply(Reply):
    """Potential [1/m], its gradient [1/m^2] and the winding number of a unit charge at each point."""

    potential: list[float]
    gradient: list[Vector3]
    winding: list[float]
    schema: int = 1


class LinkWrench(Reply):
    """Force and torque of the field on one link, per configuration; torque about the link's joint."""

    force: list[Vector3]
    torque: list[Vector3]


class RobotPotentialReply(Reply):
    """Potential of the robot, its generalised force and the wrench on each link, per configuration."""

    potential: list[float]
    generalized_force: Rows
    velocity_names: list[str]
    links: dict[str, LinkWrench]
    schema: int = 1


class ScenesReply(Reply):
    """The scenes that can be named."""

    scenes: list[str]
    schema: int = 1


class SceneReply(Reply):
    """A stored scene."""

    scene: Scene
    schema: int = 1


class RunSummary(Reply):
    """One line of the list of runs; `status` is RUNNING until there is a reply, `began` is in seconds since 1970."""

    run_id: str
    status: str
    robot: str
    scene: str
    began: float


class RunsReply(Reply):
    """The runs that are kept, newest first."""

    runs: list[RunSummary]
    schema: int = 1


class RunReply(Reply):
    """One run: its request, and its reply, or the error that ended it, once there is one."""

    run_id: str
    began: float
    request: PlanRequest
    reply: PlanReply | None = None
    error: ErrorReply | None = None
    schema: int = 1


class Done(Reply):
    """A command was carried out."""

    done: str
    schema: int = 1


AnyReply = (
    PlanReply
    | ForwardKinematicsReply
    | InverseKinematicsReply
    | ClearanceReply
    | PointPotentialReply
    | RobotPotentialReply
    | RobotReply
    | RobotsReply
    | ScenesReply
    | SceneReply
    | RunsReply
    | RunReply
    | Done
    | InfoReply
    | Progress
)


def as_plain_data(message: msgspec.Struct) -> Any:
    """A message as dicts, lists, strings and numbers."""
    return msgspec.to_builtins(message)


def error_reply(error: GuidefieldError) -> ErrorReply:
    """An exception as the message that stands for it on the wire; details that aren't plain data become text."""
    details = msgspec.to_builtins(error.details, enc_hook=str)
    return ErrorReply(code=int(error.code), name=error.code.name, message=error.message, details=details)
