"""The replies of the service, one Struct per request: all by this module, those about robots, scenes and runs in it.

Errors travel as `ErrorReply`; `make_error_reply` and `make_error` convert exceptions. Names, meanings and defaults of
fields are the wire. Docstrings of messages are in docs/wire.md and the schemas: after a change, `tools/wire_page`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import msgspec

from guidefield.errors import ERRORS, GuidefieldError, InternalFailure
from guidefield.messages.certify_reply import (
    Along as Along,
    CertifyReply as CertifyReply,
    LimitShares as LimitShares,
    LimitUse as LimitUse,
    MotionCertificate as MotionCertificate,
    MotionClearance as MotionClearance,
    Place as Place,
)
from guidefield.messages.execution import ExecutionFigures as ExecutionFigures, MotionDeviation as MotionDeviation
from guidefield.messages.kinematics_replies import (
    ClearanceReply as ClearanceReply,
    DynamicsReply as DynamicsReply,
    ForwardKinematicsReply as ForwardKinematicsReply,
    InverseKinematicsReply as InverseKinematicsReply,
    JacobianReply as JacobianReply,
    LinkWrench as LinkWrench,
    PointPotentialReply as PointPotentialReply,
    RobotPotentialReply as RobotPotentialReply,
)
from guidefield.messages.plan_reply import (
    CartesianUse as CartesianUse,
    CertificateFigures as CertificateFigures,
    ClearanceFigures as ClearanceFigures,
    Counters as Counters,
    EffortFigures as EffortFigures,
    EffortUse as EffortUse,
    Metrics as Metrics,
    Outcome as Outcome,
    Permission as Permission,
    PlanReply as PlanReply,
    Rows as Rows,
    SelfClearance as SelfClearance,
    Stage as Stage,
    StepFigures as StepFigures,
    Timing as Timing,
    Trajectory as Trajectory,
)
from guidefield.messages.requests import CertifyRequest, PlanRequest, Positions
from guidefield.messages.scene import Scene
from guidefield.messages.service_replies import (
    DeliveryRule as DeliveryRule,
    Disk as Disk,
    Health as Health,
    Histogram as Histogram,
    Identity as Identity,
    InfoReply as InfoReply,
    LimitInfo as LimitInfo,
    Progress as Progress,
    UserFigures as UserFigures,
)
from guidefield.messages.values import Reply


class JointInfo(Reply):
    """One joint.

    Attributes:
        name: Its name.
        kind: Its type, such as revolute or planar. A continuous joint is revolute, with whole turns that count, if one
            of its mimic joints is elsewhere after a turn: it slides, has limits, or turns half as far.
        lower, upper: Limits of its coordinates [rad or m]; null for none.
        velocity: Limits [rad/s or m/s].
        acceleration: Limits [rad/s^2 or m/s^2].
        velocity_source, acceleration_source: Sources of those limits.
        mimics: Its source joint, if it is a mimic joint; at the end of a chain of mimic joints.
        multiplier, offset: Its value is then multiplier * the source joint's, with whole turns, + offset [rad or m].
    """

    name: str
    kind: str
    lower: list[float | None]
    upper: list[float | None]
    velocity: list[float]
    acceleration: list[float]
    velocity_source: str
    acceleration_source: str
    mimics: str | None = None
    multiplier: float = 1.0
    offset: float = 0.0


class PairLeftOut(Reply):
    """A pair of links that isn't tested for collision, and the reason."""

    links: list[str]
    reason: str


class CoverInfo(Reply):
    """Bounding spheres of a shape, their largest distance beyond it [m], and the number of inscribed spheres."""

    spheres: int
    overhang: float
    inner_balls: int


class PartsInfo(Reply):
    """Convex parts that together contain a mesh, and their one-sided Hausdorff distance to it [m]."""

    count: int
    stand_off: float


class GeometryInfo(Reply):
    """One collision shape of a link, its form in collision checks, and a hull's Hausdorff distance to the mesh [m].

    Cover and parts are null until the first plan that needs them computes them.
    """

    name: str
    link: str
    shape: str
    judged_as: str
    stand_off: float = 0.0
    cover: CoverInfo | None = None
    parts: PartsInfo | None = None


class RobotReply(Reply):
    """All facts about a robot that a client needs to plan for it.

    Attributes:
        rest: Values of joints that a request leaves out.
        rest_state: Name of the SRDF's state in `rest`; null if there is none.
    """

    name: str
    joints: list[JointInfo]
    frames: list[str]
    links: list[str]
    groups: dict[str, list[str]]
    tip: str
    rest: Positions
    geometry: list[GeometryInfo]
    collision_pairs: list[list[str]]
    pairs_left_out: list[PairLeftOut]
    warnings: list[str]
    rest_state: str | None = None
    schema: int = 1


class RobotSummary(Reply):
    """One line of the list of robots; those of one family are variants. `dof` excludes mimic joints."""

    name: str
    source: str
    family: str
    dof: int | None = None
    joint_kinds: dict[str, int] = {}
    mimics: int = 0
    groups: list[str] = []
    tip: str | None = None
    problem: str | None = None


