"""The replies of the service: one Struct per request, and the error that stands in for it."""

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
    CertificateFigures as CertificateFigures,
    ClearanceFigures as ClearanceFigures,
    Counters as Counters,
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
from guidefield.messages.requests import CertifyRequest, PlanRequest
from guidefield.messages.robot_replies import (
    GeometryInfo as GeometryInfo,
    JointInfo as JointInfo,
    PairLeftOut as PairLeftOut,
    RobotReply as RobotReply,
    RobotsReply as RobotsReply,
    RobotSummary as RobotSummary,
)
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


class ErrorReply(Reply):
    """An error as it travels, in ``reply_err``; the fields are those of `Outcome`."""

    code: int
    name: str
    message: str
    details: dict[str, Any] = {}


class ScenesReply(Reply):
    """The scenes that can be named."""

    scenes: list[str]
    schema: int = 1


class SceneReply(Reply):
    """A scene that can be named.

    Attributes:
        scene: The scene.
        version: How often it was stored or changed; null: it comes with the package and never changes.
    """

    scene: Scene
    version: int | None = None
    schema: int = 1


class RunSummary(Reply):
    """One line of the list of runs.

    Attributes:
        run_id: Its name.
        status: Name of the status that it ended with, RUNNING until then; UNREADABLE where its file is damaged.
        robot: Name of the robot; "urdf" where it was sent. UNREADABLE, as the scene, where the request is damaged.
        scene: Name of the scene.
        began: When [s since 1970].
        ended: When [s since 1970]; null until then.
        message: What the status says, in a sentence.
        bytes: Size of request, reply, recording and proof.
        recording: "rendered"; "owed" until it is rendered from the run's log, which asking for it does at once; "lost"
            if it can't be; "none" if there is none.
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
    """The runs that are kept, newest first.

    Attributes:
        runs: A page of the list.
        total: How many there are on all pages.
        next: What to give as `after` for the next page; null: this is the last.
    """

    runs: list[RunSummary]
    total: int = 0
    next: str | None = None
    schema: int = 1


class RunReply(Reply):
    """One run.

    Attributes:
        run_id: Its name.
        began: When [s since 1970].
        request: What was asked.
        reply: The answer, once there is one.
        error: What ended it instead.
        schema: Version of this message.
    """

    run_id: str
    began: float
    request: PlanRequest
    reply: PlanReply | None = None
    error: ErrorReply | None = None
    schema: int = 1


class CertifyRunReply(Reply):
    """One run that judged a motion; its fields are those of `RunReply`."""

    run_id: str
    began: float
    request: CertifyRequest
    reply: CertifyReply | None = None
    error: ErrorReply | None = None
    schema: int = 1


MotionReply = PlanReply | CertifyReply
AnyRunReply = RunReply | CertifyRunReply


CERTIFY = "certify"
"""The tag of requests for a judgement."""


class RequestTag(msgspec.Struct):
    """Just enough of a request to tell what it asks for: nothing stands there in a plan request."""

    type: str = ""


class _Tagged(msgspec.Struct):
    request: RequestTag


def run_reply_kind(kept: bytes, decode: Callable[..., Any]) -> type[AnyRunReply]:
    """Return the kind of run that a reply is about.

    Args:
        kept: The reply.
        decode: Takes bytes and a `type`: that of `msgspec.json` or `msgspec.msgpack`.

    Raises:
        msgspec.DecodeError: if it is no such reply.
    """
    return CertifyRunReply if decode(kept, type=_Tagged).request.type == CERTIFY else RunReply


def is_certify(request: bytes) -> bool:
    """Return whether JSON of a request asks for a judgement, as far as it can be read."""
    try:
        return msgspec.json.decode(request, type=RequestTag).type == CERTIFY
    except (msgspec.DecodeError, UnicodeDecodeError):
        return False


class Done(Reply):
    """A command was carried out.

    Attributes:
        done: Which, in words.
        warnings: What is odd but harmless about the robot or scene that was stored.
        version: Of the scene that was stored or changed, from now on.
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


def as_plain_data(message: msgspec.Struct) -> Any:
    """A message as dicts, lists, strings and numbers."""
    return msgspec.to_builtins(message)


def error_reply(error: GuidefieldError) -> ErrorReply:
    """An exception as the message that stands for it on the wire; details that aren't plain data become text."""
    details = msgspec.to_builtins(error.details, enc_hook=str)
    return ErrorReply(code=int(error.code), name=error.code.name, message=error.message, details=details)


def error_of(reply: ErrorReply) -> GuidefieldError:
    """The exception that a message stands for, the inverse of `error_reply`; InternalFailure for an unknown code."""
    kind = _ERRORS.get(reply.code, InternalFailure)
    return kind(reply.message, **reply.details)


_ERRORS = {int(code): kind for code, kind in ERRORS.items()}