class RobotsReply(Reply):
    """All robots of the catalog and the store."""

    robots: list[RobotSummary]
    schema: int = 1


class ErrorReply(Reply):
    """An error as it travels, in ``reply_err``; the fields are those of `Outcome`."""

    code: int
    name: str
    message: str
    details: dict[str, Any] = {}


class ScenesReply(Reply):
    """The names of all scenes."""

    scenes: list[str]
    schema: int = 1


class SceneReply(Reply):
    """A scene of the package, or a stored one.

    Attributes:
        scene: The scene.
        version: Number of times that it was stored or changed; null: it is part of the package and never changes.
    """

    scene: Scene
    version: int | None = None
    schema: int = 1


class RunSummary(Reply):
    """One line of the list of runs.

    Attributes:
        run_id: Its name.
        status: Name of its final status, RUNNING until then; UNREADABLE if its file is damaged.
        robot: Name of the robot; "urdf" if it was sent. UNREADABLE, as the scene, if the request is damaged.
        scene: Name of the scene.
        began: Begin [s since 1970].
        ended: End [s since 1970]; null until then.
        message: The status in a sentence.
        bytes: Size of request, reply, recording and proof.
        recording: "rendered"; "owed" until it is rendered from the run's log, at the latest when it is read; "lost" if
            the log is damaged; "none" if there is none.
    """

    run_id: str
    status: str
    robot: str
    scene: str
    began: float
    ended: float | None = None
    message: str = ""
    bytes: int = 0
    recording: Literal["none", "owed", "rendered", "lost"] = "none"


class RunsReply(Reply):
    """The stored runs, newest first.

    Attributes:
        runs: A page of the list.
        total: The number of runs on all pages.
        next: The `after` of the next page; null: this is the last.
    """

    runs: list[RunSummary]
    total: int = 0
    next: str | None = None
    schema: int = 1


class RunReply(Reply):
    """One run.

    Attributes:
        run_id: Its name.
        began: Begin [s since 1970].
        request: The request.
        reply: The reply, once there is one.
        error: The error that ended it instead.
    """

    run_id: str
    began: float
    request: PlanRequest
    reply: PlanReply | None = None
    error: ErrorReply | None = None
    schema: int = 1


class CertifyRunReply(Reply):
    """One run of a certify request; its fields are those of `RunReply`."""

    run_id: str
    began: float
    request: CertifyRequest
    reply: CertifyReply | None = None
    error: ErrorReply | None = None
    schema: int = 1


MotionReply = PlanReply | CertifyReply
AnyRunReply = RunReply | CertifyRunReply

CERTIFY = "certify"
"""The tag of certify requests."""


class RequestTag(msgspec.Struct):
    """The tag of a request; empty in a plan request."""

    type: str = ""


class _Tagged(msgspec.Struct):
    request: RequestTag


def run_reply_kind(encoded: bytes, decode: Callable[..., Any]) -> type[AnyRunReply]:
    """Return the type of an encoded reply about a run, by its request; raises msgspec.DecodeError if it is none."""
    return CertifyRunReply if decode(encoded, type=_Tagged).request.type == CERTIFY else RunReply


def is_certify(request: bytes) -> bool:
    """Return whether JSON is a certify request; False if it can't be decoded."""
    try:
        return msgspec.json.decode(request, type=RequestTag).type == CERTIFY
    except (msgspec.DecodeError, UnicodeDecodeError):
        return False


class Done(Reply):
    """The success of a command.

    Attributes:
        done: The command in words.
        warnings: Harmless peculiarities of the stored robot or scene.
        version: New version of the stored or changed scene.
    """

    done: str
    warnings: list[str] = []
    version: int | None = None
    schema: int = 1


AnyReply = (
    PlanReply
    | CertifyReply
    | ForwardKinematicsReply
    | InverseKinematicsReply
    | ClearanceReply
    | PointPotentialReply
    | JacobianReply
    | DynamicsReply
    | RobotPotentialReply
    | RobotReply
    | RobotsReply
    | ScenesReply
    | SceneReply
    | RunsReply
    | RunReply
    | CertifyRunReply
    | Done
    | InfoReply
    | Progress
)


def to_plain_data(message: msgspec.Struct) -> Any:
    """Convert a message to dicts, lists, strings and numbers."""
    return msgspec.to_builtins(message)


def make_error_reply(error: GuidefieldError) -> ErrorReply:
    """Make the message of an exception; details that aren't plain data become text."""
    details = msgspec.to_builtins(error.details, enc_hook=str)
    return ErrorReply(code=int(error.code), name=error.code.name, message=error.message, details=details)


def make_error(reply: ErrorReply) -> GuidefieldError:
    """Make the exception of an error message, as the inverse of `make_error_reply`; unknown codes are failures."""
    kind = _ERRORS.get(reply.code, InternalFailure)
    return kind(reply.message, **reply.details)


_ERRORS = {int(code): kind for code, kind in ERRORS.items()}
